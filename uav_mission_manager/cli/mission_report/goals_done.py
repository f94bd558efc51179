"""When each goal was asked for and done, beside what simulated flights say of it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from uav_mission_manager.cli.mission_report.flight_record import FlightRecord
from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.epoch import SECONDS_PER_MINUTE
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.policy import ExpansionPolicy, Policy
from uav_mission_manager.solver.evaluation.flights import fly
from uav_mission_manager.solver.evaluation.forecast import forecast_epochs, minutes_until_done

SIMULATED, EXPANSION_SIMULATED = 1000, 100
"""Flights that an expectation is made of: choices, of shares to three hundredths, and to a
tenth where an expansion decides, which takes long."""

MOST_SIMULATED = 12
"""Requests for which flights are simulated: a choice, of some seconds."""

SIMULATION_SECONDS = 10.0
"""Time [s] after which no more of them are begun: a choice."""


@dataclass(frozen=True)
class WantedGoal:
    """A goal that was asked for.

    Attributes
    ----------
    goal : int
        From 0.
    priority : int
        The highest that it had meanwhile.
    counts, over : float
        When the manager first wanted it, and when not any more [s]; infinite if never.
    done : bool
        Whether it was completed then.
    state : tuple of int
        In which the manager decided when it first wanted it.
    asked : float
        When it was asked for [s]; NaN if that was not heard.
    begun : float
        When it was first commanded [s]; infinite if never.
    """

    goal: int
    priority: int
    counts: float
    over: float
    done: bool
    state: tuple[int, ...]
    asked: float = math.nan
    begun: float = math.inf

    def waited(self, slack: float) -> bool:
        """Whether it counted later than it was asked for, by more than times are off [s]."""
        return self.counts - self.asked > slack


@dataclass(frozen=True)
class Expectation:
    """How long a goal takes in flights simulated from the state in which it was asked for.

    Attributes
    ----------
    median : float
        Time [s] within which half of them have it done; infinite if fewer do.
    slower : float or None
        Share of them that take longer than the real flight; None where it was not done there.
    """

    median: float
    slower: float | None


def requests(record: FlightRecord, names: list[str]) -> list[WantedGoal]:
    """Return what was asked for, in order, as the manager took it."""
    found: list[WantedGoal] = []
    wanted: dict[int, WantedGoal] = {}
    for at, decision in record.decided:
        if not decision.state:
            continue
        for j, g in enumerate(decision.named.g.tolist()):
            if g and j not in wanted:
                wanted[j] = WantedGoal(j, g, at, math.inf, False, decision.state)
            elif g:
                wanted[j] = replace(wanted[j], priority=max(wanted[j].priority, g))
            elif j in wanted:
                found.append(_over(wanted.pop(j), at, record, names))
    return [
        _told(request, record, names)
        for request in sorted([*found, *wanted.values()], key=lambda r: (r.counts, r.goal))
    ]


def _told(request: WantedGoal, record: FlightRecord, names: list[str]) -> WantedGoal:
    """Say when it was asked for, and when first commanded."""
    asked, before = math.nan, 0
    for at, priorities in record.asked:
        now = priorities[request.goal] if request.goal < len(priorities) else 0
        if now and not before and at <= request.counts + record.slack:
            asked = at
        before = now
    start = f'commit {names[request.goal]} ' if request.goal < len(names) else '\n'
    begun = [
        at
        for at, decision in record.decided
        if request.counts <= at <= request.over and decision.command.startswith(start)
    ]
    return replace(request, asked=asked, begun=begun[0] if begun else math.inf)


def _over(request: WantedGoal, at: float, record: FlightRecord, names: list[str]) -> WantedGoal:
    name = names[request.goal] if request.goal < len(names) else ''
    latest = at + record.slack
    done = [t for t, n in record.completed if n == name and request.counts <= t <= latest]
    return replace(request, over=done[-1] if done else at, done=bool(done))


def simulated(policy: Policy) -> int:
    """Return of how many flights of a policy an expectation is made."""
    return EXPANSION_SIMULATED if isinstance(policy, ExpansionPolicy) else SIMULATED


def expectations(found: list[WantedGoal], policy: Policy) -> list[Expectation | None]:
    """Simulate flights from where each goal was asked for; None where that is not known."""
    try:
        epochs = forecast_epochs(policy.mission)
    except Bad:
        return [None] * len(found)
    began, minutes = time.perf_counter(), dict[tuple[int, ...], FloatArray]()
    for request in found:
        late = time.perf_counter() - began > SIMULATION_SECONDS
        if request.state not in minutes and len(minutes) < MOST_SIMULATED and not late:
            rows = np.repeat(policy.space.check([request.state]), simulated(policy), axis=0)
            rng = np.random.default_rng(0)
            flights = fly(policy.mission, policy.act, rows, epochs, rng)
            minutes[request.state] = minutes_until_done(flights)
    return [
        _expectation(request, minutes[request.state][:, request.goal])
        if request.state in minutes
        else None
        for request in found
    ]


def _expectation(request: WantedGoal, minutes: FloatArray) -> Expectation:
    seconds = minutes * SECONDS_PER_MINUTE
    taken = request.over - request.counts
    slower = float((seconds > taken).mean()) if request.done else None
    return Expectation(float(np.sort(seconds)[len(seconds) // 2]), slower)
