"""Grids on which the waypoints of tasks are near the centres of their goals' cells."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from shapely import MultiPoint, minimum_bounding_radius

from uav_mission_manager.cli.mission_new.found import Place
from uav_mission_manager.cli.mission_new.layout import CLEARLY, LARGEST, cell_of, laid_out
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import Grid
from uav_mission_manager.mdp.goal_tasks import WAYPOINT_REACH

MOST_CENTRED = 3
"""Goals on whose waypoints a grid is centred by way of trial: a choice, the widest ones."""


def with_waypoints(places: Sequence[Place]) -> list[Place]:
    """Return places, and those of the waypoints of their tasks."""
    points = (point for place in places for point in place.waypoints)
    return [*places, *(Place('', point.latitude, point.longitude, '') for point in points)]


def fitting(
    home: Place,
    service: Place,
    goals: Sequence[Place],
    size: float,
    bearing: float,
    *,
    larger: bool,
) -> Grid | None:
    """Return a grid of cells of a size [m], or of the least larger one, that fits all tasks.

    On it each goal has a cell of its own, if it can be another one than those of home and service,
    and no waypoint is too far from the centre of its goal's cell. To that end the cell of a goal
    with waypoints may be centred on them.

    Returns
    -------
    Grid or None
        None where there is none.
    """
    rounds = [goal for goal in goals if goal.waypoints]
    sizes = [*_sizes(size, max(map(reach, rounds), default=0.0))] if larger else [size]
    places = with_waypoints([home, service, *goals])
    widest = sorted(rounds, key=reach, reverse=True)[:MOST_CENTRED]
    for kept_free in ((home, service), ()):
        for width in sizes:
            for centred in (None, *widest):
                grid = laid_out(home, places, service, width, bearing, centred)
                if not any(misfit(grid, goal) for goal in rounds) and _apart(
                    grid, goals, kept_free
                ):
                    return grid
    return None


def misfit(grid: Grid, goal: Place) -> str:
    """Say which waypoint is too far from the centre of its goal's cell, '' if none is."""
    assert grid.origin is not None
    centre, limit = grid.position(cell_of(grid, goal)), WAYPOINT_REACH * grid.cell_size
    for number, point in enumerate(goal.waypoints, 1):
        away = math.dist(centre, grid.origin.to_local(point.latitude, point.longitude))
        if away > CLEARLY * limit:
            return f'waypoint {number} is {away:.0f} m from the centre of its cell, over {limit:g}'
    return ''


def advice(home: Place, service: Place, goals: Sequence[Place], grid: Grid) -> str:
    """Say which cells are large enough for the tasks of all goals."""
    larger = fitting(home, service, goals, grid.cell_size, grid.bearing, larger=True)
    if larger is not None:
        return f'--cell {larger.cell_size:g} is large enough'
    return 'cells that are large enough do not give every goal one of its own: --skip one'


def reach(goal: Place) -> float:
    """Return how far [m] the waypoints of a goal's task reach from the middle of them."""
    plane = Origin(goal.latitude, goal.longitude, 0.0)
    points = [plane.to_local(point.latitude, point.longitude) for point in goal.waypoints]
    return float(minimum_bounding_radius(MultiPoint(points))) if points else 0.0


def _apart(grid: Grid, goals: Sequence[Place], kept_free: Sequence[Place]) -> bool:
    """Whether each goal has a cell of its own, in which no place to be kept free lies either."""
    cells = {cell_of(grid, goal) for goal in goals}
    return len(cells) == len(goals) and cells.isdisjoint(cell_of(grid, it) for it in kept_free)


def _sizes(least: float, radius: float) -> Iterator[float]:
    """Yield widths of cells, from a least one to one that surely fits tasks of a radius [m].

    It does so wherever in its cell, at most half a diagonal from the centre, a task has its
    middle.
    """
    needed = radius / WAYPOINT_REACH / CLEARLY
    size, enough = least, needed / (1.0 - math.sqrt(0.5) / WAYPOINT_REACH) / CLEARLY
    if size < needed:
        size = _next_size(needed)
    while True:
        yield size
        if size >= min(enough, LARGEST):
            return
        size = _next_size(size * (1.0 + 1e-9))


def _next_size(size: float) -> float:
    """Return the least width of two digits that is not smaller."""
    step = 10.0 ** (math.floor(math.log10(size)) - 1)
    return round(math.ceil(size / step) * step, 6)
