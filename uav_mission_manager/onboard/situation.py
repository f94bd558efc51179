"""The situation on board: inputs in, state `[f r.. g.. l c t m]` and decision out.

A `Situation` is immutable; every `with_...` method checks one input and returns the next
situation, or raises `InputError` and leaves the last good value where it is. Time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from uav_mission_manager.mdp import (
    FAULT_MODES,
    THREAT_LEVELS,
    Action,
    ActionKind,
    Grid,
    Mission,
)
from uav_mission_manager.onboard.inputs import InputError
from uav_mission_manager.onboard.range_model import range_flags, required_ranges
from uav_mission_manager.policy import Decision, Policy

REQUIRED_INPUTS = ('battery_state', 'odom', 'fault_mode')
"""Inputs that a decision needs, each of them fresh."""

MAX_DIAGONALS_OFF_GRID = 2.0
"""Distance from the grid, in grid diagonals, beyond which a position is refused: a choice. So far
off it comes in another frame or from another origin, and its nearest cell means nothing."""


UNHEALTHY_BATTERY = 'battery_state: reported unhealthy, counted as empty'
"""What is said while the sender of the battery state does not call the battery healthy."""


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
        Needs an `energy` section: the range flags are computed from it.
    hysteresis : float
        A lost range flag comes back at 1 + hysteresis times the range that its goal needs.
    charge : float or None
        State of charge, 0 to 1.
    battery_healthy : bool
        Whether the sender calls the battery healthy; if not, no goal is in range.
    position : tuple of (east, north) or None
        From the centre of cell 0 [m].
    fault, threat : int
        f from 1, t from 0.
    priorities, in_range : tuple of k
        g_j, and whether the charge reaches goal j.
    refused : tuple of bool
        Whether the vehicle refused to fly to goal j; it counts as out of range.
    request : str
        Id of the last request for priorities.
    commitment, agile : int, bool
        c (the goal committed to, from 1; 0 for none) and m, as the last decided action left
        them.
    seen : mapping
        Time of the last good message by topic [s].
    """

    mission: Mission
    hysteresis: float = 0.2
    charge: float | None = None
    battery_healthy: bool = True
    position: tuple[float, float] | None = None
    fault: int = 1
    threat: int = 0
    priorities: tuple[int, ...] = ()
    in_range: tuple[int, ...] = ()
    refused: tuple[bool, ...] = ()
    request: str = ''
    commitment: int = 0
    agile: bool = False
    seen: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Start with every goal in range, not refused and of priority 0."""
        if self.mission.energy is None:
            raise ValueError(f'mission {self.mission.name}: no energy section, so no range')
        object.__setattr__(self, 'priorities', self.priorities or (0,) * self.mission.k)
        object.__setattr__(self, 'in_range', self.in_range or (1,) * self.mission.k)
        object.__setattr__(self, 'refused', self.refused or (False,) * self.mission.k)

    def with_battery(self, percentage: float, now: float, healthy: bool = True) -> Situation:
        """Take a state of charge (0 to 1); NaN and anything outside is unknown.

        A battery that is not `healthy` counts as empty, whatever its percentage.
        """
        charge = percentage if healthy else 0.0
        if not 0.0 <= charge <= 1.0:
            raise InputError(f'battery_state: percentage {charge} is unknown (not in 0..1)')
        return self._heard('battery_state', now, charge=charge, battery_healthy=healthy)._ranged()

    def with_position(self, east: float, north: float, now: float) -> Situation:
        """Take a position in `map` [m], on the grid or near it."""
        if not (math.isfinite(east) and math.isfinite(north)):
            raise InputError(f'odom: position ({east}, {north}) is not finite')
        away = _diagonals_off_grid(self.mission.grid, east, north)
        if away > MAX_DIAGONALS_OFF_GRID:
            # In whole diagonals: the complaint stays the same while the vehicle moves a little.
            raise InputError(
                f'odom: position is {away:.0f} grid diagonals off the grid, '
                f'more than {MAX_DIAGONALS_OFF_GRID:.0f}: another frame or origin?'
            )
        return self._heard('odom', now, position=(east, north))._ranged()

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
        """Take a request for the priorities of all goals.

        A request with the id of the last one is its repetition and changes nothing. A new one
        forgets which goals were refused; one without id, which may be repeated, does so only
        for goals whose priority it changes.
        """
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
        refused: tuple[bool, ...] = ()
        if not request:
            refused = tuple(
                was and old == new
                for was, old, new in zip(self.refused, self.priorities, values, strict=True)
            )
        return self._heard(
            'goal_priorities',
            now,
            priorities=values,
            refused=refused,
            request=request or self.request,
        )

    def with_completed(self, name: str) -> Situation:
        """Set the priority of a completed goal to 0, and c too where it was committed to."""
        goal = self._goal('goal_completed', name)
        priorities = tuple(0 if j == goal else g for j, g in enumerate(self.priorities))
        commitment = 0 if self.commitment == goal + 1 else self.commitment
        return replace(self, priorities=priorities, commitment=commitment)

    def with_refused(self, name: str) -> Situation:
        """Count a goal as out of range until priorities are asked for anew, or goals reset.

        The commitment stays, as it does for a goal that falls out of range by the charge.
        """
        goal = self._goal('goal_refused', name)
        refused = tuple(j == goal or was for j, was in enumerate(self.refused))
        return replace(self, refused=refused)

    def without_goals(self) -> Situation:
        """Set all priorities and the commitment to 0 and forget refusals, not the request's id."""
        return replace(self, priorities=(0,) * self.mission.k, commitment=0, refused=())

    def with_mission(self, mission: Mission) -> Situation:
        """Continue with a mission of the same goals and grid but other numbers."""
        return replace(self, mission=mission)._ranged()

    def after(self, action: Action) -> Situation:
        """Continue with c' and m' of a decided action."""
        return replace(self, commitment=action.commitment, agile=action.agile)

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
            *self.reachable,
            *self.priorities,
            self.cell,
            self.commitment,
            self.threat,
            int(self.agile),
        )

    @property
    def reachable(self) -> tuple[int, ...]:
        """The range flags r_j of the state: in range by the charge, and not refused."""
        return tuple(int(r and not refused) for r, refused in zip(self.in_range, self.refused))

    @property
    def refused_goals(self) -> tuple[str, ...]:
        """Names of the refused goals."""
        goals = zip(self.mission.goals, self.refused)
        return tuple(goal.name for goal, refused in goals if refused)

    @property
    def task(self) -> tuple[object, ...]:
        """What is asked of the vehicle: compare it to see whether that changed."""
        return self.request, self.priorities, self.refused

    def without_refused(self) -> Situation:
        """Return the same situation, with refused goals not wanted instead of out of range."""
        priorities = tuple(
            0 if refused else g for g, refused in zip(self.priorities, self.refused)
        )
        return replace(self, priorities=priorities, refused=())

    @property
    def warnings(self) -> tuple[str, ...]:
        """What counts as worse than it would by the measured values alone, one line each."""
        battery = () if self.battery_healthy else (UNHEALTHY_BATTERY,)
        until = 'counted as out of range until priorities are asked for anew'
        return (*battery, *(f'goal_refused: {name}, {until}' for name in self.refused_goals))

    def ages(self, now: float) -> dict[str, float]:
        """Age [s] of the last good message of every topic heard."""
        return {topic: now - time for topic, time in self.seen.items()}

    def missing(self, now: float, timeout: float) -> tuple[str, ...]:
        """Name the required inputs older than `timeout` [s] or never heard, and how old."""
        ages = self.ages(now)
        # A clock set back makes ages negative: as suspect as old ones.
        return tuple(
            f'{topic} {ages[topic]:.1f} s old' if topic in ages else f'{topic} never received'
            for topic in REQUIRED_INPUTS
            if topic not in ages or abs(ages[topic]) > timeout
        )

    def _goal(self, topic: str, name: str) -> int:
        """Number of a goal from 0, by name."""
        names = [goal.name for goal in self.mission.goals]
        if name not in names:
            raise InputError(f'{topic}: {name!r} is not one of {", ".join(names)}')
        return names.index(name)

    def _heard(self, topic: str, now: float, **changes: object) -> Situation:
        return replace(self, seen={**self.seen, topic: now}, **changes)  # type: ignore[arg-type]

    def _ranged(self) -> Situation:
        if self.charge is None or self.position is None or self.mission.energy is None:
            return self
        if not self.battery_healthy:
            return replace(self, in_range=(0,) * self.mission.k)
        needed = required_ranges(self.mission, self.position)
        flags = range_flags(
            self.mission.energy, self.charge, needed, self.in_range, self.hysteresis
        )
        return replace(self, in_range=flags)


def _diagonals_off_grid(grid: Grid, east: float, north: float) -> float:
    """Distance of a point [m] from the grid, in grid diagonals; 0 on the grid."""
    half, width, height = grid.cell_size / 2, grid.cols, grid.rows
    x, y = (east + half) / grid.cell_size, (half - north) / grid.cell_size
    away = math.hypot(max(-x, x - width, 0.0), max(-y, y - height, 0.0))
    return away / math.hypot(width, height)


def decide(policy: Policy, situation: Situation, now: float, timeout: float) -> Decision | Refusal:
    """Return the policy's decision, or a refusal where a required input is missing.

    In the model recharging brings every goal back into range, but it brings no refused one back:
    where it has no other use, the policy decides as if the refused goals were not wanted, and the
    decision's values are those of that state.

    Parameters
    ----------
    policy : Policy
    situation : Situation
    now : float
        Time [s], on the clock of the situation's inputs.
    timeout : float
        Age [s] above which an input counts as missing.
    """
    missing = situation.missing(now, timeout)
    if missing:
        return Refusal('link lost: ' + ', '.join(missing))
    decision = policy.decide(situation.state)
    refused = ', '.join(situation.refused_goals)
    if refused and decision.action.kind is ActionKind.RECHARGE and all(situation.in_range):
        decision = policy.decide(situation.without_refused().state)
        reason = f'as if {refused}, refused, were not wanted: {decision.reason}'
        return replace(decision, state=situation.state, reason=reason)
    return decision
