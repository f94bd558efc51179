"""A lower bound on V* in every state, from costs split among clusters of goals.

Every cluster of goals is a mission of its own that keeps all 2k+4 actions, with a share J_i of
the cost: of what the goals have in common an even one, of a goal's own cost an even one among the
clusters that hold the goal. A policy of the whole mission is, history and all, a policy of each
cluster, so with sum_i J_i = J

    sum_i V_i <= V*

(Russell and Zimdars 2003; Adelman and Mersereau 2008). Shifting cost between clusters,
J_i + psi_i with sum_i psi_i = 0, keeps this true and can tighten it: psi_i(y, a) between all
clusters, psi_i(y, x_j, a) between those that share goal j; y = (place, t, f), x_j = (g_j, r_j).
The sum of the V_i, averaged over states, is concave in psi, and greatest where the clusters that
share psi agree on how often each (y, a) or (y, x_j, a) occurs. With a soft minimum of temperature
tau, adding tau log(rho_i / mean rho) to psi_i would make the occupancies rho agree if the
distribution of states stayed the same (Sinkhorn 1967); since it follows, a part of that is taken
in each iteration, while tau falls and V_i and rho_i follow psi by one sweep. Whatever psi that
ends in, value iteration then proves the bound.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray, RealArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.bounds.cluster_mdp import ClusterMdp, proven_values
from uav_mission_manager.solver.progress import Progress, Report, ignore
from uav_mission_manager.solver.reduced import X_VALUES, ReducedMission, goal_order
from uav_mission_manager.solver.submdp import shared_sub_mdps, state_count, whole_mission
from uav_mission_manager.solver.threads import processors, share, single_threaded_blas

T = TypeVar('T')

FIRST_TEMPERATURE = 0.5
"""Of the soft minimum, in the mean cost of an epoch over the square of the clusters that hold a
goal on average."""

COOLING = 1 / 150
"""Last temperature over the first."""

STEP = 3.0
"""Part of the agreeing psi taken in an iteration, in (1 - discount). Measured on the case study
and random missions of three and ten goals: larger parts and higher temperatures overshoot, lower
ones creep."""

HORIZONS = 6.0
"""Iterations by default, in 1 / (1 - discount)."""

RARE = 1e-6
"""What is added to occupancies, of which a state's is 1 on average."""

PSI_UNIT = 2.0**-24
"""Of the mean cost of an epoch: psi is rounded to multiples of it, so that its sums are exact."""

ROUGH_TOLERANCE = 1e-2
"""Tolerance of the values that the ascent starts from."""

WORK_ENTRIES = 1 << 26
"""Most entries of all clusters' Q in a certificate; an iteration takes some 10 ns an entry."""

SINGLE_LOSS = 1e-6
"""Part of the bound that rounding its tables to float32 may cost; else they are float64."""


@dataclass(frozen=True)
class LowerBound:
    """A proven lower bound on the optimal cost.

    Attributes
    ----------
    mission : Mission
    clusters : int array (C, n)
        Goals of each cluster, from 0, ascending.
    tables : float32 or float64 array (C, q, 3, 8, 6, .., 6)
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
        Goals, from 0, of each cluster: as many in each, every goal in at least one. A single
        cluster of all goals gives V* itself.
    iterations : int, optional
        Steps of the ascent; 0 leaves the even split. By default 6 / (1 - discount).
    tolerance : float
        How far value iteration may stay below a cluster's optimum, relative to its largest W.
    threads : int, optional
        At most this many; all processors by default. The result is the same bits.
    progress : Progress
        Is told of each step of the ascent.

    Raises
    ------
    ValueError
        If the clusters are of different sizes, name no such goal or one twice, or leave one out,
        or an option is out of its range.
    """
    members = _members(clusters, mission.k)
    if iterations is None:
        iterations = round(HORIZONS / (1 - mission.discount))
    if iterations < 0:
        raise ValueError(f'iterations {iterations} must not be below 0')
    if not tolerance > 0:
        raise ValueError(f'tolerance {tolerance} must be above 0')
    with single_threaded_blas():
        split = _Split(mission, members, processors() if threads is None else threads)
        best = _best(split, iterations, tolerance, progress)
    progress(Report(iterations, 1.0, 'lower bound proven'))
    return LowerBound(mission, members, _rounded_down(best, members.shape[1]))


def _members(clusters: Sequence[Sequence[int]], k: int) -> IndexArray:
    if not clusters or len({len(goals) for goals in clusters}) > 1:
        raise ValueError(f'clusters {clusters} must be of one size')
    if any(len(set(goals)) < len(goals) for goals in clusters):
        raise ValueError(f'clusters {clusters} name a goal twice')
    if {j for goals in clusters for j in goals} != set(range(k)):
        raise ValueError(f'clusters {clusters} must hold the goals 0..{k - 1}, each at least once')
    return np.sort(np.array(clusters, dtype=np.intp), axis=1)


def _best(split: _Split, iterations: int, tolerance: float, progress: Progress) -> FloatArray:
    """The better of the even split and of what the ascent finds."""
    if len(split.members) == 1 or not iterations:
        return split.proven(tolerance)
    even = split.proven(ROUGH_TOLERANCE)
    mean = split.epoch_cost(even)
    if mean == 0:
        return split.proven(tolerance, even)
    ascent = _Ascent(split, even, mean)
    for step in range(iterations):
        ascent.climb(step / iterations)
        text = f'lower bound, step {step + 1} of {iterations}'
        progress(Report(step + 1, (step + 1) / (iterations + 1), text))
    best = split.proven(
        tolerance, ascent.unit * ascent.values.astype(np.float64), ascent.balanced()
    )
    return best if best.sum() > even.sum() else split.proven(tolerance, even)


def _rounded_down(values: FloatArray, n: int) -> RealArray:
    """Tables in float32, where that costs little, rounded down, over the axes of W."""
    with np.errstate(over='ignore'):
        single = values.astype(np.float32)
        single = np.where(single > values, np.nextafter(single, np.float32(-np.inf)), single)
    every = (1, 2, 3, 4)
    loss = (values - single).max(axis=every).sum()
    tables = single if loss <= SINGLE_LOSS * values.min(axis=every).sum() else values
    return tables.reshape(*values.shape[:4], *(X_VALUES,) * n)


class _Split:
    """The clusters, and what their even split costs."""

    def __init__(self, mission: Mission, members: IndexArray, threads: int) -> None:
        self.mission, self.members, self.threads = mission, members, threads
        self.subs = shared_sub_mdps(mission, members)
        self.holders = np.bincount(members.ravel())
        n = members.shape[1]
        x = np.indices((X_VALUES,) * n).reshape(n, -1)
        own = (x[:, None] == np.arange(X_VALUES)[:, None]).reshape(X_VALUES * n, -1)
        self.columns = np.vstack([own, np.ones((1, own.shape[1]))])
        """Which psi add up for each x, (6 n + 1, 6^n): one by slot and x_j, and one of all."""

    def epoch_cost(self, values: FloatArray) -> float:
        """Mean cost of an epoch, from the clusters' W."""
        return (1 - self.mission.discount) * float(np.abs(values.sum(axis=0)).mean())

    def each(self, work: Callable[[int], T]) -> list[T]:
        """Results of work(cluster), of the clusters in their order."""

        def numbered(thread: int, cluster: int) -> tuple[int, T]:
            return cluster, work(cluster)

        found = dict(share(numbered, range(len(self.members)), self.threads))
        return [found[cluster] for cluster in range(len(self.members))]

    def proven(
        self, tolerance: float, start: FloatArray | None = None, psi: FloatArray | None = None
    ) -> FloatArray:
        """Lower bounds on the clusters' W, (C, q, 3, 8, 6^n)."""

        def prove(cluster: int) -> RealArray:
            mdp = ClusterMdp(self.subs[cluster], np.float64)
            shape = (-1, *mdp.shape[1:])
            shifts: list[RealArray] = [np.zeros((1, 1, 1, 1))] * mdp.shape[0]
            if psi is not None:
                shifts = [(part @ self.columns).reshape(shape) for part in psi[cluster]]
            values = np.zeros(mdp.shape) if start is None else start[cluster]
            return proven_values(mdp, shifts, values, tolerance)

        return np.array(self.each(prove))


class _Ascent:
    """Ascent on psi, (C, q, A, 3 * 8, 6 n + 1), from V_i of the even split.

    All costs are over `unit`, the mean cost of an epoch to the next power of two, so that single
    precision does whatever they are counted in.
    """

    def __init__(self, split: _Split, even: FloatArray, mean: float) -> None:
        self.split, self.rest = split, 1 - split.mission.discount
        self.unit = unit = 2.0 ** math.ceil(math.log2(mean))
        self.warm = FIRST_TEMPERATURE * mean / unit / split.holders.mean() ** 2
        self.columns = split.columns.astype(np.float32)
        self.mdps = [ClusterMdp(sub, np.float32, unit) for sub in split.subs]
        self.values = (even / unit).astype(np.float32)
        self.occupancy = np.ones_like(self.values)
        actions = len(split.subs[0].numbers)
        shape = len(even), len(even[0]), actions, 24, len(self.columns)
        self.psi: RealArray = np.zeros(shape, np.float32)
        self.pools = [np.nonzero(split.members == j) for j in range(split.mission.k)]

    def climb(self, done: float) -> None:
        """Take one step, after a part of all."""
        tau = np.float32(self.warm * COOLING**done)
        step = np.stack(self.split.each(lambda cluster: self._visit(cluster, tau)))
        np.log(step + np.float32(RARE), out=step)
        step *= np.float32(STEP * self.rest) * tau
        step[..., -1] -= step[..., -1].mean(axis=0)
        own = self._own(step)
        for clusters, slots in self.pools:
            own[clusters, ..., slots, :] -= own[clusters, ..., slots, :].mean(axis=0)
        self.psi += step

    def balanced(self) -> FloatArray:
        """Psi as multiples of its unit; exactly zero in sum over the clusters that share it."""
        psi = np.round(self.psi.astype(float) / PSI_UNIT)
        own = self._own(psi)
        psi[-1, ..., -1] -= psi[..., -1].sum(axis=0)
        for clusters, slots in self.pools:
            own[clusters[-1], ..., slots[-1], :] -= own[clusters, ..., slots, :].sum(axis=0)
        return np.asarray(psi * (PSI_UNIT * self.unit))

    def _visit(self, cluster: int, tau: np.float32) -> RealArray:
        """Sweep a cluster's W and occupancy; return the occupancies of (y, x_j, a) and (y, a)."""
        mdp, values = self.mdps[cluster], self.values[cluster]
        ahead = mdp.ahead(values)
        arrived = {arrival: np.zeros_like(table) for arrival, table in ahead.items()}
        marginals = np.empty_like(self.psi[cluster])
        for cell, psi in enumerate(self.psi[cluster]):
            q = mdp.q_values(cell, ahead)
            q += (psi @ self.columns).reshape(q.shape)
            least = q.min(axis=0)
            q -= least
            q *= -1 / tau
            np.exp(q, out=q)
            total = q.sum(axis=0)
            values[cell] = least - tau * np.log(total) + mdp.state_costs
            q *= self.occupancy[cluster, cell] / total
            marginals[cell] = q.reshape(*psi.shape[:2], -1) @ self.columns.T
            mdp.leave(cell, q, arrived)
        self.occupancy[cluster] = self.rest + mdp.settle(arrived)
        return marginals

    def _own(self, rows: RealArray) -> RealArray:
        """View of psi(y, x_j, a): (C, q, A, 24, n, 6)."""
        return rows[..., :-1].reshape(*rows.shape[:-1], -1, X_VALUES)


def covering(mission: Mission, max_states: int) -> list[tuple[int, ...]]:
    """Clusters for a certificate, of at most T_max states each.

    One of all goals, if it fits; else triples that hold every pair, or all pairs of up to four
    goals and a ring of pairs of more, or single goals. Where an iteration of the ascent would
    take long, because of many goals, the next smaller ones.

    Raises
    ------
    ValueError
        If the sub-MDP of one goal has more than T_max states.
    """
    k, order = mission.k, goal_order(mission)
    if state_count(1, mission.grid.q, 8) > max_states:
        raise ValueError(f'no goal has a sub-MDP of at most T_max = {max_states:,} states')
    for n, cover in ((3, _triples(k)), (2, _ring(k)), (1, [(j,) for j in range(k)])):
        entries = len(cover) * mission.grid.q * (2 * k + 4) * 24 * 6**n
        if n == 1 or (
            n <= k and state_count(n, mission.grid.q, 8) <= max_states and entries <= WORK_ENTRIES
        ):
            break
    return [tuple(order[j] for j in cluster) for cluster in cover]


def _triples(k: int) -> list[tuple[int, ...]]:
    """Triples of k goals that hold every pair, each the one that holds most pairs left."""
    missing = set(itertools.combinations(range(k), 2))
    triples: list[tuple[int, ...]] = []
    while missing and k > 2:
        triples.append(
            max(
                itertools.combinations(range(k), 3),
                key=lambda t: len(missing.intersection(itertools.combinations(t, 2))),
            )
        )
        missing.difference_update(itertools.combinations(triples[-1], 2))
    return triples


def _ring(k: int) -> list[tuple[int, ...]]:
    """All pairs of up to four goals; of more, each with the next."""
    if k <= 4:
        return list(itertools.combinations(range(k), 2))
    return [(j, (j + 1) % k) for j in range(k)]
