"""Simulation of fleets that share a mission's goals.

Each UAV lives through the mission's epoch alone but for the priorities: a goal is achieved by
whichever UAV completes it, and changes for all alike. An epoch of n UAVs costs

    sum_j eta_j g_j R_j (1 - C_j) + sum_j delta_j g_j (1 - R_j)
        + sum over UAVs of h + phi + p + (beta/k) sum_j (1 - r_j),

with R_j = max r_j over the UAVs (one can reach the goal) and C_j = max r_j [c = j] (one that can
is committed to it). For one UAV that is the stage cost J(s, a).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.mdp.cost import commitment_savings, goal_costs
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.evaluation.simulation import Simulator
from uav_mission_manager.solver.recombination import FleetPlanner


class FleetSimulator:
    """One epoch of a mission for many independent fleets, states (N, n, 2k+5)."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self._uav = Simulator(mission)
        self._flags = RangeFlags(mission)
        self._savings = commitment_savings(mission)
        # What a goal costs where g_j = 0, range lost, is each UAV's own cost.
        costs = goal_costs(mission)
        self._shared = costs - costs[:, :1]

    def costs(self, fleets: IntArray, actions: IntArray) -> FloatArray:
        """Stage costs of fleets and their action numbers (N, n), shape (N,)."""
        alone = fleets.copy()
        s, own = self._uav.space.split(fleets), self._uav.space.split(alone)
        own.g[:] = 0
        goals = np.arange(self.mission.k)
        committed = s.c[..., None] == goals + 1
        r = self._flags(s)
        g, reached, covered = s.g[:, 0], r.max(axis=1), (r * committed).max(axis=1)
        shared = self._shared[goals, g, reached] - self._savings[goals, g, covered]
        uavs = self._uav.costs(_rows(alone), actions.ravel()).reshape(actions.shape)
        return np.asarray(shared.sum(axis=1) + uavs.sum(axis=1))

    def step(self, fleets: IntArray, actions: IntArray, rng: np.random.Generator) -> IntArray:
        """Draw the next states, shape (N, n, 2k+5).

        Raises
        ------
        ValueError
            If an action is not allowed.
        """
        states, chosen = _rows(fleets), actions.ravel()
        self._uav.check(states, chosen)
        drawn, completed = self._uav.act(states, chosen, rng)
        after, by_fleet = drawn.reshape(fleets.shape), completed.reshape(*actions.shape, -1)
        g = self._uav.space.split(after).g
        g[:] = self._uav.priorities(g[:, 0], by_fleet.max(axis=1), rng)[:, None]
        return after


def _rows(fleets: IntArray) -> IntArray:
    """The UAVs one by one, shape (N n, 2k+5)."""
    return fleets.reshape(-1, fleets.shape[2])


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
    simulator, pursued = FleetSimulator(planner.mission), None
    states = np.asarray(fleets, np.int64)
    total, weight = np.zeros(len(states)), 1.0
    for _ in range(epochs):
        plan = planner.plan(states, pursued, assignment)
        pursued = plan.pursued
        total += weight * simulator.costs(states, plan.actions)
        states = simulator.step(states, plan.actions, rng)
        weight *= planner.mission.discount
    return total
