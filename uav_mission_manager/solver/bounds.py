"""A lower bound on V* in every state, from costs split among clusters of goals.

Every cluster of goals is a mission of its own that keeps all 2k+4 actions, with a share J_i of
the cost: of what the goals have in common an even one, of a goal's own cost an even one among the
clusters that hold the goal. A policy of the whole mission is, history and all, a policy of each
cluster, so with sum_i J_i = J

    sum_i V_i <= V*

(Russell and Zimdars 2003; Adelman and Mersereau 2008). Shifting cost between clusters,
J_i + psi_i with sum_i psi_i = 0, keeps this true and can tighten it: psi_i(y, a) between all
clusters, psi_i(y, x_j, a) between those that share goal j; y = (place, t, f), x_j = (g_j, r_j).
The sum of the V_i, averaged over states, is concave in psi. A supergradient is the occupancy of
each cluster under its optimal policy, less its mean over those that share psi. Adam (Kingma and
Ba 2015) climbs it on a soft minimum that hardens on the way, V_i and occupancies following psi by
a few sweeps an iteration. Whatever psi that ends in, value iteration then proves the bound.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.basis import cluster_states
from uav_mission_manager.solver.cluster_mdps import ClusterOperator, proven_values, split_costs
from uav_mission_manager.solver.factors import FLAGS, LEVELS, Factors

SWEEPS = 2
"""Sweeps of V_i and of the occupancies in an iteration of the ascent."""

TEMPERATURE, RATE, HALVINGS = 0.3, 0.3, 7
"""Of the soft minimum and of Adam, in a cluster's mean cost an epoch, and how often they halve."""

MEMORY, SQUARES = 0.9, 0.99
"""Adam's decay rates."""

GRID = 2.0**-24
"""Of the same unit: psi is rounded to multiples of it, so that its sums are exact."""


ITERATIONS = 120
"""Of the ascent in a certificate; twice as many gain little."""

MOST_ALL, MOST_PAIRED = 4, 12
"""Goals up to which a certificate looks at all pairs, and at disjoint ones."""


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
        k, goals, eta = self.mission.k, self._goals, self._eta
        f, (cell, c, t, m) = states[:, 0] - 1, states[:, -4:].T
        x = 2 * states[:, 1 + k : 1 + 2 * k] + states[:, 1 : 1 + k]
        place = np.where(cell == goals[c], self.mission.grid.q + c - 1, cell)
        committed = x[np.arange(len(x)), np.maximum(c - 1, 0)]
        total = self._threat[t, m] - eta[c] * (LEVELS * FLAGS)[committed]
        shared = (part[:, None] for part in (place, t, f))
        own = (x[:, column] for column in self.clusters.T)
        entries = self.tables[(np.arange(len(self.clusters)), *shared, *own)]
        total += entries.sum(axis=1, dtype=float)
        return np.asarray(np.maximum(total, 0.0))

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
    iterations: int = 250,
    seconds: float | None = None,
    tolerance: float = 1e-5,
) -> LowerBound:
    """Bound V* from below by the sum over clusters of goals.

    Parameters
    ----------
    mission : Mission
    clusters : sequence of sequences of int
        Goals, from 0, of each cluster: as many in each, every goal in at least one. A single
        cluster of all goals gives V* itself.
    iterations : int
        Steps of the ascent; 0 leaves the even split.
    seconds : float, optional
        The ascent ends at the first step after this time.
    tolerance : float
        How far value iteration may stay below a cluster's optimum, relative to its largest W.

    Raises
    ------
    ValueError
        If the clusters are of different sizes, name no such goal or one twice, or leave one out,
        or an option is out of its range.
    """
    members = _members(clusters, mission.k)
    if iterations < 0:
        raise ValueError(f'iterations {iterations} must not be below 0')
    if not tolerance > 0 or (seconds is not None and not seconds > 0):
        raise ValueError(f'tolerance {tolerance} and seconds {seconds} must be above 0')
    factors = Factors(mission)
    operator = ClusterOperator(factors, members, np.float64)
    costs = split_costs(factors, members)
    best = proven_values(operator, costs, np.zeros(operator.shape), tolerance)
    if len(members) > 1 and iterations:
        shift, start = _Ascent(factors, members, costs, best).run(iterations, seconds)
        shifted = proven_values(operator, costs + shift, start, tolerance)
        best = max(best, shifted, key=lambda tables: float(tables.mean(axis=(1, 2, 3, 4)).sum()))
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


class _Ascent:
    """Supergradient ascent on psi: over (C, A, P, 3, 8), and (C n, A, P, 3, 8, 6) where shared."""

    def __init__(
        self, factors: Factors, clusters: NDArray[np.intp], costs: FloatArray, start: FloatArray
    ) -> None:
        mean = (1 - factors.mission.discount) * float(np.abs(start).mean())
        self.unit = 2.0 ** np.floor(np.log2(mean)) if mean > 0 else 1.0
        self.operator = ClusterOperator(factors, clusters, np.float32)
        self.costs = (costs / self.unit).astype(np.float32)
        self.values = (start / self.unit).astype(np.float32)
        self.start = np.float32(1 - factors.mission.discount)
        self.occupancy = np.ones_like(self.values)
        (count, self.n), shape = clusters.shape, costs.shape[:-1]
        self.pools: list[FloatArray] = [np.ones((count, count))]
        self.psi: list[FloatArray] = [np.zeros(shape)]
        same = (clusters.reshape(-1, 1) == clusters.reshape(1, -1)).astype(float)
        if same.sum() > clusters.size:
            self.pools.append(same)
            self.psi.append(np.zeros((clusters.size, *shape[1:], 6)))
        self.moments = [(np.zeros_like(psi), np.zeros_like(psi)) for psi in self.psi]

    def run(self, iterations: int, seconds: float | None) -> tuple[FloatArray, FloatArray]:
        """What to add to the costs, exactly zero in sum over the clusters, and about W then."""
        began, done, step = time.monotonic(), 0.0, 0
        while done < 1:
            step += 1
            self._step(step, 0.5 ** (HALVINGS * done))
            spent = (time.monotonic() - began) / seconds if seconds else 0.0
            done = max(step / iterations, spent)
        self.psi = [_balanced(pool, psi) for pool, psi in zip(self.pools, self.psi)]
        return self.unit * self._shift(), self.unit * self.values.astype(float)

    def _shift(self) -> FloatArray:
        """Psi summed, (C, A, P, 3, 8, 6^n)."""
        shape, n = self.psi[0].shape, self.n
        total = np.zeros((*shape, *(6,) * n))
        total += self.psi[0].reshape(*shape, *(1,) * n)
        for psi in self.psi[1:]:
            for slot, part in enumerate(psi.reshape(-1, n, *shape[1:], 6).swapaxes(0, 1)):
                np.moveaxis(total, 5 + slot, -1)[...] += part[(..., *(None,) * (n - 1), slice(6))]
        return total.reshape(self.costs.shape)

    def _step(self, step: int, cooling: float) -> None:
        costs = self.costs + self._shift().astype(np.float32)
        for _ in range(SWEEPS):
            q = costs + self.operator.expect(self.values)
            self.values, policy = _soft_min(q, np.float32(cooling * TEMPERATURE))
        for _ in range(SWEEPS):
            mass = policy * self.occupancy[:, None]
            self.occupancy = self.start + self.operator.arrive(mass)
        gradients = self._marginals(policy * self.occupancy[:, None])
        for psi, pool, moments, gradient in zip(self.psi, self.pools, self.moments, gradients):
            first, second = moments
            gradient = _centred(pool, gradient)
            first += (1 - MEMORY) * (gradient - first)
            second += (1 - SQUARES) * (gradient**2 - second)
            size = np.sqrt(second / (1 - SQUARES**step)) + 1e-8
            psi += _centred(pool, cooling * RATE / (1 - MEMORY**step) * first / size)

    def _marginals(self, mass: FloatArray) -> list[FloatArray]:
        """Occupancies of (y, a), and of (y, x_j, a)."""
        marginals = [mass.sum(axis=-1)]
        for psi in self.psi[1:]:
            cube, slots = mass.reshape(*mass.shape[:-1], *(6,) * self.n), range(5, 5 + self.n)
            own = np.empty((len(mass), self.n, *psi.shape[1:]), mass.dtype)
            for slot in slots:
                cube.sum(axis=tuple(set(slots) - {slot}), out=own[:, slot - 5])
            marginals.append(own.reshape(psi.shape))
        return marginals


def _centred(pool: FloatArray, rows: FloatArray) -> FloatArray:
    """Less its mean over the rows of the same pool."""
    share = pool / pool.sum(axis=1)
    return rows - (share @ rows.reshape(len(rows), -1)).reshape(rows.shape)


def _balanced(pool: FloatArray, rows: FloatArray) -> FloatArray:
    """On the grid, where the last row of each pool makes up for what rounding leaves."""
    rows = GRID * np.round(rows / GRID)
    last = ~np.triu(pool, 1).any(axis=1)
    rows[last] -= (pool[last] @ rows.reshape(len(rows), -1)).reshape(rows[last].shape)
    return rows


def _soft_min(costs: FloatArray, temperature: np.float32) -> tuple[FloatArray, FloatArray]:
    """Soft minimum over the actions, and its policy."""
    least = costs.min(axis=1, keepdims=True)
    policy = np.exp((least - costs) / temperature)
    total = policy.sum(axis=1, keepdims=True)
    policy /= total
    return (least - temperature * np.log(total))[:, 0], policy


def certificate(mission: Mission, max_states: int) -> LowerBound:
    """Return a lower bound from clusters of at most T_max states that takes seconds.

    All pairs of up to four goals, disjoint pairs of up to twelve (an odd goal beside another
    one's pair), and beyond single goals with the costs split evenly.
    """
    k = mission.k
    if k == 1 or k > MOST_PAIRED or cluster_states(mission, 2, 6) > max_states:
        iterations = 0 if k > MOST_PAIRED else ITERATIONS
        return lower_bound(mission, [(j,) for j in range(k)], iterations=iterations)
    pairs = [(j, j + 1) for j in range(0, k - 1, 2)]
    if k <= MOST_ALL:
        pairs = list(itertools.combinations(range(k), 2))
    elif k % 2:
        pairs.append((0, k - 1))
    return lower_bound(mission, pairs, iterations=ITERATIONS)
