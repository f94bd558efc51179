"""Cells, areas, waypoints and ranges of a mission as shapes in metres, to be drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp import Grid, Mission
from uav_mission_manager.mdp.areas import Polygon
from uav_mission_manager.mdp.range_model import flight_range

Point = tuple[float, float]
"""East and north [m] from the centre of cell 0."""

RING_CHARGES = (1.0, 0.75, 0.5, 0.25)
"""Charges of which the reach is drawn: a choice."""


RING_POINTS = 180
"""Corners by which an ellipse is drawn: no eye sees them."""


@dataclass(frozen=True)
class Reach:
    """Where a goal may lie to be in range at base.

    Attributes
    ----------
    charge : float
        State of charge, 0 to 1.
    distance : float
        Range [m]: from base there and on to the service cell.
    ring : tuple of (float, float)
        East and north [m] of the ellipse around it, from its northern side on; closed.
    """

    charge: float
    distance: float
    ring: tuple[Point, ...]


@dataclass(frozen=True)
class AreaShape:
    """A fence, or an area not to fly over.

    Attributes
    ----------
    field : str
        Where it stands in the mission file.
    name : str
        Its own; a fence is called so.
    stay_inside : bool
        Whether it is the fence.
    ring : tuple of (float, float)
        East and north [m] of its corners, counter-clockwise, closed.
    """

    field: str
    name: str
    stay_inside: bool
    ring: tuple[Point, ...]


def area_shapes(mission: Mission) -> list[AreaShape]:
    """Return the areas not to fly over, and the fence."""
    areas = mission.areas
    found = [
        AreaShape(f'areas.no_fly.{number}', area.name, False, _ring(mission, area.polygon))
        for number, area in enumerate(areas.no_fly)
    ]
    if areas.fence is not None:
        found.append(AreaShape('areas.fence', 'fence', True, _ring(mission, areas.fence)))
    return found


def _ring(mission: Mission, polygon: Polygon) -> tuple[Point, ...]:
    assert mission.grid.origin is not None
    ring = [mission.grid.origin.to_local(*corner) for corner in polygon]
    doubled = sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(ring, [*ring[1:], ring[0]]))
    return (*ring, ring[0]) if doubled > 0 else (ring[0], *reversed(ring))


def rounds(mission: Mission) -> dict[int, tuple[Point, ...]]:
    """Return the waypoints [m] of the goals that have some, by the goals' indices."""
    origin = mission.grid.origin
    return {
        number: tuple(origin.to_local(point.latitude, point.longitude) for point in task.points)
        for number, goal in enumerate(mission.goals)
        if origin is not None and isinstance(task := goal.task, Waypoints)
    }


def corners(grid: Grid, first: int, last: int) -> tuple[Point, ...]:
    """Corners of the rectangle from one cell to another one below it and to the right.

    They go counter-clockwise; the first one is repeated at the end.
    """
    (top, left), (bottom, right) = divmod(first, grid.cols), divmod(last, grid.cols)
    lower_left = grid.at(left - 0.5, bottom + 0.5)
    lower_right = grid.at(right + 0.5, bottom + 0.5)
    upper_right, upper_left = grid.at(right + 0.5, top - 0.5), grid.at(left - 0.5, top - 0.5)
    return lower_left, lower_right, upper_right, upper_left, lower_left


def inner_lines(grid: Grid) -> list[tuple[Point, Point]]:
    """Return the lines between columns and between rows, by their ends."""
    right, bottom = grid.cols - 0.5, grid.rows - 0.5
    columns = [(grid.at(x + 0.5, -0.5), grid.at(x + 0.5, bottom)) for x in range(grid.cols - 1)]
    rows = [(grid.at(-0.5, y + 0.5), grid.at(right, y + 0.5)) for y in range(grid.rows - 1)]
    return columns + rows


def outline(grid: Grid) -> tuple[Point, ...]:
    """Corners of the whole grid, see `corners`."""
    return corners(grid, 0, grid.q - 1)


def onsets(mission: Mission) -> dict[int, float]:
    """Cells with a chance of threats of their own, that differs from the ordinary one."""
    return {cell: p for cell, p in mission.threat.zones if p != mission.threat.onset}


def reaches(mission: Mission) -> list[Reach]:
    """Return the reach of each of `RING_CHARGES` that has any."""
    grid, energy = mission.grid, mission.energy
    if energy is None:
        return []
    base, service = grid.position(grid.base), grid.position(grid.service)
    ranges = {charge: flight_range(energy, charge) for charge in RING_CHARGES}
    return [
        Reach(charge, distance, ellipse(base, service, distance))
        for charge, distance in ranges.items()
        if distance > math.dist(base, service)
    ]


def ellipse(focus: Point, other: Point, distance: float) -> tuple[Point, ...]:
    """All points whose distances [m] to two points sum to this one, see `RING_POINTS`; closed."""
    east, north = (other[0] - focus[0]) / 2, (other[1] - focus[1]) / 2
    middle, apart = (focus[0] + east, focus[1] + north), math.hypot(east, north)
    turn = math.atan2(north, east)
    along, across = distance / 2, math.sqrt((distance / 2) ** 2 - apart**2)
    found = []
    for step in range(RING_POINTS + 1):
        angle = math.pi / 2 - turn + 2 * math.pi * step / RING_POINTS
        x, y = along * math.cos(angle), across * math.sin(angle)
        found.append(
            (
                middle[0] + x * math.cos(turn) - y * math.sin(turn),
                middle[1] + x * math.sin(turn) + y * math.cos(turn),
            )
        )
    return tuple(found)
