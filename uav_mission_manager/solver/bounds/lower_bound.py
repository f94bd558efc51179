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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import DTypeLike, NDArray

from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.bounds.cluster_mdp import ClusterMdp, proven_values
from uav_mission_manager.solver.expansion.basis import cluster_states
from uav_mission_manager.solver.factors import STAKES, Factors, goal_order

WARM, FALL = 0.5, 1 / 150
"""First temperature of the soft minimum, in the mean cost of an epoch over the square of the
clusters that hold a goal on average, and what is left of it in the end."""

RATE, HORIZONS = 3.0, 6.0
"""Part of the agreeing psi taken, in (1 - discount), and iterations, in 1 / (1 - discount).
Measured on the case study and random missions of three and ten goals: larger parts
and higher temperatures overshoot, lower ones creep."""

RARE = 1e-6
"""What is added to occupancies, of which a state's is 1 on average."""

GRID = 2.0**-24
"""Of the mean cost: psi is rounded to multiples of it, so that its sums are exact."""

ROUGH = 1e-2
"""Tolerance of the values that the ascent starts from."""

WORK = 1 << 26
"""Most entries of all clusters' Q in a certificate; an iteration takes some 10 ns an entry."""

TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class LowerBound:
    """A proven lower bound on the optimal cost.

    Attributes
    ----------
    mission : Mission
    clusters : int array (C, n)
        Goals of each cluster, from 0.
    tables : float32 array (C, P, 3, 8, 6, .., 6)
        Lower bounds on each cluster's W over place, t, f and its x_j = 2 g_j + r_j, so
        V*(s) >= p(t, m) - [c > 0] eta_c g_c r_c + sum of the clusters' W.
    """

    mission: Mission
    clusters: NDArray[np.intp]
    tables: NDArray[np.float32]

    def values(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """Lower bound on V* of valid states (N, 2k+5), shape (N,)."""
        return np.maximum(self.sums(states), 0.0)

    def sums(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the same before it is raised to 0, below which no cost is."""
        k, goals, eta = self.mission.k, self._goals, self._eta
        f, (cell, c, t, m) = states[:, 0] - 1, states[:, -4:].T
        x = 2 * states[:, 1 + k : 1 + 2 * k] + states[:, 1 : 1 + k]
        place = np.where(cell == goals[c], self.mission.grid.q + c - 1, cell)
        committed = x[np.arange(len(x)), np.maximum(c - 1, 0)]
        total = self._threat[t, m] - eta[c] * STAKES[committed]
        shared = (part[:, None] for part in (place, t, f))
        own = (x[:, column] for column in self.clusters.T)
        entries = self.tables[(np.arange(len(self.clusters)), *shared, *own)]
        total += entries.sum(axis=1, dtype=float)
        return np.asarray(total)

    @cached_property
    def _goals(self) -> NDArray[np.intp]:
        return np.array([-1, *(goal.cell for goal in self.mission.goals)])

    @cached_property
    def _eta(self) -> NDArray[np.float64]:
        return np.array([0.0, *(goal.eta for goal in self.mission.goals)])

    @cached_property
    def _threat(self) -> NDArray[np.float64]:
        return np.array(self.mission.threat.cost)


def lower_bound(
    mission: Mission,
    clusters: Sequence[Sequence[int]],
    *,
    iterations: int | None = None,
    tolerance: float = 1e-4,
    on_step: Callable[[int, int], None] | None = None,
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
    on_step : callable, optional
        Called after each step of the ascent with its number and that of all.

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
    split = _Split(Factors(mission), members)
    if len(members) == 1 or not iterations:
        best = split.proven(tolerance)
    else:
        even = split.proven(ROUGH)
        ascent = _Ascent(split, even)
        for step in range(iterations):
            ascent.climb(step / iterations)
            if on_step is not None:
                on_step(step + 1, iterations)
        best = split.proven(tolerance, ascent.values.astype(float), ascent.balanced())
        if best.sum() < even.sum():
            best = split.proven(tolerance, even)
    tables = best.astype(np.float32)
    tables = np.where(tables > best, np.nextafter(tables, np.float32(-np.inf)), tables)
    return LowerBound(mission, members, tables.reshape(*best.shape[:4], *(6,) * members.shape[1]))


def _members(clusters: Sequence[Sequence[int]], k: int) -> NDArray[np.intp]:
    if not clusters or len({len(goals) for goals in clusters}) > 1:
        raise ValueError(f'clusters {clusters} must be of one size')
    if any(len(set(goals)) < len(goals) for goals in clusters):
        raise ValueError(f'clusters {clusters} name a goal twice')
    if {j for goals in clusters for j in goals} != set(range(k)):
        raise ValueError(f'clusters {clusters} must hold the goals 0..{k - 1}, each at least once')
    return np.array(clusters, dtype=np.intp)


class _Split:
    """The clusters, and what their even split costs."""

    def __init__(self, factors: Factors, members: NDArray[np.intp]) -> None:
        self.factors, self.members = factors, members
        self.holders = np.bincount(members.ravel())
        n = members.shape[1]
        x = np.indices((6,) * n).reshape(n, -1)
        own = (x[:, None] == np.arange(6)[:, None]).reshape(6 * n, -1)
        self.columns = np.vstack([own, np.ones((1, own.shape[1]))])
        """Which psi add up for each x, (6 n + 1, 6^n): one by slot and x_j, and one of all."""

    def mdp(self, cluster: int, dtype: DTypeLike) -> ClusterMdp:
        return ClusterMdp(self.factors, self.members[cluster].tolist(), dtype)

    def costs(self, mdp: ClusterMdp) -> list[FloatArray]:
        return mdp.costs(self.holders, len(self.members))

    def proven(
        self, tolerance: float, start: FloatArray | None = None, psi: FloatArray | None = None
    ) -> FloatArray:
        """Lower bounds on the clusters' W, (C, P, 3, 8, 6^n)."""

        def prove(cluster: int) -> FloatArray:
            mdp = self.mdp(cluster, np.float64)
            costs = self.costs(mdp)
            if psi is not None:
                for cost, shift in zip(costs, psi[cluster]):
                    cost += (shift @ self.columns).reshape(cost.shape)
            values = np.zeros(mdp.shape) if start is None else start[cluster]
            return proven_values(mdp, costs, values, tolerance)

        return np.stack([prove(cluster) for cluster in range(len(self.members))])


class _Ascent:
    """Ascent on psi, (C, P, A, 3 * 8, 6 n + 1), from V_i of the even split."""

    def __init__(self, split: _Split, even: FloatArray) -> None:
        self.split, self.rest = split, 1 - split.factors.mission.discount
        self.unit = self.rest * float(np.abs(even.sum(axis=0)).mean())
        self.warm = WARM * max(self.unit, TINY) / split.holders.mean() ** 2
        self.columns = split.columns.astype(np.float32)
        self.mdps = [split.mdp(c, np.float32) for c in range(len(split.members))]
        self.costs = [split.costs(mdp) for mdp in self.mdps]
        self.values = even.astype(np.float32)
        self.occupancy = np.ones_like(self.values)
        shape = len(even), len(even[0]), len(split.factors.actions), 24, len(self.columns)
        self.psi: FloatArray = np.zeros(shape, np.float32)
        self.pools = [np.nonzero(split.members == j) for j in range(split.factors.k)]

    def climb(self, done: float) -> None:
        """Take one step, after a part of all."""
        tau = np.float32(self.warm * FALL**done)
        step = np.stack([self._visit(cluster, tau) for cluster in range(len(self.mdps))])
        np.log(step + np.float32(RARE), out=step)
        step *= np.float32(RATE * self.rest) * tau
        step[..., -1] -= step[..., -1].mean(axis=0)
        own = self._own(step)
        for clusters, slots in self.pools:
            own[clusters, ..., slots, :] -= own[clusters, ..., slots, :].mean(axis=0)
        self.psi += step

    def balanced(self) -> FloatArray:
        """Psi on the grid; exactly zero in sum over the clusters that share it."""
        grid = GRID * 2.0 ** np.ceil(np.log2(max(self.unit, TINY)))
        psi = grid * np.round(self.psi / grid)
        own = self._own(psi)
        psi[-1, ..., -1] -= psi[..., -1].sum(axis=0)
        for clusters, slots in self.pools:
            own[clusters[-1], ..., slots[-1], :] -= own[clusters, ..., slots, :].sum(axis=0)
        return psi

    def _visit(self, cluster: int, tau: np.float32) -> FloatArray:
        """Sweep a cluster's W and occupancy; return the occupancies of (y, x_j, a) and (y, a)."""
        mdp, values = self.mdps[cluster], self.values[cluster]
        ahead = mdp.ahead(values)
        arrived = {arrival: np.zeros_like(table) for arrival, table in ahead.items()}
        marginals = np.empty_like(self.psi[cluster])
        for place, cost in enumerate(self.costs[cluster]):
            q = mdp.expected(place, ahead)
            q += cost
            q += (self.psi[cluster, place] @ self.columns).reshape(q.shape)
            least = q.min(axis=0)
            q -= least
            q *= -1 / tau
            np.exp(q, out=q)
            total = q.sum(axis=0)
            values[place] = least - tau * np.log(total)
            q *= self.occupancy[cluster, place] / total
            marginals[place] = q.reshape(*marginals.shape[1:3], -1) @ self.columns.T
            mdp.leave(place, q, arrived)
        self.occupancy[cluster] = self.rest + mdp.settle(arrived)
        return marginals

    def _own(self, rows: FloatArray) -> FloatArray:
        """View of psi(y, x_j, a): (C, P, A, 24, n, 6)."""
        return rows[..., :-1].reshape(*rows.shape[:-1], -1, 6)


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
    if cluster_states(mission, 1) > max_states:
        raise ValueError(f'no goal has a sub-MDP of at most T_max = {max_states:,} states')
    for n, cover in ((3, _triples(k)), (2, _ring(k)), (1, [(j,) for j in range(k)])):
        entries = len(cover) * (mission.grid.q + k) * (2 * k + 4) * 24 * 6**n
        if n == 1 or (n <= k and cluster_states(mission, n) <= max_states and entries <= WORK):
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
