"""The bridge between the mission manager and an ArduCopter: telemetry up, commands down."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from uav_mission_manager.autopilot.bridge import WARNING_PHASES, VehicleBridge
from uav_mission_manager.autopilot.faults import FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import Settings
from uav_mission_manager.autopilot.vehicle import mode_name
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.bridge_memory import BridgeMemory
from uav_mission_manager.nodes.clocks import ClockWatch, safety_clock, seconds
from uav_mission_manager.nodes.flight_energy import FlightEnergy
from uav_mission_manager.nodes.flight_plan import FlightPlan, Plans, speed_differences
from uav_mission_manager.nodes.goal_answers import GoalAnswers
from uav_mission_manager.nodes.lifecycle import AUTOSTART, FAILURE, ManagedNode
from uav_mission_manager.nodes.log_limit import LogLimit
from uav_mission_manager.nodes.manager_inputs import ManagerInputs
from uav_mission_manager.nodes.memory import STATE_DIR, open_journal
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.plan_offers import PlanOffers
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.reporting import status
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.nodes.vehicle_outputs import VehicleOutputs

POLL_PERIOD = 0.05
"""Time [s] between two looks at the link, and two steps of the pilot: a choice, 20 Hz."""

DEFAULT_SETTINGS = Settings()
"""Defaults of the flight parameters."""

Order = Callable[[VehicleBridge, float], tuple[bool, str]]
"""What a service asks of a bridge at a time [s], and what is answered."""


def _flight(
    name: str, description: str, minimum: float, maximum: float, *, in_flight: bool = True
) -> NodeParameter:
    default = getattr(DEFAULT_SETTINGS, name)
    return NodeParameter(name, default, description, minimum, maximum, read_only=not in_flight)


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
    _flight(
        'flight_altitude',
        "Flight height above the mission file's ground [m]",
        2.0,
        500.0,
        in_flight=False,
    ),
    _flight('cruise_speed', 'Speed in normal mode [m/s]', 0.1, 50.0),
    _flight('agile_speed', 'Speed in agile mode [m/s]', 0.1, 50.0),
    _flight(
        'acceptance_radius',
        'Largest distance from a destination on site [m]',
        0.1,
        1000.0,
        in_flight=False,
    ),
    _flight(
        'goal_dwell', 'Time on site until a goal without a task is completed [s]', 0.0, 3600.0
    ),
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
        in_flight=False,
    ),
    NodeParameter(
        'allow_arming',
        DEFAULT_SETTINGS.allow_arming,
        'Whether the bridge may arm the vehicle and take off',
    ),
    STATE_DIR,
    AUTOSTART,
    LISTENING,
)


class MavlinkBridge(ManagedNode):
    """Publishes what the vehicle says and flies what the manager commands.

    While it is not active it publishes nothing and obeys nobody: in flight it holds. What was true
    when it ended, however it did, is true when it is started again.
    """

    _bridge: VehicleBridge

    def __init__(self) -> None:
        super().__init__('mavlink_bridge')
        self._settings = declare(self, PARAMETERS, changed=self._adjust)
        self._steady = safety_clock()
        self._limit = LogLimit()
        self._opened, self._begun = ExitStack(), ExitStack()
        self._configured = False
        self.create_service(Trigger, '~/hold', self._on_hold)
        self.create_service(Trigger, '~/resume', self._on_resume)

    def configure(self) -> None:
        """Open the link, and recall what was before; from now on the vehicle is heard."""
        p = self._settings
        self._mission = load_mission(p.mission)
        try:
            self._plans = Plans(FlightPlan(self._mission, p.flight_altitude))
        except ValueError as error:
            raise ValueError(f'{p.mission}: {error}') from error
        for text in speed_differences(self._mission, p.cruise_speed, p.agile_speed):
            self.get_logger().warning(text)
        link = AutopilotLink(
            p.connection,
            source_system=p.source_system,
            source_component=p.source_component,
            target_system=p.target_system,
            timeout=p.link_timeout,
        )
        self._opened.callback(link.close)
        pilot = Pilot(self._flight_settings(), self._plans.present.ground)
        pilot.active = False
        self._bridge = VehicleBridge(link, pilot, FaultEstimator(p.effectiveness_threshold))
        self._bridge.remember = self._remember
        journal = open_journal(self, p.state_dir, 'mavlink_bridge', self._mission)
        self._opened.callback(journal.close)
        self._memory = BridgeMemory(journal, self._plans, self._log)
        self._energy = FlightEnergy(self._mission.energy)
        self._memory.recall(self._bridge)
        self._clock_watch = ClockWatch(self)
        self._presence = Presence(self, 'mavlink_bridge', p.listening_time)
        self.create_timer(POLL_PERIOD, self._poll, clock=self._steady)
        self._configured = True

    def activate(self) -> None:
        """Publish, and obey the manager."""
        p, pilot = self._settings, self._bridge.pilot
        self._outputs = VehicleOutputs(
            self, self._plans.present.origin, self._plans.goals, self._log
        )
        self._begun.callback(self._outputs.close)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, '/diagnostics', qos.RELIABLE, qos_overriding_options=qos.OVERRIDABLE
        )
        self._inputs = ManagerInputs(self, self._plans, pilot, p.manager_timeout)
        self._offers = PlanOffers(self, self._plans, self._log)
        self._answers = GoalAnswers(self, self._bridge, self._log)
        self.create_timer(1.0, self._diagnose, clock=self._steady)
        pilot.set_active(True, self._now())

    def deactivate(self) -> None:
        """Obey nobody; in flight the vehicle holds."""
        self._bridge.pilot.set_active(False, self._now())
        self._begun.close()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up, but not under a vehicle that may fly."""
        if self._bridge.pilot.armed:
            self._failure = RuntimeError('the motors run')
            return FAILURE
        return super().on_cleanup(state)

    def cleanup(self) -> None:
        """Close link and journal."""
        self._configured = False
        self._opened.close()

    def _flight_settings(self) -> Settings:
        p, grid = self._settings, self._mission.grid
        return Settings(
            landed_radius=max(p.acceptance_radius, grid.cell_size / 2.0),
            reach=2.0 * math.hypot(grid.rows, grid.cols) * grid.cell_size,
            **{name: value for name, value in vars(p).items() if hasattr(DEFAULT_SETTINGS, name)},
        )

    def _adjust(self) -> None:
        """Fly on with parameters that were set in flight, from the next order on."""
        if self._configured:
            self._bridge.pilot.site.settings = self._flight_settings()
        if self.active:
            self._inputs.timeout = self._settings.manager_timeout

    def _remember(self, memory: dict[str, Any]) -> None:
        if not self._presence.silent:  # The journal may be another one's.
            self._memory.write(memory, self._now())

    def _now(self) -> float:
        return seconds(self._steady)

    def _on_hold(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, VehicleBridge.hold)

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(response, VehicleBridge.resume)

    def _answer(self, response: Trigger.Response, do: Order) -> Trigger.Response:
        response.success, response.message = (
            do(self._bridge, self._now()) if self._configured else (False, 'not configured')
        )
        return response

    def _poll(self) -> None:
        now = self._now()
        if self._presence.silent:
            self._bridge.link.poll(now)  # and drop it: it will be out of date
            return
        if self.active:
            self._inputs.look()
        step = self._bridge.step(now)
        for warning, text in step.log:
            self._log(warning, text)
        if self.active:
            telemetry = self._bridge.telemetry
            self._outputs.publish(step, telemetry.fix_type, now)
            for text in self._energy.note(step, telemetry, self._inputs.action):
                self._log(True, text)

    def _log(self, warning: bool, text: str) -> None:
        line = self._limit.passed(text.partition(':')[0], text)
        # rclpy refuses a call site that changes its severity: one for each.
        if line and warning:
            self.get_logger().warning(line)
        elif line:
            self.get_logger().info(line)

    def _diagnose(self) -> None:
        if self._presence.silent:
            return
        link, output = self._bridge.link, self._bridge.output
        troubles = self._clock_watch.problem, self._memory.error
        warnings = (
            *self._inputs.complaints,
            *self._bridge.warnings,
            *self._energy.warnings,
            *filter(None, troubles),
        )
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
        link, telemetry, inputs = bridge.link, bridge.telemetry, self._inputs
        return {
            'link': 'up' if link.up else 'lost',
            'link_error': link.error,
            'system': link.target_system,
            'vehicle': link.vehicle,
            'others_heard': '; '.join(link.others),
            'mode': mode_name(telemetry.mode),
            'armed': telemetry.armed,
            'allow_arming': self._settings.allow_arming,
            'flight_altitude': self._settings.flight_altitude,
            'phase': bridge.output.phase.value,
            'command': inputs.command,
            'command_refused': '; '.join(inputs.complaints),
            'command_age': f'{inputs.command_age:.1f}' if inputs.command else '',
            'goal_at_work': bridge.pilot.work.goal,
            'goal_active': bridge.output.active,
            'goal_refused': self._outputs.refused,
            'fault_mode': self._outputs.fault_mode,
            'motor_effectiveness': ' '.join(f'{e:.2f}' for e in bridge.faults.effectiveness),
            **{f'refused {name}': why for name, why in link.refused.items()},
        }


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MavlinkBridge, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
