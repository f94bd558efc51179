"""Priority scores of sub-MDPs and their ranked list L (Algorithm 2, priority ranking).

In a state at hand the score of goal j is

    rho_j = (w_1 reward + w_2 urgency + w_3 (1 - risk) + w_4 (1 - resources)) / sum w

or 0 where nothing is wanted of the goal (g_j = 0); that of a sub-MDP is its best goal's. The
paper names the four without a formula. Here each is a number in [0, 1]:

- reward = eta_j g_j r_j / (2 max_i eta_i): what commitment to the goal saves an epoch, of the
  most that any goal's can.
- urgency = g_j / 2: how much the base station wants it, whatever its weight and range.
- risk = 1 - completion(f) P(no part fails) P(t is never 2): the probability that a flight
  straight to the goal in normal mode, from the cell and in the threat at hand, meets a new
  failure or a high threat, or does not complete the goal in its first epoch on site.
- resources: the way to the goal and from there to the service cell, of the longest such way
  in the mission; 1 where the goal is out of range, r_j = 0.

With the weights (1, 0, 0, 0) the first of L is the choice of
`uav_mission_manager.solver.recombination.highest_priority`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.dynamics import failure_matrices, threat_matrices
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.submdp import SubMdp

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class PriorityWeights:
    """w_1..w_4, not below 0, one at least above it; only their ratios matter."""

    reward: float = 1.0
    urgency: float = 0.0
    risk: float = 0.0
    resources: float = 0.0

    def __post_init__(self) -> None:
        """Raise `ValueError` where a weight is not finite or below 0, or all are 0."""
        for name, weight in vars(self).items():
            if not 0 <= weight < math.inf:
                raise ValueError(f'weight of {name}: {weight} is not a finite number >= 0')
        if not any(vars(self).values()):
            raise ValueError('all priority weights are 0')


class PriorityScore:
    """rho of a mission's goals and sub-MDPs in any state.

    Parameters
    ----------
    mission : Mission
    weights : PriorityWeights
    """

    def __init__(self, mission: Mission, weights: PriorityWeights | None = None) -> None:
        self.mission = mission
        weighted = np.array(list(vars(weights or PriorityWeights()).values()))
        self._weights = weighted / weighted.sum()
        cells = np.array([goal.cell for goal in mission.goals])
        eta = np.array([goal.eta for goal in mission.goals])
        self._reward = eta / (2 * eta.max() or 1.0)
        distances, service = mission.grid.distances(), mission.grid.service
        way = distances[:, cells] + distances[cells, service]
        self._way = way / (way.max() or 1.0)
        self._steps, self._calm = _steps(mission, cells), _calm_flight(mission, cells)
        sound = [matrix[:, 0] for matrix in failure_matrices(mission, agile=False)]
        bits = np.arange(8)[:, None] >> np.arange(3) & 1
        # A failed part cannot fail anew.
        self._no_failure = np.prod(np.where(bits, 1.0, [row[0] for row in sound]), axis=1)

    def terms(self, states: NDArray[np.int64]) -> FloatArray:
        """Reward, urgency, risk and resources of each goal in states (N, 2k+5), (N, k, 4)."""
        k = self.mission.k
        r, g = states[:, 1 : 1 + k], states[:, 1 + k : 1 + 2 * k]
        f, cell, t = states[:, 0] - 1, states[:, -4], states[:, -2]
        achieved = np.array(self.mission.faults.completion)[f, None] * self._calm[cell, :, t]
        achieved = achieved * self._no_failure[f, None] ** self._steps[cell]
        resources = np.where(r == 1, self._way[cell], 1.0)
        return np.stack([self._reward * g * r, g / 2, 1 - achieved, resources], axis=-1)

    def of_goals(self, states: NDArray[np.int64]) -> FloatArray:
        """rho_j of each goal in states (N, 2k+5), shape (N, k)."""
        k, terms = self.mission.k, self.terms(states)
        terms[..., 2:] = 1 - terms[..., 2:]
        return np.where(states[:, 1 + k : 1 + 2 * k] > 0, terms @ self._weights, 0.0)

    def of(self, subs: Sequence[SubMdp], states: NDArray[np.int64]) -> FloatArray:
        """Rho of sub-MDPs that track some goal in states (N, 2k+5), shape (N, sub-MDPs)."""
        scores = self.of_goals(states)
        return np.stack([scores[:, list(sub.goals)].max(axis=1) for sub in subs], axis=1)


def ranked(scores: FloatArray) -> NDArray[np.intp]:
    """The list L: positions by descending score along the last axis, of equals the lowest."""
    return np.argsort(-scores, axis=-1, kind='stable')


def _steps(mission: Mission, cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Epochs of flight from each cell to each of some, shape (q, cells)."""
    row, col = np.divmod(np.arange(mission.grid.q), mission.grid.cols)
    return np.abs(row[:, None] - row[cells]) + np.abs(col[:, None] - col[cells])


def _calm_flight(mission: Mission, cells: NDArray[np.int64]) -> FloatArray:
    """P(no high threat on the way | l, t) to each of some cells, shape (q, cells, 3)."""
    hops = mission.grid.next_hops()[:, cells]
    threat, goals = threat_matrices(mission)[hops][..., :2], np.arange(len(cells))
    there = (np.arange(mission.grid.q)[:, None] == cells)[..., None]
    calm = np.ones((*hops.shape, 3))
    for _ in range(mission.grid.rows + mission.grid.cols):
        onwards = (threat @ calm[hops, goals, :2, None])[..., 0]
        calm = np.where(there, 1.0, onwards)
    return calm
