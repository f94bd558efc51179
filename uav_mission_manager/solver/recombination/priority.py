"""Priority scores of sub-MDPs and their ranked list L (Algorithm 2, priority ranking).

In a state at hand the score of goal j is

    rho_j = (w_1 reward + w_2 urgency + w_3 (1 - risk) + w_4 (1 - resources)) / sum w

or 0 where nothing is wanted of the goal (g_j = 0); the sub-MDP M_j has the score of its goal. The
paper names the four without a formula. Here each is a number in [0, 1]:

- reward = eta_j g_j r_j / (2 max_i eta_i): what commitment to the goal saves an epoch, of the
  most that any goal's can.
- urgency = g_j / 2: how much the base station wants it, whatever its weight and range.
- risk = 1 - completion_j(f) P(no part fails) P(t is never high): the probability that a flight
  straight to the goal in normal mode, from the cell and in the threat at hand, meets a new
  failure or a high threat, or does not complete the goal in its first epoch on site.
- resources: the distance to the goal and from there to the service cell, of the longest such
  distance in the mission; 1 where the goal is out of range, r_j = 0.

With the weights (1, 0, 0, 0) the first of L is the choice of
`uav_mission_manager.solver.recombination.highest_priority`.
"""

from __future__ import annotations

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.mdp.cost import commitment_savings
from uav_mission_manager.mdp.dynamics import (
    Regime,
    completion_probabilities,
    fault_matrices,
    threat_matrices,
)
from uav_mission_manager.mdp.fleet_rules import PriorityWeights
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.routes import distances, epochs_of_flight, next_hops
from uav_mission_manager.mdp.states import StateSpace


class PriorityScore:
    """rho of a mission's goals in any state.

    Parameters
    ----------
    mission : Mission
    weights : PriorityWeights
    """

    def __init__(self, mission: Mission, weights: PriorityWeights | None = None) -> None:
        self.mission, grid = mission, mission.grid
        self._space, self._flags = StateSpace.of(mission), RangeFlags(mission)
        weighted = np.array(list(vars(weights or PriorityWeights()).values()))
        self._weights = weighted / weighted.sum()
        savings = commitment_savings(mission)
        self._reward = savings / (savings.max() or 1.0)
        cells = [goal.cell for goal in mission.goals]
        to_service = distances(grid, grid.service)
        needed = np.stack([distances(grid, cell) + to_service[cell] for cell in cells], axis=1)
        self._resources = needed / (needed.max() or 1.0)
        self._epochs = np.stack([epochs_of_flight(grid, cell) for cell in cells], axis=1)
        self._calm = np.stack([calm_flight(mission, cell) for cell in cells], axis=1)
        self._no_failure = fault_matrices(mission)[Regime.NORMAL_FLIGHT].diagonal()
        self._completion = completion_probabilities(mission).T

    def terms(self, states: IntArray) -> FloatArray:
        """Reward, urgency, risk and resources of each goal in states (N, 2k+5), (N, k, 4)."""
        s = self._space.split(states)
        f, r = s.f[:, None] - 1, self._flags(s)
        achieved = self._completion[s.f - 1] * self._calm[s.l, :, s.t]
        achieved *= self._no_failure[f] ** self._epochs[s.l]
        reward = self._reward[np.arange(self.mission.k), s.g, r]
        resources = np.where(r == 1, self._resources[s.l], 1.0)
        return np.stack([reward, s.g / 2, 1 - achieved, resources], axis=-1)

    def of_goals(self, states: IntArray) -> FloatArray:
        """rho_j of each goal in states (N, 2k+5), shape (N, k)."""
        terms = self.terms(states)
        terms[..., 2:] = 1 - terms[..., 2:]
        return np.where(self._space.split(states).g > 0, terms @ self._weights, 0.0)


def ranked(scores: FloatArray) -> IndexArray:
    """The list L: positions by descending score along the last axis, of equals the lowest."""
    return np.argsort(-scores, axis=-1, kind='stable')


def calm_flight(mission: Mission, destination: int) -> FloatArray:
    """P(no high threat during the flight to a destination | l, t), shape (q, T)."""
    grid = mission.grid
    hops, epochs = next_hops(grid, destination), epochs_of_flight(grid, destination)
    threat = threat_matrices(mission)[..., :2]
    calm = np.ones(threat.shape[:2])
    order = np.argsort(epochs, kind='stable')
    # Cells so many epochs away, the nearest first: each looks one epoch ahead.
    for cells in np.split(order, np.cumsum(np.bincount(epochs)))[1:-1]:
        after = hops[cells]
        calm[cells] = (threat[after] @ calm[after, :2, None])[..., 0]
    return calm
