"""What a mission takes of what was found, as the options say."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

from uav_mission_manager.cli.mission_new.found import (
    Found,
    Line,
    Outline,
    Place,
    Role,
    valid_name,
)
from uav_mission_manager.cli.mission_new.geometry import inner_place, task_middle
from uav_mission_manager.cli.mission_new.rounds import too_long, waypoints_task
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.geodesy import Origin, ground_distance
from uav_mission_manager.likeness import nearest
from uav_mission_manager.mdp import MissionError
from uav_mission_manager.mdp.areas import MAX_CORNERS, fault_of_polygon

REACH = 100_000.0
"""How far from home places may be [m]: a choice, beyond any multirotor."""

LINE_LEFT_OUT = 'a line is neither a place nor an area; --line NAME flies along it'
"""Why a line is left out."""


@dataclass(frozen=True)
class Selection:
    """What a mission is made of."""

    home: Place
    service: Place
    goals: tuple[Place, ...]
    fence: Outline | None
    no_fly: tuple[Outline, ...]


def select(found: Found, options: argparse.Namespace) -> Selection:
    """Return what the mission takes; what it leaves out is noted in `found`.

    Raises
    ------
    MissionError
        If something needed is missing, or a place is too far away.
    """
    for name, point in options.goal:
        found.add_place(name, point, '--goal')
    for name in options.skip:
        _take(found, name, '--skip')
        found.leave_out(shown(name), '--skip')
    home = found.home
    if options.home is not None:
        home = replace(_resolved(found, options.home, '--home'), name='home')
    if home is None:
        raise MissionError(
            f'{shown(found.source)}: has no home: give --home, LATITUDE,LONGITUDE or the '
            'name of a point'
        )
    service = home
    if options.service is not None:
        service = _resolved(found, options.service, '--service')
    along = [_along(found, name) for name in options.line]
    for line in found.lines:
        found.leave_out(line.source, LINE_LEFT_OUT)
    outlines = _with_roles(found, options)
    inner = (inner_place(_sound(found, one)) for one in outlines if one.role == 'goal')
    goals = (*found.places, *inner, *along)
    for place in (service, *goals):
        _require_near(found, home, place)
    if not goals:
        raise MissionError(
            f'{shown(found.source)}: has no goal; --goal NAME,LATITUDE,LONGITUDE adds one'
        )
    fence = _fence(found, [one for one in outlines if one.role == 'fence'])
    no_fly = tuple(one for one in outlines if one.role == 'no_fly' and _is_near(found, home, one))
    return Selection(home, service, goals, fence, tuple(_sound(found, one) for one in no_fly))


def _resolved(found: Found, given: str | Place, option: str) -> Place:
    """Return a place given by its name, which is no goal then, or by its position."""
    if isinstance(given, Place):
        return given
    taken = _take(found, given, option)
    if not isinstance(taken, Place):
        kind = 'an area' if isinstance(taken, Outline) else 'a line'
        raise MissionError(f'{option}: {quoted(given)} is {kind}, not a point')
    if taken.task is not None:
        found.leave_out(taken.source, 'its task: it is no goal')
    return replace(taken, source=f'{option} {taken.name}: {taken.source}', task=None)


def _along(found: Found, name: str) -> Place:
    """Return the goal of flying along a line."""
    line = _take(found, name, '--line')
    if not isinstance(line, Line):
        raise MissionError(f'--line: {quoted(name)} is no line')
    task = waypoints_task((*point, None) for point in line.points)
    if task is None:
        raise MissionError(f'--line: {quoted(name)}: {too_long(len(line.points))}')
    return Place(line.name, *task_middle(task), line.source, task=task)


def _take(found: Found, name: str, option: str) -> Place | Outline | Line:
    """Take a place, an outline or a line out of what was found."""
    for one in found.features():
        if one.name == valid_name(name):
            found.places = [place for place in found.places if place is not one]
            found.outlines = [outline for outline in found.outlines if outline is not one]
            found.lines = [line for line in found.lines if line is not one]
            return one
    raise _unknown(found, name, option)


def _unknown(found: Found, name: str, option: str) -> MissionError:
    names = [one.name for one in found.features()]
    hint = f'; the nearest name is {quoted(nearest(name, names))}' if names else ''
    return MissionError(f'{option}: nothing here is called {quoted(name)}{hint}')


def _with_roles(found: Found, options: argparse.Namespace) -> list[Outline]:
    """Return the outlines, each with a role: that of its name, of the file, or --polygons."""
    roles: dict[str, Role] = {valid_name(name): 'no_fly' for name in options.no_fly}
    roles |= {valid_name(name): 'fence' for name in options.fence}
    names = [one.name for one in found.outlines]
    for name in roles:
        if name not in names:
            raise _unknown(found, name, f'--{roles[name].replace("_", "-")}')
    return [
        replace(one, role=roles.get(one.name) or one.role or options.polygons)
        for one in found.outlines
    ]


def _sound(found: Found, outline: Outline) -> Outline:
    """Return an outline if it is one of an area."""
    if len(outline.polygon) > MAX_CORNERS:
        fault = f'{len(outline.polygon)} corners are more than {MAX_CORNERS}'
    else:
        fault = fault_of_polygon(outline.polygon, Origin(*outline.polygon[0], 0.0))
    if fault:
        found.fail(outline.source, fault)
    return outline


def _fence(found: Found, fences: list[Outline]) -> Outline | None:
    for outline in fences[1:]:
        found.leave_out(outline.source, f'a mission has one fence, which is {fences[0].source}')
    return _sound(found, fences[0]) if fences else None


def _distance(home: Place) -> Callable[[float, float], float]:
    return lambda latitude, longitude: ground_distance(
        home.latitude, home.longitude, latitude, longitude
    )


def _require_near(found: Found, home: Place, place: Place) -> None:
    points = [(place.latitude, place.longitude)]
    points += [(point.latitude, point.longitude) for point in place.waypoints]
    away = max(_distance(home)(*point) for point in points)
    if away > REACH:
        found.fail(
            place.source,
            f'{shown(place.name)} is {away / 1000.0:,.0f} km from home, more than '
            f'{REACH / 1000.0:g}; are latitude and longitude in the right order?',
        )


def _is_near(found: Found, home: Place, outline: Outline) -> bool:
    away = min(_distance(home)(*corner) for corner in outline.polygon)
    if away > REACH:
        found.leave_out(outline.source, f'it is {away / 1000.0:,.0f} km from home')
    return away <= REACH
