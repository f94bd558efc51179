"""What the console hears of a vehicle: messages as changes of what was heard."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Header, String, UInt8MultiArray

from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.heard import (
    Heard,
    LogLine,
    Pose,
    bridge_from,
    decision_from,
)
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import seconds
from uav_mission_manager.nodes.frames import MAP_FRAME
from uav_mission_manager.nodes.vehicle_inputs import NO_EVENTS

HeardChange = Callable[[Heard, Any], Heard]
"""How a message changes what is known; raises `ValueError` where it cannot be believed."""


class VehicleEar:
    """Listens to one vehicle."""

    def __init__(self, node: Node, fleet: Fleet, vehicle: str) -> None:
        self._node, self._fleet, self._vehicle = node, fleet, vehicle
        fleet.heard[vehicle] = Heard()
        sensor, latched, state, event = qos.SENSOR, qos.LATCHED, qos.STATE_IN, qos.EVENT
        sensor.depth = 1  # Only where it is now is shown ..
        decisions = qos.LATCHED
        decisions.depth = 10  # .. but every epoch.
        self._listen('odom', Odometry, sensor, self._with_odometry)
        self._listen('battery_state', BatteryState, qos.SENSOR, self._with_battery)
        self._listen('fault_mode', String, state, self._with_fault)
        self._listen('threat_level', String, state, self._with_threat)
        self._listen('goal_priorities', UInt8MultiArray, state, self._with_asked)
        self._listen('goal_completed', String, event, self._told('completed'))
        self._listen('goal_refused', String, event, self._told('out of reach', 'warning'))
        self._listen('policy_set', String, latched, self._told('new policy set'))
        self._listen('manager/decision', DiagnosticArray, decisions, self._with_decision)

    def _listen(self, topic: str, kind: Any, profile: Any, change: HeardChange) -> None:
        def heard(message: Any) -> None:
            self.take(topic, message, change)

        self._node.create_subscription(
            kind,
            f'{self._vehicle}/{topic}',
            heard,
            profile,
            event_callbacks=NO_EVENTS,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def take(self, topic: str, message: Any, change: HeardChange) -> None:
        """Note what a message says; one that cannot be believed is told."""
        before = self._fleet.heard[self._vehicle]
        try:
            after = change(before, message)
        except ValueError as error:
            after = before.with_line(LogLine(time_of_day(), f'{topic}: {shown(error)}', 'warning'))
        self._fleet.heard[self._vehicle] = after

    def take_diagnostics(self, header: Header, status: DiagnosticStatus) -> None:
        """Note what the bridge says of itself."""
        values = {pair.key: pair.value for pair in status.values}

        def change(heard: Heard, _: Any) -> Heard:
            bridge = bridge_from(status.message, values)
            return heard.with_bridge(bridge, self._at(header), time_of_day())

        self.take('/diagnostics', status, change)

    def _at(self, header: Header | None = None) -> float:
        """When a message was made, by the clock of the fleet; now, where it does not say."""
        now = self._fleet.clock()
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 if header else 0.0
        return now - max(seconds(self._node.get_clock()) - stamp, 0.0) if stamp else now

    def _with_odometry(self, heard: Heard, message: Odometry) -> Heard:
        if message.header.frame_id not in ('', MAP_FRAME):
            raise ValueError(f'frame_id {quoted(message.header.frame_id)} is not {MAP_FRAME!r}')
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        yaw = math.atan2(
            2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2)
        )
        pose = Pose(place.x, place.y, place.z, math.pi / 2.0 - yaw)
        return heard.with_pose(pose, self._at(message.header))

    def _with_battery(self, heard: Heard, message: BatteryState) -> Heard:
        return heard.with_battery(message.location, message.percentage, self._at(message.header))

    def _with_fault(self, heard: Heard, message: String) -> Heard:
        if message.data not in FAULT_MODES:
            raise ValueError(f'{quoted(message.data)} is no fault mode')
        return heard.with_fault(message.data, self._at(), time_of_day())

    def _with_threat(self, heard: Heard, message: String) -> Heard:
        if message.data not in THREAT_LEVELS:
            raise ValueError(f'{quoted(message.data)} is no threat level')
        return heard.with_threat(message.data, self._at(), time_of_day())

    def _with_asked(self, heard: Heard, message: UInt8MultiArray) -> Heard:
        return heard.with_asked(tuple(message.data), self._at(), time_of_day())

    def _told(self, what: str, level: str = '') -> HeardChange:
        return lambda heard, message: heard.with_line(
            LogLine(time_of_day(), f'{what}: {message.data}', level)
        )

    def _with_decision(self, heard: Heard, message: DiagnosticArray) -> Heard:
        for status in message.status:
            decision = decision_from(
                status.message, {pair.key: pair.value for pair in status.values}
            )
            heard = heard.with_decision(decision, self._at(message.header), time_of_day())
        return heard


def time_of_day() -> str:
    """Return the time here, for people."""
    return datetime.now().strftime('%H:%M:%S')
