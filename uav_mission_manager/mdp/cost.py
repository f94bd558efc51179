"""The stage cost J(s, a), the paper's Eq. (cost), term by term.

    J(s, a) = sum_j goal_costs_j(g_j, r_j) - commitment_savings_c(g_c, r_c)
              + travel_costs(a, l) + fault_costs(f) + threat_costs(t, m)

The first term is what the goals cost as if the UAV were committed to none of them; the second,
0 where c = 0, is what the commitment takes off. Only `travel_costs`, the paper's h, depends on
the action.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.actions import ActionKind, global_actions
from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.routes import distances
from uav_mission_manager.mdp.states import StateSpace

PRIORITIES = np.arange(3.0)[:, None]
"""The values 0, 1, 2 of g_j, over the rows of a table of a goal."""

RANGE_FLAGS = np.arange(2.0)
"""The values 0 and 1 of r_j, over its columns."""


def goal_costs(mission: Mission) -> FloatArray:
    """eta_j g_j r_j + (delta_j g_j + beta/k) (1 - r_j), over goal, g_j and r_j: (k, 3, 2)."""
    delta = np.array([goal.delta for goal in mission.goals])[:, None, None]
    out_of_range = delta * PRIORITIES + mission.range.cost / mission.k
    return commitment_savings(mission) + out_of_range * (1 - RANGE_FLAGS)


def commitment_savings(mission: Mission) -> FloatArray:
    """eta_j g_j r_j, over goal, g_j and r_j: (k, 3, 2)."""
    eta = np.array([goal.eta for goal in mission.goals])[:, None, None]
    return np.asarray(eta * PRIORITIES * RANGE_FLAGS)


def travel_costs(mission: Mission) -> FloatArray:
    """h: distance to the destination, what a service costs where it is given, extra: (2k+4, q)."""
    costs = []
    for action in global_actions(mission):
        cost = mission.distance_weight * distances(mission.grid, action.destination)
        if action.kind in (ActionKind.RECHARGE, ActionKind.REPAIR):
            cost[mission.grid.service] += getattr(mission.service_cost, action.kind.value)
        costs.append(cost)
    extra = mission.extra_costs
    return np.array(costs) + np.array(extra) if extra else np.array(costs)


def fault_costs(mission: Mission) -> FloatArray:
    """phi(f), shape (8,)."""
    return np.array(mission.faults.cost)


def threat_costs(mission: Mission) -> FloatArray:
    """p(t, m), shape (T, 2) for T threat levels."""
    return np.array(mission.threat.cost)


class StageCost:
    """J(s, a) of a mission, its tables made once for many calls."""

    def __init__(self, mission: Mission) -> None:
        self._space = StateSpace.of(mission)
        self._goals, self._savings = goal_costs(mission), commitment_savings(mission)
        self._travel = travel_costs(mission)
        self._faults, self._threat = fault_costs(mission), threat_costs(mission)

    def __call__(self, states: ArrayLike, actions: ArrayLike) -> FloatArray:
        """J(s, a) of states (N, 2k+5) and action numbers (N,), shape (N,). Raises `StateError`."""
        s = self._space.split(self._space.check(states))
        total = self._goals[np.arange(self._space.k), s.g, s.r].sum(axis=1)
        row, goal = np.arange(len(s.c)), np.maximum(s.c - 1, 0)
        saved = self._savings[goal, s.g[row, goal], s.r[row, goal]]
        total += self._faults[s.f - 1] + self._threat[s.t, s.m] - (s.c > 0) * saved
        return np.asarray(total + self._travel[np.asarray(actions) - 1, s.l])


def stage_costs(mission: Mission, states: ArrayLike, actions: ArrayLike) -> FloatArray:
    """J(s, a) of states (N, 2k+5) and action numbers (N,), shape (N,). Raises `StateError`."""
    return StageCost(mission)(states, actions)


def largest_stage_cost(mission: Mission) -> float:
    """Bound on J(s, a) from above; it is nowhere below 0."""
    goals = goal_costs(mission).max(axis=(1, 2)).sum()
    own = travel_costs(mission).max() + fault_costs(mission).max() + threat_costs(mission).max()
    return float(goals + own)
