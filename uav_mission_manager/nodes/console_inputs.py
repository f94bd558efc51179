"""What the console hears of a vehicle: messages as changes of what was heard."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Header

from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.heard import Heard
from uav_mission_manager.console.messages import (
    DECISION_TOPIC,
    DIAGNOSTICS_TOPIC,
    HEARD_CHANGES,
    Moment,
    heard_after,
)
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import seconds
from uav_mission_manager.nodes.topics import TOPICS
from uav_mission_manager.nodes.vehicle_inputs import NO_EVENTS

PROFILES = {
    'odom': 'SENSOR',
    'battery_state': 'SENSOR',
    'goal_active': 'LATCHED',
    'goal_completed': 'EVENT',
    'goal_failed': 'EVENT',
    'goal_refused': 'EVENT',
    'policy_set': 'LATCHED',
    DECISION_TOPIC: 'LATCHED',
}
"""Quality of service of each topic, where it is not `STATE_IN`."""

DEPTHS = {'odom': 1, DECISION_TOPIC: 10}
"""Only where it is now is shown, but every epoch."""


def time_of_day() -> str:
    """Return the time of day, for people."""
    return datetime.now().strftime('%H:%M:%S')


class VehicleEar:
    """Listens to one vehicle."""

    def __init__(self, node: Node, fleet: Fleet, vehicle: str) -> None:
        self._node, self._fleet, self._vehicle = node, fleet, vehicle
        fleet.heard[vehicle] = Heard()
        for topic in HEARD_CHANGES:
            if topic != DIAGNOSTICS_TOPIC:
                profile = getattr(qos, PROFILES.get(topic, 'STATE_IN'))
                profile.depth = DEPTHS.get(topic, profile.depth)
                self._listen(topic, profile)

    def _listen(self, topic: str, profile: Any) -> None:
        def heard(message: Any) -> None:
            self._take(topic, message, getattr(message, 'header', None))

        self._node.create_subscription(
            TOPICS[topic],
            f'{self._vehicle}/{topic}',
            heard,
            profile,
            event_callbacks=NO_EVENTS,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def take_diagnostics(self, header: Header, status: DiagnosticStatus) -> None:
        """Note what the bridge says of itself."""
        self._take(DIAGNOSTICS_TOPIC, status, header)

    def take_share(self, words: str) -> None:
        """Note which goal the base station of several vehicles gives this one, and why."""
        heard = self._fleet.heard[self._vehicle]
        self._fleet.heard[self._vehicle] = heard.with_share(words, time_of_day())

    def _take(self, topic: str, message: Any, header: Header | None) -> None:
        moment = Moment(self._made_at(header), time_of_day())
        before = self._fleet.heard[self._vehicle]
        self._fleet.heard[self._vehicle] = heard_after(before, topic, message, moment)

    def _made_at(self, header: Header | None) -> float:
        """When a message was made, by the clock of the fleet; now, where it does not say."""
        now = self._fleet.clock()
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 if header else 0.0
        return now - max(seconds(self._node.get_clock()) - stamp, 0.0) if stamp else now
