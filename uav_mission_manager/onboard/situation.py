"""The situation on board: inputs in, state `[f r.. g.. l c t m]` and decision out.

A `Situation` is immutable; every `with_...` method checks one input and returns the next
situation, or raises `InputError` and leaves the last good value where it is. Time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Action, Mission, global_actions
from uav_mission_manager.onboard.range_model import range_flags, way_home
from uav_mission_manager.policy import Decision, Policy

REQUIRED = ('battery_state', 'odom', 'fault_mode')
"""Inputs without which, or without a fresh value of which, nothing is decided."""


class InputError(ValueError):
    """A refused input: one line naming topic, field and value."""


@dataclass(frozen=True)
class Refusal:
    """No decision, and why."""

    reason: str


@dataclass(frozen=True)
class Situation:
    """What the manager knows.

    Attributes
    ----------
    mission : Mission
        With `energy`, or no range could be told.
    hysteresis : float
        Margin by which a lost range flag must be exceeded to come back (fraction).
    charge : float or None
        State of charge, 0 to 1.
    position : tuple of (east, north) or None
        From the centre of cell 0 [m].
    fault, threat : int
        f from 1, t from 0.
    priorities, in_range : tuple of k
        g_j and r_j.
    request : str
        Id of the last request for priorities taken over.
    commitment, agile : int, bool
        c and m, as the last decided action left them.
    arrived : float or None
        Since when the UAV is in the cell of the goal it is committed to [s].
    seen : mapping
        Time of the last good message by topic [s].
    """

    mission: Mission
    hysteresis: float = 0.2
    charge: float | None = None
    position: tuple[float, float] | None = None
    fault: int = 1
    threat: int = 0
    priorities: tuple[int, ...] = ()
    in_range: tuple[int, ...] = ()
    request: str = ''
    commitment: int = 0
    agile: bool = False
    arrived: float | None = None
    seen: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Start with every goal in range and irrelevant."""
        if self.mission.energy is None:
            raise ValueError(f'mission {self.mission.name}: no energy section, so no range')
        object.__setattr__(self, 'priorities', self.priorities or (0,) * self.mission.k)
        object.__setattr__(self, 'in_range', self.in_range or (1,) * self.mission.k)

    def with_battery(self, percentage: float, now: float) -> Situation:
        """Take a state of charge (0 to 1); NaN and anything outside is unknown."""
        if not 0.0 <= percentage <= 1.0:
            raise InputError(f'battery_state: percentage {percentage} is unknown (not in 0..1)')
        return self._heard('battery_state', now, charge=percentage)._ranged()

    def with_position(self, east: float, north: float, now: float) -> Situation:
        """Take a position in `map` [m]."""
        if not (math.isfinite(east) and math.isfinite(north)):
            raise InputError(f'odom: position ({east}, {north}) is not finite')
        return self._heard('odom', now, position=(east, north))._ranged()._settled(now)

    def with_fault(self, name: str, now: float) -> Situation:
        """Take a fault mode by name."""
        if name not in FAULT_MODES:
            raise InputError(f'fault_mode: {name!r} is not one of {", ".join(FAULT_MODES)}')
        return self._heard('fault_mode', now, fault=FAULT_MODES.index(name) + 1)

    def with_threat(self, name: str, now: float) -> Situation:
        """Take a threat level by name."""
        if name not in THREAT_LEVELS:
            raise InputError(f'threat_level: {name!r} is not one of {", ".join(THREAT_LEVELS)}')
        return self._heard('threat_level', now, threat=THREAT_LEVELS.index(name))

    def with_priorities(self, values: Sequence[int], request: str, now: float) -> Situation:
        """Take a request for priorities, whole or not at all; a repeated id changes nothing."""
        values = tuple(values)
        if len(values) != self.mission.k:
            raise InputError(
                f'goal_priorities: data has {len(values)} values, not {self.mission.k}'
            )
        for goal, value in zip(self.mission.goals, values, strict=True):
            if value not in (0, 1, 2):
                raise InputError(f'goal_priorities: {goal.name} is {value}, not 0, 1 or 2')
        if request and request == self.request:
            return self._heard('goal_priorities', now)
        return self._heard(
            'goal_priorities', now, priorities=values, request=request or self.request
        )

    def with_completed(self, name: str) -> Situation:
        """Take a goal off the list; c returns to 0 when it was committed to."""
        names = [goal.name for goal in self.mission.goals]
        if name not in names:
            raise InputError(f'goal_completed: {name!r} is not one of {", ".join(names)}')
        j = names.index(name) + 1
        priorities = tuple(0 if i == j else g for i, g in enumerate(self.priorities, 1))
        if self.commitment != j:
            return replace(self, priorities=priorities)
        return replace(self, priorities=priorities, commitment=0, arrived=None)

    def without_goals(self) -> Situation:
        """Drop every request and the commitment; the last request id stays known."""
        return replace(self, priorities=(0,) * self.mission.k, commitment=0, arrived=None)

    def under(self, mission: Mission) -> Situation:
        """Continue under a mission with the same goals and grid but other numbers."""
        return replace(self, mission=mission)._ranged()

    def after(self, action: Action, now: float) -> Situation:
        """Continue with c' and m' of a decided action."""
        arrived = self.arrived if action.goal == self.commitment else None
        changed = replace(self, commitment=action.goal, agile=action.agile, arrived=arrived)
        return changed._settled(now)

    @property
    def cell(self) -> int:
        """Cell of the last position, the base before there is one."""
        grid = self.mission.grid
        return grid.base if self.position is None else grid.cell_at(*self.position)

    @property
    def state(self) -> tuple[int, ...]:
        """The MDP state `[f r.. g.. l c t m]`."""
        return (
            self.fault,
            *self.in_range,
            *self.priorities,
            self.cell,
            self.commitment,
            self.threat,
            int(self.agile),
        )

    def ages(self, now: float) -> dict[str, float]:
        """Age [s] of the last good message of every topic heard."""
        return {topic: now - time for topic, time in self.seen.items()}

    def missing(self, now: float, timeout: float) -> tuple[str, ...]:
        """Name the required inputs older than `timeout` [s] or never heard, and how old."""
        ages = self.ages(now)
        # A clock set back makes ages negative: as suspect as old ones.
        return tuple(
            f'{topic} {ages[topic]:.1f} s old' if topic in ages else f'{topic} never received'
            for topic in REQUIRED
            if topic not in ages or abs(ages[topic]) > timeout
        )

    def _heard(self, topic: str, now: float, **changes: object) -> Situation:
        return replace(self, seen={**self.seen, topic: now}, **changes)  # type: ignore[arg-type]

    def _settled(self, now: float) -> Situation:
        j = self.commitment
        if j == 0 or self.mission.goals[j - 1].cell != self.cell:
            return replace(self, arrived=None)
        return replace(self, arrived=now if self.arrived is None else self.arrived)

    def _ranged(self) -> Situation:
        if self.charge is None or self.position is None or self.mission.energy is None:
            return self
        distances = way_home(self.mission, self.position)
        flags = range_flags(
            self.mission.energy, self.charge, distances, self.in_range, self.hysteresis
        )
        return replace(self, in_range=flags)


def decide(
    policy: Policy,
    situation: Situation,
    now: float,
    timeout: float,
    epoch: float,
) -> Decision | Refusal:
    """Decide on a situation, or refuse for want of inputs fresher than `timeout` [s].

    In the model the epoch on site may complete the goal whatever action is chosen in it, so the
    policy already looks past the goal there; obeyed at once, it would leave, find the goal undone
    and turn back for ever. So that epoch is flown: until completion, or `epoch` [s] after
    arrival, the commitment is kept, in the mode the policy asks for.
    """
    missing = situation.missing(now, timeout)
    if missing:
        return Refusal('link lost: ' + ', '.join(missing))
    decision = policy.decide(situation.state)
    if not _on_site(situation, now, epoch) or decision.action.goal == situation.commitment:
        return decision
    keep = (situation.commitment, decision.action.agile)
    action = next(a for a in global_actions(situation.mission) if (a.goal, a.agile) == keep)
    goal = situation.mission.goals[action.goal - 1].name
    return replace(
        decision,
        action=action,
        runner_up=decision.action,
        margin=decision.values[decision.action.number - 1] - decision.values[action.number - 1],
        reason=f'on site at {goal}; then: {decision.reason}',
    )


def _on_site(situation: Situation, now: float, epoch: float) -> bool:
    j = situation.commitment - 1
    return (
        situation.arrived is not None
        and 0.0 <= now - situation.arrived < epoch
        and situation.priorities[j] > 0
        and situation.in_range[j] == 1
        and situation.mission.faults.completion[situation.fault - 1] > 0.0
    )
