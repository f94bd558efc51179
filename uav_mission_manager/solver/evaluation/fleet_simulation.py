"""Simulation of fleets that share a mission's goals.

Each UAV lives through the mission's epoch alone but for the priorities: a goal is achieved by
whichever UAV completes it, and changes for all alike. An epoch of n UAVs costs

    sum_j eta_j g_j R_j (1 - C_j) + sum_j delta_j g_j (1 - R_j)
        + sum over UAVs of h + phi + p + (beta/k) sum_j (1 - r_j),

with R_j = max r_j over the UAVs (one can reach the goal) and C_j = max r_j [c = j] (one that can
is committed to it). For one UAV that is the stage cost J(s, a).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.mdp.cost import commitment_savings, goal_costs
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.evaluation.simulation import Simulator
from uav_mission_manager.solver.recombination import FleetPlan, FleetPlanner

STANDS = 1
"""Number of the action of a UAV that is lost: no commitment, at the base."""


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

    def strand(self, fleets: IntArray, lost: BoolArray) -> None:
        """Put UAVs (N, n) where they do and cost nothing, but for the lost range."""
        s = self._uav.space.split(fleets)
        for values, value in (
            (s.f, 1),
            (s.l, self.mission.grid.base),
            (s.c, 0),
            (s.t, 0),
            (s.m, 0),
        ):
            values[lost] = value
        s.r[lost], s.b[lost] = 0, 0

    def still_wanted(self, fleets: IntArray, goals: IntArray) -> IntArray:
        """Return the goals (N, n) of UAVs, -1 where there is none or it is not wanted now."""
        g = self._uav.space.split(fleets).g
        wanted = np.take_along_axis(g, np.maximum(goals, 0)[..., None], axis=2)[..., 0] > 0
        return np.where((goals >= 0) & wanted, goals, -1)

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


@dataclass(frozen=True)
class Losses:
    """UAVs that are lost for good.

    Attributes
    ----------
    at : int array (N, n)
        Epoch in which each is lost, counted from 0; one that never comes for the rest.
    noticed_after : int
        Epochs for which one that is lost still counts as acting for its goal.
    """

    at: IntArray
    noticed_after: int


Decide = Callable[[IntArray, IntArray, IntArray, BoolArray], FleetPlan]
"""Returns a decision for states (N, n, 2k+5), goals pursued before and goals kept (N, n), -1 for
none, and barred goals (N, n, k)."""


def simulate_fleets(
    planner: FleetPlanner,
    fleets: ArrayLike,
    epochs: int,
    rng: np.random.Generator,
    assignment: str = 'queue',
    *,
    losses: Losses | None = None,
    decide: Decide | None = None,
    watch: Callable[[IntArray], None] | None = None,
) -> FloatArray:
    """Discounted costs of some epochs of fleets from states (N, n, 2k+5), shape (N,).

    Of generators in the same state, fleets that differ only in how they decide meet with the
    same luck. A UAV that is lost stands at the base from then on, out of range of all goals, and
    completes nothing.

    Parameters
    ----------
    planner : FleetPlanner
    fleets : int array
    epochs : int
    rng : numpy.random.Generator
    assignment : {'queue', 'optimal'}
    losses : Losses, optional
    decide : callable, optional
        In place of the planner with that assignment.
    watch : callable, optional
        Is shown the states of every epoch, and those after the last.
    """
    simulator, k = FleetSimulator(planner.mission), planner.mission.k
    states = np.array(fleets, np.int64)
    shape = states.shape[:2]
    losses = losses or Losses(np.full(shape, epochs), 0)
    pursued, total, weight = np.full(shape, -1), np.zeros(len(states)), 1.0

    def by_planner(*case: Any) -> FleetPlan:
        now, before, kept, barred = case
        return planner.plan(now, before, assignment, kept=kept, barred=barred)

    for epoch in range(epochs):
        lost = losses.at <= epoch
        simulator.strand(states, losses.at == epoch)
        noticed = losses.at + losses.noticed_after <= epoch
        kept = np.where(lost & ~noticed, simulator.still_wanted(states, pursued), -1)
        barred = np.repeat(lost[..., None], k, axis=2)
        plan = (decide or by_planner)(states, pursued, kept, barred)
        if watch is not None:
            watch(states)
        pursued, actions = plan.pursued, np.where(lost, STANDS, plan.actions)
        total += weight * simulator.costs(states, actions)
        states = simulator.step(states, actions, rng)
        weight *= planner.mission.discount
    if watch is not None:
        watch(states)
    return total
