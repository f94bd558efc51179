"""Cells, areas and goals as GeoJSON (RFC 7946): longitude, latitude; rings counter-clockwise."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from uav_mission_manager.cli.check.facts import goal_facts, marks
from uav_mission_manager.drawing.places import (
    Point,
    area_shapes,
    corners,
    onsets,
    outline,
    rounds,
)
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp import Mission

MOST_CELLS = 10_000
"""Cells of a grid that are all written, a choice: 4 MB; of a larger one those that differ."""


def geojson(mission: Mission) -> dict[str, Any]:
    """Return the mission as a feature collection. Raises `ValueError` without a `grid.origin`."""
    if mission.grid.origin is None:
        raise ValueError(
            'grid.origin: is missing: without it cells have no longitude and latitude'
        )
    features = [_grid(mission, mission.grid.origin)]
    features += _cells(mission, mission.grid.origin)
    features += _areas(mission, mission.grid.origin)
    features += _goals(mission, mission.grid.origin)
    features += _rounds(mission, mission.grid.origin)
    return {'type': 'FeatureCollection', 'features': features}


def _grid(mission: Mission, origin: Origin) -> dict[str, Any]:
    grid = mission.grid
    properties = {'kind': 'grid', 'name': mission.name, 'rows': grid.rows, 'cols': grid.cols}
    return _feature(_area(origin, outline(grid)), properties)


def _cells(mission: Mission, origin: Origin) -> list[dict[str, Any]]:
    grid, special, zones = mission.grid, marks(mission), onsets(mission)
    cells = range(grid.q) if grid.q <= MOST_CELLS else sorted({*special, *zones})
    return [
        _feature(
            _area(origin, corners(grid, cell, cell)),
            {
                'kind': 'cell',
                'cell': cell,
                'row': cell // grid.cols,
                'col': cell % grid.cols,
                'base': cell == grid.base,
                'service': cell == grid.service,
                'goals': [goal.name for goal in mission.goals if goal.cell == cell],
                'threat_onset': zones.get(cell, mission.threat.onset),
            },
        )
        for cell in cells
    ]


def _areas(mission: Mission, origin: Origin) -> list[dict[str, Any]]:
    return [
        _feature(
            _area(origin, area.ring),
            {'kind': 'fence' if area.stay_inside else 'no_fly', 'name': area.name},
        )
        for area in area_shapes(mission)
    ]


def _rounds(mission: Mission, origin: Origin) -> list[dict[str, Any]]:
    """Waypoints in order: a line, or points alone where it would cross the 180th meridian."""
    found = []
    for number, points in rounds(mission).items():
        places = [_degrees(origin, point) for point in points]
        longitudes = [longitude for longitude, _ in places]
        line = len(places) > 1 and max(longitudes) - min(longitudes) <= 180
        geometry = {'type': 'LineString' if line else 'MultiPoint', 'coordinates': places}
        goal = mission.goals[number]
        assert isinstance(goal.task, Waypoints)
        heights = [point.height for point in goal.task.points]
        properties = {'kind': 'waypoints', 'goal': goal.name, 'heights_m': heights}
        found.append(_feature(geometry, properties))
    return found


def _goals(mission: Mission, origin: Origin) -> list[dict[str, Any]]:
    found = []
    for number, goal in enumerate(goal_facts(mission), 1):
        place = _degrees(origin, mission.grid.position(goal.cell))
        properties = {'kind': 'goal', 'number': number, 'name': goal.name, 'cell': goal.cell}
        properties |= {'eta': goal.eta, 'delta': goal.delta, 'range_needed_m': goal.needed}
        found.append(_feature({'type': 'Point', 'coordinates': place}, properties))
    return found


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {'type': 'Feature', 'geometry': geometry, 'properties': properties}


def _degrees(origin: Origin, point: Point) -> Point:
    latitude, longitude = origin.to_geodetic(*point)
    return longitude, latitude


def _area(origin: Origin, ring: Sequence[Point]) -> dict[str, Any]:
    """A polygon; one across the 180th meridian is cut in two there (RFC 7946, 3.1.9)."""
    places = [_degrees(origin, point) for point in ring]
    longitudes = [longitude for longitude, _ in places]
    if max(longitudes) - min(longitudes) <= 180:
        return {'type': 'Polygon', 'coordinates': [places]}
    around = [(longitude % 360, latitude) for longitude, latitude in places]
    west, east = _west_of_180(around, 1), _west_of_180(around, -1)
    parts = [west, [(longitude - 360, latitude) for longitude, latitude in east]]
    return {'type': 'MultiPolygon', 'coordinates': [[part] for part in parts]}


def _west_of_180(ring: Sequence[Point], side: int) -> list[Point]:
    """What of a closed convex ring is west (side 1) or east (-1) of longitude 180."""
    kept: list[Point] = []
    for (x, y), (next_x, next_y) in pairwise(ring):
        inside, goes_inside = side * (180 - x) > 0, side * (180 - next_x) > 0
        if inside:
            kept.append((x, y))
        if inside != goes_inside:
            kept.append((180.0, y + (180 - x) / (next_x - x) * (next_y - y)))
    return [*kept, kept[0]]
