"""Reads plans of QGroundControl: JSON of fileType Plan, in version 1 with a mission in version 2.

See https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html.
"""

from __future__ import annotations

import math
from typing import Any

from shapely import LineString

from uav_mission_manager.cli.mission_new.found import Found, Place, Role, point_of, ring_of
from uav_mission_manager.cli.mission_new.json_value import JsonValue
from uav_mission_manager.echo import shown
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp.areas import Polygon
from uav_mission_manager.mdp.fields import Bad, number, positive

PLACE_COMMANDS = {
    16: 'waypoint',
    17: 'loiter',
    18: 'loiter',
    19: 'loiter',
    31: 'loiter',
    82: 'spline',
}
"""MAV_CMD of the items that are places to fly to, and what their goals are called."""

OTHER_COMMANDS = {
    20: 'return to launch',
    21: 'landing: the mission says where, by its base and service cells',
    22: 'take-off: the bridge takes off by itself',
    178: 'change of speed: give --speed',
    195: 'region of interest: no place to fly to',
    201: 'region of interest: no place to fly to',
    206: 'camera trigger: the camera is not for this package to release',
    530: 'camera mode: the camera is not for this package to release',
    2000: 'pictures: the camera is not for this package to release',
}
"""Why other items are left out."""

AREA_ITEMS = {'survey': 'survey', 'StructureScan': 'structure'}
"""Complex items over a polygon, and what their goals are called."""

RELATIVE_FRAMES = (3, 6)
"""MAV_FRAME of altitudes above home."""

POSITION = slice(4, 6)
"""Where the latitude and longitude are in an item's params."""

CIRCLE_CORNERS = 32
"""Corners of the polygon in place of a circle: a choice, within half a percent of its radius."""

LARGEST_RADIUS = 100_000.0
"""Radius of a circle at most [m]: a choice."""


def read_plan(root: JsonValue) -> Found:
    """Return what a plan says.

    Raises
    ------
    MissionError
        If it is no plan.
    """
    found = Found(root.source)
    mission = root['mission']
    home = mission['plannedHomePosition']
    if home:
        found.home = home.read(_home)
    for key in ('hoverSpeed', 'cruiseSpeed'):  # Multirotors go by the first.
        if found.speed is None and mission[key]:
            found.speed = mission[key].read(positive), key
    heights = []
    for position, item in enumerate(mission['items'].entries(), 1):
        if height := _read_item(found, item, position):
            heights.append((height, f'item {position}'))
    found.height = max(heights, default=None)
    _read_fence(found, root['geoFence'])
    for position, _ in enumerate(
        root['rallyPoints']['points'].entries() if root['rallyPoints'] else (), 1
    ):
        found.leave_out(f'rally point {position}', 'the vehicle returns to base or service cell')
    return found


def _home(given: Any) -> Place:
    point = point_of(given)
    altitude = number(given[2]) if len(given) > 2 and given[2] is not None else None
    return Place('home', *point, 'plannedHomePosition', altitude)


def _read_item(found: Found, item: JsonValue, position: int) -> float | None:
    """Take one item; return its height above home [m] if it is taken and has one."""
    if item['type'].value == 'ComplexItem':
        return _read_complex_item(found, item, position)
    command, what = item['command'].value, f'item {position}'
    name = PLACE_COMMANDS.get(command) if isinstance(command, int) else None
    if name is None:
        reason = OTHER_COMMANDS.get(command) if isinstance(command, int) else None
        found.leave_out(what, reason or f'command {shown(command)} is no place to fly to')
        return None
    params = [entry.value for entry in item['params'].entries()]
    point = params[POSITION]
    if len(point) < 2 or None in point or point == [0, 0]:
        found.leave_out(what, f'{name} without a position: it means where the vehicle is')
        return None
    found.add_place(f'{name}_{position}', item['params'].read(lambda _: point_of(point)), what)
    height = item['Altitude'].value if item['Altitude'] else (params + [None] * 7)[6]
    if item['frame'].value in RELATIVE_FRAMES and height is not None:
        return item['Altitude'].read(lambda _: number(height))
    return None


def _read_complex_item(found: Found, item: JsonValue, position: int) -> float | None:
    kind, what = item['complexItemType'].value, f'item {position}'
    if kind == 'CorridorScan':
        middle = item['polyline'].read(_middle)
        found.add_place(f'corridor_{position}', middle, f'{what}, the middle of a corridor')
    elif isinstance(kind, str) and kind in AREA_ITEMS:
        polygon = item['polygon'].read(ring_of)
        found.add_outline(f'{AREA_ITEMS[kind]}_{position}', polygon, f'{what}, {kind}', 'goal')
    else:
        found.leave_out(what, f'{shown(kind)} is no place to fly to')
        return None
    if not item['TransectStyleComplexItem']:
        return None
    calculation = item['TransectStyleComplexItem']['CameraCalc']
    height = calculation['DistanceToSurface'] if calculation else calculation
    return height.read(number) if height else None


def _middle(given: Any) -> tuple[float, float]:
    """Return the point halfway along a line."""
    if not isinstance(given, list) or len(given) < 2:
        raise Bad(f'{shown(given)} is no line of two or more corners')
    corners = [point_of(corner) for corner in given]
    plane = Origin(*corners[0], 0.0)
    line = LineString([plane.to_local(*corner) for corner in corners])
    middle = line.interpolate(0.5, normalized=True)
    return plane.to_geodetic(middle.x, middle.y)


def _read_fence(found: Found, fence: JsonValue) -> None:
    if not fence:
        return
    for kind in ('polygons', 'circles'):
        for position, entry in enumerate(fence[kind].entries(), 1):
            what = f'geofence {kind.removesuffix("s")} {position}'
            inside = entry['inclusion'].value
            if not isinstance(inside, bool):
                entry['inclusion'].fail(f'{shown(inside)} is neither true nor false')
            role: Role = 'fence' if inside else 'no_fly'
            polygon = (
                _circle(entry['circle'], inside)
                if kind == 'circles'
                else (entry['polygon'].read(ring_of))
            )
            found.add_outline(f'{role}_{kind.removesuffix("s")}_{position}', polygon, what, role)


def _circle(circle: JsonValue, inside: bool) -> Polygon:
    """Return a polygon within a circle to stay inside, around one to stay outside."""
    plane = Origin(*circle['center'].read(point_of), 0.0)
    radius = circle['radius'].read(positive)
    if radius > LARGEST_RADIUS:
        circle['radius'].fail(f'{radius:g} is above {LARGEST_RADIUS:g} m')
    if not inside:
        radius /= math.cos(math.pi / CIRCLE_CORNERS)
    angles = (2.0 * math.pi * corner / CIRCLE_CORNERS for corner in range(CIRCLE_CORNERS))
    return tuple(
        plane.to_geodetic(radius * math.sin(angle), radius * math.cos(angle)) for angle in angles
    )
