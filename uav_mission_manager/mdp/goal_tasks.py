"""The tasks at goals in mission files: their fields, and what is checked of them."""

from __future__ import annotations

import math
from typing import Any

from uav_mission_manager.echo import quoted
from uav_mission_manager.goal_task import (
    Dwell,
    External,
    GoalTask,
    Photo,
    Waypoint,
    Waypoints,
)
from uav_mission_manager.mdp import fields
from uav_mission_manager.mdp.fields import Bad, Check
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.tables import Field, Section, Table

MAX_PICTURES, MAX_WAYPOINTS = 1000, 100
"""Pictures and waypoints of a task at most: choices."""

MAX_TIME = 86400.0
"""Longest time [s] of a task: a choice, a day."""

WAYPOINT_REACH = 1.0
"""Distance of a waypoint from the centre of its goal's cell, at most, in widths of a cell: a
choice, so that the vehicle stays about where the model has it."""

_TIME = fields.within(0.0, MAX_TIME)
waypoint_height = fields.within(5.0, 500.0)
"""Check a height above ground [m]: below, an error of it is a crash."""

_PLACE = (fields.within(-90.0, 90.0), fields.within(-180.0, 180.0), waypoint_height)


def _waypoints(value: Any) -> tuple[Waypoint, ...]:
    if not isinstance(value, (list, tuple)) or not 1 <= len(value) <= MAX_WAYPOINTS:
        raise Bad(f'{quoted(value)} is not a list of 1 to {MAX_WAYPOINTS} waypoints')
    return tuple(map(_waypoint, value))


def _waypoint(value: Any) -> Waypoint:
    if not isinstance(value, (list, tuple)) or len(value) not in (2, 3):
        raise Bad(f'{quoted(value)} is not [latitude, longitude] or [latitude, longitude, height]')
    return Waypoint(*(check(entry) for check, entry in zip(_PLACE, value, strict=False)))


_WAYPOINTS: Check[tuple[Waypoint, ...]] = Check(
    _waypoints,
    {
        'type': 'array',
        'minItems': 1,
        'maxItems': MAX_WAYPOINTS,
        'items': {
            'type': 'array',
            'prefixItems': [dict(check.schema) for check in _PLACE],
            'minItems': 2,
            'maxItems': 3,
        },
    },
)

_PHOTO = Table(
    (
        Field('count', fields.integer(1, MAX_PICTURES), 'how many'),
        Field('interval', _TIME, 'from one to the next, at least [s]', 0.0),
    )
)

_EXTERNAL = Table(
    (Field('timeout', _TIME, 'for which another program may work, in all, or it has failed [s]'),)
)

KINDS = ('dwell', 'photo', 'waypoints', 'external')
"""What may be done at a goal: one of these."""

TASK_TABLE = Table(
    (
        Field('dwell', _TIME, 'stay there for so long [s]'),
        Field('photo', _PHOTO, 'take pictures there'),
        Field(
            'waypoints',
            _WAYPOINTS,
            'fly to places near it, in order; each is latitude, longitude, and a height above '
            "ground if it is not the bridge's flight_altitude [deg, deg, m]",
        ),
        Field('external', _EXTERNAL, 'let another program say when it is done'),
    ),
    (tuple((kind,) for kind in KINDS),),
)
"""Fields of `goals[].task`."""


def read_task(section: Section, grid: Grid, cell: int) -> GoalTask:
    """Return the task of the goal in a cell.

    Raises
    ------
    MissionError
        It is none, or leads away from the cell.
    """
    if 'dwell' in section:
        return Dwell(section.get('dwell'))
    if 'photo' in section:
        return section.below(
            'photo', lambda photo: Photo(photo.get('count'), photo.get('interval'))
        )
    if 'waypoints' in section:
        return Waypoints(section.get('waypoints', lambda points: _near(points, grid, cell)))
    if 'external' in section:
        return section.below('external', lambda external: External(external.get('timeout')))
    section.fail('', f'has none of {", ".join(KINDS)}')


def read_slot(
    section: Section, task: GoalTask | None, after_added: bool
) -> tuple[bool, int, bool]:
    """Return whether a goal is a slot, the priority it was requested with, and if it is added.

    Raises
    ------
    MissionError
        A slot whose task is bound to a place, a request without a slot, an added goal that is
        none, or one that is not added `after_added` ones.
    """
    slot, requested, added = (section.get(key) for key in ('slot', 'requested', 'added'))
    if slot and isinstance(task, Waypoints):
        section.fail('slot', 'has no place yet, so its task cannot be waypoints')
    if requested and not slot:
        section.fail('requested', 'only a slot has one')
    if added and not slot:
        section.fail('added', 'only a slot can be')
    if after_added and not added:
        section.fail('added', 'the goal before it is, so this one must be too')
    return slot, requested, added


def _near(points: tuple[Waypoint, ...], grid: Grid, cell: int) -> tuple[Waypoint, ...]:
    """Return waypoints that are on the grid and near the cell; so are the legs between them."""
    if grid.origin is None:
        raise Bad('needs grid.origin')
    limit = WAYPOINT_REACH * grid.cell_size
    for number, point in enumerate(points, 1):
        place = grid.origin.to_local(point.latitude, point.longitude)
        distance = math.dist(place, grid.position(cell))
        where = f'waypoint {number}, {point.latitude:.7f} {point.longitude:.7f}, is'
        if not grid.contains(*place):
            raise Bad(f'{where} off the {grid.rows}x{grid.cols} grid')
        if distance > limit:
            raise Bad(f'{where} {distance:.0f} m from the centre of cell {cell}, over {limit:g} m')
    return points
