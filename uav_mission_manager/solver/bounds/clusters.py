"""Which clusters of goals a certificate uses, and whether they fit in memory."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver import memory
from uav_mission_manager.solver.bounds.ascent import Goals, shared_goals
from uav_mission_manager.solver.decomposition.measures import Measures
from uav_mission_manager.solver.reduced import goal_order
from uav_mission_manager.solver.submdp import sub_mdp_states
from uav_mission_manager.solver.threads import processors

FEWEST_HORIZONS, MOST_HORIZONS = 6.0, 12.0
"""Steps of the ascent by default, in 1 / (1 - discount): as many within these as the work allows.
Measured on the case study with ten goals and pairs: the second six bring the bound up by 0.7 %."""

LARGEST_CLUSTER = 3
"""Most goals of a cluster: (X^n)^2 numbers move the x of each arrival, of X values each."""

WORK_ENTRIES = 15_000_000_000
"""Most entries of all clusters' Q in all steps; on two processors some 4 ns an entry."""

WEAK_COUPLING = 0.05
"""Coupling, over the largest, below which pairs count as equally weak."""

LARGE_TABLES = 6
"""Tables of the size of its psi that a cluster needs while it is worked on, about."""


def default_steps(mission: Mission, clusters: Sequence[Goals]) -> int:
    """Steps of the ascent that are worth their time."""
    horizon = 1 / (1 - mission.discount)
    affordable = WORK_ENTRIES / sum(_entries(mission, len(goals)) for goals in clusters)
    return round(min(max(affordable, FEWEST_HORIZONS * horizon), MOST_HORIZONS * horizon))


def _entries(mission: Mission, n: int) -> int:
    """Entries of the Q of a cluster of n goals."""
    return _levels(mission) * (2 * mission.k + 4) * (3 * mission.range.flag_values) ** n


def covering(mission: Mission, max_states: int) -> list[Goals]:
    """Clusters for a certificate, of at most T_max states each.

    One of all goals, if it fits; else as many of the largest size as can be worked on in about a
    minute, each goal in some three of them at least, or else of a smaller size. What helps most is
    that every pair of goals that couple strongly is in some cluster, so each cluster is the one
    whose pairs are in the fewest so far, in relation to their coupling.

    Raises
    ------
    ValueError
        If the sub-MDP of one goal has more than T_max states.
    """
    k, order = mission.k, goal_order(mission)
    if sub_mdp_states(mission, 1) > max_states:
        raise ValueError(f'no goal has a sub-MDP of at most T_max = {max_states:,} states')
    coupling = Measures(mission).coupling[np.ix_(order, order)]
    for n in range(min(LARGEST_CLUSTER, k), 0, -1):
        work = _entries(mission, n) * FEWEST_HORIZONS / (1 - mission.discount)
        count = min(int(WORK_ENTRIES / work), math.comb(k, n))
        if n == 1:
            return [(j,) for j in range(k)]
        if sub_mdp_states(mission, n) <= max_states and count >= min(k, math.comb(k, n)):
            break
    chosen = _spread(coupling, n, count)
    return [tuple(sorted(order[j] for j in cluster)) for cluster in chosen]


def _spread(coupling: FloatArray, n: int, count: int) -> list[Goals]:
    """So many clusters of n goals: those of goals in none so far, then of pairs least held."""
    k = len(coupling)
    candidates = np.array(list(itertools.combinations(range(k), n)))
    pairs = np.array(list(itertools.combinations(range(n), 2)))
    one, other = candidates[:, pairs].transpose(2, 0, 1)
    held, free, missing = np.ones(coupling.shape), np.ones(len(candidates), bool), np.ones(k, bool)
    weight = 1 / np.maximum(coupling / (coupling.max() or 1.0), WEAK_COUPLING)
    chosen = []
    for _ in range(count):
        new, cost = missing[candidates].sum(axis=1), (held * weight)[one, other].sum(axis=1)
        best = int(np.lexsort((cost, -new, ~free))[0])
        goals = candidates[best]
        free[best] = missing[goals] = False
        held[np.ix_(goals, goals)] += 1
        chosen.append(tuple(goals.tolist()))
    return chosen


def _levels(mission: Mission) -> int:
    """Values of (l, t, z)."""
    return mission.grid.q * len(mission.threat.levels) * 8 * mission.range.levels


def bound_bytes(mission: Mission, clusters: Sequence[Goals]) -> int:
    """Estimate the memory that a lower bound from these clusters needs, in bytes."""
    levels, actions, values = _levels(mission), 2 * mission.k + 4, 3 * mission.range.flag_values
    shared = shared_goals(clusters)
    size = {goals: levels * actions * values ** len(goals) for goals in shared}
    tables = [levels * values ** len(goals) for goals in clusters]
    moves = sum(11 * values ** (2 * len(goals)) for goals in clusters)
    moves += len(clusters) * 11 * (8 * len(mission.threat.levels)) ** 2
    psi = sum(size[goals] * (len(holders) + 1) for goals, holders in shared.items())
    largest = sum(sorted(size.values())[-7:]) or max(tables) * actions
    working = processors() * (2 * LARGE_TABLES * largest + 8 * max(tables))
    return 4 * (psi + 4 * sum(tables) + moves + working)


def check_bound_memory(mission: Mission, clusters: Sequence[Goals]) -> None:
    """Raise `MissionSizeError` where a lower bound from these clusters does not fit."""
    needed = bound_bytes(mission, clusters)
    if not memory.fits(needed):
        raise memory.MissionSizeError(
            f'mission {mission.name}: a lower bound from {len(clusters)} clusters of up to '
            f'{max(map(len, clusters))} goals on {mission.grid.q} cells needs '
            f'{memory.size_text(needed)} of memory, {memory.size_text(memory.available_bytes())} '
            'are free: build without a certificate'
        )
