"""Simulation of fleets that share a mission's goals.

Each UAV lives through the mission's epoch alone but for the priorities: a goal is achieved by
whichever UAV completes it, and changes for all alike. An epoch of n UAVs costs

    sum_j eta_j g_j R_j (1 - C_j) + sum_j delta_j g_j (1 - R_j)
        + sum over UAVs of h + phi + p + (beta/k) sum_j (1 - r_j),

with R_j = max r_j over the UAVs (one can reach the goal) and C_j = max r_j [c = j] (one that can
is committed to it). For one UAV that is the stage cost J(s, a).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.mdp.dynamics import priority_matrices
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.evaluation.simulation import Simulator
from uav_mission_manager.solver.recombination.fleet import FleetPlanner

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

STANDING = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""P(g' | g) of a goal whose priority does not change by itself."""


class FleetSimulator:
    """One epoch of a mission for many independent fleets, states (N, n, 2k+5)."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self._eta = np.array([goal.eta for goal in mission.goals])
        self._delta = np.array([goal.delta for goal in mission.goals])
        self._priority = np.cumsum(np.stack(priority_matrices(mission)), axis=-1)
        # Where priorities stand still, one that is 0 after the epoch has been completed in it.
        goals = tuple(replace(goal, priority_transition=STANDING) for goal in mission.goals)
        self._alone = Simulator(replace(mission, goals=goals))

    def costs(self, fleets: IntArray, actions: IntArray) -> FloatArray:
        """Stage costs of fleets and their action numbers (N, n), shape (N,)."""
        k = self.mission.k
        r, g = fleets[..., 1 : 1 + k], fleets[:, 0, 1 + k : 1 + 2 * k]
        committed = fleets[..., -3, None] == np.arange(1, k + 1)
        reached, covered = r.max(axis=1), (r * committed).max(axis=1)
        cost = self._eta * g * (reached - covered) + self._delta * g * (1 - reached)
        alone = self._alone.costs(self._with_priority(fleets, 0), actions.ravel())
        return cost.sum(axis=1) + alone.reshape(actions.shape).sum(axis=1)

    def step(self, fleets: IntArray, actions: IntArray, rng: np.random.Generator) -> IntArray:
        """Draw the next states, shape (N, n, 2k+5).

        However the UAVs act, an epoch draws as many numbers, each for the same purpose.
        """
        k = self.mission.k
        self._alone.check(fleets.reshape(-1, fleets.shape[2]), actions.ravel())
        after = self._alone.step(self._with_priority(fleets, 2), actions.ravel(), rng)
        after = after.reshape(fleets.shape)
        completed = (after[..., 1 + k : 1 + 2 * k] == 0).any(axis=1)
        rows = self._priority[np.arange(k), fleets[:, 0, 1 + k : 1 + 2 * k]]
        drawn = (rng.random(completed.shape)[..., None] >= rows[..., :2] / rows[..., 2:]).sum(-1)
        after[..., 1 + k : 1 + 2 * k] = np.where(completed, 0, drawn)[:, None]
        return after

    def _with_priority(self, fleets: IntArray, level: int) -> IntArray:
        """The UAVs one by one, shape (N n, 2k+5), every goal at one priority."""
        states = fleets.reshape(-1, fleets.shape[2]).copy()
        states[:, 1 + self.mission.k : 1 + 2 * self.mission.k] = level
        return states


def simulate_fleets(
    planner: FleetPlanner,
    fleets: ArrayLike,
    epochs: int,
    rng: np.random.Generator,
    assignment: str = 'queue',
) -> FloatArray:
    """Discounted costs of some epochs of fleets from states (N, n, 2k+5), shape (N,).

    Of generators in the same state, fleets that differ only in how they decide meet with the
    same luck.
    """
    simulator, plan = FleetSimulator(planner.mission), None
    states = np.asarray(fleets, np.int64)
    total, weight = np.zeros(len(states)), 1.0
    for _ in range(epochs):
        plan = planner.plan(states, plan, assignment)
        total += weight * simulator.costs(states, plan.actions)
        states = simulator.step(states, plan.actions, rng)
        weight *= planner.mission.discount
    return total
