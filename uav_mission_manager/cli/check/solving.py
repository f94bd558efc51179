"""What shows only in the solution of a mission: goals that are never worth it, sensitivities."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.cli.check.facts import duration_text
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.limits import (
    DRAWN_EPOCHS,
    MAX_SENSITIVITY_SECONDS,
    MAX_SOLVE_SECONDS,
)
from uav_mission_manager.mdp import FAULT_MODES, ActionKind, Mission, StateSpace, global_actions
from uav_mission_manager.policy import ExactPolicy, build_policy
from uav_mission_manager.policy.prediction import likely_seconds, obstacle_to_exact
from uav_mission_manager.solver.evaluation import flown_states, start_state
from uav_mission_manager.solver.evaluation.sensitivity import (
    Sensitivity,
    by_occupancy,
    by_solving,
    parameters,
)
from uav_mission_manager.solver.progress import Progress, ignore
from uav_mission_manager.solver.submdp import whole_mission

LEAST_SEEN = 100
"""Epochs that a fault mode is flown in before it is said never to be repaired: a choice."""


@dataclass(frozen=True)
class Solved:
    """What the optimal policy shows.

    Attributes
    ----------
    findings : tuple of Finding
        Of goals and repairs, seen in simulated flights.
    value : float
        V* at the start.
    seconds : float
        Time that the solution took [s].
    method : str
        How the sensitivities were found, in words.
    sensitivities : tuple of Sensitivity
        The largest first.
    policy : ExactPolicy
        The optimal one.
    """

    findings: tuple[Finding, ...]
    value: float
    seconds: float
    method: str
    sensitivities: tuple[Sensitivity, ...]
    policy: ExactPolicy


def obstacle_to_solving(mission: Mission, most: float = MAX_SOLVE_SECONDS) -> str:
    """Why a mission is not solved if that may take `most` [s], empty where it is."""
    seconds = likely_seconds(whole_mission(mission))
    if seconds > most:
        return (
            f'the exact solution would take about {duration_text(seconds)}, more than the '
            f'{most:g} s that a check waits for'
        )
    return obstacle_to_exact(mission)


def solve(mission: Mission, progress: Progress = ignore) -> Solved:
    """Solve a mission exactly and look at what comes out."""
    began = time.perf_counter()
    policy = build_policy(mission, 'exact')
    assert isinstance(policy, ExactPolicy)
    seconds = time.perf_counter() - began
    start = start_state(mission)
    value = float(policy.part_values(start)[0, 0])
    again = len(parameters(mission)) * likely_seconds(whole_mission(mission))
    if again <= MAX_SENSITIVITY_SECONDS:
        method = 'each changed mission solved exactly'
        found = by_solving(policy.solution, start, progress)
    else:
        method = f'to first order, by one backup in {DRAWN_EPOCHS:,} epochs of flight'
        found = by_occupancy(policy.solution, policy.act, start, DRAWN_EPOCHS, progress)
    return Solved(tuple(flown_findings(policy)), value, seconds, method, tuple(found), policy)


def flown_findings(policy: ExactPolicy) -> Iterator[Finding]:
    """Warn of what the optimal policy never does in flights from base, with any goals wanted."""
    mission, rng = policy.mission, np.random.default_rng(0)
    states = flown_states(mission, policy.act, DRAWN_EPOCHS, rng)
    taken = np.array(global_actions(mission), dtype=object)[policy.act(states) - 1]
    s = StateSpace.of(mission).split(states)
    goals = np.array([-1 if action.goal is None else action.goal for action in taken])
    for j, goal in enumerate(mission.goals):
        # On its cell: a commitment elsewhere may be a cheap way to wait for something else.
        if not ((goals == j) & (s.l == goal.cell)).any() and (s.g[:, j] > 0).any():
            text = f'the best policy gets it done in none of {DRAWN_EPOCHS:,} epochs of flight'
            yield Finding(f'goals.{j}', goal.name, f'{text}: raise its worth, or drop it')
    repairs = np.array([action.kind is ActionKind.REPAIR for action in taken])
    repairs &= s.l == mission.grid.service
    for f in range(2, len(FAULT_MODES) + 1):
        seen = s.f == f
        if seen.sum() >= LEAST_SEEN and not repairs[seen].any():
            text = f'the best policy never has {FAULT_MODES[f - 1]} repaired: raise it'
            yield Finding(f'faults.cost.{f - 1}', mission.faults.cost[f - 1], text)
