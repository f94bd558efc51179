"""Functions of all goals as products of functions of a few goals each.

A feature is a product over the goals of a cluster T of one function of each x_j = 2 g_j + r_j.
Given the regime of an epoch, the x_j move independently, so that the expectation of a feature is
the product of the expectations: E[prod b(x_j')] = prod E[b(x_j')].

Five functions and the constant tell all six x_j apart. The first three ask what matters most, each
with two answers: whether the goal is in range, whether it is wanted in range, whether it is
wanted. The other two are *fine*. `RANKS` counts what a function asks beyond the first two, and a
feature is the more detailed the higher the sum of its factors' ranks. With i fine factors of n it
is made of functions on sub-MDPs in which i of the goals take six values and the others two. So
features of three goals with one fine factor are made of sub-MDPs smaller than that of two goals
in full, 41,472 states on 8 cells.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray, RealArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.decomposition.measures import Measures
from uav_mission_manager.solver.reduced import (
    X_PRIORITY,
    X_RANGE,
    X_VALUES,
    ReducedMission,
)

LIKELIHOOD = np.array([0.5, 0.25, 0.25])[X_PRIORITY] * np.array([0.45, 0.55])[X_RANGE]
"""Weight of each x_j in a fit, as likely as in missions that are flown. Measured with three goals:
equal weights change mean losses by factors of 0.8 to 2.2."""

FEATURES, COMPLETE = 1536, 2304
"""Most features of an expansion of order two, and for each order more; where there is room for all
clusters in more than the least detail, it may have half as many more."""

Outcome = tuple[int, int | None]
"""What an epoch does to the goals: its regime, and the goal that is completed or None."""

Factors = list[tuple[int, IndexArray]]
"""Factors of features: of the first factor, the second and so on, which feature is the first that
has one, and the factors' positions from there on."""

RANKS = (0, 0, 1, 2, 2)
"""Detail of each function of x_j but the constant: 2 for the fine ones."""

FINE = 2
"""Rank of a fine function."""

DETAILS = (0, 1, 2, 3)
"""Details of clusters that are not in full."""


@dataclass(frozen=True)
class Group:
    """Clusters of as many goals, looked at in the same detail.

    Attributes
    ----------
    detail : int
        Largest sum of the ranks of a feature's factors, see `RANKS`; 2n of n goals in full.
    clusters : tuple of tuple of int
        Goals from 0, ascending; those that couple most closely first.
    """

    detail: int
    clusters: tuple[tuple[int, ...], ...]

    @property
    def n(self) -> int:
        """Goals of a cluster."""
        return len(self.clusters[0])

    @property
    def size(self) -> int:
        """Features of a cluster."""
        return _features(self.n, self.detail)


@dataclass(frozen=True)
class Clusters:
    """Which goals an expansion looks at together.

    Attributes
    ----------
    groups : tuple of Group
        Those of fewer goals first, of as many goals those in more detail.
    """

    groups: tuple[Group, ...]

    @classmethod
    def up_to(cls, mission: Mission, order: int, max_states: int) -> Clusters:
        """Clusters of at most `order` goals in full and of one more in less detail, within T_max.

        Up to `COMPLETE` times (order - 1) features, where that is room for all clusters in more
        than the least detail. Else up to `FEATURES` times that: those of fewer goals first, and
        of as many goals those that couple most closely, in more detail as far as there is room.

        Raises
        ------
        ValueError
            If order is below 1, or one goal does not fit.
        """
        if order < 1:
            raise ValueError(f'order {order} must be at least 1')
        if cluster_states(mission, 1) > max_states:
            raise ValueError(f'no goal has a sub-MDP of at most T_max = {max_states:,} states')
        for most in (COMPLETE, FEATURES):
            clusters, complete = cls._fill(mission, order, max_states, most * max(1, order - 1))
            if complete:
                break
        return clusters

    @classmethod
    def _fill(
        cls, mission: Mission, order: int, max_states: int, features: int
    ) -> tuple[Clusters, bool]:
        """As many clusters as there is room for, and whether all are in more than least detail."""
        room, groups, complete, measures = features - 1, [], True, Measures(mission)
        for n in range(1, min(order + 1, mission.k) + 1):
            details = [
                detail
                for detail in ((FINE,) if n == 1 else (*DETAILS, FINE * n))
                if (n <= order or detail < FINE * n)
                and cluster_states(mission, n, _values(n, detail)) <= max_states
            ]
            sizes = [0, *(_features(n, detail) for detail in details)]
            counts, most = [], math.comb(mission.k, n)
            for size in np.diff(sizes).tolist():
                most = most if n == 1 else min(most, max(room, 0) // size)
                room -= most * size
                counts.append(most)
            complete &= not counts or min(counts[:2]) == math.comb(mission.k, n)
            closest = measures.closest(n) if any(counts) else ()
            starts = [*counts[1:], 0]
            for detail, start, end in list(zip(details, starts, counts))[::-1]:
                if end > start:
                    groups.append(Group(detail, closest[start:end]))
        return cls(tuple(groups)), complete

    def within(self, features: int) -> Clusters:
        """Return the first of the clusters that have no more features, single goals at least."""
        room, groups = features - 1, []
        for group in self.groups:
            most = len(group.clusters) if group.n == 1 else max(room, 0) // group.size
            if kept := group.clusters[:most]:
                groups.append(Group(group.detail, kept))
            room -= len(kept) * group.size
        return Clusters(tuple(groups))

    @property
    def features(self) -> int:
        """Number of features, P."""
        return 1 + sum(len(group.clusters) * group.size for group in self.groups)

    @property
    def count(self) -> int:
        """Number of clusters."""
        return sum(len(group.clusters) for group in self.groups)

    def states(self, mission: Mission) -> list[int]:
        """States of each cluster's largest sub-MDP."""
        return [
            cluster_states(mission, group.n, _values(group.n, group.detail))
            for group in self.groups
            for _ in group.clusters
        ]


def cluster_states(mission: Mission, n: int, values: int | None = None) -> int:
    """States of a sub-MDP of n goals whose x_j together take so many values, 6^n in full."""
    shared = 8 * mission.grid.q * (n + 1) * len(mission.threat.levels) * 2
    return shared * (X_VALUES**n if values is None else values)


def _features(n: int, detail: int) -> int:
    """Features of n goals whose factors' ranks add up to at most `detail`."""
    counts = np.ones(1, int)
    for _ in range(n):
        counts = np.convolve(counts, np.bincount(RANKS))
    return int(counts[: detail + 1].sum())


def _values(n: int, detail: int) -> int:
    """Values that x_1..x_n take together in the largest sub-MDP of a cluster."""
    fine = min(detail // FINE, n)
    return X_VALUES**fine * 2 ** (n - fine)


class Basis:
    """Features of a mission's clusters.

    Functions are orthonormal under `LIKELIHOOD`, and all but the constant have mean 0.

    Parameters
    ----------
    reduced : ReducedMission
        Of the whole mission.
    clusters : Clusters

    Attributes
    ----------
    size : int
        P, the constant feature counted, which is the first.
    products : list of tuple of int
        Positions of each feature's factors, 6 times the goal plus the function.
    """

    def __init__(self, reduced: ReducedMission, clusters: Clusters) -> None:
        self.reduced, self.clusters, self.size = reduced, clusters, clusters.features
        wanted = X_PRIORITY > 0
        coarse = np.ones(X_VALUES), X_RANGE, X_RANGE * wanted, wanted
        functions = _orthonormal(np.column_stack([*coarse, np.eye(X_VALUES)[:, 2:4]]))
        self._now = np.broadcast_to(functions, (1, reduced.n, *functions.shape))
        self._next = reduced.goals @ functions
        self._completed = reduced.completed @ functions
        self.products = self._products()
        self._factors = _factors(self.products)

    def _products(self) -> list[tuple[int, ...]]:
        products: list[tuple[int, ...]] = [()]
        for group in self.clusters.groups:
            chosen = [
                functions
                for functions in itertools.product(range(1, X_VALUES), repeat=group.n)
                if sum(RANKS[function - 1] for function in functions) <= group.detail
            ]
            for goals in group.clusters:
                offsets = [X_VALUES * j for j in goals]
                products += [tuple(map(sum, zip(offsets, functions))) for functions in chosen]
        return products

    def embed(self, theta: RealArray, other: Basis) -> RealArray:
        """Coefficients (..., P) of a function in another basis, as far as this one has them."""
        positions = {product: position for position, product in enumerate(self.products)}
        out: RealArray = np.zeros((*theta.shape[:-1], self.size), theta.dtype)
        for row, product in enumerate(other.products):
            if product in positions:
                out[..., positions[product]] = theta[..., row]
        return out

    def now(self, x: IntArray, dtype: DTypeLike = np.float64) -> RealArray:
        """Features of x (N, k), shape (P, N)."""
        return self.features(self._now.astype(dtype), x)[0]

    def expected(
        self, x: IntArray, outcomes: Sequence[Outcome], dtype: DTypeLike = np.float64
    ) -> RealArray:
        """Expected features after an epoch from x (N, k), shape (outcomes, P, N)."""
        return self.features(self.functions_after(outcomes).astype(dtype), x)

    def functions_after(self, outcomes: Sequence[Outcome]) -> FloatArray:
        """E of the functions of each x_j' by x_j, shape (outcomes, k, 6, functions)."""
        table = self._next[[regime for regime, _ in outcomes]]
        for position, (regime, goal) in enumerate(outcomes):
            if goal is not None:
                table[position, goal] = self._completed[regime]
        return table

    def features(
        self, functions: RealArray, x: IntArray, factors: Factors | None = None
    ) -> RealArray:
        """Features (outcomes, P, N) of functions (outcomes, k, 6, functions) at x (N, k).

        All of them by default, else those of some factors.
        """
        values = functions[:, np.arange(x.shape[1]), x]
        flat = values.transpose(0, 2, 3, 1).reshape(len(values), -1, len(x))
        (_, index), *rest = factors or self._factors
        out: RealArray = flat.take(index, axis=1)
        for first, index in rest:
            out[:, first:] *= flat.take(index, axis=1)
        return out

    @cached_property
    def of_goals(self) -> list[tuple[IndexArray, Factors]]:
        """Positions of the features that look at each goal, and their factors."""
        goals = [{factor // X_VALUES for factor in product} for product in self.products]
        found = []
        for j in range(self.reduced.n):
            positions = [position for position, looks_at in enumerate(goals) if j in looks_at]
            factors = _factors([self.products[position] for position in positions])
            found.append((np.array(positions, np.intp), factors))
        return found


def _factors(products: list[tuple[int, ...]]) -> Factors:
    """Factors of products, of which those of fewer factors stand first."""
    factors = []
    for place in range(max(map(len, products))):
        first = next(n for n, product in enumerate(products) if len(product) > place)
        # Function 0 of the first goal is the constant, that of the feature without factors.
        first = first if place else 0
        rows = [product[place] if product else 0 for product in products[first:]]
        factors.append((first, np.array(rows, np.intp)))
    return factors


def _orthonormal(functions: FloatArray) -> FloatArray:
    """Functions of x_j (6, 6) made orthonormal, each to those before it."""
    weight = np.sqrt(LIKELIHOOD)[:, None]
    q, r = np.linalg.qr(functions * weight)
    return np.asarray(q * np.sign(np.diag(r)) / weight)
