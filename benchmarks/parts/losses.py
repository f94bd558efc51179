"""Fleets that lose UAVs on the way: cost, and when the goals are done, by how they decide."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.mdp import Mission, StateSpace
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.solver.evaluation.fleet_simulation import (
    Decide,
    Losses,
    simulate_fleets,
)
from uav_mission_manager.solver.recombination import FleetPlanner

SEEDS, EPOCHS = 50, 60
FIRST_LOSS, LAST_LOSS, NOTICED_AFTER = 3, 15, 1
"""Epochs in which a UAV may be lost, and for which nobody knows."""


@dataclass(frozen=True)
class Outcome:
    """Discounted costs, and epochs until no goal is open that was asked for, each (SEEDS,)."""

    costs: FloatArray
    ends: FloatArray

    def words(self, decimals: int = 1) -> tuple[str, str]:
        """Mean of both, with 95 % intervals."""
        return tuple(
            f'{values.mean():.{decimals}f} ± {interval(values):.{decimals}f}'
            for values in (self.costs, self.ends)
        )


def interval(values: FloatArray) -> float:
    """Half of the 95 % confidence interval of a mean."""
    return float(1.96 * values.std(ddof=1) / math.sqrt(len(values)))


def all_wanted(mission: Mission, uavs: int) -> IntArray:
    """Fleets at the base, nominal and charged, every goal of high priority."""
    space = StateSpace.of(mission)
    start = (1, *space.charged, *(2,) * mission.k, mission.grid.base, 0, 0, 0)
    return np.array([[start] * uavs] * SEEDS)


def one_lost(uavs: int) -> Losses:
    """In each fleet one UAV is lost, drawn evenly, in an epoch drawn evenly."""
    rng, at = np.random.default_rng(2), np.full((SEEDS, uavs), EPOCHS)
    epochs = rng.integers(FIRST_LOSS, LAST_LOSS, SEEDS)
    at[np.arange(SEEDS), rng.integers(0, uavs, SEEDS)] = epochs
    return Losses(at, NOTICED_AFTER)


def fly(
    planner: FleetPlanner,
    uavs: int,
    assignment: str = 'queue',
    losses: Losses | None = None,
    decide: Decide | None = None,
) -> Outcome:
    """Fly all goals once, with the same luck for whoever decides."""
    mission = planner.mission
    space, ends, epoch = StateSpace.of(mission), np.full((SEEDS, mission.k), EPOCHS), 0

    def watch(states: IntArray) -> None:
        nonlocal epoch
        g = space.split(states).g[:, 0]
        ends[(g == 0) & (ends == EPOCHS)] = epoch
        epoch += 1

    costs = simulate_fleets(
        planner,
        all_wanted(mission, uavs),
        EPOCHS,
        np.random.default_rng(1),
        assignment,
        losses=losses,
        decide=decide,
        watch=watch,
    )
    return Outcome(costs, ends.max(axis=1).astype(float))
