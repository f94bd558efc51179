"""Who is given which goal, why, and what it would cost otherwise: Algorithm 2 on what was heard.

Vehicles that are ready share the goals. One that is awaited keeps the goal that it has, and
counts as acting for it. The others have none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.fleet.reports import FleetRole, FleetSettings, VehicleReport
from uav_mission_manager.mdp import PRIORITY_LEVELS, Mission, StateSpace
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.solver.recombination import FleetPlan, FleetPlanner


@dataclass(frozen=True)
class VehicleShare:
    """What a vehicle is given.

    Attributes
    ----------
    vehicle : str
    role : FleetRole
    goal : int
        Counted from 0; -1 for none.
    reason : str
        One line for people.
    """

    vehicle: str
    role: FleetRole
    goal: int
    reason: str


@dataclass(frozen=True)
class FleetDecision:
    """Who is given which goal.

    Attributes
    ----------
    shares : tuple of VehicleShare
        In the order of the vehicles.
    left : mapping of str to str
        Goals that are wanted and have no vehicle, and why.
    """

    shares: tuple[VehicleShare, ...]
    left: Mapping[str, str]

    @property
    def given(self) -> dict[str, int]:
        """The goal of each vehicle, -1 for none."""
        return {share.vehicle: share.goal for share in self.shares}


def share_goals(
    planner: FleetPlanner,
    wanted: Sequence[int],
    reports: Mapping[str, VehicleReport],
    parts: Mapping[str, tuple[FleetRole, str]],
    had: Mapping[str, int],
    settings: FleetSettings,
) -> FleetDecision:
    """Share out the goals.

    Parameters
    ----------
    planner : FleetPlanner
    wanted : sequence of int
        Priority of each goal, 0 where it is achieved.
    reports : mapping of str to VehicleReport
    parts : mapping
        What `roles` says of the vehicles.
    had : mapping of str to int
        The goal of each vehicle up to now, -1 for none.
    settings : FleetSettings
    """
    goals = planner.mission.goals
    taking_part = [
        v
        for v, (role, _) in parts.items()
        if role is FleetRole.READY
        or (role is FleetRole.AWAITED and _goes_on(had[v], wanted, reports[v]))
    ]
    words = {vehicle: why or 'no goal is wanted' for vehicle, (_, why) in parts.items()}
    given = dict.fromkeys(parts, -1)
    left = {goals[j].name: 'no vehicle is ready' for j, g in enumerate(wanted) if g}
    if taking_part and any(wanted):
        case = _Case(
            planner,
            settings.assignment,
            tuple(wanted),
            tuple(taking_part),
            _states(planner.mission, wanted, [reports[v] for v in taking_part]),
            np.array([had[v] for v in taking_part]),
            np.array([had[v] if parts[v][0] is FleetRole.AWAITED else -1 for v in taking_part]),
            np.array([[j in reports[v].refused for j in range(len(goals))] for v in taking_part]),
        )
        plan = case.plan()
        given |= dict(zip(taking_part, plan.pursued[0].tolist()))
        words |= {
            vehicle: f'keeps it for now: {why}' if (why := parts[vehicle][1]) else reason
            for vehicle, reason in zip(taking_part, case.reasons(plan))
        }
        left = case.left(plan)
    shares = (VehicleShare(v, parts[v][0], given[v], words[v]) for v in parts)
    return FleetDecision(tuple(shares), left)


def _goes_on(goal: int, wanted: Sequence[int], report: VehicleReport) -> bool:
    """Whether a vehicle may keep the goal that it had."""
    return goal >= 0 and wanted[goal] > 0 and goal not in report.refused


def _states(mission: Mission, wanted: Sequence[int], reports: Sequence[VehicleReport]) -> IntArray:
    """The states of n vehicles, the fleet's priorities in each, (n, 2k+5)."""
    states = np.array([report.state for report in reports])
    StateSpace.of(mission).split(states).g[:] = wanted
    return states


@dataclass(frozen=True)
class _Case:
    """What is decided on.

    Attributes
    ----------
    planner : FleetPlanner
    assignment : str
    wanted : tuple of k
    vehicles : tuple of n
    states : int array (n, 2k+5)
    had, kept : int arrays (n,)
        Goal of each vehicle up to now, and the one that it keeps whatever is decided; -1 for none.
    refused : bool array (n, k)
    """

    planner: FleetPlanner
    assignment: str
    wanted: tuple[int, ...]
    vehicles: tuple[str, ...]
    states: IntArray
    had: IntArray
    kept: IntArray
    refused: BoolArray

    def plan(self, barred: BoolArray | None = None) -> FleetPlan:
        """Decide; with `barred` (N, n, k), what is forbidden besides, N times."""
        barred = self.refused[None] if barred is None else self.refused | barred
        had, kept, states = (
            np.repeat(each[None], len(barred), axis=0)
            for each in (self.had, self.kept, self.states)
        )
        return self.planner.plan(states, had, self.assignment, kept=kept, barred=barred)

    def reasons(self, plan: FleetPlan) -> list[str]:
        """Why each vehicle has its goal, and what happens, and costs, if it must not have it."""
        pursued, n = plan.pursued[0], len(self.vehicles)
        without = np.zeros((n, *self.refused.shape), bool)
        busy = np.flatnonzero(pursued >= 0)
        without[busy, busy, pursued[busy]] = True
        others = self.plan(without)
        dearer = _gained(plan)[0] - _gained(others)
        return [
            f'{PRIORITY_LEVELS[self.wanted[goal]]} priority, going there saves '
            f'{plan.gains[0, n, goal]:.4g}{self._otherwise(pursued, others.pursued[n], dearer[n])}'
            if goal >= 0
            else 'stands by: no goal is open to it'
            for n, goal in enumerate(pursued.tolist())
        ]

    def _otherwise(self, pursued: IntArray, instead: IntArray, dearer: float) -> str:
        goals = self.planner.mission.goals
        changes = [
            f'{vehicle} to {goals[new].name if new >= 0 else "none"}'
            for vehicle, old, new in zip(self.vehicles, pursued, instead)
            if old != new
        ]
        size = f'{abs(dearer):.3g} {"dearer" if dearer >= 0 else "cheaper"}'
        return f'; otherwise {", ".join(changes)}, {size}' if changes else ''

    def left(self, plan: FleetPlan) -> dict[str, str]:
        """Goals that are wanted and that nobody acts for, and why."""
        goals, limits = self.planner.mission.goals, self.planner.limits
        found = {}
        for j, goal in enumerate(goals):
            before = [goals[i].name for i in np.flatnonzero(limits.before[j]) if self.wanted[i]]
            if not self.wanted[j] or j in plan.pursued[0]:
                continue
            if before:
                found[goal.name] = f'waits for {", ".join(before)}'
            elif limits.counts[j] > 1:
                found[goal.name] = f'waits for {limits.counts[j]} vehicles that are free'
            else:
                found[goal.name] = 'waits for a vehicle that is free'
        return found


def _gained(plan: FleetPlan) -> FloatArray:
    """Sum of what the agents save, of each plan, shape (N,)."""
    goals = plan.pursued[..., None]
    gains = np.take_along_axis(plan.gains, np.maximum(goals, 0), axis=2)
    return np.asarray((gains * (goals >= 0)).sum(axis=(1, 2)))
