"""Complex items of a plan of QGroundControl: surveys, corridors, structures, and their legs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shapely import LineString

from uav_mission_manager.cli.mission_new.found import Found, line_of, point_of, ring_of
from uav_mission_manager.cli.mission_new.geometry import task_middle
from uav_mission_manager.cli.mission_new.json_value import JsonValue
from uav_mission_manager.cli.mission_new.rounds import Corner, too_long, waypoints_task
from uav_mission_manager.echo import shown
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp.fields import number
from uav_mission_manager.mdp.goal_tasks import waypoint_height

AREA_ITEMS = {'survey': 'survey', 'StructureScan': 'structure'}
"""Complex items over a polygon, and what their goals are called."""

POSITION = slice(4, 6)
"""Where the latitude and longitude are in an item's params."""

WAYPOINT = 16
"""MAV_CMD of a corner of a leg."""

SEA_LEVEL_FRAMES, SEA_LEVEL_MODE = (0, 5), 2
"""MAV_FRAME, and AltitudeMode of QGroundControl, of altitudes above mean sea level."""


def read_complex_item(found: Found, item: JsonValue, position: int) -> float | None:
    """Take a complex item; return its height above home [m] if it is taken and has one."""
    kind, what = item['complexItemType'].value, f'item {position}'
    if not isinstance(kind, str) or kind not in ('CorridorScan', *AREA_ITEMS):
        found.leave_out(what, f'{shown(kind)} is no place to fly to')
        return None
    transects = item['TransectStyleComplexItem']
    height = _survey_height(found, transects) if transects else None
    task = _task(found, transects, height, what) if transects else None
    if kind in AREA_ITEMS:
        polygon, name = item['polygon'].read(ring_of), AREA_ITEMS[kind]
        found.add_outline(f'{name}_{position}', polygon, f'{what}, {kind}', 'goal', task)
    else:
        place = task_middle(task) if task else item['polyline'].read(_halfway)
        found.add_place(f'corridor_{position}', place, f'{what}, the middle of a corridor', task)
    if kind == 'StructureScan':
        found.leave_out(what, 'its rounds: the goal is over the structure, so mind its height')
    return height


def _task(found: Found, transects: JsonValue, height: float | None, what: str) -> Waypoints | None:
    """Return the task of flying the legs; what is left out of it is noted."""
    legs = _legs(found, transects, height)
    if not legs:
        found.leave_out(what, 'its legs: the plan has none')
        return None
    task = waypoints_task(legs)
    if task is None:
        found.leave_out(what, f'its legs: {too_long(len(legs))}')
    else:
        found.leave_out(what, 'its pictures: let camera or autopilot take them by themselves')
    return task


def _survey_height(found: Found, transects: JsonValue) -> float | None:
    """Return the height of all legs above home [m], None where nothing says it."""
    camera = transects['CameraCalc']
    given = camera['DistanceToSurface'] if camera else camera
    if not given:
        return None
    return _above_home(found, given.read(number), camera['DistanceMode'].value == SEA_LEVEL_MODE)


def _above_home(found: Found, altitude: float, above_sea_level: bool) -> float | None:
    if not above_sea_level:
        return altitude
    ground = found.home.altitude if found.home else None
    return None if ground is None else altitude - ground


def _legs(found: Found, transects: JsonValue, height: float | None) -> list[Corner]:
    """Return the corners of the legs: of the items that are flown, else of the line drawn."""
    legs = [
        (item['params'], params[POSITION], _item_height(found, item, params))
        for item in transects['Items'].entries()
        if item['command'].value == WAYPOINT
        and None not in (params := [entry.value for entry in item['params'].entries()])[POSITION]
    ]
    if not legs:
        legs = [
            (entry, entry.value, None) for entry in transects['VisualTransectPoints'].entries()
        ]
    return [_corner(*leg, height) for leg in legs]


def _item_height(found: Found, item: JsonValue, params: Sequence[Any]) -> float | None:
    if len(params) < 7 or params[6] is None:
        return None
    altitude = item['params'].read(lambda _: number(params[6]))
    return _above_home(found, altitude, item['frame'].value in SEA_LEVEL_FRAMES)


def _corner(place: JsonValue, point: Any, own: float | None, height: float | None) -> Corner:
    high = height if own is None else own
    return (
        *place.read(lambda _: point_of(point)),
        None if high is None else place.read(lambda _: waypoint_height(high)),
    )


def _halfway(given: Any) -> tuple[float, float]:
    """Return the point halfway along a line."""
    corners = line_of(given)
    plane = Origin(*corners[0], 0.0)
    line = LineString([plane.to_local(*corner) for corner in corners])
    there = line.interpolate(0.5, normalized=True)
    return plane.to_geodetic(there.x, there.y)
