"""Recombination: from the Q values of sub-MDPs to one Q a global action (Algorithm 2).

Each rule takes the global states (N, 2k+5) and, for every sub-MDP, its Q values (N, its
actions), and returns (N, 2k+4): the Q values by which the action is chosen, inf for actions the
rule does not consider.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray
from uav_mission_manager.mdp.cost import commitment_savings
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.submdp import SubMdp


def summed(subs: Sequence[SubMdp], states: IntArray, tables: Sequence[FloatArray]) -> FloatArray:
    """Sum of the sub-MDPs' Q values (Q-decomposition, Russell and Zimdars 2003)."""
    total = np.zeros(_shape(subs, states))
    for sub, table in zip(subs, tables):
        total += _by_global_number(sub, table)
    return total


def best_value(
    subs: Sequence[SubMdp], states: IntArray, tables: Sequence[FloatArray]
) -> FloatArray:
    """Q values of the sub-MDP with the best value (the paper's `ActionCalc_with_values`)."""
    values = np.stack([table.min(axis=1) for table in tables])
    return _of_one(subs, states, tables, values.argmin(axis=0))


def highest_priority(
    subs: Sequence[SubMdp], states: IntArray, tables: Sequence[FloatArray]
) -> FloatArray:
    """Q values of the sub-MDP with the highest priority score, the largest eta_j g_j r_j."""
    mission = subs[0].mission
    s = StateSpace.of(mission).split(states)
    scores = commitment_savings(mission)[np.arange(mission.k), s.g, s.r]
    ranks = np.stack([scores[:, list(sub.goals)].max(axis=1) for sub in subs])
    return _of_one(subs, states, tables, ranks.argmax(axis=0))


def _shape(subs: Sequence[SubMdp], states: IntArray) -> tuple[int, int]:
    return len(states), 2 * subs[0].mission.k + 4


def _by_global_number(sub: SubMdp, table: FloatArray) -> FloatArray:
    q = np.full((len(table), 2 * sub.mission.k + 4), np.inf)
    q[:, np.array(sub.numbers) - 1] = table
    return q


def _of_one(
    subs: Sequence[SubMdp], states: IntArray, tables: Sequence[FloatArray], chosen: IndexArray
) -> FloatArray:
    """Q values of one sub-MDP in each state, given by its position."""
    q = np.empty(_shape(subs, states))
    for position, (sub, table) in enumerate(zip(subs, tables)):
        rows = chosen == position
        q[rows] = _by_global_number(sub, table[rows])
    return q
