"""What the manager hears: messages of ROS as inputs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.clock import Clock
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Header, String, UInt8MultiArray

from uav_mission_manager.console.heard import Pose
from uav_mission_manager.console.messages import pose_of
from uav_mission_manager.echo import quoted
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import seconds
from uav_mission_manager.onboard import InputError
from uav_mission_manager.onboard.heard_input import HeardInput
from uav_mission_manager.onboard.stamps import stamp_age

Values = Callable[[Any], dict[str, Any]]
"""What a message says, as the arguments of the method of `Situation` that takes it; may raise
`InputError`."""

Taken = Callable[[str, Callable[[], HeardInput]], None]
"""Takes what came on a topic: what reads it, and raises `InputError` where it cannot be."""

HEALTHY = (
    BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN,
    BatteryState.POWER_SUPPLY_HEALTH_GOOD,
)
"""Health of a battery that is taken at its percentage; many senders do not know the health."""

LONGEST_LABEL = 200
"""Characters of an id, at most: a choice; ids are kept, and written to the journal."""

REMEMBERED_STAMPS = 16
"""Messages by which one that comes twice is known again: a choice, more than are under way."""


GRAPH_PERIOD = 1.0
"""Time [s] between two looks for senders that latch: a choice, within the time of listening."""

NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""For a second subscription, that does not suit all senders and need not."""


class TakenOnce:
    """Knows a message again that two subscriptions of a topic both get, by its time of sending."""

    def __init__(self) -> None:
        self._recent: deque[int] = deque(maxlen=REMEMBERED_STAMPS)
        self._last = 0

    def again(self, stamp: int) -> bool:
        """Whether the message sent at `stamp` [ns] was taken, and none that was sent later."""
        again = stamp in self._recent and stamp <= self._last
        if not again:
            self._recent.append(stamp)
            self._last = stamp
        return again


class VehicleInputs:
    """Subscribes to all that changes the situation.

    Parameters
    ----------
    node : Node
    take : callable
        Is given what reads each message, with its topic.
    clock : Clock
        That of the situation's times.
    timeout : float
        Age [s] above which the stamp of a message is not believed.

    Attributes
    ----------
    timeout : float
    pose : Pose or None
        The last one heard that was believed.
    """

    def __init__(self, node: Node, take: Taken, clock: Clock, timeout: float) -> None:
        self._node, self._take, self._clock = node, take, clock
        self.timeout = timeout
        self.pose: Pose | None = None
        self._unlatched: dict[str, tuple[Any, Any]] = {}
        self._stamped('battery_state', BatteryState, _battery)
        self._stamped('odom', Odometry, self._position)
        self._state('fault_mode', String, _name)
        self._state('threat_level', String, _name)
        self._state('goal_priorities', UInt8MultiArray, _priorities)
        self._event('goal_completed')
        self._event('goal_refused')
        node.create_timer(GRAPH_PERIOD, self._hear_latched, clock=clock)

    def _stamped(self, topic: str, kind: Any, values: Values) -> None:
        def heard(message: Any) -> None:
            def read() -> HeardInput:
                age = self._age(topic, message.header)
                return HeardInput(topic, seconds(self._clock) - age, values(message))

            self._take(topic, read)

        self._subscribe(topic, kind, heard, qos.SENSOR)

    def _state(self, topic: str, kind: Any, values: Values) -> None:
        """Hear both who repeats and who latches; what comes both ways is taken once."""
        once = TakenOnce()

        def heard(message: Any, info: dict[str, int]) -> None:
            if not once.again(info['source_timestamp']):
                self._take(topic, partial(self._read, topic, values, message))

        self._subscribe(topic, kind, heard, qos.STATE_IN)
        self._unlatched[topic] = kind, heard

    def _hear_latched(self) -> None:
        """Hear what was latched before the start, too, where someone latches.

        Not from the first: everyone who does not latch would be warned of it.
        """
        for topic, (kind, heard) in list(self._unlatched.items()):
            senders = self._node.get_publishers_info_by_topic(topic)
            if any(
                sender.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                for sender in senders
            ):
                del self._unlatched[topic]
                self._node.create_subscription(
                    kind, topic, heard, qos.LATCHED, event_callbacks=NO_EVENTS
                )

    def _event(self, topic: str) -> None:
        def heard(message: Any) -> None:
            self._take(topic, partial(self._read, topic, _name, message))

        self._subscribe(topic, String, heard, qos.EVENT)

    def _subscribe(self, topic: str, kind: Any, heard: Any, profile: QoSProfile) -> None:
        self._node.create_subscription(
            kind, topic, heard, profile, qos_overriding_options=qos.OVERRIDABLE
        )

    def _read(self, topic: str, values: Values, message: Any) -> HeardInput:
        return HeardInput(topic, seconds(self._clock), values(message))

    def _position(self, message: Odometry) -> dict[str, Any]:
        if message.header.frame_id not in ('', MAP_FRAME):
            frame = quoted(message.header.frame_id)
            raise InputError(f'odom: frame_id {frame} is not {MAP_FRAME!r}')
        pose = pose_of(message)
        if math.isfinite(pose.east) and math.isfinite(pose.north):
            self.pose = pose
        return {'east': pose.east, 'north': pose.north}

    def _age(self, topic: str, header: Header) -> float:
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9
        return stamp_age(topic, stamp, seconds(self._node.get_clock()), self.timeout)


def _battery(message: BatteryState) -> dict[str, Any]:
    name = ' '.join(filter(None, (message.location, message.serial_number)))
    return {
        'percentage': message.percentage,
        'healthy': message.power_supply_health in HEALTHY,
        'voltage': message.voltage,
        'current': message.current,
        'capacity': message.capacity,
        'battery': _label('battery_state', name),
    }


def _name(message: String) -> dict[str, Any]:
    return {'name': message.data}


def _priorities(message: UInt8MultiArray) -> dict[str, Any]:
    request = message.layout.dim[0].label if message.layout.dim else ''
    return {'values': message.data, 'request': _label('goal_priorities', request)}


def _label(topic: str, text: str) -> str:
    if len(text) > LONGEST_LABEL:
        raise InputError(f'{topic}: an id of {len(text):,} characters, more than {LONGEST_LABEL}')
    return text
