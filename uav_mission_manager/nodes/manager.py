"""The manager: inputs from the vehicle and the base station in, the mission command out."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import fields
from functools import partial

from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import String
from std_srvs.srv import Trigger

from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import THREAT_LEVELS
from uav_mission_manager.nodes import qos, reporting
from uav_mission_manager.nodes.background import LatestOnly, SupersededError
from uav_mission_manager.nodes.clocks import ClockWatch, safety_clock, seconds
from uav_mission_manager.nodes.command_outputs import CommandOutputs
from uav_mission_manager.nodes.complaints import Complaints
from uav_mission_manager.nodes.failures import START_ERRORS, one_line
from uav_mission_manager.nodes.lifecycle import AUTOSTART, ManagedNode
from uav_mission_manager.nodes.memory import STATE_DIR, open_journal
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.recollection import PolicyInUse, recollect
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.nodes.vehicle_inputs import VehicleInputs
from uav_mission_manager.onboard import (
    InputError,
    ManagerSettings,
    MissionManager,
    Refusal,
    format_command,
)
from uav_mission_manager.onboard.heard_input import HeardInput
from uav_mission_manager.onboard.journal import Journal, goals_hash
from uav_mission_manager.onboard.priority_request import REQUEST_TIME
from uav_mission_manager.onboard.trace import TraceWriter
from uav_mission_manager.policy import Decision, load_policy
from uav_mission_manager.policy.certificate import worsening

PARAMETERS = (
    NodeParameter(
        'policy', '', 'Directory of the policy set', path=True, example='policies/case_study'
    ),
    NodeParameter(
        'input_timeout',
        3.0,
        'Age of battery, odom or fault mode above which no command is published, and of a stamp '
        'above which it is not believed [s]',
        0.1,
        60.0,
        read_only=False,
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
        'Time for which a command stays before a change that no danger asks for [s]',
        0.0,
        60.0,
        read_only=False,
    ),
    NodeParameter(
        'settling_time',
        5.0,
        'Time for which an input is to be better before it counts as better; what is worse counts '
        'at once [s]',
        0.0,
        60.0,
        read_only=False,
    ),
    NodeParameter(
        'threat_unknown',
        'none',
        f'What a threat never heard of counts as: {", ".join(THREAT_LEVELS)}',
    ),
    NodeParameter('rate', 1.0, 'Rate of decisions and of the repeated command [Hz]', 1.0, 20.0),
    STATE_DIR,
    LISTENING,
    AUTOSTART,
)


class Manager(ManagedNode):
    """Commands what the policy says about the state that vehicle and base station report.

    A changed command stays for `command_dwell` unless danger rises. Without a fresh battery
    state, position and fault mode it publishes no command, nor before it knows what is wanted,
    nor while another manager may be there that it has not heard yet, in its first seconds.
    """

    _asked: PolicyInUse
    _used: PolicyInUse
    _core: MissionManager
    _journal: Journal | None = None

    def __init__(self) -> None:
        super().__init__('manager')
        self._settings = declare(self, PARAMETERS, changed=self._adjust)
        self._steady = safety_clock()

    def configure(self) -> None:
        """Load the policy set that the parameter names."""
        path = self._settings.policy
        self._asked = PolicyInUse(load_policy(path), path, path)

    def activate(self) -> None:
        """Go on where the manager before this one ended, and begin to listen."""
        p = self._settings
        self._journal = open_journal(self, p.state_dir, 'manager', self._asked.policy.mission)
        found = recollect(self._journal, self._asked, self._manager_settings)
        self._core, self._used, self._trouble = found.core, found.used, found.trouble
        self._journal.mission = goals_hash(found.core.policy.mission)
        self._knows_since = -math.inf if found.goes_on else seconds(self._steady)
        self._trace = TraceWriter(found.core, seconds(self._steady))
        self._outcome: Decision | Refusal = Refusal('no decision yet')
        self._remembered: tuple[int, ...] = ()
        # Lambdas, as rclpy wants a place in the code for each severity.
        self._complaints = Complaints(lambda text: self.get_logger().warning(text))
        self._warnings = Complaints(lambda text: self.get_logger().warning(text))
        self._silences = Complaints(lambda text: self.get_logger().error(text))
        self._loading = LatestOnly(self)
        self._outputs = CommandOutputs(self)
        self._create_inputs()
        self.get_logger().info(f'policy {self._label}')
        if self._trouble:
            self.get_logger().warning(self._trouble)
        self._presence = Presence(self, 'manager', p.listening_time)
        self._waits_until = seconds(self._steady) + p.listening_time + REQUEST_TIME

    def deactivate(self) -> None:
        """Leave the journal to the next one."""
        if self._journal is not None:
            self._journal.close()

    def _create_inputs(self) -> None:
        p = self._settings
        self._inputs = VehicleInputs(self, self._take, self._steady, p.input_timeout)
        waiting = ReentrantCallbackGroup()  # Others go on while a policy is loaded.
        self.create_subscription(
            String,
            'policy_set',
            self._on_policy_set,  # type: ignore[arg-type]  # Coroutines are as good.
            qos.LATCHED,
            callback_group=waiting,
            qos_overriding_options=qos.OVERRIDABLE,
        )
        self.create_service(Trigger, '~/reload_policy', self._on_reload, callback_group=waiting)
        self.create_service(Trigger, '~/reset_goals', self._on_reset)
        self.create_timer(1.0 / p.rate, partial(self._step, repeat=True), clock=self._steady)
        self.create_timer(1.0, self._diagnose, clock=self._steady)
        self._watch = ClockWatch(self)

    @property
    def _label(self) -> str:
        policy = self._used.policy
        return f'{shown(self._used.path)} ({policy.method}, {policy.digest[:12]})'

    @property
    def _manager_settings(self) -> ManagerSettings:
        names = [field.name for field in fields(ManagerSettings)]
        return ManagerSettings(**{name: getattr(self._settings, name) for name in names})

    def _adjust(self) -> None:
        """Go on with parameters that were set in flight."""
        if self.active:
            self._core.adjust(self._manager_settings)
            self._inputs.timeout = self._settings.input_timeout
            self._trace.adjust()

    def _take(self, topic: str, read: Callable[[], HeardInput]) -> None:
        try:
            heard = read()
            self._core.take(heard)
        except InputError as error:
            self._complaints.add(topic, f'{error}; kept the last good value')
            return
        self._trace.hear(heard)
        if topic == 'odom' and self._inputs.pose is not None:
            self._outputs.scene.move(self._inputs.pose)
        self._step()
        self._complaints.settle(topic)
        for warning in self._core.news():
            self._warnings.add(warning.partition(':')[0], warning)

    def _step(self, repeat: bool = False) -> None:
        """Decide; publish what changed, or everything when it is time to `repeat`.

        What is told only comes after what is commanded. What is heard but once, what is wanted,
        is written down before anyone acts on it; what is heard again and again, right after. A
        manager that has just started listens first: to hear of another one, and what is wanted.
        """
        now = seconds(self._steady)
        if not (self._presence.silent or self._waits(now)):
            self._decide(now, repeat)
        self._outputs.trace(self._trace.entry())

    def _decide(self, now: float, repeat: bool) -> None:
        core, before = self._core, self._outcome
        self._outcome = outcome = core.step(now)
        if core.situation.priorities != self._remembered:
            self._remember()
        if self._knows_what_is_wanted:
            self._outputs.goals(core.situation.priorities, repeat)
        if isinstance(outcome, Refusal):
            changed = self._outputs.silence()
            if changed or repeat:
                self._tell_silence(outcome)
        else:
            if self._outputs.command(core.policy.mission, outcome, repeat):
                command = format_command(core.policy.mission, outcome.action)
                self.get_logger().info(f'{command}: {outcome.reason}')
            self._silences.settle('command')
            changed = isinstance(before, Refusal) or _key(before) != _key(outcome)
        self._remember()
        if changed or repeat:
            self._outputs.explain(outcome, core.situation, now, core.policy.digest)
        self._trace.step(now, outcome)
        if changed and not isinstance(outcome, Refusal):
            core.foresee()

    def _waits(self, now: float) -> bool:
        """Whether what was wanted before may have been cancelled, and that not heard yet."""
        return now < self._waits_until and 'goal_priorities' not in self._core.situation.seen

    @property
    def _knows_what_is_wanted(self) -> bool:
        """Else an old journal stays, lest this one passes for it."""
        return 'goal_priorities' in self._core.situation.known

    @property
    def _journal_trouble(self) -> str:
        """What is wrong with the memory; empty if nothing."""
        error = '' if self._journal is None else self._journal.error
        return '; '.join(filter(None, (self._trouble, error)))

    def _remember(self) -> None:
        """Write down what is known and what has been decided."""
        self._remembered = self._core.situation.priorities
        if self._journal is not None and self._knows_what_is_wanted:
            state = {'policy': self._used.as_record(), 'memory': self._core.memory}
            self._journal.write(state)

    def _tell_silence(self, refusal: Refusal) -> None:
        if not self._knows_what_is_wanted:
            self.get_logger().info('waits for goal priorities', once=True)
        elif self._core.situation.missing(seconds(self._steady), math.inf):
            # Never heard, as it is while all start: no error yet.
            self.get_logger().warning(f'no command yet: {refusal.reason}', once=True)
        elif not self._silences.current:  # Its words change with the ages in it.
            self._silences.add('command', f'{refusal.reason}: no command until it is back')

    def _diagnose(self) -> None:
        situation = self._core.situation
        for log in self._complaints, self._warnings, self._silences:
            log.flush()
        for kind, text in self._warnings.current.items():
            if text not in situation.warnings:
                self._warnings.settle(kind)
        if self._knows_what_is_wanted:
            self._trouble = ''  # Whatever was forgotten.
        statuses = reporting.manager_health(
            self.get_fully_qualified_name(),
            (shown(self._used.path), self._core.policy),
            self._outcome,
            situation,
            self._complaints.current,
            {'clock': self._watch.problem, 'memory': self._journal_trouble},
            seconds(self._steady),
            self._settings.input_timeout,
        )
        self._outputs.diagnose(statuses)

    async def _take_over(self, path: str, wanted: bool = True) -> str:
        """Fly on with the policy set in `path`; return why not, or an empty string."""
        core = self._core
        before = core.policy.proved_gap
        try:
            policy = await self._loading.run(partial(load_policy, path))
            if not self.active or core is not self._core:
                return 'deactivated meanwhile'
            try:
                new = core.adopt(policy, wanted)
            except ValueError as error:
                raise ValueError(f'{shown(path)}: {error}') from error
        except SupersededError as error:
            return str(error)
        except START_ERRORS as error:
            why = one_line(error)
            self._complaints.add('policy_set', f'policy set refused, the old one kept: {why}')
            return why
        self._complaints.settle('policy_set')
        self._used = PolicyInUse(policy, path, self._asked.path)
        if self._journal is not None:
            self._journal.mission = goals_hash(policy.mission)
        self._trace.adopt(wanted)
        unwanted = '' if wanted else ', not wanted: requested before this manager, which forgot'
        goals = f'; goals {", ".join(new)}{unwanted}' if new else ''
        self.get_logger().info(f'policy taken over: {self._label}{goals}')
        if worse := worsening('mean gap over all states', before, policy.proved_gap):
            self.get_logger().warning(f'policy taken over: {worse}')
        self._step(repeat=True)
        return ''

    async def _on_policy_set(self, message: String, info: dict[str, int]) -> None:
        """Goals requested before this manager, by one of which nothing is known, may be done."""
        age = (info['received_timestamp'] - info['source_timestamp']) * 1e-9
        wanted = seconds(self._steady) - age >= self._knows_since
        await self._take_over(message.data, wanted)

    async def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        refused = await self._take_over(self._used.path)
        response.success = not refused
        response.message = refused or self._label
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._core.reset_goals()
        self._trace.reset()
        self._waits_until = 0.0  # This is what is wanted by now.
        self.get_logger().info('goals reset')
        self._step(repeat=True)
        response.success, response.message = True, 'all priorities 0, no commitment'
        return response


def _key(decision: Decision) -> tuple[object, ...]:
    return decision.state, decision.action.number


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Manager, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
