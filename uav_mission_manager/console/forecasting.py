"""The forecast from here: simulated flights from the present state, in an unhurried thread."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver.evaluation.flights import FlightLog
from uav_mission_manager.solver.evaluation.forecast import epochs_within
from uav_mission_manager.solver.evaluation.simulation import simulate

FORECAST_LIMITS = (1, 2, 5, 10)
"""Times by which goals may be done [min]: a choice."""

FORECAST_FLIGHTS = 400
"""Simulated flights: a choice; the error of a probability is 2.5 points at most, one in three."""

FORECAST_PERIOD = 3.0
"""Time [s] between two forecasts, at least: a choice, a few hundredths of one processor."""

LOWEST_PRIORITY = 19
"""Niceness of the thread."""


@dataclass(frozen=True)
class GoalChances:
    """Chances of the goals that are wanted in a state, or why there are none.

    Attributes
    ----------
    digest : str
        Of the policy set.
    state : tuple of int
        Where the flights began.
    chances : mapping
        Probability that each goal, by name, is done within so many minutes.
    trouble : str
    """

    digest: str
    state: tuple[int, ...]
    chances: Mapping[str, Mapping[int, float]]
    trouble: str = ''


def goal_chances(policy: Policy, state: tuple[int, ...], seed: int = 0) -> GoalChances:
    """Simulate flights from a state and count when the goals are done that are wanted in it."""
    mission = policy.mission
    try:
        start = policy.space.check(np.repeat([state], FORECAST_FLIGHTS, axis=0))
        epochs = {limit: epochs_within(mission, limit) for limit in FORECAST_LIMITS}
    except (Bad, ValueError) as error:
        return GoalChances(policy.digest, state, {}, str(error))
    log = FlightLog(mission, start, max(epochs.values()))
    rng = np.random.default_rng(seed)
    simulate(mission, policy.act, start, max(epochs.values()), rng, watch=log)
    wanted = policy.space.split(start).g[0] > 0
    chances = {
        goal.name: {
            limit: float(((log.done[:, j] > 0) & (log.done[:, j] <= last)).mean())
            for limit, last in epochs.items()
        }
        for j, goal in enumerate(mission.goals)
        if wanted[j]
    }
    return GoalChances(policy.digest, state, chances)


class Forecaster:
    """Forecasts for the vehicles that somebody looks at, one at a time, the longest waiting first.

    Attributes
    ----------
    found : dict of str to GoalChances
        The last forecast of each vehicle.
    """

    def __init__(self) -> None:
        self.found: dict[str, GoalChances] = {}
        self._wanted: dict[str, tuple[Policy, tuple[int, ...]]] = {}
        self._changed = threading.Condition()
        threading.Thread(target=self._run, daemon=True).start()

    def want(self, vehicle: str, policy: Policy, state: tuple[int, ...]) -> None:
        """Ask for a forecast, unless it is there already."""
        found = self.found.get(vehicle)
        if found and (found.digest, found.state) == (policy.digest, state):
            return
        with self._changed:
            self._wanted[vehicle] = policy, state
            self._changed.notify()

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOWEST_PRIORITY)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted)
                vehicle = next(iter(self._wanted))
                policy, state = self._wanted.pop(vehicle)
            self.found[vehicle] = goal_chances(policy, state)
            time.sleep(FORECAST_PERIOD)
