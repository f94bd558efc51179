"""The manager's trace: all that its decisions follow from, in the order in which it met it.

Each entry is a line of JSON with `run`, which the manager's start gave it, and `number`, one more
than the last entry's. Its `events` are, in their order:

- `["state", {...}]`: settings, digest of the policy, hash of goals and grid, all that is known.
- `["hear", TOPIC, TIME, {...}]`: a message was taken, see `HeardInput`.
- `["step", TIME]` or `["step", TIME, {...}]`: it was decided; with what, if that is new.
- `["adopt", DIGEST, HASH, WANTED]`: another policy set, hash of its goals and grid, and whether
  goals that are new in it are wanted.
- `["adjust", {...}]`: other settings.
- `["reset"]`: goals were reset.

Times are of the manager's steady clock [s]. Floats are written so that they are read as the same.
"""

from __future__ import annotations

import json
import math
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from uav_mission_manager.mdp import Mission
from uav_mission_manager.onboard.deciding import Refusal
from uav_mission_manager.onboard.heard_input import HeardInput
from uav_mission_manager.onboard.inputs import InputError
from uav_mission_manager.onboard.journal import goals_hash
from uav_mission_manager.onboard.mission_manager import ManagerSettings, MissionManager
from uav_mission_manager.policy import Decision, Policy

STATE_PERIOD = 5.0
"""Time [s] between two states in a trace: a choice, the most of a flight that is not replayed when
its recording begins in the middle of it."""

RUN_DIGITS = 8
"""Of the name of a run: a choice, enough to tell the few of a recording apart."""

NOT_UNDERSTOOD = LookupError, TypeError, AttributeError, RecursionError, json.JSONDecodeError
"""What is raised where an entry is not as it should be."""

RecordedOutcome = dict[str, Any]
"""What was decided, or `{'refused': REASON}`, as JSON values."""


def outcome_values(outcome: Decision | Refusal) -> RecordedOutcome:
    """Return what a step led to."""
    if isinstance(outcome, Refusal):
        return {'refused': outcome.reason}
    runner_up = outcome.runner_up
    return {
        'state': list(outcome.state),
        'action': outcome.action.number,
        'runner_up': None if runner_up is None else runner_up.number,
        'values': list(outcome.values),
        'margin': outcome.margin,
    }


class TraceWriter:
    """Collects what a manager meets, for `entry` to write down.

    Parameters
    ----------
    core : MissionManager
    now : float
        Time [s].
    """

    def __init__(self, core: MissionManager, now: float) -> None:
        self._core = core
        self._run, self._number = uuid.uuid4().hex[:RUN_DIGITS], 0
        self._events: list[list[Any]] = []
        self._last: object = None
        self._keep_state(now)

    def hear(self, heard: HeardInput) -> None:
        """Say what was taken."""
        self._events.append(['hear', heard.topic, heard.time, heard.values])

    def step(self, now: float, outcome: Decision | Refusal) -> None:
        """Say that it was decided at `now` [s], and what."""
        event: list[Any] = ['step', now]
        last = self._last
        if isinstance(outcome, Refusal):
            self._last = None  # Its words change with the ages in it.
        else:
            d = outcome
            self._last = d.state, d.action, d.runner_up, d.values, d.margin
        if self._last != last:
            event.append(outcome_values(outcome))
        self._events.append(event)
        if now - self._state_at >= STATE_PERIOD:
            self._keep_state(now)

    def adopt(self, wanted: bool = True) -> None:
        """Say that another policy set is in use, and whether goals new in it are wanted."""
        policy = self._core.policy
        self._events.append(['adopt', policy.digest, goals_hash(policy.mission), wanted])
        self._state_at = -math.inf  # A recording may begin here.

    def adjust(self) -> None:
        """Say that the settings are others now."""
        self._events.append(['adjust', asdict(self._core.settings)])

    def reset(self) -> None:
        """Say that goals were reset."""
        self._events.append(['reset'])

    def entry(self) -> str:
        """Return what there is to write; empty if nothing."""
        if not self._events:
            return ''
        entry = {'run': self._run, 'number': self._number, 'events': self._events}
        self._number, self._events = self._number + 1, []
        return json.dumps(entry, separators=(',', ':'), default=list)

    def _keep_state(self, now: float) -> None:
        self._state_at, policy = now, self._core.policy
        state = {
            'settings': asdict(self._core.settings),
            'policy': policy.digest,
            'goals': goals_hash(policy.mission),
            'memory': self._core.snapshot,
        }
        self._events.append(['state', state])
        self._last = ''  # Who begins here does not know it.


@dataclass(frozen=True)
class ReplayedStep:
    """One decision, as it was and as it is now.

    Attributes
    ----------
    now : float
        When it was decided, on the steady clock of then [s].
    recorded : dict
        What the manager decided, see `outcome_values`.
    replayed : Decision or Refusal
        What it decides now.
    mission : Mission
        Of the policy that decides now; its goals and grid are those of then.
    """

    now: float
    recorded: RecordedOutcome
    replayed: Decision | Refusal
    mission: Mission


@dataclass
class _Run:
    """A manager from its start on: what it knew, decided last, and says next."""

    core: MissionManager | None = None
    recorded: RecordedOutcome | None = None
    next_number: int = 0

    def skips_to(self, number: int) -> bool:
        """Go on with an entry; return whether it comes after a gap, so that nothing is known."""
        gap = number > self.next_number
        if gap:
            self.core = self.recorded = None
        self.next_number = number + 1
        return gap

    def step(self, now: float, outcome: RecordedOutcome | None = None) -> ReplayedStep:
        """Decide as it did then."""
        self.recorded = outcome or self.recorded
        if self.core is None or self.recorded is None:
            raise LookupError('a first decision')
        replayed = self.core.step(now)
        return ReplayedStep(now, self.recorded, replayed, self.core.policy.mission)


class Replay:
    """Decides anew what a trace tells of, by any policy of the same goals and grid.

    Parameters
    ----------
    *policies : Policy
        One for each mission of other goals that was flown; ValueError where two are for the same.

    Attributes
    ----------
    policies : list of str
        Digests of the policy sets that were flown, in order.
    gaps, skipped : int
        How often entries are missing, and how many decisions no state came before.
    """

    def __init__(self, *policies: Policy) -> None:
        self._by_goals: dict[str, Policy] = {}
        for policy in policies:
            other = self._by_goals.setdefault(goals_hash(policy.mission), policy)
            if other is not policy:
                raise ValueError(
                    f'{other.mission.name} and {policy.mission.name} have the same goals and '
                    'grid: give one policy set of them'
                )
        self._runs: dict[str, _Run] = {}
        self.policies: list[str] = []
        self.gaps = self.skipped = 0

    @property
    def runs(self) -> int:
        """How often a manager was started."""
        return len(self._runs)

    def take(self, text: str) -> Iterator[ReplayedStep]:
        """Go on with an entry; yield the decisions in it.

        Raises
        ------
        ValueError
            One line: it is no such entry, or of other goals or another grid.
        """
        try:
            entry = json.loads(text)
            number, run = int(entry['number']), self._runs.setdefault(str(entry['run']), _Run())
            if number < run.next_number:  # Heard twice.
                return
            self.gaps += run.skips_to(number)
            for kind, *values in entry['events']:
                if kind == 'state':
                    self._know(run, *values)
                elif run.core is None:
                    self.skipped += kind == 'step'
                elif kind == 'step':
                    yield run.step(*values)
                else:
                    self._change(run.core, kind, *values)
        except (*NOT_UNDERSTOOD, InputError) as error:
            raise ValueError(f'no entry of a trace: {error!r}') from error

    def _know(self, run: _Run, state: dict[str, Any]) -> None:
        policy = self._policy_for(state['goals'])
        self._flown_by(state['policy'])
        if run.core is None:
            settings = ManagerSettings(**state['settings'])
            run.core = MissionManager(policy, settings, state['memory'])

    def _policy_for(self, goals: str) -> Policy:
        if goals not in self._by_goals:
            names = ', '.join(policy.mission.name for policy in self._by_goals.values())
            raise ValueError(
                f'recorded in a mission with other goals or another grid than {names}'
            )
        return self._by_goals[goals]

    def _flown_by(self, digest: str) -> None:
        if self.policies[-1:] != [digest]:
            self.policies.append(digest)

    def _change(self, core: MissionManager, kind: str, *values: Any) -> None:
        if kind == 'hear':
            core.take(HeardInput(*values))
        elif kind == 'adopt':
            self._adopt(core, *values)
        elif kind == 'adjust':
            [settings] = values
            core.adjust(ManagerSettings(**settings))
        elif kind == 'reset':
            core.reset_goals()
        else:
            raise LookupError(kind)

    def _adopt(
        self, core: MissionManager, digest: str, goals: str = '', wanted: bool = True
    ) -> None:
        self._flown_by(digest)
        core.adopt(self._policy_for(goals) if goals else core.policy, wanted)
