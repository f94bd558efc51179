"""Tasks at goals in words, and how long they take, as `docs/mission_file.md` says it."""

from __future__ import annotations

import math

from uav_mission_manager.autopilot.task import Settings
from uav_mission_manager.goal_task import Dwell, External, GoalTask, Photo
from uav_mission_manager.mdp import Grid

AT_WAYPOINT = 2.0
"""Time [s] by which a waypoint is slower than flying past it: a choice, to brake and to start."""

CLIMB_SPEED, DESCENT_SPEED = 2.5, 1.5
"""Speeds [m/s] of ArduCopter by default."""


def in_words(task: GoalTask | None) -> str:
    """Return what a task is, '' for none."""
    if task is None:
        return ''
    if isinstance(task, Dwell):
        return f'stay of {task.seconds:g} s'
    if isinstance(task, External):
        return 'work of another program'
    count, what = (
        (task.count, 'picture') if isinstance(task, Photo) else (len(task.points), 'waypoint')
    )
    return f'{count} {what}{"" if count == 1 else "s"}'


def task_seconds(
    task: GoalTask | None,
    grid: Grid,
    cell: int,
    speed: float,
    flight_altitude: float = Settings.flight_altitude,
) -> float | None:
    """Return the time [s] from the arrival at a goal until its task is done.

    Parameters
    ----------
    task : GoalTask or None
        None is the stay that the bridge makes by default.
    grid : Grid
        With an origin, where the task has waypoints.
    cell : int
        That of the goal.
    speed, flight_altitude : float
        Of the bridge [m/s], [m].

    Returns
    -------
    float or None
        None where only another program knows.
    """
    if task is None:
        return Settings.goal_dwell
    if isinstance(task, Dwell):
        return task.seconds
    if isinstance(task, Photo):
        return (task.count - 1) * task.interval
    if isinstance(task, External):
        return None
    assert grid.origin is not None
    here, altitude = grid.position(cell), grid.ground(cell) + flight_altitude
    seconds = 0.0
    for point in task.points:
        there = grid.origin.to_local(point.latitude, point.longitude)
        height = flight_altitude if point.height is None else point.height
        up = grid.ground(grid.cell_at(*there)) + height - altitude
        seconds += math.dist(here, there) / speed + AT_WAYPOINT
        seconds += up / CLIMB_SPEED if up > 0.0 else -up / DESCENT_SPEED
        here, altitude = there, altitude + up
    return seconds
