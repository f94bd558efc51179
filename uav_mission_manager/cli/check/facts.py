"""What follows from a mission before it is solved: ways, ranges, the length of an epoch."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_mission_manager.cli.tasks import in_words, task_seconds
from uav_mission_manager.mdp import Grid, Mission
from uav_mission_manager.mdp.dynamics import completion_probabilities
from uav_mission_manager.mdp.epoch import SECONDS_PER_MINUTE
from uav_mission_manager.mdp.range_model import flight_range, required_ranges
from uav_mission_manager.solver.evaluation.forecast import epoch_length


@dataclass(frozen=True)
class GoalFacts:
    """A goal on the ground.

    Attributes
    ----------
    name : str
    cell : int
    from_base, to_service : float
        Ways [m] from base to it, and from it to the service cell.
    needed : float
        Range that it takes [m]: both.
    charge : float or None
        Charge, 0 to 1, that has this range; above 1 none has; None where no energy is given.
    eta, delta : float
        Cost an epoch and unit of priority, in range and not committed to, and out of range.
    task : str
        What is done there, '' for a stay.
    task_seconds : float or None
        How long that takes about [s]; None where nothing says it.
    done_seconds : float or None
        How long it takes by the model [s], in the mean with all in order, inf for never; None
        where the length of an epoch is unknown.
    """

    name: str
    cell: int
    from_base: float
    to_service: float
    needed: float
    charge: float | None
    eta: float
    delta: float
    task: str
    task_seconds: float | None
    done_seconds: float | None


def epoch_seconds(mission: Mission) -> float | None:
    """Length of an epoch [s], None where no speed is given."""
    return None if mission.energy is None else epoch_length(mission)


def full_range(mission: Mission) -> float | None:
    """Range on a full battery [m], None where no energy is given."""
    return None if mission.energy is None else flight_range(mission.energy, 1.0)


def grid_text(grid: Grid) -> str:
    """Return the size of a grid, and how it is turned, for people."""
    text = f'{grid.rows} x {grid.cols} cells of {grid.cell_size:g} m'
    return f'{text}, their columns leading to {grid.bearing:g} deg' if grid.bearing else text


def done_text(goal: GoalFacts) -> str:
    """Return the mean time at a goal until it is done, for people."""
    if goal.done_seconds is None:
        return '?'
    return duration_text(goal.done_seconds) if math.isfinite(goal.done_seconds) else 'never'


def worth_a_minute(goal: GoalFacts, seconds: float | None) -> tuple[float, float] | None:
    """Return eta and delta by the minute, None where the length of an epoch is unknown."""
    if seconds is None:
        return None
    scale = SECONDS_PER_MINUTE / seconds
    return goal.eta * scale, goal.delta * scale


def task_text(goal: GoalFacts) -> str:
    """Return what is done at a goal, and how long it takes, for people; '' for a stay."""
    known = goal.task and goal.task_seconds is not None
    return f'{goal.task}, about {goal.task_seconds:.0f} s' if known else goal.task


def goal_facts(mission: Mission) -> tuple[GoalFacts, ...]:
    """Facts of all goals, in the order of the mission."""
    grid = mission.grid
    base, service = grid.position(grid.base), grid.position(grid.service)
    ranges = required_ranges(mission, base)
    times = zip(goal_times(mission), done_times(mission))
    found = []
    for goal, needed, (taken, done) in zip(mission.goals, ranges, times):
        place = grid.position(goal.cell)
        ways = math.dist(base, place), math.dist(place, service)
        charge = _charge(mission, needed)
        costs = goal.eta, goal.delta
        task, lasts = in_words(goal.task), (taken, done)
        found.append(GoalFacts(goal.name, goal.cell, *ways, needed, charge, *costs, task, *lasts))
    return tuple(found)


def goal_times(mission: Mission) -> list[float | None]:
    """Return how long each goal takes about [s], None where nothing says it."""
    if mission.energy is None:
        return [None] * mission.k
    grid, speed = mission.grid, mission.energy.speed
    return [task_seconds(goal.task, grid, goal.cell, speed) for goal in mission.goals]


def done_times(mission: Mission) -> list[float | None]:
    """Return the mean time [s] of each goal in the model, see `GoalFacts.done_seconds`."""
    epoch = epoch_seconds(mission)
    if epoch is None:
        return [None] * mission.k
    nominal = completion_probabilities(mission)[:, 0].tolist()
    return [epoch / chance if chance else math.inf for chance in nominal]


def _charge(mission: Mission, needed: float) -> float | None:
    """Charge that has a range: the range grows with it in a straight line."""
    if mission.energy is None:
        return None
    empty, full = (flight_range(mission.energy, charge) for charge in (0.0, 1.0))
    return (needed - empty) / (full - empty) if full > empty else math.inf


def marks(mission: Mission) -> dict[int, str]:
    """Base, service and goals by their cell: B, S, and goals numbered from 1, as in `BS1,2`."""
    found: dict[int, str] = {}
    places = [(mission.grid.base, 'B'), (mission.grid.service, 'S')]
    places += [(goal.cell, str(number)) for number, goal in enumerate(mission.goals, 1)]
    for cell, mark in places:
        before = found.get(cell, '')
        found[cell] = f'{before},{mark}' if before[-1:].isdigit() else before + mark
    return found


def duration_text(seconds: float) -> str:
    """Return a duration for people."""
    for unit, length in (('years', 365.25 * 86_400), ('days', 86_400), ('h', 3600), ('min', 60)):
        if seconds >= 2 * length:
            count = seconds / length
            return f'{count:,.0f} {unit}' if count < 1e6 else f'{count:.0e} {unit}'
    return f'{seconds:.2g} s' if seconds < 10 else f'{seconds:.0f} s'
