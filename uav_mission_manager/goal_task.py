"""What is to be done at a goal, as the mission file says it (`goals[].task`).

It matters to the flight alone. The model knows of it only how long it takes: `goals[].done_in`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Dwell:
    """Stay over the goal for some time [s]."""

    seconds: float


@dataclass(frozen=True)
class Photo:
    """Take so many pictures over the goal, at least `interval` [s] apart."""

    count: int
    interval: float


@dataclass(frozen=True)
class Waypoint:
    """A place [deg] and its height above the ground there [m], the flight height if None."""

    latitude: float
    longitude: float
    height: float | None = None


@dataclass(frozen=True)
class Waypoints:
    """Fly from the goal to some places near it, in order."""

    points: tuple[Waypoint, ...]


@dataclass(frozen=True)
class External:
    """Wait over the goal for another program to do what is to be done, for `timeout` [s]."""

    timeout: float


GoalTask = Dwell | Photo | Waypoints | External
"""What may be done at a goal."""


def task_to_dict(task: GoalTask) -> dict[str, Any]:
    """Return a task in the mission file's schema."""
    if isinstance(task, Dwell):
        return {'dwell': task.seconds}
    if isinstance(task, Waypoints):
        places = ((place.latitude, place.longitude, place.height) for place in task.points)
        return {'waypoints': [[value for value in place if value is not None] for place in places]}
    return {type(task).__name__.lower(): asdict(task)}
