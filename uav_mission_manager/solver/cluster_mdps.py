"""Clusters of goals as MDPs of their own, all of one size, computed side by side.

A cluster keeps all 2k+4 actions, and its y = (place, t, f) and x_j = 2 g_j + r_j move as in the
whole mission: tables over (C, P, 3, 8, 6^n) for C clusters of n goals. Its costs are shares of J
that sum to J over the clusters; p(t, m) - [c > 0] eta_c g_c r_c of the present state is left out,
as in `uav_mission_manager.solver.bellman`.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy import sparse

from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.factors import FLAGS, LEVELS, Factors

ROUNDINGS = 64
"""Errors of one ulp of the largest number in a backup, at most, besides 6^n for the x_j."""


def split_costs(factors: Factors, clusters: NDArray[np.intp]) -> FloatArray:
    """J_i with the discounted price of t', less what a commitment saves: (C, A, P, 3, 8, 6^n).

    inf where what the cluster sees does not allow the action.
    """
    count, n = clusters.shape
    agile = np.array([int(action.agile) for action in factors.actions])
    price = factors.price[agile[:, None], factors.landing]
    faults = np.array(factors.mission.faults.cost)
    shared = (factors.distance[..., None] + price)[..., None] + faults
    costs = np.empty((count, *shared.shape, *(6,) * n))
    costs[:] = shared.reshape(shared.shape + (1,) * n) / count
    # On a site the goal may be completed, which drops the commitment whatever goal it is to.
    kept = np.ones((factors.places, 1, 8, 1))
    kept[factors.q :] = (1 - factors.completion)[:, None]
    holders = np.bincount(clusters.ravel())
    for cost, goals in zip(costs, clusters):
        for slot, j in enumerate(goals.tolist()):
            own = np.moveaxis(cost, 4 + slot, -1)
            own += factors.cost[j] / holders[j]
            lift = (..., *(None,) * (n - 1), slice(None))
            for a, action in enumerate(factors.actions):
                if action.goal == j + 1:
                    own[a] -= (kept * factors.saving[agile[a], j] / holders[j])[lift]
                    if factors.strict:
                        own[a][..., LEVELS * FLAGS == 0] = np.inf
    if factors.strict:
        _forbid(factors, costs, n)
    return costs.reshape(count, *shared.shape, 6**n)


def _forbid(factors: Factors, costs: FloatArray, n: int) -> None:
    """What f forbids, and recharging where a cluster sees all goals in range."""
    for a, action in enumerate(factors.actions):
        own = costs[:, a]
        if action.kind == 'commit':
            own[:, :, :, factors.completion == 0] = np.inf
        elif action.kind == 'repair':
            own[:, :, :, 0] = np.inf
        elif action.kind == 'recharge' and n == factors.k:
            all_in_range = np.ix_(*[FLAGS == 1] * n)
            own[(..., *all_in_range)] = np.inf


class ClusterOperator:
    """Expectations of all clusters at once, tables (C, P, 3, 8, 6^n), and their adjoint.

    Places and ways make 5 P arrivals. From a site, the goal is completed with some probability:
    then the arrival is on the cell, without commitment, and x_j' follows `Factors.achieved`; a
    cluster that does not hold the goal only loses the commitment.
    """

    def __init__(self, factors: Factors, clusters: NDArray[np.intp], dtype: DTypeLike) -> None:
        self.q, self.discount = factors.q, factors.mission.discount
        count, n = clusters.shape
        self.shape = (count, factors.places, 3, 8, 6**n)
        self.threat = factors.threat.astype(dtype)
        self.faults = factors.faults.astype(dtype)
        self.goals = np.stack([_moves(factors, goals, dtype) for goals in clusters], axis=1)
        self.achieved = [
            (c, j, _moves(factors, goals, dtype, slot))
            for c, goals in enumerate(clusters)
            for slot, j in enumerate(goals)
        ]
        # What a cluster does not see of the goals' rows, whose sums may be slightly off 1.
        self.defect = float(np.abs(factors.goals.sum(axis=-1) - 1).max(axis=(0, 2)).sum())
        self.completion = factors.completion.astype(dtype)[:, None]
        self.ways = factors.way[:, self.q :]
        self.cells = factors.cells[factors.landing[:, self.q :]]
        self.arrivals = factors.way * factors.places + factors.landing
        self.dropped = self.ways * factors.places + self.cells
        self.scatter, self.scatter_dropped = (
            _scatter(to, self.faults.shape[0] * factors.places, dtype)
            for to in (self.arrivals, self.dropped)
        )

    def expect(self, values: FloatArray) -> FloatArray:
        """Discounted E[W'] of each action: (C, A, P, 3, 8, 6^n)."""
        count, places, *rest = self.shape
        ahead = (self.threat @ values.reshape(count, places, 3, -1)).reshape(self.shape)
        arrived = np.empty((count, len(self.faults), *self.shape[1:]), values.dtype)
        for w, (faults, goals) in enumerate(zip(self.faults, self.goals)):
            health = (faults @ ahead).reshape(count, -1, self.shape[-1])
            arrived[:, w] = (health @ goals.swapaxes(1, 2)).reshape(self.shape)
        arrived = arrived.reshape(count, -1, *rest)
        result = arrived[:, self.arrivals]
        done = arrived[:, self.dropped]
        for c, j, matrices in self.achieved:
            ways = self.ways[:, j]
            health = self.faults[ways, None] @ ahead[c, self.cells[:, j]]
            flat = health.reshape(len(ways), 24, -1) @ matrices[ways].swapaxes(1, 2)
            done[c, :, j] = flat.reshape(health.shape)
        on_site = result[:, :, self.q :]
        done -= on_site
        done *= self.completion
        on_site += done
        result *= values.dtype.type(self.discount)
        return result

    def arrive(self, mass: FloatArray) -> FloatArray:
        """Adjoint of `expect`: discounted mass of the next states, from (C, A, P, 3, 8, 6^n)."""
        count, places = self.shape[:2]
        on_site = mass[:, :, self.q :]
        done = on_site * self.completion
        kept = mass.copy()
        kept[:, :, self.q :] -= done
        result = np.zeros(self.shape, mass.dtype)
        for c, j, matrices in self.achieved:
            ways = self.ways[:, j]
            flat = done[c, :, j].reshape(len(ways), 24, -1) @ matrices[ways]
            health = self.faults[ways, None].swapaxes(2, 3) @ flat.reshape(len(ways), 3, 8, -1)
            np.add.at(result[c], self.cells[:, j], health)
            done[c, :, j] = 0
        for c in range(count):
            arrived = self.scatter @ kept[c].reshape(self.arrivals.size, -1)
            arrived += self.scatter_dropped @ done[c].reshape(self.dropped.size, -1)
            arrived = arrived.reshape(len(self.faults), -1, 8, self.shape[-1])
            for way, faults, goals in zip(arrived, self.faults, self.goals[:, c]):
                result[c] += (faults.T @ (way @ goals)).reshape(self.shape[1:])
        ahead = self.threat.swapaxes(1, 2) @ result.reshape(count, places, 3, -1)
        return ahead.reshape(self.shape) * mass.dtype.type(self.discount)


def _moves(
    factors: Factors, goals: NDArray[np.intp], dtype: DTypeLike, done: int | None = None
) -> FloatArray:
    """P(x' | x) of each way, (5, 6^n, 6^n), where the goal in slot `done` is completed."""
    matrices = []
    for way, achieved in zip(factors.goals, factors.achieved):
        parts = [achieved if slot == done else way[j] for slot, j in enumerate(goals)]
        matrices.append(reduce(np.kron, parts))
    return np.array(matrices, dtype)


def _scatter(to: NDArray[np.intp], size: int, dtype: DTypeLike) -> sparse.csr_matrix:
    ones = np.ones(to.size, dtype)
    return sparse.csr_matrix((ones, (to.ravel(), np.arange(to.size))), (size, to.size))


def proven_values(
    operator: ClusterOperator, costs: FloatArray, values: FloatArray, tolerance: float
) -> FloatArray:
    """Lower bounds on the clusters' W by value iteration, rounding included.

    Stops once they are within `tolerance`, relative to the largest number, of the upper bounds.
    W_{n+1} + gamma/(1-gamma) min(W_{n+1} - W_n) <= W* (MacQueen 1966).
    """
    gain, each = operator.discount / (1 - operator.discount), (1, 2, 3, 4)
    largest = np.abs(costs[np.isfinite(costs)]).max()
    spread = np.inf
    while True:
        change = -values
        values = (costs + operator.expect(values)).min(axis=1)
        change += values
        low = change.min(axis=each, keepdims=True)
        previous, spread = spread, float((change.max(axis=each, keepdims=True) - low).max())
        magnitude = largest + np.abs(values).max()
        if gain * spread <= tolerance * magnitude or not spread < previous:
            break
    error = (ROUNDINGS + values.shape[-1]) * np.finfo(values.dtype).eps + operator.defect
    return values + (gain * low - error * magnitude / (1 - operator.discount))
