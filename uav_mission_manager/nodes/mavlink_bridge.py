"""The bridge between the mission manager and an ArduCopter: telemetry up, commands down."""

from __future__ import annotations

import math
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState, NavSatFix
from std_msgs.msg import Header, String, UInt8MultiArray
from std_srvs.srv import Trigger

from uav_mission_manager.autopilot.bridge import WARNING_PHASES, VehicleBridge
from uav_mission_manager.autopilot.faults import FIX_3D, Fault, FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import PilotOutput, Settings
from uav_mission_manager.autopilot.vehicle import mode_name
from uav_mission_manager.mdp import FAULT_MODES, load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.conversions import battery_state, nav_sat_fix, odometry
from uav_mission_manager.nodes.flight_plan import FlightPlan
from uav_mission_manager.nodes.frames import MAP_FRAME
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.reporting import status
from uav_mission_manager.nodes.runtime import run_node, safety_clock
from uav_mission_manager.onboard import parse_command

POLL_PERIOD = 0.05
"""Time [s] between two looks at the link, and two steps of the pilot: a choice, 20 Hz."""

FAULT_REPEAT_PERIOD = 0.5
"""Time [s] after which an unchanged fault mode is published again: a choice, well within the time
after which the manager misses it."""

DEFAULT_SETTINGS = Settings()
"""Defaults of the flight parameters."""


def _flight(name: str, description: str, minimum: float, maximum: float) -> NodeParameter:
    return NodeParameter(name, getattr(DEFAULT_SETTINGS, name), description, minimum, maximum)


PARAMETERS = (
    NodeParameter('mission', '', 'Mission file', path=True, example='config/case_study.yaml'),
    NodeParameter('connection', 'udpin:127.0.0.1:14550', 'pymavlink connection string'),
    NodeParameter('source_system', 1, 'MAVLink system id of the bridge', 1, 255),
    NodeParameter('source_component', 191, 'MAVLink component id of the bridge', 1, 255),
    NodeParameter(
        'target_system', 1, 'MAVLink system id of the vehicle; 0 is the first one heard', 0, 255
    ),
    NodeParameter(
        'link_timeout', 3.0, 'Time without a heartbeat after which the link is lost [s]', 0.5, 60.0
    ),
    NodeParameter(
        'effectiveness_threshold',
        0.85,
        'Effectiveness below which a motor has failed: the command that a healthy one would need '
        'for the same thrust, as a fraction of its own',
        0.0,
        1.0,
    ),
    _flight('flight_altitude', "Flight height above the mission file's ground [m]", 2.0, 500.0),
    _flight('cruise_speed', 'Speed in normal mode [m/s]', 0.1, 50.0),
    _flight('agile_speed', 'Speed in agile mode [m/s]', 0.1, 50.0),
    _flight('acceptance_radius', 'Largest distance from a destination on site [m]', 0.1, 1000.0),
    _flight('goal_dwell', 'Time on site until a goal is completed [s]', 0.0, 3600.0),
    _flight('service_time', 'Time landed in the service cell until a repair [s]', 0.0, 3600.0),
    _flight('manager_timeout', 'Time without mission command until it holds [s]', 1.5, 600.0),
    _flight('rtl_delay', 'Time of holding until it returns to launch [s]', 0.0, 3600.0),
    _flight(
        'progress_timeout',
        'Time without getting nearer until a destination counts as out of reach [s]',
        1.0,
        3600.0,
    ),
    _flight(
        'datum_tolerance',
        "Largest distance from the mission file's ground to take off from [m]",
        0.5,
        1000.0,
    ),
    NodeParameter(
        'allow_arming',
        DEFAULT_SETTINGS.allow_arming,
        'Whether the bridge may arm the vehicle and take off',
    ),
    LISTENING,
)


class MavlinkBridge(Node):
    """Publishes what the vehicle says and flies what the manager commands.

    The destination of a command comes from the bridge's own mission file. A `command_pose` in
    another cell says that the manager has another mission; its commands are then refused.
    """

    def __init__(self) -> None:
        super().__init__('mavlink_bridge')
        p = declare(self, PARAMETERS)
        self._safety_clock = safety_clock(self)
        self._mission = load_mission(p.mission)
        try:
            self._plan = FlightPlan(self._mission, p.flight_altitude)
        except ValueError as error:
            raise ValueError(f'{p.mission}: {error}') from error
        self._command_timeout = p.manager_timeout
        grid = self._mission.grid
        settings = Settings(
            landed_radius=max(p.acceptance_radius, grid.cell_size / 2.0),
            reach=2.0 * math.hypot(grid.rows, grid.cols) * grid.cell_size,
            **{name: value for name, value in vars(p).items() if hasattr(DEFAULT_SETTINGS, name)},
        )
        self._bridge = VehicleBridge(
            AutopilotLink(
                p.connection,
                source_system=p.source_system,
                source_component=p.source_component,
                target_system=p.target_system,
                timeout=p.link_timeout,
            ),
            Pilot(settings, self._plan.ground),
            FaultEstimator(p.effectiveness_threshold),
        )
        self._pose_cell: int | None = None
        self._command = self._received = self._complaint = ''
        self._posed_at = self._commanded_at = self._goals_at = -math.inf
        self._fault: Fault | None = None
        self._fault_at = -math.inf
        self._connect()
        self._presence = Presence(self, 'mavlink_bridge', p.listening_time)

    def _connect(self) -> None:
        def publisher(kind: Any, topic: str, profile: Any) -> Any:
            return self.create_publisher(
                kind, topic, profile, qos_overriding_options=qos.OVERRIDABLE
            )

        self._battery_state = publisher(BatteryState, 'battery_state', qos.SENSOR)
        self._odom = publisher(Odometry, 'odom', qos.SENSOR)
        self._global_position = publisher(NavSatFix, 'global_position', qos.SENSOR)
        self._fault_mode = publisher(String, 'fault_mode', qos.STATE_IN)
        self._goal_completed = publisher(String, 'goal_completed', qos.EVENT)
        self._goal_refused = publisher(String, 'goal_refused', qos.EVENT)
        self._diagnostics = publisher(DiagnosticArray, '/diagnostics', qos.RELIABLE)
        # The manager publishes goals and pose before the command. Where all have arrived, the
        # subscription made first is served first.
        inputs: tuple[tuple[Any, str, Any], ...] = (
            (UInt8MultiArray, 'goal_states', self._on_goals),
            (PoseStamped, 'command_pose', self._on_pose),
            (String, 'mission_command', self._on_command),
        )
        for kind, topic, callback in inputs:
            self.create_subscription(
                kind, topic, callback, qos.LATCHED, qos_overriding_options=qos.OVERRIDABLE
            )
        self.create_service(Trigger, '~/hold', self._on_hold)
        self.create_service(Trigger, '~/resume', self._on_resume)
        self.create_timer(POLL_PERIOD, self._poll, clock=self._safety_clock)
        self.create_timer(1.0, self._diagnose, clock=self._safety_clock)

    def destroy_node(self) -> None:
        """Close the link too."""
        self._bridge.link.close()
        super().destroy_node()

    def _now(self) -> float:
        return self._safety_clock.now().nanoseconds * 1e-9

    # In: manager and operator

    def _on_command(self, message: String, info: dict[str, int]) -> None:
        age = (info['received_timestamp'] - info['source_timestamp']) * 1e-9
        if age > self._command_timeout:  # Latched by a manager that is silent by now.
            self._log(True, f'mission_command {message.data!r} ignored: {age:.1f} s old')
            return
        repeated, self._received = message.data == self._received, message.data
        try:
            action = parse_command(self._mission, message.data)
        except ValueError as error:
            self._refuse(f'{error}; keeping {self._command or "no command"!r}')
            return
        now = self._now()
        posed = now - self._posed_at <= self._command_timeout
        if self._pose_cell == action.destination if posed else repeated:
            self._complaint, self._command, self._commanded_at = '', message.data, now
            self._bridge.pilot.command(self._plan.task(action, message.data), now)
        elif repeated:  # Else the pose may still be on its way.
            self._refuse(
                'command_pose is not the destination of mission_command in '
                f'{self._mission.name}: the manager has another mission; not flown'
            )

    def _on_pose(self, message: PoseStamped) -> None:
        if message.header.frame_id == MAP_FRAME:
            grid, point = self._mission.grid, message.pose.position
            inside = grid.contains(point.x, point.y)
            self._pose_cell = grid.cell_at(point.x, point.y) if inside else None
            self._posed_at = self._now()

    def _on_goals(self, message: UInt8MultiArray) -> None:
        self._bridge.pilot.goals_wanted = any(message.data)
        self._goals_at = self._now()

    def _refuse(self, complaint: str) -> None:
        if complaint != self._complaint:
            self.get_logger().error(complaint)
        self._complaint = complaint

    def _on_hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._bridge.hold(self._now())
        return response

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self._bridge.resume(self._now())
        return response

    # Out: vehicle

    def _poll(self) -> None:
        now = self._now()
        if self._presence.silent:
            self._bridge.link.poll(now)  # and drop it: it will be out of date
            return
        if now - self._goals_at > self._command_timeout:
            self._bridge.pilot.goals_wanted = None
        step = self._bridge.step(now)
        for warning, text in step.log:
            self._log(warning, text)
        self._report_goals(step.pilot)
        stamp = self.get_clock().now().to_msg()
        if step.battery:
            self._battery_state.publish(battery_state(step.battery, stamp))
        if step.position:
            has_fix = (self._bridge.telemetry.fix_type or 0) >= FIX_3D
            self._odom.publish(odometry(step.position, self._plan.origin, stamp))
            self._global_position.publish(nav_sat_fix(step.position, has_fix, stamp))
        self._report_fault(step.fault, now)

    def _report_goals(self, output: PilotOutput) -> None:
        if output.completed:
            self._goal_completed.publish(String(data=output.completed))
            self._log(False, f'goal {output.completed} completed')
        if output.refused:
            goals = [goal.name for goal in self._mission.goals]
            lost = goals if output.losing_ground else [output.refused]
            for goal in lost:
                self._goal_refused.publish(String(data=goal))
            self._log(True, f'out of reach: {", ".join(lost)}')

    def _report_fault(self, fault: Fault | None, now: float) -> None:
        if fault is not None and (
            fault != self._fault or now - self._fault_at >= FAULT_REPEAT_PERIOD
        ):
            self._fault_mode.publish(String(data=FAULT_MODES[fault]))
            self._fault_at = now
        if fault not in (None, self._fault):
            self._log(bool(fault), f'fault mode {FAULT_MODES[fault or 0]}')
        self._fault = fault

    def _log(self, warning: bool, text: str) -> None:
        # rclpy refuses a call site that changes its severity: one for each.
        if warning:
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)

    def _diagnose(self) -> None:
        if self._presence.silent:
            return
        link, output = self._bridge.link, self._bridge.output
        warnings = tuple(filter(None, (self._complaint, *self._bridge.warnings)))
        level = DiagnosticStatus.WARN
        if not link.up:
            level = DiagnosticStatus.ERROR
        elif output.phase not in WARNING_PHASES and not warnings:
            level = DiagnosticStatus.OK
        report = status(
            level,
            f'{self.get_fully_qualified_name()}: autopilot',
            '; '.join((f'{output.phase.value}: {output.status}', *warnings)),
            **self._facts(),
        )
        report.hardware_id = f'MAVLink system {link.target_system}'
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(DiagnosticArray(header=header, status=[report]))

    def _facts(self) -> dict[str, object]:
        """Return the values of the diagnostics."""
        bridge = self._bridge
        link, telemetry = bridge.link, bridge.telemetry
        age = self._now() - self._commanded_at
        return {
            'link': 'up' if link.up else 'lost',
            'link_error': link.error,
            'system': link.target_system,
            'vehicle': link.vehicle,
            'others_heard': '; '.join(link.others),
            'mode': mode_name(telemetry.mode),
            'armed': telemetry.armed,
            'phase': bridge.output.phase.value,
            'command': self._command,
            'command_refused': self._complaint,
            'command_age': f'{age:.1f}' if self._command else '',
            'fault_mode': '' if self._fault is None else FAULT_MODES[self._fault],
            'motor_effectiveness': ' '.join(f'{e:.2f}' for e in bridge.faults.effectiveness),
            **{f'refused {name}': why for name, why in link.refused.items()},
        }


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MavlinkBridge, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
