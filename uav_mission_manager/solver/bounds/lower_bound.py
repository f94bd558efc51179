"""A lower bound on V* in every state, from costs split among clusters of goals.

Every cluster of goals is a mission of its own that keeps all 2k+4 actions, with a share J_i of
the cost: of what the goals have in common an even one, of a goal's own cost an even one among the
clusters that hold the goal. A policy of the whole mission is, history and all, a policy of each
cluster, so with sum_i J_i = J

    sum_i V_i <= V*

(Russell and Zimdars 2003). Shifting cost between clusters, J_i + psi_i with sum_i psi_i = 0, keeps
this true and can tighten it; `uav_mission_manager.solver.bounds.ascent` looks for the best psi.
Whatever that finds, value iteration in double precision then proves the bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray, RealArray
from uav_mission_manager.mdp.cost import largest_stage_cost
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.bounds.ascent import Ascent, each
from uav_mission_manager.solver.bounds.cluster_mdp import ClusterMdp, Terms, proven_values
from uav_mission_manager.solver.bounds.clusters import check_bound_memory, default_steps
from uav_mission_manager.solver.progress import Progress, Report, ignore
from uav_mission_manager.solver.reduced import X_VALUES, ReducedMission
from uav_mission_manager.solver.submdp import shared_sub_mdps, whole_mission
from uav_mission_manager.solver.threads import processors, single_threaded_blas

CLIMBING = 0.8
"""Share of the time that the ascent takes; the rest is for the proof."""

SINGLE_LOSS = 1e-5
"""Part of the bound that its tables in single precision may cost."""

LOSS_STATES = 1_000
"""States, drawn evenly, in which that is looked at."""


@dataclass(frozen=True)
class LowerBound:
    """A proven lower bound on the optimal cost.

    Attributes
    ----------
    mission : Mission
    clusters : int array (C, n)
        Goals of each cluster, from 0, ascending.
    tables : float32 or float64 array (C, q, T, 8, 6, .., 6)
        Lower bounds on each cluster's W over l, t, f and its x_j = 2 g_j + r_j, so
        V*(s) >= p(t, m) - [c > 0] eta_c g_c r_c + sum of the clusters' W.
    """

    mission: Mission
    clusters: IndexArray
    tables: RealArray

    def values(self, states: IntArray) -> FloatArray:
        """Lower bound on V* of valid states (N, 2k+5), shape (N,)."""
        return np.maximum(self.sums(states), 0.0)

    def sums(self, states: IntArray) -> FloatArray:
        """Return the same before it is raised to 0, below which no cost is."""
        s, x = self._whole.split(states), self._whole.x(states)
        shared = (part[:, None] for part in (s.l, s.t, s.f - 1))
        own = (x[:, column] for column in self.clusters.T)
        entries = self.tables[(np.arange(len(self.clusters)), *shared, *own)]
        return np.asarray(self._whole.mode_costs(states) + entries.sum(axis=1, dtype=float))

    @cached_property
    def _whole(self) -> ReducedMission:
        return ReducedMission(whole_mission(self.mission))


def lower_bound(
    mission: Mission,
    clusters: Sequence[Sequence[int]],
    *,
    iterations: int | None = None,
    tolerance: float = 1e-4,
    threads: int | None = None,
    progress: Progress = ignore,
) -> LowerBound:
    """Bound V* from below by the sum over clusters of goals.

    Parameters
    ----------
    mission : Mission
    clusters : sequence of sequences of int
        Goals, from 0, of each cluster: as many in each, every goal in at least one. A cluster of
        all goals gives V* itself; others are then left out.
    iterations : int, optional
        Steps of the ascent; 0 leaves the even split. By default 6 / (1 - discount), or up to twice
        as many where they take little time.
    tolerance : float
        How far value iteration may stay below the clusters' optima, all together, relative to the
        mean of their sum.
    threads : int, optional
        At most this many; all processors by default. The result is the same bits.
    progress : Progress
        Is told of each step of the ascent.

    Raises
    ------
    ValueError
        If the clusters are of different sizes, name no such goal or one twice, or leave one out,
        or an option is out of its range.
    MissionSizeError
        If the memory does not suffice.
    """
    members = _members(clusters, mission.k)
    shared = [tuple(goals) for goals in members.tolist()]
    iterations = default_steps(mission, shared) if iterations is None else iterations
    if iterations < 0:
        raise ValueError(f'iterations {iterations} must not be below 0')
    if not tolerance > 0:
        raise ValueError(f'tolerance {tolerance} must be above 0')
    check_bound_memory(mission, shared)
    with single_threaded_blas():
        threads = threads or processors()
        bound = _climbed(mission, members, iterations, tolerance, threads, progress)
    progress(Report(iterations, 1.0, 'lower bound proven'))
    return bound


def _members(clusters: Sequence[Sequence[int]], k: int) -> IndexArray:
    if not clusters or len({len(goals) for goals in clusters}) > 1:
        raise ValueError(f'clusters {clusters} must be of one size')
    if any(len(set(goals)) < len(goals) for goals in clusters):
        raise ValueError(f'clusters {clusters} name a goal twice')
    if {j for goals in clusters for j in goals} != set(range(k)):
        raise ValueError(f'clusters {clusters} must hold the goals 0..{k - 1}, each at least once')
    members = np.sort(np.array(clusters, dtype=np.intp), axis=1)
    return members[:1] if members.shape[1] == k else members


def _climbed(
    mission: Mission,
    members: IndexArray,
    iterations: int,
    tolerance: float,
    threads: int,
    progress: Progress,
) -> LowerBound:
    """The bound after so many steps of the ascent."""
    subs = shared_sub_mdps(mission, members)
    ascent = Ascent(subs, _power_of_two(largest_stage_cost(mission)), threads)
    for step in range(iterations if ascent.possible else 0):
        ascent.climb(step / iterations)
        text = f'lower bound, step {step + 1} of {iterations}'
        progress(Report(step + 1, CLIMBING * (step + 1) / iterations, text))

    def prove(cluster: int) -> RealArray:
        return _proven(ascent, cluster, ascent.psi(cluster), tolerance)

    def prove_even(cluster: int) -> RealArray:
        return _proven(ascent, cluster, {}, tolerance)

    found = each(prove, len(subs), threads)
    if iterations and _mean(found) < ascent.unit * ascent.mean:
        found = max(found, each(prove_even, len(subs), threads), key=_mean)
    return _rounded_down(mission, members, np.array(found))


def _power_of_two(value: float) -> float:
    """A power of two near a number, so that dividing by it is exact; 1 for 0."""
    return math.ldexp(1.0, math.frexp(value)[1]) if value > 0 else 1.0


def _proven(ascent: Ascent, cluster: int, psi: Terms, tolerance: float) -> RealArray:
    """Lower bound on a cluster's W under psi, (q, 6^n, 8 T)."""
    mdp = ClusterMdp(ascent.mdps[cluster].sub, np.float64)
    allowed = tolerance * ascent.unit * ascent.mean / len(ascent.mdps)
    return proven_values(mdp, mdp.costs(psi), ascent.settled(cluster, allowed), allowed)


def _mean(tables: Sequence[RealArray]) -> float:
    """Mean over evenly drawn states of the sum of the clusters' W."""
    return float(sum(table.mean() for table in tables))


def _rounded_down(mission: Mission, members: IndexArray, tables: FloatArray) -> LowerBound:
    """The bound from W (C, q, 6^n, 8 T), in single precision where that costs little."""
    tables = tables.reshape(*tables.shape[:3], -1, 8).transpose(0, 1, 3, 4, 2)
    axes = (*tables.shape[:4], *(X_VALUES,) * members.shape[1])
    with np.errstate(over='ignore'):
        rounded = tables.astype(np.float32)
        rounded = np.where(rounded > tables, np.nextafter(rounded, np.float32(-np.inf)), rounded)
    double = LowerBound(mission, members, np.ascontiguousarray(tables).reshape(axes))
    single = LowerBound(mission, members, np.ascontiguousarray(rounded).reshape(axes))
    states = StateSpace.of(mission).draw(LOSS_STATES, np.random.default_rng(0))
    above, below = double.values(states), single.values(states)
    return single if (above - below <= SINGLE_LOSS * above).all() else double
