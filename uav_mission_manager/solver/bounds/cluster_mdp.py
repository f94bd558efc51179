"""A cluster of goals as an MDP of its own, computed cell by cell.

A cluster is a sub-MDP with all 2k+4 actions and a share of the costs. Its W (see
`uav_mission_manager.solver.reduced`) is a table over (q, 3, 8, 6^n) for n goals, with
y = (l, t, f) and x_j = 2 g_j + r_j. Actions with the same arrival share one expectation of
(3, 8, 6^n) entries, and all that is done with the Q of a cell, (A, 3, 8, 6^n), is done while it is
in the cache.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.mdp.arrays import IndexArray, RealArray
from uav_mission_manager.mdp.dynamics import Regime
from uav_mission_manager.solver.reduced import X_VALUES, ReducedMission
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import SubMdp

ROUNDINGS_A_BACKUP = 64
"""Errors of one ulp of the largest number in a backup, at most, besides 6^n for the x_j."""


class Arrival(NamedTuple):
    """Where an epoch leads: a regime, a cell, and the goal (its slot) that may be completed."""

    regime: int
    cell: int
    slot: int | None


Expectations = dict[Arrival, RealArray]
"""For each arrival a table (3, 8, 6^n) over t, f and x of the state before it."""


class ClusterMdp:
    """One cluster, with tables of a floating type.

    Parameters
    ----------
    sub : SubMdp
    dtype : floating type
    unit : float
        That costs are counted in.

    Attributes
    ----------
    shape : tuple of int
        Of a table over the cluster's states, (q, 3, 8, 6^n).
    x : int array (6^n, n)
        x_j of each column.
    state_costs : float array (8, 6^n)
        What f and x cost, whatever is done.
    action_costs : float array (q, A, 1, 8, 6^n)
        See `ReducedMission.action_costs`.
    """

    def __init__(self, sub: SubMdp, dtype: DTypeLike, unit: float = 1.0) -> None:
        self.sub, self.dtype, n = sub, np.dtype(dtype), sub.n
        self.reduced = reduced = ReducedMission(sub)
        self.shape = (reduced.q, 3, 8, X_VALUES**n)
        self.x = np.indices((X_VALUES,) * n).reshape(n, -1).T
        goals = reduced.goal_costs[np.arange(n), self.x].sum(axis=1)
        self.state_costs = ((reduced.fault_costs[:, None] + goals) / unit).astype(dtype)
        costs = [reduced.action_costs(cell, self.x) / unit for cell in range(reduced.q)]
        self.action_costs = np.array(costs, self.dtype)[:, :, None]
        self.threat = reduced.threat.astype(dtype)
        self.faults = (sub.mission.discount * reduced.faults).astype(dtype)
        self.completion = reduced.completion.astype(dtype)[:, None]
        # Rows of transition matrices may sum to slightly more or less than 1.
        self.defect = float(np.abs(reduced.goals.sum(axis=-1) - 1).max(axis=(0, 2)).sum())
        self.leads = [self._leads(cell) for cell in range(reduced.q)]
        arrivals = {arrival for here, _ in self.leads for arrival in here}
        self.moves = {arrival: self._moves(arrival) for arrival in sorted(arrivals, key=str)}
        self.price = {arrival: self._price(arrival, unit) for arrival in self.moves}

    def _leads(self, cell: int) -> tuple[list[Arrival], IndexArray]:
        """Different arrivals from a cell, and the position of each action's among them."""
        reduced, found = self.reduced, []
        for a, slot in enumerate(reduced.slots.tolist()):
            completable = slot if reduced.completes[a, cell] else None
            regime, landing = int(reduced.regimes[a, cell]), int(reduced.landings[a, cell])
            found.append(Arrival(regime, landing, completable))
        different = sorted(set(found), key=str)
        return different, np.array([different.index(arrival) for arrival in found])

    def _moves(self, arrival: Arrival) -> tuple[RealArray, ...]:
        """P(x' | x), (6^n, 6^n), and where a goal may be completed the same if it is."""
        matrices = list(self.reduced.goals[arrival.regime])
        moves = [reduce(np.kron, matrices).astype(self.dtype)]
        if arrival.slot is not None:
            matrices[arrival.slot] = self.reduced.completed[arrival.regime]
            moves.append(reduce(np.kron, matrices).astype(self.dtype))
        return tuple(moves)

    def _price(self, arrival: Arrival, unit: float) -> RealArray:
        """Discounted E[p(t', m') | t], (3, 1, 1)."""
        agile = int(arrival.regime == Regime.AGILE_FLIGHT)
        price = self.reduced.price[agile, arrival.cell]
        return (price[:, None, None] / unit).astype(self.dtype)

    def ahead(self, values: RealArray) -> Expectations:
        """Discounted E[W'] of each arrival, of W over (q, 3, 8, 6^n)."""
        later = (self.threat @ values.reshape(len(values), 3, -1)).reshape(values.shape)
        ahead = {}
        for arrival, (moves, *completed) in self.moves.items():
            health = (self.faults[arrival.regime] @ later[arrival.cell]).reshape(24, -1)
            table = (health @ moves.T).reshape(self.shape[1:])
            for instead in completed:
                table += self.completion * ((health @ instead.T).reshape(table.shape) - table)
            ahead[arrival] = table
        return ahead

    def q_values(self, cell: int, ahead: Expectations) -> RealArray:
        """Discounted E[W'] of the actions in a cell plus their costs, (A, 3, 8, 6^n).

        inf where what the cluster sees does not allow the action.
        """
        arrivals, of = self.leads[cell]
        tables = np.stack([ahead[arrival] for arrival in arrivals])
        tables += np.stack([self.price[arrival] for arrival in arrivals])
        q = tables.take(of, axis=0)
        q += self.action_costs[cell]
        return q

    def leave(self, cell: int, mass: RealArray, arrived: Expectations) -> None:
        """Add the mass (A, 3, 8, 6^n) on a cell's actions to their arrivals.

        With `settle` the adjoint of the expectation.
        """
        arrivals, of = self.leads[cell]
        merge = (np.arange(len(arrivals))[:, None] == of).astype(self.dtype)
        tables = (merge @ mass.reshape(len(mass), -1)).reshape(-1, *mass.shape[1:])
        for arrival, table in zip(arrivals, tables):
            arrived[arrival] += table

    def settle(self, arrived: Expectations) -> RealArray:
        """Discounted mass of the next states, (q, 3, 8, 6^n)."""
        mass = np.zeros(self.shape, self.dtype)
        for arrival, (moves, *completed) in self.moves.items():
            table = arrived[arrival]
            moved = np.zeros((24, self.shape[-1]), self.dtype)
            for instead in completed:
                done = self.completion * table
                moved += done.reshape(moved.shape) @ instead
                table = table - done
            moved += table.reshape(moved.shape) @ moves
            mass[arrival.cell] += self.faults[arrival.regime].T @ moved.reshape(table.shape)
        later = self.threat.swapaxes(1, 2) @ mass.reshape(len(mass), 3, -1)
        return later.reshape(self.shape)


def proven_values(
    mdp: ClusterMdp, shifts: Sequence[RealArray], values: RealArray, tolerance: float
) -> RealArray:
    """Lower bound on a cluster's W, (q, 3, 8, 6^n), by value iteration, rounding included.

    Parameters
    ----------
    mdp : ClusterMdp
        In double precision.
    shifts : list of float array (A, 3, 8, 6^n)
        What is added to the cost of each action, for each cell.
    values : float array (q, 3, 8, 6^n)
        Where to start.
    tolerance : float
        Largest distance from the upper bound, relative to the largest number.
    """
    discount, span = mdp.sub.mission.discount, np.inf
    largest = max(
        np.abs(cost[np.isfinite(cost)]).max()
        for cost in (mdp.state_costs, mdp.action_costs, *mdp.price.values(), *shifts)
    )
    while True:
        ahead, before = mdp.ahead(values), values
        values = np.stack(
            [(mdp.q_values(cell, ahead) + shift).min(axis=0) for cell, shift in enumerate(shifts)]
        )
        values += mdp.state_costs
        change = values - before
        bounds = SpanBounds(float(change.min()), float(change.max()), discount)
        magnitude = float(largest + np.abs(values).max())
        if bounds.gain * bounds.span <= tolerance * magnitude or bounds.stalled(span):
            break
        span = bounds.span
    rounding = (ROUNDINGS_A_BACKUP + values.shape[-1]) * np.finfo(values.dtype).eps + mdp.defect
    return values + (bounds.lowest - bounds.accumulated(rounding * magnitude))
