"""The Bellman backup of a sum of features in design points, all y at once.

With W(y, x) = theta(y) phi(x) the expectation over t' and f' is one over theta, that over x' one
over phi, and what is left is a matrix product for each way to go on. What the actions of one
arrival differ in, their costs and where they are allowed, does not change from sweep to sweep.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.expansion.basis import Basis
from uav_mission_manager.solver.factors import WAYS

Arrival = tuple[int, int]
"""Way (see `WAYS`) and landing place."""


class DesignBackup:
    """T W in the design points.

    Parameters
    ----------
    basis : Basis
    x : int array (M, k)
    """

    def __init__(self, basis: Basis, x: NDArray[np.int64]) -> None:
        self.basis, self.x, self.factors = basis, x, basis.factors
        factors = self.factors
        # A repair moves the goals as staying on the ground does.
        expected = [*basis.expected(x, range(4), dtype=np.float32)]
        self.expected = [*expected, expected[WAYS.index('none')]]
        self.threat = factors.threat.astype(np.float32)
        self.faults = (factors.mission.discount * factors.faults).astype(np.float32)
        # Fault modes up to the last that may complete a goal.
        self.able = 1 + max(np.flatnonzero(factors.completion), default=-1)
        self.completion = factors.completion[: self.able, None].astype(np.float32)
        self.price = factors.price[..., None, None].astype(np.float32)
        self.arrivals = [self._arrivals(place) for place in range(factors.places)]
        self.gains = [self._gains(goal) for goal in range(factors.k)]
        self.landings = self._landings()
        costs = factors.cost[np.arange(factors.k), x].sum(axis=1)
        self.costs = (np.array(factors.mission.faults.cost)[:, None] + costs).astype(np.float32)

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return T W, shape (places, 3, 8, M), of theta over place, t, f and feature."""
        places, points = len(theta), len(self.x)
        later = (self.threat @ theta.reshape(places, 3, -1)).reshape(theta.shape)
        coefficients, ahead = {}, {}
        for way, landings in self.landings.items():
            mixed = self.faults[way] @ later[landings]
            tables = mixed.reshape(-1, self.basis.size) @ self.expected[way]
            tables = tables.reshape(-1, 3, 8, points) + self.price[int(way == 1), landings]
            coefficients.update({(way, place): c for place, c in zip(landings, mixed)})
            ahead.update({(way, place): table for place, table in zip(landings, tables)})
        out: FloatArray = np.full((places, 3, 8, points), np.inf, np.float32)
        scratch = np.empty_like(out[0])
        for place, arrivals in enumerate(self.arrivals):
            for arrival, cost in arrivals.items():
                arrived = ahead[arrival]
                if place >= self.factors.q and self.able:
                    arrived = self._completing(place, arrival, ahead, coefficients)
                np.add(arrived, cost, out=scratch)
                np.minimum(out[place], scratch, out=out[place])
            out[place] += self.costs
        return out

    def _completing(
        self,
        place: int,
        arrival: Arrival,
        ahead: dict[Arrival, FloatArray],
        coefficients: dict[Arrival, FloatArray],
    ) -> FloatArray:
        """E on an arrival from a goal's site, where the goal is completed with some probability.

        Then the arrival is on the cell, and the features that look at the goal gain.
        """
        (way, landing), goal, able = arrival, place - self.factors.q, self.able
        on_cell = way, int(self.factors.cells[landing])
        gains = self.gains[goal][way]
        part = coefficients[on_cell][:, :able].take(self.basis.of_goal[goal], axis=-1)
        done = (part.reshape(-1, part.shape[-1]) @ gains).reshape(3, able, -1)
        done += ahead[on_cell][:, :able]
        arrived = ahead[arrival].copy()
        done -= arrived[:, :able]
        done *= self.completion
        arrived[:, :able] += done
        return arrived

    def _arrivals(self, place: int) -> dict[Arrival, FloatArray]:
        """Arrivals from a place, each with the least cost of its actions, (8, M)."""
        ways, landings = self.factors.way[:, place], self.factors.landing[:, place]
        arrivals: dict[Arrival, list[int]] = {}
        for action, arrival in enumerate(zip(ways.tolist(), landings.tolist())):
            arrivals.setdefault(arrival, []).append(action)
        costs = self.factors.action_costs(place, self.x)
        return {
            arrival: costs[actions].min(axis=0).astype(np.float32)
            for arrival, actions in arrivals.items()
        }

    def _gains(self, goal: int) -> dict[int, FloatArray]:
        """What the features that look at a goal gain where it is completed, (P_j, M) by way."""
        basis = Basis(self.factors, self.basis.clusters.of(goal))
        members = self.basis.of_goal[goal]
        gains = {}
        for way, _ in self.arrivals[self.factors.q + goal]:
            achieved = basis.expected(self.x, [way], goal, np.float32)[0, 1:]
            gains[way] = achieved - self.expected[way][members]
        return gains

    def _landings(self) -> dict[int, list[int]]:
        """Places where arrivals by each way are, with the cells of those from a goal's site."""
        landings: dict[int, set[int]] = {}
        for place, arrivals in enumerate(self.arrivals):
            for way, landing in arrivals:
                landings.setdefault(way, set()).add(landing)
                if place >= self.factors.q and self.able:
                    landings[way].add(int(self.factors.cells[landing]))
        return {way: sorted(places) for way, places in landings.items()}
