"""What another policy would have done in a recorded flight, beside what was flown."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from uav_mission_manager.console.heard import HeardEpoch
from uav_mission_manager.mdp import Mission, global_actions
from uav_mission_manager.onboard import format_command
from uav_mission_manager.onboard.trace import RecordedOutcome, ReplayedStep, outcome_values


@dataclass(frozen=True)
class OtherDecision:
    """A decision of the other policy, with the one flown.

    Attributes
    ----------
    state : tuple of int
        That was flown in; empty where nothing was decided.
    flown, command : str
        Commands of the policy flown and of the other one; empty for none.
    reason : str
        Why the other one decides so, in a line.
    flown_costs : float or None
        What the command flown costs more than the other one, by the other policy's values.
    other_costs : float or None
        What the other command costs more than the one flown, by the values of the policy flown.
        Both are inf where that is not allowed, and None where one of the two decides nothing.
    """

    state: tuple[int, ...]
    flown: str
    command: str
    reason: str
    flown_costs: float | None = None
    other_costs: float | None = None

    @property
    def differs(self) -> bool:
        """Whether it is another command."""
        return self.command != self.flown


class OtherPolicy:
    """The decisions of another policy over a flight.

    Parameters
    ----------
    name : str
        What to call it.
    mission : Mission
        That it was built from: the grid is that of the flight.
    steps : iterable of (float, ReplayedStep)
        Each decision, and when it was recorded [s]; at least one.

    Attributes
    ----------
    name, mission
    differences : list of (float, float)
        From when to when [s] it decides otherwise.
    """

    def __init__(
        self, name: str, mission: Mission, steps: Iterable[tuple[float, ReplayedStep]]
    ) -> None:
        self.name, self.mission = name, mission
        self._times: list[float] = []
        self._decisions: list[OtherDecision] = []
        end = 0.0
        for end, step in steps:
            found = _other_decision(step)
            if self._decisions[-1:] != [found]:
                self._times.append(end)
                self._decisions.append(found)
        self.differences: list[tuple[float, float]] = []
        for found, (start, stop) in zip(self._decisions, pairwise([*self._times, end])):
            if not found.differs:
                continue
            if self.differences and self.differences[-1][1] == start:
                start = self.differences.pop()[0]
            self.differences.append((start, stop))

    def at(self, seconds: float) -> OtherDecision | None:
        """Return what it decides then; None before the first decision."""
        position = bisect_right(self._times, seconds) - 1
        return self._decisions[position] if position >= 0 else None

    def by_epoch(self, epochs: Sequence[tuple[float, HeardEpoch]]) -> dict[int, str]:
        """Return its command in each epoch in which that is another one, by the epoch's number.

        Parameters
        ----------
        epochs : sequence of (float, HeardEpoch)
            Each epoch of the flight, and when it began [s].
        """
        found: dict[int, str] = {}
        ends = [start for start, _ in epochs[1:]] + [math.inf]
        for (start, epoch), end in zip(epochs, ends):
            first = max(bisect_right(self._times, start) - 1, 0)
            for at, decision in zip(self._times[first:], self._decisions[first:]):
                if at >= end:
                    break
                # Both topics are recorded at nearly the same time, in either order.
                same = (decision.state, decision.flown) == (epoch.state, epoch.command)
                if same and decision.differs:
                    found.setdefault(epoch.number, decision.command)
        return found


def _other_decision(step: ReplayedStep) -> OtherDecision:
    flown, other = step.recorded, outcome_values(step.replayed)
    costs: tuple[float | None, float | None] = None, None
    if 'action' in flown and 'action' in other:
        costs = _extra(other, flown['action']), _extra(flown, other['action'])
    return OtherDecision(
        tuple(flown.get('state', ())),
        _command(step.mission, flown),
        _command(step.mission, other),
        step.replayed.reason,
        *costs,
    )


def _command(mission: Mission, outcome: RecordedOutcome) -> str:
    if 'action' not in outcome:
        return ''
    return format_command(mission, global_actions(mission)[outcome['action'] - 1])


def _extra(outcome: RecordedOutcome, number: int) -> float:
    """What an action costs more than the one chosen."""
    return float(outcome['values'][number - 1] - outcome['values'][outcome['action'] - 1])
