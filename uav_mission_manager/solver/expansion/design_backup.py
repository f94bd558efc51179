"""The Bellman backup of a sum of features in design points, all cells, threats and conditions.

With W(l, t, z, x) = theta(l, t, z) phi(x) the expectation over t' and z' is one over theta, that
over x' one over phi, and what is left is a matrix product for each regime. What the actions of
one arrival differ in, their costs and where they are allowed, does not change from sweep to
sweep.

The points are divided into blocks of a fixed size, which threads take one by one. So the matrix
products, and with them the bits of the result, do not depend on how many threads there are.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.mdp.arrays import IndexArray, IntArray, RealArray
from uav_mission_manager.mdp.dynamics import Regime
from uav_mission_manager.solver import threads
from uav_mission_manager.solver.expansion.basis import Basis, Outcome

BLOCK_POINTS = 512
"""Design points of a block: measured, from here on matrix products are at full speed."""

RegimeAndCell = tuple[int, int]
"""Regime and cell."""

Coefficients = dict[int, RealArray]
"""Coefficients of the discounted expectation over t' and z', (q, T, Z, P), of each regime."""


class DesignBackup:
    """T W in the design points.

    Parameters
    ----------
    basis : Basis
    x : int array (M, k)
    dtype : numpy type
        Of all arithmetic.
    """

    def __init__(self, basis: Basis, x: IntArray, dtype: DTypeLike) -> None:
        self.points, self.dtype = len(x), np.dtype(dtype)
        reduced = basis.reduced
        self._threat = reduced.threat.astype(dtype)
        self._conditions = (reduced.sub.mission.discount * reduced.conditions).astype(dtype)
        starts = range(0, len(x), BLOCK_POINTS)
        self._slices = [slice(start, start + BLOCK_POINTS) for start in starts]
        blocks = threads.share(
            lambda _, part: (part.start, _Block(basis, x[part], self.dtype)),
            self._slices,
            threads.processors(),
        )
        self._blocks = [block for _, block in sorted(blocks, key=itemgetter(0))]

    def __call__(self, theta: RealArray) -> RealArray:
        """Return T W, shape (q, T, Z, M), of theta over cell, t, z and feature."""
        later = (self._threat @ theta.reshape(*theta.shape[:2], -1)).reshape(theta.shape)
        coefficients = {int(regime): self._conditions[regime] @ later for regime in Regime}
        out = np.empty((*theta.shape[:3], self.points), self.dtype)

        def back_up(thread: int, block: int) -> None:
            self._blocks[block](coefficients, out[..., self._slices[block]])

        threads.share(back_up, range(len(self._blocks)), threads.processors())
        return out


@dataclass(frozen=True)
class _Completion:
    """An action that may complete a goal, in the points of a block where it is allowed.

    Attributes
    ----------
    regime, goal : int
    points : int array (n,)
        Positions of those points in the block.
    costs : float array (Z, n)
        Its `ReducedMission.action_costs`.
    gains : float array (P_j, n)
        What the expected features that look at the goal gain by its completion.
    """

    regime: int
    goal: int
    points: IndexArray
    costs: RealArray
    gains: RealArray


class _Block:
    """T W in some of the design points, with all that the sweeps have in common.

    Parameters
    ----------
    basis : Basis
    x : int array (m, k)
    dtype : numpy type
    """

    def __init__(self, basis: Basis, x: IntArray, dtype: np.dtype[Any]) -> None:
        reduced = self.reduced = basis.reduced
        outcomes: list[Outcome] = [(int(r), None) for r in Regime if r != Regime.REPAIRED]
        features = basis.expected(x, outcomes, dtype)
        self.expected = {regime: table for (regime, _), table in zip(outcomes, features)}
        # A repair moves the goals as staying on the ground does.
        self.expected[int(Regime.REPAIRED)] = self.expected[Regime.PARKED]
        self.price = reduced.price[..., None, None].astype(dtype)
        self.completion = reduced.completion[..., None].astype(dtype)
        self.members = [positions for positions, _ in basis.of_goals]
        self.arrivals: list[dict[RegimeAndCell, RealArray]] = []
        self.completions: list[list[_Completion]] = []
        for cell in range(reduced.q):
            costs = reduced.action_costs(cell, x).astype(dtype)
            self.arrivals.append(self._arrivals(cell, costs))
            self.completions.append(self._completions(cell, costs, basis, x))
        self.costs = reduced.own_costs(x).astype(dtype)

    def __call__(self, coefficients: Coefficients, out: RealArray) -> None:
        """Write T W, shape (q, T, Z, m)."""
        ahead = {regime: self._ahead(regime, coefficients[regime]) for regime in self.expected}
        scratch = np.empty_like(out[0])
        out[:] = np.inf
        for cell, least in enumerate(out):
            for (regime, landing), costs in self.arrivals[cell].items():
                np.add(ahead[regime][landing], costs, out=scratch)
                np.minimum(least, scratch, out=least)
            for completion in self.completions[cell]:
                regime, points = completion.regime, completion.points
                arrived = ahead[regime][cell].take(points, axis=-1) + completion.costs
                arrived += self._gained(completion, coefficients[regime][cell])
                least[..., points] = np.minimum(least[..., points], arrived)
            least += self.costs[cell % len(self.costs)]

    def _ahead(self, regime: int, coefficients: RealArray) -> dict[int, RealArray]:
        """Discounted E[V'], nothing completed, (T, Z, m) by the cells it may lead to."""
        regimes, landings = self.reduced.regimes, self.reduced.landings
        cells = np.unique(landings[regimes == regime])
        chosen = coefficients[cells]
        table = chosen.reshape(-1, chosen.shape[-1]) @ self.expected[regime]
        out = table.reshape(*chosen.shape[:3], -1)
        out += self.price[int(regime == Regime.AGILE_FLIGHT), cells]
        return dict(zip(cells.tolist(), out))

    def _gained(self, completion: _Completion, coefficients: RealArray) -> RealArray:
        """What the chance to complete a goal adds to the discounted E[V'], (T, Z, n)."""
        part = coefficients.take(self.members[completion.goal], axis=-1)
        gained = part.reshape(-1, part.shape[-1]) @ completion.gains
        return self.completion[completion.goal] * gained.reshape(*part.shape[:2], -1)

    def _arrivals(self, cell: int, costs: RealArray) -> dict[RegimeAndCell, RealArray]:
        """Least cost (Z, m) of the actions of each arrival from a cell, nothing completed."""
        reduced = self.reduced
        arrivals: dict[RegimeAndCell, list[int]] = {}
        for action in np.flatnonzero(~reduced.completes[:, cell]).tolist():
            regime, landing = reduced.regimes[action, cell], reduced.landings[action, cell]
            arrivals.setdefault((int(regime), int(landing)), []).append(action)
        return {arrival: costs[actions].min(axis=0) for arrival, actions in arrivals.items()}

    def _completions(
        self, cell: int, costs: RealArray, basis: Basis, x: IntArray
    ) -> list[_Completion]:
        """Actions that may complete a goal on its cell."""
        reduced, completions = self.reduced, []
        for action in np.flatnonzero(reduced.completes[:, cell]).tolist():
            regime, goal = int(reduced.regimes[action, cell]), int(reduced.slots[action])
            points = np.flatnonzero(np.isfinite(costs[action]).any(axis=0))
            if not points.size:
                continue
            members, factors = basis.of_goals[goal]
            functions = basis.functions_after([(regime, goal)]).astype(costs.dtype)
            gains = basis.features(functions, x[points], factors)[0]
            gains -= self.expected[regime][np.ix_(members, points)]
            allowed = costs[action][:, points]
            completions.append(_Completion(regime, goal, points, allowed, gains))
        return completions
