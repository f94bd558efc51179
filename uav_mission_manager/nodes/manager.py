"""The manager: inputs from the vehicle and the base station in, the mission command out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Header, String, UInt8MultiArray
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from uav_mission_manager.nodes import qos, reporting
from uav_mission_manager.nodes.frames import MAP_FRAME
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.runtime import run_node, safety_clock
from uav_mission_manager.onboard import (
    InputError,
    Refusal,
    Situation,
    StandingCommand,
    decide,
    dwell,
    format_command,
)
from uav_mission_manager.policy import Decision, load_policy

Change = Callable[[Situation, Any, float], Situation]
"""How a message received at a time [s] changes the situation; raises `InputError`."""

PARAMETERS = (
    NodeParameter(
        'policy', '', 'Directory of the policy set', path=True, example='policies/case_study'
    ),
    NodeParameter(
        'input_timeout',
        3.0,
        'Age of battery, odom or fault mode above which no command is published [s]',
        0.1,
        60.0,
    ),
    NodeParameter(
        'range_hysteresis',
        0.2,
        'Extra range with which a lost range flag comes back (fraction)',
        0.0,
        1.0,
    ),
    NodeParameter(
        'command_dwell',
        5.0,
        'Time for which a command stays before a change that neither danger nor a new task asks '
        'for [s]',
        0.0,
        60.0,
    ),
    NodeParameter('rate', 1.0, 'Rate of decisions and of the repeated command [Hz]', 1.0, 20.0),
    LISTENING,
)


HEALTHY = (
    BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN,
    BatteryState.POWER_SUPPLY_HEALTH_GOOD,
)
"""Health of a battery that is taken at its percentage; many senders do not know the health."""

KEPT_INPUTS = ('threat_level', 'goal_priorities')
"""Inputs whose last value stays in force however old it is; the diagnostics warn of its age."""


class Manager(Node):
    """Commands what the policy says about the state that vehicle and base station report.

    A changed command stays for `command_dwell` unless danger or a new task asks for another.
    Without a fresh battery state, position and fault mode it publishes no command, nor while
    another manager may be there that it has not heard yet, in its first seconds.
    """

    def __init__(self) -> None:
        super().__init__('manager')
        self._settings = declare(self, PARAMETERS)
        self._timer_clock = safety_clock(self)
        self._path = self._settings.policy
        self._policy = load_policy(self._path)
        self._situation = Situation(self._policy.mission, self._settings.range_hysteresis)
        self._outcome: Decision | Refusal = Refusal('no decision yet')
        self._standing: StandingCommand | None = None
        self._command: str | None = None
        self._goals: tuple[int, ...] = ()
        self._silent_logged = False
        self._refused: dict[str, str] = {}
        self._create_outputs()
        self._create_inputs()
        self.create_timer(
            1.0 / self._settings.rate, partial(self._step, repeat=True), clock=self._timer_clock
        )
        self.create_timer(1.0, self._diagnose, clock=self._timer_clock)
        self.get_logger().info(f'policy {self._label}')
        self._presence = Presence(self, 'manager', self._settings.listening_time)

    def _create_outputs(self) -> None:
        def output(kind: Any, topic: str, profile: QoSProfile = qos.LATCHED) -> Publisher:
            return self.create_publisher(
                kind, topic, profile, qos_overriding_options=qos.OVERRIDABLE
            )

        self._command_out = output(String, 'mission_command')
        self._pose_out = output(PoseStamped, 'command_pose')
        self._goals_out = output(UInt8MultiArray, 'goal_states')
        self._decision_out = output(DiagnosticArray, '~/decision')
        self._markers_out = output(MarkerArray, '~/markers')
        self._diagnostics_out = output(DiagnosticArray, '/diagnostics', qos.RELIABLE)

    def _create_inputs(self) -> None:
        def heard(
            topic: str,
            kind: Any,
            profile: QoSProfile,
            callback: Callable[[Any], None],
        ) -> None:
            self.create_subscription(
                kind, topic, callback, profile, qos_overriding_options=qos.OVERRIDABLE
            )

        def state(topic: str, kind: Any, profile: QoSProfile, change: Change) -> None:
            heard(topic, kind, profile, partial(self._take, topic, change))

        state('battery_state', BatteryState, qos.SENSOR, _with_battery)
        state('odom', Odometry, qos.SENSOR, _with_odometry)
        state('fault_mode', String, qos.STATE_IN, lambda s, m, now: s.with_fault(m.data, now))
        state('threat_level', String, qos.STATE_IN, lambda s, m, now: s.with_threat(m.data, now))
        state('goal_priorities', UInt8MultiArray, qos.STATE_IN, _with_priorities)
        state('goal_completed', String, qos.EVENT, lambda s, m, now: s.with_completed(m.data))
        state('goal_refused', String, qos.EVENT, lambda s, m, now: s.with_refused(m.data))
        heard('policy_set', String, qos.LATCHED, self._on_policy_set)
        self.create_service(Trigger, '~/reload_policy', self._on_reload)
        self.create_service(Trigger, '~/reset_goals', self._on_reset)

    def _now(self) -> float:
        return float(self._timer_clock.now().nanoseconds) * 1e-9

    @property
    def _label(self) -> str:
        return f'{self._path} ({self._policy.method}, {self._policy.digest[:12]})'

    def _take(self, topic: str, change: Change, message: Any) -> None:
        before = self._situation.warnings
        try:
            self._situation = change(self._situation, message, self._now())
        except InputError as error:
            self._refuse(topic, f'{error}; kept the last good value')
            return
        self._refused.pop(topic, None)
        for warning in set(self._situation.warnings) - set(before):
            self.get_logger().warning(warning)
        self._step()

    def _refuse(self, topic: str, reason: str) -> None:
        # Bad messages come at the rate of good ones: one line for each new complaint.
        if self._refused.get(topic) != reason:
            self.get_logger().warning(reason)
        self._refused[topic] = reason

    def _step(self, repeat: bool = False) -> None:
        """Decide; publish what changed, or everything when it is time to `repeat`.

        A manager that has just started listens first: to hear of another one, and what is wanted.
        """
        if self._presence.silent:
            return
        if repeat or self._situation.priorities != self._goals:  # Before what follows from them.
            self._goals = self._situation.priorities
            self._goals_out.publish(UInt8MultiArray(data=self._goals))
        now, before = self._now(), self._outcome
        outcome = decide(self._policy, self._situation, now, self._settings.input_timeout)
        if isinstance(outcome, Refusal):
            changed = self._command is not None
            self._standing = self._command = None
            if (changed or repeat) and not self._silent_logged:
                self.get_logger().error(f'{outcome.reason}: no command until it is back')
                self._silent_logged = True
        else:
            outcome, self._standing = dwell(
                outcome, self._situation, self._standing, self._settings.command_dwell, now
            )
            self._situation = self._situation.after(outcome.action)
            self._send(outcome, repeat)
            changed = isinstance(before, Refusal) or _key(before) != _key(outcome)
        self._outcome = outcome
        if changed or repeat:
            self._explain(now)

    def _send(self, decision: Decision, repeat: bool) -> None:
        command = format_command(self._situation.mission, decision.action)
        if command == self._command and not repeat:
            return
        if command != self._command:
            self.get_logger().info(f'{command}: {decision.reason}')
        self._command, self._silent_logged = command, False
        stamp = self.get_clock().now().to_msg()
        self._pose_out.publish(
            reporting.cell_pose(self._situation.mission.grid, decision.action.destination, stamp)
        )
        self._command_out.publish(String(data=command))

    def _explain(self, now: float) -> None:
        stamp = self.get_clock().now().to_msg()
        status = reporting.decision_status(
            f'{self.get_fully_qualified_name()}: decision',
            self._outcome,
            self._situation,
            now,
            self._policy.digest,
        )
        target = None if isinstance(self._outcome, Refusal) else self._outcome.action.destination
        self._decision_out.publish(DiagnosticArray(header=Header(stamp=stamp), status=[status]))
        self._markers_out.publish(reporting.markers(self._situation, target, stamp))

    def _diagnose(self) -> None:
        now, name = self._now(), self.get_fully_qualified_name()
        refused = dict(self._refused)
        bad_policy = refused.pop('policy_set', '')
        missing = self._situation.missing(now, self._settings.input_timeout)
        ok, warn, error = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
        ages = self._situation.ages(now)
        old = [
            f'{topic} {ages[topic]:.1f} s old, its last value kept'
            for topic in KEPT_INPUTS
            if topic in ages and ages[topic] > self._settings.input_timeout
        ]
        notes = [*refused.values(), *self._situation.warnings, *old]
        statuses = [
            reporting.status(
                warn if bad_policy else ok,
                f'{name}: policy',
                bad_policy or self._path,
                digest=self._policy.digest,
                method=self._policy.method,
            ),
            reporting.status(
                warn if notes else ok,
                f'{name}: inputs',
                '; '.join(notes) or 'all good',
                **{topic: f'{age:.2f} s' for topic, age in ages.items()},
            ),
            reporting.status(
                error if missing else ok,
                f'{name}: link',
                'link lost: ' + ', '.join(missing) if missing else 'all inputs fresh',
            ),
        ]
        stamp = self.get_clock().now().to_msg()
        self._diagnostics_out.publish(DiagnosticArray(header=Header(stamp=stamp), status=statuses))

    def _take_over(self, path: str) -> str:
        """Fly on with the policy set in `path`; return why not, or an empty string."""
        try:
            policy = load_policy(path, self._policy.mission)
            self._situation = self._situation.with_mission(policy.mission)
        except (ValueError, OSError) as error:
            self._refuse('policy_set', f'policy set refused, the old one kept: {error}')
            return str(error)
        self._refused.pop('policy_set', None)
        self._path, self._policy, self._standing = path, policy, None
        self.get_logger().info(f'policy taken over: {self._label}')
        self._step(repeat=True)
        return ''

    def _on_policy_set(self, message: String) -> None:
        self._take_over(message.data)

    def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refused = self._take_over(self._path)
        response.success = not refused
        response.message = refused or self._label
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._situation = self._situation.without_goals()
        self.get_logger().info('goals reset')
        self._step(repeat=True)
        response.success, response.message = True, 'all priorities 0, no commitment'
        return response


def _key(decision: Decision) -> tuple[object, ...]:
    return decision.state, decision.action.number


def _with_battery(situation: Situation, message: BatteryState, now: float) -> Situation:
    return situation.with_battery(message.percentage, now, message.power_supply_health in HEALTHY)


def _with_odometry(situation: Situation, message: Odometry, now: float) -> Situation:
    if message.header.frame_id not in ('', MAP_FRAME):
        raise InputError(f'odom: frame_id {message.header.frame_id!r} is not {MAP_FRAME!r}')
    position = message.pose.pose.position
    return situation.with_position(position.x, position.y, now)


def _with_priorities(situation: Situation, message: UInt8MultiArray, now: float) -> Situation:
    request = message.layout.dim[0].label if message.layout.dim else ''
    return situation.with_priorities(message.data, request, now)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Manager, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
