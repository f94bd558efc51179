"""A cluster of goals as an MDP of its own, computed place by place.

A cluster keeps all 2k+4 actions, and its y = (place, t, f) and x_j = 2 g_j + r_j move as in the
whole mission: tables over (P, 3, 8, 6^n) for n goals. Its costs are shares of J that sum to J over
the clusters; p(t, m) - [c > 0] eta_c g_c r_c of the present state is left out, as in
`uav_mission_manager.solver.reduced`.

The actions of one place are a block of (A, 3, 8, 6^n) entries. All that is done with it is done
while it is in the cache, and no table of all places and actions is kept but that of the costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.factors import FLAGS, STAKES, Factors

ROUNDINGS = 64
"""Errors of one ulp of the largest number in a backup, at most, besides 6^n for the x_j."""

Arrival = tuple[int, int, int | None]
"""By which way (see `WAYS`) at which place, and which goal of the cluster is completed."""


class _Actions(NamedTuple):
    """Where the actions of a place lead.

    Attributes
    ----------
    open : list of Arrival
        The different arrivals where nothing is completed.
    completed : list of Arrival
        On a goal's site, the same where that goal is completed; empty elsewhere.
    of : int array (A,)
        Position of each action's arrival.
    merge : float array (arrivals, A)
        Sums over the actions of each arrival.
    """

    open: list[Arrival]
    completed: list[Arrival]
    of: NDArray[np.intp]
    merge: FloatArray


class ClusterMdp:
    """One cluster, with tables of a floating type.

    From a site, the goal is completed with some probability: then the arrival is on the cell,
    without commitment, and x_j' follows `Factors.achieved`; a cluster that does not hold the goal
    only loses the commitment.

    Parameters
    ----------
    factors : Factors
    goals : sequence of int
        Of the cluster, from 0.
    dtype : floating type

    Attributes
    ----------
    shape : tuple of int
        Of a table over the cluster's states, (P, 3, 8, 6^n).
    """

    def __init__(self, factors: Factors, goals: Sequence[int], dtype: DTypeLike) -> None:
        self.factors, self.goals, self.dtype = factors, tuple(goals), np.dtype(dtype)
        self.shape = (factors.places, 3, 8, 6 ** len(self.goals))
        self.threat = factors.threat.astype(dtype)
        self.faults = (factors.mission.discount * factors.faults).astype(dtype)
        self.completion = factors.completion.astype(dtype)[:, None]
        # What a cluster does not see of the goals' rows, whose sums may be slightly off 1.
        self.defect = float(np.abs(factors.goals.sum(axis=-1) - 1).max(axis=(0, 2)).sum())
        self.actions = [self._actions(place) for place in range(factors.places)]
        arrivals = {key for here in self.actions for key in here.open + here.completed}
        self.moves = {key: self._moves(key[0], key[2]) for key in arrivals}

    def _actions(self, place: int) -> _Actions:
        factors = self.factors
        leads = list(zip(factors.way[:, place].tolist(), factors.landing[:, place].tolist()))
        different = sorted(set(leads))
        of = np.array([different.index(lead) for lead in leads])
        completed: list[Arrival] = []
        if place >= factors.q:
            done = place - factors.q if place - factors.q in self.goals else None
            completed = [(way, int(factors.cells[to]), done) for way, to in different]
        merge = (np.arange(len(different))[:, None] == of).astype(self.dtype)
        return _Actions([(way, to, None) for way, to in different], completed, of, merge)

    def _moves(self, way: int, done: int | None) -> FloatArray:
        """P(x' | x), (6^n, 6^n)."""
        ways, achieved = self.factors.goals[way], self.factors.achieved[way]
        parts = [achieved if j == done else ways[j] for j in self.goals]
        return reduce(np.kron, parts).astype(self.dtype)

    def costs(self, holders: NDArray[np.intp], count: int) -> list[FloatArray]:
        """J_i with the discounted price of t', less what a commitment saves, by place.

        Parameters
        ----------
        holders : int array (k,)
            Clusters that hold each goal, among which its cost is split evenly.
        count : int
            All clusters, among which the common costs are.

        Returns
        -------
        list of float array (A, 3, 8, 6^n)
            inf where what the cluster sees does not allow the action.
        """
        return [self._cost(place, holders, count) for place in range(self.factors.places)]

    def _cost(self, place: int, holders: NDArray[np.intp], count: int) -> FloatArray:
        factors, n = self.factors, len(self.goals)
        agile = np.array([int(action.agile) for action in factors.actions])
        price = factors.price[agile, factors.landing[:, place]] + factors.distance[:, place, None]
        shared = price[..., None] + np.array(factors.mission.faults.cost)
        cost = np.empty((*shared.shape, *(6,) * n))
        cost[:] = shared.reshape(shared.shape + (1,) * n) / count
        # On a site the goal may be completed, which drops the commitment whatever goal it is to.
        kept = 1 - factors.completion if place >= factors.q else np.ones(8)
        for slot, j in enumerate(self.goals):
            own = np.moveaxis(cost, 3 + slot, -1)
            own += factors.cost[j] / holders[j]
            lift = (..., *(None,) * (n - 1), slice(None))
            for a, action in enumerate(factors.actions):
                if action.goal == j + 1:
                    saving = factors.saving[agile[a], j] / holders[j]
                    own[a] -= (kept[:, None] * saving)[lift]
                    if factors.strict:
                        own[a][..., STAKES == 0] = np.inf
        if factors.strict:
            self._forbid(cost)
        return cost.reshape(*shared.shape, -1).astype(self.dtype)

    def _forbid(self, cost: FloatArray) -> None:
        """What f forbids, and recharging where a cluster sees all goals in range."""
        n = len(self.goals)
        for action, own in zip(self.factors.actions, cost):
            if action.kind == 'commit':
                own[:, self.factors.completion == 0] = np.inf
            elif action.kind == 'repair':
                own[:, 0] = np.inf
            elif action.kind == 'recharge' and n == self.factors.k:
                own[(..., *np.ix_(*[FLAGS == 1] * n))] = np.inf

    def ahead(self, values: FloatArray) -> dict[Arrival, FloatArray]:
        """Discounted E[W'] on each arrival, (3, 8, 6^n), of W over (P, 3, 8, 6^n)."""
        later = (self.threat @ values.reshape(len(values), 3, -1)).reshape(values.shape)
        ahead = {}
        for arrival, moves in self.moves.items():
            way, place, _ = arrival
            health = self.faults[way] @ later[place]
            ahead[arrival] = (health.reshape(24, -1) @ moves.T).reshape(health.shape)
        return ahead

    def expected(self, place: int, ahead: dict[Arrival, FloatArray]) -> FloatArray:
        """Discounted E[W'] of the actions of a place, (A, 3, 8, 6^n)."""
        here = self.actions[place]
        tables = np.stack([ahead[arrival] for arrival in here.open])
        if here.completed:
            done = np.stack([ahead[arrival] for arrival in here.completed])
            done -= tables
            done *= self.completion
            tables += done
        return tables.take(here.of, axis=0)

    def leave(self, place: int, mass: FloatArray, arrived: dict[Arrival, FloatArray]) -> None:
        """Add mass (A, 3, 8, 6^n) on a place's actions to its arrivals: adjoint of `expected`."""
        here = self.actions[place]
        tables = (here.merge @ mass.reshape(len(mass), -1)).reshape(-1, *mass.shape[1:])
        if here.completed:
            done = tables * self.completion
            tables -= done
            for arrival, table in zip(here.completed, done):
                arrived[arrival] += table
        for arrival, table in zip(here.open, tables):
            arrived[arrival] += table

    def settle(self, arrived: dict[Arrival, FloatArray]) -> FloatArray:
        """Discounted mass of the next states, (P, 3, 8, 6^n): adjoint of `ahead`."""
        mass = np.zeros(self.shape, self.dtype)
        for arrival, table in arrived.items():
            way, place, _ = arrival
            moved = table.reshape(24, -1) @ self.moves[arrival]
            mass[place] += self.faults[way].T @ moved.reshape(table.shape)
        later = self.threat.swapaxes(1, 2) @ mass.reshape(len(mass), 3, -1)
        return later.reshape(self.shape)


def proven_values(
    mdp: ClusterMdp, costs: Sequence[FloatArray], values: FloatArray, tolerance: float
) -> FloatArray:
    """Lower bound on a cluster's W, (P, 3, 8, 6^n), by value iteration, rounding included.

    Stops once it is within `tolerance`, relative to the largest number, of the upper bound.
    W_{n+1} + gamma/(1-gamma) min(W_{n+1} - W_n) <= W* (MacQueen 1966).
    """
    discount = mdp.factors.mission.discount
    gain, spread = discount / (1 - discount), np.inf
    largest = max(float(np.abs(cost[np.isfinite(cost)]).max()) for cost in costs)
    while True:
        ahead, before = mdp.ahead(values), values
        values = np.stack(
            [(cost + mdp.expected(place, ahead)).min(axis=0) for place, cost in enumerate(costs)]
        )
        change = values - before
        low = float(change.min())
        previous, spread = spread, float(change.max()) - low
        magnitude = largest + float(np.abs(values).max())
        if gain * spread <= tolerance * magnitude or not spread < previous:
            break
    error = (ROUNDINGS + values.shape[-1]) * np.finfo(values.dtype).eps + mdp.defect
    return values + (gain * low - error * magnitude / (1 - discount))
