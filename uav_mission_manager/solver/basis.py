"""Functions of all goals as products of functions of a few goals each.

A feature is a product over the goals of a cluster T of one function of each x_j = 2 g_j + r_j.
Given the way an action leads, the x_j move independently, so that the expectation of a feature is
the product of the expectations: E[prod b(x_j')] = prod E[b(x_j')].

Five functions and the constant tell all six x_j apart: the features of a *fine* cluster span all
functions of its goals. Two and the constant tell apart what matters most, out of range, in
range and idle, in range and wanted: those of a *coarse* cluster span all functions of these. So
three goals in coarse are as many states, 41,472 on 8 cells, as two in fine.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import DTypeLike, NDArray

from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.factors import FLAGS, LEVELS, Factors

LIKELIHOOD = np.array([0.5, 0.25, 0.25])[LEVELS] * np.array([0.45, 0.55])[FLAGS]
"""Weight of each x_j in a fit. Measured: other weights of priority and range cost more, equal
ones ten times as much (goals just completed matter, and are few among all states)."""


@dataclass(frozen=True)
class Clusters:
    """Which goals are looked at together, by tuples of goals from 0, ascending.

    Attributes
    ----------
    fine, coarse : tuple of tuple of tuple of int
        Clusters of 1, 2, .. goals in fine; of more goals in coarse.
    """

    fine: tuple[tuple[tuple[int, ...], ...], ...]
    coarse: tuple[tuple[tuple[int, ...], ...], ...]

    @classmethod
    def up_to(cls, mission: Mission, order: int, max_states: int) -> Clusters:
        """All clusters of at most `order` goals in fine and one more in coarse that fit T_max.

        Raises
        ------
        ValueError
            If order is below 1, or one goal does not fit.
        """
        if order < 1:
            raise ValueError(f'order {order} must be at least 1')
        size = cluster_states(mission, 1, 6)
        if size > max_states:
            raise ValueError(f'max_states {max_states} is below the {size} states of one goal')
        k = mission.k
        orders = range(1, min(order, k) + 1)
        fine = [n for n in orders if cluster_states(mission, n, 6) <= max_states]
        coarse = range(len(fine) + 1, min(order + 1, k) + 1)
        fitting = [n for n in coarse if cluster_states(mission, n, 3) <= max_states]

        def combinations(n: int) -> tuple[tuple[int, ...], ...]:
            return tuple(itertools.combinations(range(k), n))

        return cls(tuple(map(combinations, fine)), tuple(map(combinations, fitting)))

    @property
    def features(self) -> int:
        """Number of features, P."""
        sizes = [(clusters, 5) for clusters in self.fine] + [(c, 2) for c in self.coarse]
        return 1 + sum(base ** len(c) for clusters, base in sizes for c in clusters)

    def of(self, goal: int) -> Clusters:
        """Return those that hold a goal, in their order."""
        fine, coarse = (
            tuple(tuple(c for c in clusters if goal in c) for clusters in parts)
            for parts in (self.fine, self.coarse)
        )
        return Clusters(fine, coarse)

    @property
    def count(self) -> int:
        """Number of clusters."""
        return sum(map(len, (*self.fine, *self.coarse)))

    def states(self, mission: Mission) -> list[int]:
        """States of each cluster's sub-MDP."""
        parts = [(c, 6) for clusters in self.fine for c in clusters]
        parts += [(c, 3) for clusters in self.coarse for c in clusters]
        return [cluster_states(mission, len(cluster), values) for cluster, values in parts]


def cluster_states(mission: Mission, n: int, values: int) -> int:
    """States of a sub-MDP of n goals of which x_j is known to so many values."""
    return 8 * values**n * mission.grid.q * (n + 1) * 6


FUNCTIONS = 8
"""Of each x_j: the constant, five fine and two coarse."""


class Basis:
    """Features of a mission's clusters.

    Functions are orthonormal under `LIKELIHOOD`, and all but the constant have mean 0.

    Attributes
    ----------
    size : int
        P, the constant feature counted, which is the first.
    """

    def __init__(self, factors: Factors, clusters: Clusters) -> None:
        self.factors, self.clusters, self.size = factors, clusters, clusters.features
        wanted = FLAGS * (LEVELS > 0)
        fine, coarse = np.eye(6)[:, 1:], np.stack([FLAGS, wanted], axis=1)
        parts = [np.ones((6, 1)), _orthonormal(fine), _orthonormal(coarse)]
        functions = np.hstack(parts)
        self._now = np.broadcast_to(functions, (1, factors.k, *functions.shape))
        self._next = factors.goals @ functions
        self._achieved = factors.achieved @ functions
        self._index = self._factors(range(1, 6), range(6, 8))

    def _factors(self, *details: range) -> NDArray[np.intp]:
        """Position of each feature's factors, (most goals, P); 0, the constant, fills up."""
        clusters = self.clusters
        products: list[tuple[int, ...]] = [()]
        for functions, groups in zip(details, (clusters.fine, clusters.coarse)):
            for goals in (cluster for group in groups for cluster in group):
                own = ([FUNCTIONS * j + b for b in functions] for j in goals)
                products += itertools.product(*own)
        most = max(map(len, products))
        return np.array([p + (0,) * (most - len(p)) for p in products], np.intp).T

    def now(self, x: NDArray[np.int64], dtype: DTypeLike = np.float64) -> FloatArray:
        """Features of x (N, k), shape (N, P)."""
        return self._features(self._look_up(self._now, x), dtype)[:, 0]

    def expected(
        self,
        x: NDArray[np.int64],
        ways: Sequence[int],
        achieved: int | None = None,
        dtype: DTypeLike = np.float64,
    ) -> FloatArray:
        """Expected features after each of the ways, shape (N, ways, P); a goal may be achieved."""
        chosen = list(ways)
        values = self._look_up(self._next[chosen], x)
        if achieved is not None:
            values[:, :, achieved] = self._achieved[chosen][:, x[:, achieved]].swapaxes(0, 1)
        return self._features(values, dtype)

    @cached_property
    def of_goal(self) -> list[NDArray[np.intp]]:
        """Positions of the features that look at each goal."""
        goals = np.where(self._index > 0, self._index // FUNCTIONS, -1)
        return [np.flatnonzero((goals == j).any(axis=0)) for j in range(self.factors.k)]

    @staticmethod
    def _look_up(table: FloatArray, x: NDArray[np.int64]) -> FloatArray:
        """Values (N, ways, k, functions) of a table (ways, k, 6, functions)."""
        return table[:, np.arange(x.shape[1]), x].swapaxes(0, 1)

    def _features(self, values: FloatArray, dtype: DTypeLike) -> FloatArray:
        """Products of the functions' values (N, ways, k, functions)."""
        flat = values.reshape(*values.shape[:2], -1).astype(dtype, copy=False)
        out: FloatArray = flat.take(self._index[0], axis=-1)
        for factor in self._index[1:]:
            out *= flat.take(factor, axis=-1)
        return out


def _orthonormal(functions: FloatArray) -> FloatArray:
    """Functions of x_j (6, n) made orthonormal to each other and the constant."""
    weight = np.sqrt(LIKELIHOOD)[:, None]
    q, _ = np.linalg.qr(np.column_stack([np.ones(6), functions]) * weight)
    return q[:, 1:] / weight
