"""The Bellman backup of a sum of features in design points, all cells, threats and faults at once.

With W(l, t, f, x) = theta(l, t, f) phi(x) the expectation over t' and f' is one over theta, that
over x' one over phi, and what is left is a matrix product for each regime. What the actions of
one arrival differ in, their costs and where they are allowed, does not change from sweep to
sweep.

The points are divided into blocks of a fixed size, which threads take one by one. So the matrix
products, and with them the bits of the result, do not depend on how many threads there are.
"""

from __future__ import annotations

import numpy as np

from uav_mission_manager.mdp.arrays import IndexArray, IntArray, RealArray
from uav_mission_manager.mdp.dynamics import Regime
from uav_mission_manager.solver import threads
from uav_mission_manager.solver.expansion.basis import Basis, Outcome
from uav_mission_manager.solver.reduced import ReducedMission

BLOCK_POINTS = 512
"""Design points of a block."""

Coefficients = dict[int, RealArray]
"""Coefficients (q, 3, 8, P) of the discounted expectation over t' and f', of each regime."""


class DesignBackup:
    """T W in the design points.

    Parameters
    ----------
    basis : Basis
    x : int array (M, k)
    """

    def __init__(self, basis: Basis, x: IntArray) -> None:
        self.basis, self.points = basis, len(x)
        reduced = basis.reduced
        discount = reduced.sub.mission.discount
        self._threat = reduced.threat.astype(np.float32)
        self._faults = (discount * reduced.faults).astype(np.float32)
        starts = range(0, len(x), BLOCK_POINTS)
        self._slices = [slice(start, start + BLOCK_POINTS) for start in starts]
        self._blocks = [_Block(basis, x[part]) for part in self._slices]

    def __call__(self, theta: RealArray) -> RealArray:
        """Return T W, shape (q, 3, 8, M), of theta over cell, t, f and feature."""
        q = len(theta)
        later = (self._threat @ theta.reshape(q, 3, -1)).reshape(theta.shape)
        coefficients = {int(r): self._faults[r] @ later for r in Regime}
        out = np.empty((*theta.shape[:3], self.points), np.float32)

        def back_up(thread: int, block: int) -> None:
            self._blocks[block](coefficients, out[..., self._slices[block]])

        threads.share(back_up, range(len(self._blocks)), threads.processors())
        return out


class _Block:
    """T W in some of the design points, with all that the sweeps have in common.

    Parameters
    ----------
    basis : Basis
    x : int array (m, k)
    """

    def __init__(self, basis: Basis, x: IntArray) -> None:
        reduced = self.reduced = basis.reduced
        outcomes: list[Outcome] = [(r, None) for r in Regime if r != Regime.REPAIRED]
        features = basis.expected(x, outcomes, np.float32)
        self.expected = {int(regime): table for (regime, _), table in zip(outcomes, features)}
        # A repair moves the goals as staying on the ground does.
        self.expected[Regime.REPAIRED] = self.expected[Regime.PARKED]
        self.price = reduced.price[..., None, None].astype(np.float32)
        self.completion = reduced.completion[:, None].astype(np.float32)
        self.of_goal = basis.of_goal
        self.gains = {
            (regime, goal): self._gain(basis, x, regime, goal)
            for regime, goal in sorted(_completions(reduced))
        }
        self.arrivals = [self._arrivals(cell, x) for cell in range(reduced.q)]
        goals = reduced.goal_costs[np.arange(reduced.n), x].sum(axis=1)
        self.costs = (reduced.fault_costs[:, None] + goals).astype(np.float32)

    def __call__(self, coefficients: Coefficients, out: RealArray) -> None:
        """Write T W, shape (q, 3, 8, m)."""
        ahead = {regime: self._ahead(regime, coefficients[regime]) for regime in self.expected}
        scratch = np.empty_like(out[0])
        out[:] = np.inf
        for cell, arrivals in enumerate(self.arrivals):
            for (regime, landing, goal), cost in arrivals.items():
                arrived = ahead[regime][landing]
                if goal is not None:
                    arrived = arrived + self._gained(regime, goal, coefficients[regime][landing])
                np.add(arrived, cost, out=scratch)
                np.minimum(out[cell], scratch, out=out[cell])
            out[cell] += self.costs

    def _ahead(self, regime: int, coefficients: RealArray) -> RealArray:
        """Discounted E[V'] on arrival in each cell, nothing completed, (q, 3, 8, m)."""
        table = coefficients.reshape(-1, coefficients.shape[-1]) @ self.expected[regime]
        out = table.reshape(*coefficients.shape[:3], -1)
        out += self.price[int(regime == Regime.AGILE_FLIGHT)]
        return out

    def _gained(self, regime: int, goal: int, coefficients: RealArray) -> RealArray:
        """What the chance to complete a goal adds to the discounted E[V'], (3, 8, m)."""
        part = coefficients.take(self.of_goal[goal], axis=-1)
        gain = part.reshape(-1, part.shape[-1]) @ self.gains[regime, goal]
        return self.completion * gain.reshape(*part.shape[:2], -1)

    def _gain(self, basis: Basis, x: IntArray, regime: int, goal: int) -> RealArray:
        """What the features that look at a goal gain where it is completed, (P_j, m)."""
        completed = basis.expected(x, [(regime, goal)], np.float32)[0]
        members = self.of_goal[goal]
        return completed[members] - self.expected[regime][members]

    def _arrivals(self, cell: int, x: IntArray) -> dict[tuple[int, int, int | None], RealArray]:
        """Least cost (8, m) of the actions by regime, landing and the goal they may complete."""
        reduced, costs = self.reduced, self.reduced.action_costs(cell, x)
        arrivals: dict[tuple[int, int, int | None], list[int]] = {}
        for action in range(len(costs)):
            goal = int(reduced.slots[action]) if reduced.completes[action, cell] else None
            arrival = int(reduced.regimes[action, cell]), int(reduced.landings[action, cell])
            arrivals.setdefault((*arrival, goal), []).append(action)
        return {
            arrival: costs[actions].min(axis=0).astype(np.float32)
            for arrival, actions in arrivals.items()
        }


def _completions(reduced: ReducedMission) -> set[tuple[int, int]]:
    """Regimes in which goals may be completed."""
    actions, cells = np.nonzero(reduced.completes)
    slots: IndexArray = reduced.slots[actions]
    return set(zip(reduced.regimes[actions, cells].tolist(), slots.tolist()))
