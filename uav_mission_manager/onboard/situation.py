"""The situation on board: inputs in, state `[f r.. g.. l c t m]` out, or `[f b g.. l c t m]`.

A `Situation` is immutable; every `with_...` method checks one input and returns the next
situation, or raises `InputError` and leaves the last good value where it is. Time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce

from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Action, Energy, Mission
from uav_mission_manager.onboard.battery import Batteries, BatteryReport
from uav_mission_manager.onboard.inputs import (
    InputError,
    checked_priorities,
    index_of,
    missing_inputs,
)
from uav_mission_manager.onboard.new_goals import goals_of
from uav_mission_manager.onboard.place import off_grid, present_cell, strayed
from uav_mission_manager.onboard.range_model import flags_on_board, level_on_board
from uav_mission_manager.onboard.settling import (
    FAULT_DANGERS,
    THREAT_DANGERS,
    Dangers,
    GoalRequest,
    Wish,
)


@dataclass(frozen=True)
class Situation:
    """What the manager knows.

    Attributes
    ----------
    mission : Mission
        Needs an `energy` section: range flags and charge are computed from it.
    hysteresis : float
        A lost range flag comes back at 1 + hysteresis times the range that its goal needs.
    settling_time : float
        Time [s] for which a danger counts after its end, and after which the next change of
        priorities counts at once.
    threat_unknown : str
        Threat level that counts until one is heard.
    batteries : Batteries
    position : tuple of (east, north) or None
        From the centre of cell 0 [m].
    cell : int
        l, the base before there is a position.
    level : int
        b of the state; full at first.
    dangers : Dangers
        Failed parts, threat, and goals out of range.
    priorities : tuple of k
        g_j.
    refused : tuple of bool
        Whether the vehicle refused to fly to goal j; it counts as out of range.
    request : str
        Id of the request that the priorities come from.
    said : tuple of k
        What the last request with an id asked for when it was last heard.
    wish : Wish
        Priorities that do not count yet.
    commitment, agile : int, bool
        c (the goal committed to, from 1; 0 for none) and m, as the last decided action left
        them.
    seen : mapping
        Time of the last good message by topic [s].
    known : set of str
        Topics heard at any time, also before the process was started anew.
    time : float
        Time of the last change [s].
    """

    mission: Mission
    hysteresis: float = 0.2
    settling_time: float = 0.0
    threat_unknown: str = THREAT_LEVELS[0]
    batteries: Batteries = field(default_factory=Batteries)
    position: tuple[float, float] | None = None
    cell: int = -1
    level: int = -1
    dangers: Dangers = field(default_factory=Dangers)
    priorities: tuple[int, ...] = ()
    refused: tuple[bool, ...] = ()
    request: str = ''
    said: tuple[int, ...] = ()
    wish: Wish = field(default_factory=Wish)
    commitment: int = 0
    agile: bool = False
    seen: Mapping[str, float] = field(default_factory=dict)
    known: frozenset[str] = frozenset()
    time: float = -math.inf

    def __post_init__(self) -> None:
        """Start at the base, charged, with no goal refused, each in range and of priority 0."""
        if self.mission.energy is None:
            raise ValueError(f'mission {self.mission.name}: no energy section, so no range')
        object.__setattr__(self, 'cell', self.mission.grid.base if self.cell < 0 else self.cell)
        if self.level < 0:
            object.__setattr__(self, 'level', self.mission.range.levels - 1)
        object.__setattr__(self, 'priorities', self.priorities or (0,) * self.mission.k)
        object.__setattr__(self, 'refused', self.refused or (False,) * self.mission.k)

    def with_battery(
        self,
        percentage: float,
        now: float,
        healthy: bool = True,
        *,
        voltage: float = math.nan,
        current: float = math.nan,
        capacity: float = math.nan,
        battery: str = '',
    ) -> Situation:
        """Take a `BatteryReport` on the battery of an id; an unhealthy one counts as empty."""
        report = BatteryReport(percentage, voltage, current, capacity, healthy)
        batteries = self.batteries.settle(now).report(battery, report, self._energy, now)
        return self._heard('battery_state', now, batteries=batteries)._ranged()

    def with_position(self, east: float, north: float, now: float) -> Situation:
        """Take a position in `map` [m]; where it is off the grid nothing is decided."""
        if not (math.isfinite(east) and math.isfinite(north)):
            raise InputError(f'odom: position ({east}, {north}) is not finite')
        position = east, north
        cell = present_cell(self.mission, position, self.cell, self.commitment)
        return self._heard('odom', now, position=position, cell=cell)._ranged()

    def with_fault(self, name: str, now: float) -> Situation:
        """Take a fault mode by name."""
        bits = index_of(name, FAULT_MODES, 'fault_mode')
        there = {part for bit, part in enumerate(FAULT_DANGERS) if bits >> bit & 1}
        return self._heard('fault_mode', now)._endangered(there, FAULT_DANGERS)

    def with_threat(self, name: str, now: float) -> Situation:
        """Take a threat level by name."""
        there = set(THREAT_DANGERS[: index_of(name, THREAT_LEVELS, 'threat_level')])
        return self._heard('threat_level', now)._endangered(there, THREAT_DANGERS)

    def with_priorities(self, values: Sequence[int], request: str, now: float) -> Situation:
        """Take a request for the priorities of all goals; added ones that it leaves out stay.

        A request with the id of the last one is its repetition: what it asks for no more has been
        achieved, else it changes nothing. A new one counts at once if nothing is wanted any more,
        or the last change is `settling_time` ago; else it must last so long. It then forgets which
        goals were refused; one without id, which may be repeated, only those that it changes.
        """
        said = checked_priorities(values, self.mission)
        heard = self._heard('goal_priorities', now)
        last = heard.wish.pending or GoalRequest(heard.priorities, heard.request)
        if request and request == last.id:
            return heard._repeated(said)
        asked = GoalRequest(said + last.priorities[len(said) :], request or last.id)
        if not request and asked.priorities == last.priorities:
            return heard
        heard = replace(heard, said=said if request else heard.said)
        if request == heard.request != '':  # The one in force, after another one.
            return replace(heard, wish=Wish(None, heard.time))
        if not any(asked.priorities) or heard.wish.lasts(heard.time, self.settling_time):
            return heard._granted(asked, heard.time)
        return replace(heard, wish=Wish(asked, heard.time))

    def with_completed(self, name: str) -> Situation:
        """Set the priority of a completed goal to 0, and c too where it was committed to."""
        goal = self._goal('goal_completed', name)

        def without(priorities: tuple[int, ...]) -> tuple[int, ...]:
            return tuple(0 if j == goal else g for j, g in enumerate(priorities))

        pending = self.wish.pending
        pending = pending and replace(pending, priorities=without(pending.priorities))
        return replace(
            self,
            priorities=without(self.priorities),
            wish=replace(self.wish, pending=pending),
            commitment=0 if self.commitment == goal + 1 else self.commitment,
        )

    def with_refused(self, name: str) -> Situation:
        """Count a goal as out of range until priorities are asked for anew, or goals reset.

        The commitment stays, as it does for a goal that falls out of range by the charge.
        """
        goal = self._goal('goal_refused', name)
        refused = tuple(j == goal or was for j, was in enumerate(self.refused))
        return replace(self, refused=refused)

    def without_goals(self) -> Situation:
        """Set all priorities and the commitment to 0 and forget refusals, not the request's id."""
        pending = self.wish.pending
        return replace(
            self,
            priorities=(0,) * self.mission.k,
            request=pending.id if pending else self.request,
            wish=replace(self.wish, pending=None),
            commitment=0,
            refused=(),
        )

    def with_mission(self, mission: Mission, wanted: bool = True) -> Situation:
        """Continue with a mission that may follow in flight, see `goals_of`."""
        known = goals_of(mission, self, self._range_dangers, wanted)
        return replace(self, mission=mission, level=-1, **known)._ranged()

    def after(self, action: Action) -> Situation:
        """Continue with c' and m' of a decided action."""
        if (action.commitment, action.agile) == (self.commitment, self.agile):
            return self
        return replace(self, commitment=action.commitment, agile=action.agile)

    def settled(self, now: float) -> Situation:
        """Let time pass: what has lasted counts, what is long over does so no more."""
        now = max(now, self.time)  # A message may be older than the one before it.
        settled = replace(
            self,
            batteries=self.batteries.settle(now),
            dangers=self.dangers.settle(now, self.settling_time),
            wish=self.wish.settle(now),
            time=now,
        )
        pending = settled.wish.pending
        if pending and settled.wish.lasts(now, self.settling_time):
            return settled._granted(pending, settled.wish.changed_at)
        return settled

    @property
    def fault(self) -> int:
        """Fault mode f, from 1."""
        counted = self.dangers.counted
        return 1 + sum((part in counted) << bit for bit, part in enumerate(FAULT_DANGERS))

    @property
    def threat(self) -> int:
        """Threat level t, from 0."""
        if 'threat_level' not in self.known:
            return THREAT_LEVELS.index(self.threat_unknown)
        return sum(danger in self.dangers.counted for danger in THREAT_DANGERS)

    @property
    def in_range(self) -> tuple[int, ...]:
        """Whether the charge reaches goal j."""
        return tuple(int(name not in self.dangers.counted) for name in self._range_dangers)

    @property
    def reachable(self) -> tuple[int, ...]:
        """The range flags r_j of the state: in range by the charge, and not refused."""
        return tuple(int(r and not refused) for r, refused in zip(self.in_range, self.refused))

    @property
    def state(self) -> tuple[int, ...]:
        """The MDP state; with a charge goals that were refused are not wanted."""
        others = self.cell, self.commitment, self.threat, int(self.agile)
        if self.mission.range.charge is None:
            return (self.fault, *self.reachable, *self.priorities, *others)
        wanted = (g * (not refused) for g, refused in zip(self.priorities, self.refused))
        return (self.fault, self.level, *wanted, *others)

    @property
    def refused_goals(self) -> tuple[str, ...]:
        """Names of the refused goals."""
        return tuple(goal.name for goal, was in zip(self.mission.goals, self.refused) if was)

    @cached_property
    def off_grid(self) -> str:
        """How far the position is off the grid, in words; '' where it is not."""
        away = 0.0 if self.position is None else off_grid(self.mission.grid, self.position)
        return f'odom: {away:.0f} m off the grid' if away else ''

    @property
    def strayed(self) -> bool:
        """Whether a position off the grid may still be the vehicle's."""
        return self.position is not None and strayed(self.mission.grid, self.position)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What is unknown or counts as worse than it is measured to be, one line each."""
        until = 'counted as out of range until priorities are asked for anew'
        threat = f'threat_level: never heard, counted as {self.threat_unknown}'
        return (
            *self.batteries.doubts(self._energy, self.time),
            *([self.off_grid] if self.off_grid else []),
            *([] if 'threat_level' in self.known else [threat]),
            *(f'goal_refused: {shown(name)}, {until}' for name in self.refused_goals),
        )

    def ages(self, now: float) -> dict[str, float]:
        """Age [s] of the last good message of every topic heard."""
        return {topic: now - time for topic, time in self.seen.items()}

    def missing(self, now: float, timeout: float) -> tuple[str, ...]:
        """Name the required inputs older than `timeout` [s] or never heard, and how old."""
        return missing_inputs(self.ages(now), timeout)

    @property
    def _energy(self) -> Energy:
        assert self.mission.energy is not None  # See __post_init__.
        return self.mission.energy

    @property
    def _range_dangers(self) -> tuple[str, ...]:
        """The dangers of the range flags r_j."""
        return tuple(f'range {goal.name}' for goal in self.mission.goals)

    def _goal(self, topic: str, name: str) -> int:
        """Number of a goal from 0, by name."""
        return index_of(name, [goal.name for goal in self.mission.goals], topic)

    def _granted(self, asked: GoalRequest, changed_at: float) -> Situation:
        """Let priorities count."""
        refused: tuple[bool, ...] = ()
        if asked.id == self.request:
            changes = zip(self.refused, self.priorities, asked.priorities, strict=True)
            refused = tuple(was and old == new for was, old, new in changes)
        return replace(
            self,
            priorities=asked.priorities,
            request=asked.id,
            refused=refused,
            wish=Wish(None, changed_at),
        )

    def _repeated(self, said: tuple[int, ...]) -> Situation:
        """Drop goals that were achieved, though nobody here heard of it."""
        goals = zip(self.mission.goals, self.said, said)
        achieved = [goal.name for goal, before, now in goals if before and not now]
        return reduce(Situation.with_completed, achieved, replace(self, said=said))

    def _heard(self, topic: str, now: float, **changes: object) -> Situation:
        heard = self.settled(now)
        changes |= {'seen': {**heard.seen, topic: now}, 'known': heard.known | {topic}}
        return replace(heard, **changes)  # type: ignore[arg-type]

    def _endangered(self, there: set[str], among: Sequence[str]) -> Situation:
        dangers = self.dangers.report(there, set(among), self.time)
        return replace(self, dangers=dangers.settle(self.time, self.settling_time))

    def _ranged(self) -> Situation:
        battery = self.batteries.worst(self._energy)
        if battery is None or self.position is None:
            return self
        level = level_on_board(self.mission, battery, self.level)
        place, held = (self.cell, level), (self.in_range, self.hysteresis)
        flags = flags_on_board(self.mission, battery, self.position, place, *held)
        lost = {name for name, flag in zip(self._range_dangers, flags) if not flag}
        return replace(self, level=level)._endangered(lost, self._range_dangers)
