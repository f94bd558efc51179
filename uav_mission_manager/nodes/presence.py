"""Presence: one node of a role in a namespace, the one that has been active longest.

Each says on `presence/ROLE` who it is and for how long it has been up: `ID UPTIME`, the uptime in
seconds. Only what is heard counts: a node that was killed stays in ROS's graph for a while.
"""

from __future__ import annotations

import math
import os
import socket
import time
import uuid

from rclpy.node import Node
from std_msgs.msg import String

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.complaints import Complaints
from uav_mission_manager.nodes.failures import FatalError
from uav_mission_manager.nodes.parameters import NodeParameter

PRESENCE_PERIOD = 0.5
"""Time [s] between two messages of a node: a choice, soon enough before a second one does harm."""

TIE = 0.2
"""Difference of uptimes [s] up to which the smaller id goes on: a choice, well above the time that
a message takes, by which each of two nodes thinks the other one younger."""

LISTENING = NodeParameter(
    'listening_time',
    3.0,
    'Time at the start in which it only listens for another one of its kind [s]',
    0.0,
    60.0,
)
"""Parameter of every node of which there may be one. The default is a choice: nodes on one machine
have found each other after 2.6 s at most, as measured."""

ANSWER_PERIOD = 0.1
"""Time [s] between two answers to younger nodes, at least: a choice, however many there are."""

FAREWELL_TIME = 1.0
"""Time [s] for which a second node stays, silent, for the first one to hear and report it: a
choice, two periods."""


class Presence:
    """Says that a node is there, and ends it when another of its role was there before.

    While it is `silent`, a node shall publish nothing of its own: another may see it otherwise.
    Make it after all that is slow in a constructor: what has waited is out of date.

    Parameters
    ----------
    node : Node
        Its namespace is that of the vehicle that may have one such node.
    role : str
        What there may be one of, such as `manager`.
    listening_time : float
        Time [s] from now for which it is silent.
    vehicle : str, optional
        Namespace of the vehicle, where that is not the node's.
    """

    def __init__(
        self, node: Node, role: str, listening_time: float, vehicle: str | None = None
    ) -> None:
        self._node, self._role = node, role
        self._place = node.get_namespace() if vehicle is None else vehicle
        self._id = f'{socket.gethostname()}:{os.getpid()}:{uuid.uuid4().hex[:8]}'
        self._complaints = Complaints(lambda text: node.get_logger().warning(text))
        self._start = time.monotonic()
        self._silent_until = self._start + listening_time
        self._heard_older, self._why = math.inf, ''
        topic = f'presence/{role}' if vehicle is None else f'{vehicle}/presence/{role}'
        self._publisher = node.create_publisher(
            String, topic, qos.EVENT, qos_overriding_options=qos.OVERRIDABLE
        )
        node.create_subscription(
            String, topic, self._on_presence, qos.EVENT, qos_overriding_options=qos.OVERRIDABLE
        )
        node.create_timer(PRESENCE_PERIOD, self._tick, clock=safety_clock())
        self._publish()

    @property
    def silent(self) -> bool:
        """Whether another node is there, or may be there and has not been heard yet."""
        return bool(self._why) or time.monotonic() < self._silent_until

    @property
    def _uptime(self) -> float:
        return time.monotonic() - self._start

    def _tick(self) -> None:
        self._publish()
        self._complaints.flush()
        if time.monotonic() - self._heard_older > FAREWELL_TIME:
            raise FatalError(self._why)

    def _publish(self) -> None:
        self._published_at = time.monotonic()
        self._publisher.publish(String(data=f'{self._id} {self._uptime:.3f}'))

    def _on_presence(self, message: String) -> None:
        """Give way to an older node; tell a younger one at once, as its period may be over."""
        other, _, text = message.data.rpartition(' ')
        if other == self._id or self._why:
            return
        name, place = shown(other), self._place
        try:
            older_by = float(text) - self._uptime
        except ValueError:
            older_by = math.nan
        if not math.isfinite(older_by):
            self._complaints.add(
                'form', f'presence/{self._role}: {quoted(message.data)} is not ID UPTIME'
            )
        elif older_by > TIE or (older_by >= -TIE and other < self._id):
            self._heard_older = time.monotonic()
            self._why = (
                f'another {self._role} is in {place}: {name}, up for '
                f'{float(text):.1f} s; there may be one, so this one ends'
            )
        else:
            self._complaints.add(
                'second', f'a second {self._role} in {place}: {name}; it shall end'
            )
            if time.monotonic() - self._published_at > ANSWER_PERIOD:
                self._publish()
