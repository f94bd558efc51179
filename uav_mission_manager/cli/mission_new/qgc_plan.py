"""Reads plans of QGroundControl: JSON of fileType Plan, in version 1 with a mission in version 2.

See https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html.
"""

from __future__ import annotations

import math
from typing import Any

from uav_mission_manager.cli.mission_new.found import Found, Place, Role, point_of, ring_of
from uav_mission_manager.cli.mission_new.json_value import JsonValue
from uav_mission_manager.cli.mission_new.qgc_items import ItemReader
from uav_mission_manager.echo import shown
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp.areas import Polygon
from uav_mission_manager.mdp.fields import number, positive

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
    reader = ItemReader(found)
    for position, item in enumerate(mission['items'].entries(), 1):
        reader.read(item, position)
    found.height = max(reader.heights, default=None)
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
