"""A cluster of goals as an MDP of its own, computed cell by cell.

A cluster is a sub-MDP with all 2k+4 actions and a share of the costs. Its W (see
`uav_mission_manager.solver.reduced`) is a table over (q, X^n, Z T) for n goals, with x_j of X
values, Z conditions and T threat levels: cell, x of the goals, and (t, z). Actions with the same
arrival share one expectation of (X^n, Z T) entries, and all that is done with the Q of a cell,
(A, X^n, Z T), is done while it is in the cache.

What an action costs is a sum of terms, each of which depends on few of the goals: h, the price of
the threat and what z forbids on none, what a commitment saves on its own goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import SubMdp

ROUNDINGS_A_BACKUP = 40
"""Errors of one ulp of the largest number in a backup, at most, besides Z T for t and z and X^n
for the x_j."""

NO_SLOT = -1

Slots = tuple[int, ...]
"""Positions of some goals among those of a cluster, ascending."""

Terms = dict[Slots, RealArray]
"""Costs of actions that add up, (q, A, X or 1, .., X or 1, Z T): X for goals they depend on."""


class Arrival(NamedTuple):
    """Where an epoch leads: a regime, a cell, and the slot of a goal that may be completed."""

    regime: int
    cell: int
    slot: int


class ClusterMdp:
    """One cluster, with tables of a floating type.

    Parameters
    ----------
    sub : SubMdp
    dtype : floating type
    unit : float
        What costs are divided by.

    Attributes
    ----------
    shape : tuple of int
        Of a table over the cluster's states, (q, X^n, Z T).
    axes : tuple of int
        Of a table over actions and the states of a cell, (A, X, .., X, Z T).
    state_costs : float array (q or 1, X^n, Z T)
        What z and x cost, whatever is done.
    terms : Terms
        What actions cost besides; inf where what the cluster sees does not allow them. Those of
        one goal hold the two actions that commit to it only, see `own`.
    own : list of int array (2,)
        Positions of the actions that commit to each goal.
    arrivals : list of Arrival
    leads : int array (q, A)
        Number of the arrival of each action.
    """

    def __init__(self, sub: SubMdp, dtype: DTypeLike, unit: float = 1.0) -> None:
        self.sub, self.dtype, self.n = sub, np.dtype(dtype), sub.n
        self.reduced = reduced = ReducedMission(sub)
        values = reduced.x_values
        self.shape = (reduced.q, values**self.n, reduced.z_values * sub.threats)
        self.axes = (len(sub.numbers), *(values,) * self.n, self.shape[2])
        self.own = [np.flatnonzero(reduced.slots == slot) for slot in range(self.n)]
        x = np.indices((values,) * self.n).reshape(self.n, -1).T
        costs = np.tile(reduced.own_costs(x).swapaxes(1, 2), sub.threats)
        self.state_costs = self._array(costs / unit)
        self.terms = {slots: self._array(term / unit) for slots, term in self._terms(x).items()}
        found = self._arrivals()
        self.arrivals = sorted({arrival for here in found for arrival in here})
        numbers = {arrival: number for number, arrival in enumerate(self.arrivals)}
        self.leads = np.array([[numbers[arrival] for arrival in here] for here in found])
        self._merges = [self._merge(here) for here in self.leads]
        self._exogenous = self._exogenous_matrices()
        # The matrices of x, the largest by far, depend on the regime and the slot alone.
        matrices = self._matrices()
        self._goals = [matrices[to.regime, to.slot] for to in self.arrivals]
        self._completion = self._array(np.tile(reduced.completion, (1, sub.threats)))
        # Rows of transition matrices may sum to slightly more or less than 1.
        of_goals = np.abs(reduced.goals.sum(axis=-1) - 1).max(axis=(0, 2)).sum()
        self.defect = float(of_goals) + reduced.defect

    def _array(self, values: RealArray) -> RealArray:
        return values.astype(self.dtype)

    def _terms(self, x: IntArray) -> dict[Slots, FloatArray]:
        reduced, every = self.reduced, tuple(range(self.n))
        price = reduced.price[reduced.agile[:, None], reduced.landings].swapaxes(0, 1)
        price = np.repeat(price, reduced.z_values, axis=-1).reshape(self.term_shape(()))
        if self.n == self.sub.mission.k:  # Whether recharging is allowed depends on all goals.
            return {(): price, every: self._costs(x, every)}
        common = self._costs(np.zeros((1, self.n), int), ())
        common[:, np.concatenate(self.own)] = 0
        terms: dict[Slots, FloatArray] = {(): common + price}
        for slot in every:
            alone = np.arange(reduced.x_values)[:, None] * (np.arange(self.n) == slot)
            terms[(slot,)] = self._costs(alone, (slot,))[:, self.own[slot]]
        return terms

    def _costs(self, x: IntArray, slots: Slots) -> FloatArray:
        """`ReducedMission.action_costs` of some x, as a term."""
        costs = self.reduced.action_costs(np.arange(self.reduced.q), x).transpose(1, 0, 3, 2)
        return np.tile(costs, self.sub.threats).reshape(self.term_shape(slots))

    def term_shape(self, slots: Slots) -> tuple[int, ...]:
        """Shape of a term that depends on some goals."""
        values = self.reduced.x_values
        axes = (values if slot in slots else 1 for slot in range(self.n))
        return (self.shape[0], self.axes[0], *axes, self.shape[2])

    def _arrivals(self) -> list[list[Arrival]]:
        """The arrival of each action from each cell."""
        reduced = self.reduced
        slots = np.where(reduced.completes, reduced.slots[:, None], NO_SLOT)
        return [
            [Arrival(*map(int, arrival)) for arrival in zip(*here)]
            for here in zip(reduced.regimes.T, reduced.landings.T, slots.T)
        ]

    def _merge(self, leads: IntArray) -> tuple[IntArray, RealArray]:
        """Arrivals from a cell, and the matrix that sums over the actions that lead to each."""
        numbers, positions = np.unique(leads, return_inverse=True)
        return numbers, self._array((np.arange(len(numbers))[:, None] == positions) * 1.0)

    def _exogenous_matrices(self) -> list[tuple[RealArray, RealArray]]:
        """Discounted P(t', f' | t, f), (8 T, 8 T), and P(b' | b) of each arrival."""
        reduced, found = self.reduced, dict[tuple[bytes, int], RealArray]()
        discount = self.sub.mission.discount
        charges = [self._array(matrix) for matrix in reduced.charge]
        matrices = []
        for arrival in self.arrivals:
            threat, regime = reduced.threat[arrival.cell], arrival.regime
            key = threat.tobytes(), regime
            if key not in found:
                found[key] = self._array(discount * np.kron(threat, reduced.faults[regime]))
            matrices.append((found[key], charges[regime]))
        return matrices

    def _later(self, number: int, values: RealArray) -> RealArray:
        """Discounted expectation over t', f' and b' on an arrival, (X^n, Z T)."""
        others, charge = self._exogenous[number]
        if len(charge) == 1:
            return values @ others.T
        by_charge = values.reshape(len(values), len(others), -1) @ charge.T
        return np.matmul(others, by_charge).reshape(values.shape)

    def _earlier(self, number: int, mass: RealArray) -> RealArray:
        """Adjoint of `_later`."""
        others, charge = self._exogenous[number]
        if len(charge) == 1:
            return mass @ others
        by_charge = mass.reshape(len(mass), len(others), -1) @ charge
        return np.matmul(others.T, by_charge).reshape(mass.shape)

    def _matrices(self) -> dict[tuple[int, int], list[RealArray]]:
        """P(x' | x), (X^n, X^n), by regime and slot; with a slot also that if it is completed."""
        found = {}
        for regime, slot in {(arrival.regime, arrival.slot) for arrival in self.arrivals}:
            matrices = list(self.reduced.goals[regime])
            found[regime, slot] = [self._array(_kron(matrices))]
            if slot != NO_SLOT:
                matrices[slot] = self.reduced.completed[regime]
                found[regime, slot].append(self._array(_kron(matrices)))
        return found

    def ahead(self, values: RealArray) -> RealArray:
        """Discounted E[W'] of each arrival, (arrivals, X^n, Z T), of W over (q, X^n, Z T)."""
        ahead = np.empty((len(self.arrivals), *self.shape[1:]), self.dtype)
        for number, arrival in enumerate(self.arrivals):
            later = self._later(number, values[arrival.cell])
            goals, *completed = self._goals[number]
            np.matmul(goals, later, out=ahead[number])
            for instead in completed:
                completion = self._completion[arrival.slot]
                ahead[number] += completion * (instead @ later - ahead[number])
        return ahead

    def costs(self, shifts: Terms) -> list[RealArray]:
        """What actions cost, with shifts added, in as few terms as possible.

        Each is added to one that depends on more goals where there is one, as such additions cost
        less than those to Q.
        """
        left = {slots: shift.copy() for slots, shift in shifts.items()}
        for slots, term in self.terms.items():
            if slots not in left:
                left[slots] = np.zeros(self.term_shape(slots), self.dtype)
            whole = not slots or self.n == self.sub.mission.k
            left[slots][:, slice(None) if whole else self.own[slots[0]]] += term
        for slots in sorted(left, key=len):
            larger = [other for other in left if set(slots) < set(other)]
            if larger:
                left[min(larger, key=len)] += left.pop(slots)
        return list(left.values())

    def q_values(self, cell: int, ahead: RealArray, costs: Sequence[RealArray]) -> RealArray:
        """Discounted E[W'] of the actions in a cell plus what they cost, (A, X, .., Z T)."""
        q = ahead.take(self.leads[cell], axis=0).reshape(self.axes)
        for cost in costs:
            q += cost[cell]
        return q

    def sweep(self, values: RealArray, costs: Sequence[RealArray]) -> tuple[RealArray, SpanBounds]:
        """Return the backup of W and the bounds that it gives."""
        ahead, backup = self.ahead(values), np.empty_like(values)
        for cell, least in enumerate(backup):
            least[:] = self.q_values(cell, ahead, costs).min(axis=0).reshape(least.shape)
        backup += self.state_costs
        change = backup - values
        discount = self.sub.mission.discount
        return backup, SpanBounds(float(change.min()), float(change.max()), discount)

    def leave(self, cell: int, mass: RealArray, arrived: RealArray) -> None:
        """Add the mass (A, X, .., Z T) on a cell's actions to their arrivals, shape as of `ahead`.

        With `settle` the adjoint of the expectation.
        """
        numbers, merge = self._merges[cell]
        arrived[numbers] += (merge @ mass.reshape(len(mass), -1)).reshape(-1, *self.shape[1:])

    def settle(self, arrived: RealArray) -> RealArray:
        """Discounted mass of the next states, (q, X^n, Z T), of mass on arrivals."""
        mass = np.zeros(self.shape, self.dtype)
        for number, arrival in enumerate(self.arrivals):
            goals, *completed = self._goals[number]
            done = self._completion[arrival.slot] * arrived[number] if completed else 0
            moved = goals.T @ (arrived[number] - done)
            for instead in completed:
                moved += instead.T @ done
            mass[arrival.cell] += self._earlier(number, moved)
        return mass


def swept_values(
    mdp: ClusterMdp, costs: Sequence[RealArray], values: RealArray, tolerance: float
) -> tuple[RealArray, SpanBounds]:
    """Sweep until the bounds are as close as a tolerance or rounding keeps them apart."""
    span = np.inf
    while True:
        values, bounds = mdp.sweep(values, costs)
        if bounds.gain * bounds.span <= tolerance or bounds.stalled(span):
            return values, bounds
        span = bounds.span


def proven_values(
    mdp: ClusterMdp, costs: Sequence[RealArray], values: RealArray, tolerance: float
) -> RealArray:
    """Lower bound on a cluster's W, (q, X^n, Z T), by value iteration, rounding included.

    Parameters
    ----------
    mdp : ClusterMdp
        In double precision.
    costs : sequence of float array
        See `ClusterMdp.costs`.
    values : float array (q, X^n, Z T)
        Where to start.
    tolerance : float
        Largest distance from the upper bound, but for rounding.
    """
    values, bounds = swept_values(mdp, costs, values, tolerance)
    largest = sum(_largest(table) for table in (mdp.state_costs, values, *costs))
    rounding = (ROUNDINGS_A_BACKUP + sum(mdp.shape[1:])) * np.finfo(np.float64).eps + mdp.defect
    return values + (bounds.lowest - bounds.accumulated(rounding * largest))


def _kron(matrices: Sequence[RealArray]) -> RealArray:
    product: RealArray = np.ones((1, 1))
    for matrix in matrices:
        product = np.kron(product, matrix)
    return product


def _largest(values: RealArray) -> float:
    return float(np.abs(values).max(initial=0.0, where=np.isfinite(values)))
