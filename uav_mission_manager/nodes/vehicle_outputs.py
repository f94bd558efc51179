"""What the bridge publishes about its vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState, NavSatFix
from std_msgs.msg import String

from uav_mission_manager.autopilot.bridge import BridgeStep
from uav_mission_manager.autopilot.faults import FIX_3D, Fault
from uav_mission_manager.autopilot.task import PilotOutput
from uav_mission_manager.autopilot.telemetry import Position
from uav_mission_manager.echo import shown
from uav_mission_manager.frames import body_frame
from uav_mission_manager.mdp import FAULT_MODES, Origin
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.conversions import (
    battery_state,
    nav_sat_fix,
    odometry,
    transform,
)
from uav_mission_manager.nodes.topics import TFMessage

FAULT_REPEAT_PERIOD = 0.5
"""Time [s] after which an unchanged fault mode is published again: a choice, well within the time
after which the manager misses it."""


class VehicleOutputs:
    """Battery, position, faults, where another program is to work, and what became of goals.

    Parameters
    ----------
    node : Node
    origin : Origin
        Of `map`.
    goals : callable
        Returns the names of the mission's goals.
    log : callable
        Takes whether a line is a warning, and the line.

    Attributes
    ----------
    refused : str
        The last goal that was refused, and why.
    """

    def __init__(
        self,
        node: Node,
        origin: Origin,
        goals: Callable[[], Sequence[str]],
        log: Callable[[bool, str], None],
    ) -> None:
        def publisher(kind: Any, topic: str, profile: Any) -> Any:
            return node.create_publisher(
                kind, topic, profile, qos_overriding_options=qos.OVERRIDABLE
            )

        self._node, self._origin, self._goals, self._log = node, origin, goals, log
        self._frame = body_frame(node.get_namespace())
        self._battery_state = publisher(BatteryState, 'battery_state', qos.SENSOR)
        self._odom = publisher(Odometry, 'odom', qos.SENSOR)
        self._global_position = publisher(NavSatFix, 'global_position', qos.SENSOR)
        self._tf = TFMessage and publisher(TFMessage, '/tf', qos.TRANSFORMS)
        self._fault_mode = publisher(String, 'fault_mode', qos.STATE_IN)
        self._goal_completed = publisher(String, 'goal_completed', qos.EVENT)
        self._goal_refused = publisher(String, 'goal_refused', qos.EVENT)
        self._goal_active = publisher(String, 'goal_active', qos.LATCHED)
        self._active: str | None = None
        self.refused = ''
        self._activate('')
        self._fault: Fault | None = None
        self._fault_at = -math.inf

    @property
    def fault_mode(self) -> str:
        """The fault mode, '' while it is not known."""
        return '' if self._fault is None else FAULT_MODES[self._fault]

    def publish(self, step: BridgeStep, fix_type: int | None, now: float) -> None:
        """Publish what a step brought."""
        self._report_goals(step.pilot)
        self._activate(step.pilot.active)
        stamp = self._node.get_clock().now().to_msg()
        for number, battery in step.batteries.items():
            self._battery_state.publish(battery_state(number, battery, stamp))
        if step.position:
            self._locate(step.position, (fix_type or 0) >= FIX_3D, stamp)
        self._report_fault(step.fault, now)

    def _locate(self, position: Position, has_fix: bool, stamp: Time) -> None:
        odom = odometry(position, self._origin, self._frame, stamp)
        self._odom.publish(odom)
        self._global_position.publish(nav_sat_fix(position, has_fix, self._frame, stamp))
        if self._tf:
            self._tf.publish(TFMessage(transforms=[transform(odom)]))

    def close(self) -> None:
        """Say that nobody is to work any more."""
        self._activate('')

    def _report_goals(self, output: PilotOutput) -> None:
        if output.completed:
            self._goal_completed.publish(String(data=output.completed))
            self._log(False, f'goal {output.completed} completed')
        if output.refused:
            lost = self._goals() if output.losing_ground else [output.refused]
            for goal in lost:
                self._goal_refused.publish(String(data=goal))
            self.refused = shown(f'{", ".join(lost)}: {output.status}')
            self._log(True, f'refused: {self.refused}')

    def _activate(self, goal: str) -> None:
        if goal != self._active:
            self._active = goal
            self._goal_active.publish(String(data=goal))

    def _report_fault(self, fault: Fault | None, now: float) -> None:
        if fault is not None and (
            fault != self._fault or now - self._fault_at >= FAULT_REPEAT_PERIOD
        ):
            self._fault_mode.publish(String(data=FAULT_MODES[fault]))
            self._fault_at = now
        if fault not in (None, self._fault):
            self._log(bool(fault), f'fault mode {FAULT_MODES[fault or 0]}')
        self._fault = fault
