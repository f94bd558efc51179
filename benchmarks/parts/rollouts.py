"""A meta-policy by rollouts: of a few assignments the one whose joint future costs least."""

from __future__ import annotations

import dataclasses

import numpy as np

from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.evaluation.fleet_simulation import FleetSimulator, simulate_fleets
from uav_mission_manager.solver.recombination import FleetPlan, FleetPlanner

EPOCHS, SAMPLES = 15, 8
"""Length of a rollout, and rollouts of a candidate: choices, what a base station has time for."""


class Rollouts:
    """Decides for fleets as the optimal assignment does, or better by what comes of it.

    Candidates are the optimal assignment, the same with each UAV's goal forbidden to it, and the
    queue. In a rollout each UAV pursues its goal to the end, and then what the queue gives it; at
    its end every goal costs what the sub-MDP of the UAV that suits it best expects. All
    candidates meet with the same luck.
    """

    def __init__(self, planner: FleetPlanner) -> None:
        self.planner, self._space = planner, StateSpace.of(planner.mission)
        self._simulator, self._seed = FleetSimulator(planner.mission), 0

    def __call__(
        self, states: IntArray, pursued: IntArray, kept: IntArray, barred: BoolArray
    ) -> FleetPlan:
        """Decide; see `simulate_fleets`."""
        candidates = self._candidates(states, pursued, kept, barred)
        self._seed += 1
        costs = np.stack([self._expected(states, plan, barred) for plan in candidates])
        chosen = costs.argmin(axis=0)
        rows = np.arange(len(states))
        values = {
            field.name: np.stack([getattr(plan, field.name) for plan in candidates])[chosen, rows]
            for field in dataclasses.fields(FleetPlan)
        }
        return FleetPlan(**values)

    def _candidates(
        self, states: IntArray, pursued: IntArray, kept: IntArray, barred: BoolArray
    ) -> list[FleetPlan]:
        given = {'kept': kept}
        best = self.planner.plan(states, pursued, 'optimal', barred=barred, **given)
        found = [best, self.planner.plan(states, pursued, 'queue', barred=barred, **given)]
        rows = np.arange(len(states))
        for agent in range(states.shape[1]):
            without, goals = barred.copy(), best.pursued[:, agent]
            without[rows[goals >= 0], agent, goals[goals >= 0]] = True
            found.append(self.planner.plan(states, pursued, 'optimal', barred=without, **given))
        return found

    def _expected(self, states: IntArray, plan: FleetPlan, barred: BoolArray) -> FloatArray:
        """Mean cost of the rollouts that begin with a decision, and of what is left then."""
        fleets, agents, _ = states.shape
        start, goals, forbidden = (
            np.repeat(each, SAMPLES, axis=0) for each in (states, plan.pursued, barred)
        )

        def to_the_end(now: IntArray, before: IntArray, kept: IntArray, _: BoolArray) -> FleetPlan:
            kept = self._simulator.still_wanted(now, goals)
            return self.planner.plan(now, before, 'queue', kept=kept, barred=forbidden)

        rng = np.random.default_rng(self._seed)
        seen: list[IntArray] = []
        costs = simulate_fleets(
            self.planner, start, EPOCHS, rng, decide=to_the_end, watch=seen.append
        )
        rest = self.planner.mission.discount**EPOCHS * self._left(seen[-1], agents)
        return np.asarray((costs + rest).reshape(fleets, SAMPLES).mean(axis=1))

    def _left(self, states: IntArray, agents: int) -> FloatArray:
        """What all goals cost from here on, each by the UAV that suits it best."""
        rows = states.reshape(-1, states.shape[2])
        values = [p.look_ahead.q_values(rows).min(axis=1) for p in self.planner.policies]
        return np.stack(values, axis=1).reshape(-1, agents, len(values)).min(axis=1).sum(axis=1)
