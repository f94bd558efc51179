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
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

from uav_mission_manager.autopilot.faults import FIX_3D, Fault, FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import NO_POSITION_TO_HOLD, Pilot
from uav_mission_manager.autopilot.task import NO_HEARTBEAT, FlightTask, Phase, Settings
from uav_mission_manager.autopilot.telemetry import Telemetry, forget, update
from uav_mission_manager.autopilot.vehicle import commands, mode_name
from uav_mission_manager.mdp import FAULT_MODES, Action, ActionKind, Mission, Origin, load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.conversions import battery_state, nav_sat_fix, odometry
from uav_mission_manager.nodes.frames import MAP_FRAME
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.reporting import status
from uav_mission_manager.nodes.runtime import run_node, safety_clock
from uav_mission_manager.onboard import parse_command
from uav_mission_manager.paths import share_directory

POLL_PERIOD = 0.05
"""Time [s] between two looks at the link, and two steps of the pilot: a choice, 20 Hz."""

FAULT_REPEAT_PERIOD = 0.5
"""Time [s] after which an unchanged fault mode is published again: a choice, well within the time
after which the manager misses it."""

CAMERA_COMPONENT = 100
"""MAV_COMP_ID_CAMERA, the component whose heartbeat says that the camera works."""

WARNING_SEVERITY = 4
"""MAV_SEVERITY_WARNING: texts of this severity or worse (lower numbers) are logged as warnings."""

WARNING_PHASES = (Phase.NO_LINK, Phase.PILOT, Phase.HOLDING, Phase.RETURNING)
"""Phases in which the manager's commands are not flown."""

DEFAULT_SETTINGS = Settings()
"""Defaults of the flight parameters."""


def _flight(name: str, description: str, minimum: float, maximum: float) -> NodeParameter:
    return NodeParameter(name, getattr(DEFAULT_SETTINGS, name), description, minimum, maximum)


PARAMETERS = (
    NodeParameter('mission', '', 'Mission file; empty is the shipped case study'),
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
        'Effectiveness below which a motor has failed: its thrust, compared with that of the '
        'others at the same PWM (fraction)',
        0.0,
        1.0,
    ),
    _flight('flight_altitude', 'Flight height above home [m]', 2.0, 500.0),
    _flight('cruise_speed', 'Speed in normal mode [m/s]', 0.1, 50.0),
    _flight('agile_speed', 'Speed in agile mode [m/s]', 0.1, 50.0),
    _flight('acceptance_radius', 'Largest distance from a destination on site [m]', 0.1, 1000.0),
    _flight('goal_dwell', 'Time on site until a goal is completed [s]', 0.0, 3600.0),
    _flight('service_time', 'Time landed in the service cell until a repair [s]', 0.0, 3600.0),
    _flight('manager_timeout', 'Time without mission command until it holds [s]', 1.5, 600.0),
    _flight('rtl_delay', 'Time of holding until it returns to launch [s]', 0.0, 3600.0),
    NodeParameter(
        'allow_arming',
        DEFAULT_SETTINGS.allow_arming,
        'Whether the bridge may arm the vehicle and take off',
    ),
)


class MavlinkBridge(Node):
    """Publishes what the vehicle says and flies what the manager commands.

    The destination of a command comes from the bridge's own mission file. A `command_pose` in
    another cell says that the manager has another mission; its commands are then refused.
    """

    def __init__(self) -> None:
        super().__init__('mavlink_bridge')
        p = declare(self, PARAMETERS)
        path = p.mission or share_directory() / 'config' / 'case_study.yaml'
        self._safety_clock = safety_clock(self)
        self._mission = load_mission(path)
        self._origin = _origin(self._mission, path)
        self._command_timeout = p.manager_timeout
        grid = self._mission.grid
        self._pilot = Pilot(
            Settings(
                landed_radius=max(p.acceptance_radius, grid.cell_size / 2.0),
                reach=2.0 * math.hypot(grid.rows, grid.cols) * grid.cell_size,
                **{
                    name: value
                    for name, value in vars(p).items()
                    if hasattr(DEFAULT_SETTINGS, name)
                },
            )
        )
        self._faults = FaultEstimator(p.effectiveness_threshold)
        self._link = AutopilotLink(
            p.connection,
            source_system=p.source_system,
            source_component=p.source_component,
            target_system=p.target_system,
            timeout=p.link_timeout,
        )
        self._telemetry = Telemetry()
        self._step = NO_HEARTBEAT
        self._pose_cell: int | None = None
        self._command = self._received = self._complaint = ''
        self._posed_at = self._commanded_at = -math.inf
        self._fault: Fault | None = None
        self._fault_at = -math.inf
        self._refused: dict[str, str] = {}
        self._connect()

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
        self._diagnostics = publisher(DiagnosticArray, '/diagnostics', qos.RELIABLE)
        # The manager publishes the pose before the command. Where both have arrived, the
        # subscription made first is served first.
        inputs: tuple[tuple[Any, str, Any], ...] = (
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
        self._link.close()
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
            self._pilot.command(self._task(action), now)
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

    def _refuse(self, complaint: str) -> None:
        if complaint != self._complaint:
            self.get_logger().error(complaint)
        self._complaint = complaint

    def _task(self, action: Action) -> FlightTask:
        point = self._mission.grid.position(action.destination)
        return FlightTask(
            self._command,
            *self._origin.to_geodetic(*point),
            agile=action.agile,
            goal='' if action.goal is None else self._mission.goals[action.goal].name,
            land=action.goal is None and not action.agile,
            service=action.kind is ActionKind.REPAIR,
        )

    def _on_hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._step.phase is Phase.PILOT:
            response.message = self._step.status
            return response
        self._pilot.hold()
        flying = self._telemetry.armed and not self._telemetry.on_ground
        if not self._link.up:
            response.message = f'{self._step.status}; holds when it is back'
        elif flying and self._telemetry.fix(self._now()) is None:
            response.message = NO_POSITION_TO_HOLD
        else:
            response.success, response.message = True, 'holds until ~/resume'
        return response

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._step.phase is Phase.NO_LINK:
            response.message = self._step.status
            return response
        self._pilot.resume(self._now())
        response.success, response.message = True, 'the manager is in command'
        return response

    # Out: vehicle

    def _poll(self) -> None:
        now, last = self._now(), self._telemetry
        for message in self._link.poll(now):
            self._telemetry = update(self._telemetry, message, now)
            if message.get_type() == 'STATUSTEXT':
                self._log(message.severity <= WARNING_SEVERITY, f'autopilot: {message.text}')
        self._telemetry = forget(self._telemetry, now)
        if not self._link.up:
            self._telemetry, self._fault = Telemetry(), None
            self._faults.link_lost()
        self._fly(now)
        self._link.repeat(now)
        if self._link.up:
            self._publish(last, now)

    def _fly(self, now: float) -> None:
        step = self._pilot.update(self._telemetry if self._link.up else None, now)
        if step.phase is not self._step.phase:  # What was asked for is no longer wanted.
            self._link.cancel()
        for request in step.requests:
            for command in commands(request):
                self._link.send(command, now)
        if step.completed:
            self._goal_completed.publish(String(data=step.completed))
            self._log(False, f'goal {step.completed} completed')
        if step.serviced:
            self._faults.serviced()
            self._log(False, 'service done')
        if (step.phase, step.status) != (self._step.phase, self._step.status):
            self._log(step.phase in WARNING_PHASES, f'{step.phase.value}: {step.status}')
        self._step = step
        if self._link.refused != self._refused:
            self._refused = dict(self._link.refused)
            for name, why in self._refused.items():
                self._log(True, f'autopilot refused {name}: {why}')

    def _publish(self, last: Telemetry, now: float) -> None:
        stamp, telemetry = self.get_clock().now().to_msg(), self._telemetry
        if telemetry.battery and telemetry.battery is not last.battery:
            self._battery_state.publish(battery_state(telemetry.battery, stamp))
        position = telemetry.fix(now)
        if position and position is not last.position:
            self._odom.publish(odometry(position, self._origin, stamp))
            self._global_position.publish(
                nav_sat_fix(position, (telemetry.fix_type or 0) >= FIX_3D, stamp)
            )
        age = self._link.component_age(CAMERA_COMPONENT, now)
        fault = self._faults.update(telemetry, age, now)
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
        phase, telemetry = self._step.phase, self._telemetry
        level = DiagnosticStatus.WARN if phase in WARNING_PHASES else DiagnosticStatus.OK
        age = self._now() - self._commanded_at
        values = {
            'link': 'up' if self._link.up else 'lost',
            'link_error': self._link.error,
            'system': self._link.target_system,
            'mode': mode_name(telemetry.mode),
            'armed': telemetry.armed,
            'phase': phase.value,
            'command': self._command,
            'command_refused': self._complaint,
            'command_age': f'{age:.1f}' if self._command else '',
            'fault_mode': '' if self._fault is None else FAULT_MODES[self._fault],
            'motor_effectiveness': ' '.join(f'{e:.2f}' for e in self._faults.effectiveness),
            **{f'refused {name}': why for name, why in self._link.refused.items()},
        }
        report = status(
            level if self._link.up else DiagnosticStatus.ERROR,
            f'{self.get_fully_qualified_name()}: autopilot',
            f'{phase.value}: {self._step.status}',
            **values,
        )
        report.hardware_id = f'MAVLink system {self._link.target_system}'
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(DiagnosticArray(header=header, status=[report]))


def _origin(mission: Mission, path: Any) -> Origin:
    if mission.grid.origin is None:
        raise ValueError(f'{path}: grid.origin is missing; the bridge needs it to fly')
    return mission.grid.origin


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MavlinkBridge, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
