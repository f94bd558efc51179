"""Goals that are requested in flight, and the slots of a mission that they take.

A request is JSON: a place, and if wanted a priority, a worth and a name. The goal takes a free
slot of the mission: a goal of the same number with another name, place and worth. Where none is
free it becomes a further goal, the last one. All else stays.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import Any, NoReturn

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import fields
from uav_mission_manager.mdp.areas import is_inside
from uav_mission_manager.mdp.epoch import Epoch
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.mission import Goal, Mission
from uav_mission_manager.mdp.mission_file import mission_from_dict
from uav_mission_manager.mdp.tables import Field, MissionError, Section, Table

SOURCE = 'goal_requests'
"""The topic of requests, which names them in errors."""

MAX_CHARACTERS = 10_000
"""Characters of a request at most: a choice, many times what one needs."""

_METERS = fields.within(-1e6, 1e6)
"""Distances in a request: a choice, farther than a drone flies."""

REQUEST_TABLE = Table(
    (
        Field('cell', fields.integer(0), 'where it is'),
        Field('east', _METERS, 'from the centre of cell 0, in place of cell [m]'),
        Field('north', _METERS, 'from the centre of cell 0 [m]'),
        Field('latitude', fields.latitude, 'in place of cell [deg]'),
        Field('longitude', fields.longitude, '[deg]'),
        Field('priority', fields.integer(1, 2), '1 low, 2 high', 2),
        Field(
            'worth', fields.non_negative, 'as of goals; without, that of slot or last goal', None
        ),
        Field('name', fields.name, 'unique; without, placed and a number', None),
    ),
    ((('cell',), ('east', 'north'), ('latitude', 'longitude')),),
)
"""The fields of a request."""


def place_goal(
    mission: Mission, text: str, free: Collection[int], most: int = 0
) -> tuple[Mission, int]:
    """Return the mission with a requested goal in a slot, and the number of that slot from 0.

    A further goal is as the last one in all that the request does not say, but has no task.

    Parameters
    ----------
    mission : Mission
    text : str
        The request.
    free : collection of int
        Numbers of the slots that may be taken; the first one is.
    most : int
        Goals that the mission may have for a further one, at most.

    Raises
    ------
    MissionError
        One line: the request is none, its place is off the grid, in a no-fly area or outside the
        fence, its name is one of the mission's, or no slot is free and there are too many goals
        for a further one.
    """
    section = Section(REQUEST_TABLE, _read_json(text), SOURCE)
    cell = _cell(section, mission)
    names = [goal.name for goal in mission.goals]
    name = section.get('name') or _next_name(names)
    if name in names:
        section.fail('name', f'{quoted(name)} is, or was last, the name of a goal')
    epoch = Epoch(mission.grid.cell_size, mission.energy.speed if mission.energy else None)
    worth, requested = section.get('worth', epoch.minute), section.get('priority')
    slot = min(free, default=mission.k)
    if slot < mission.k:
        there = mission.goals[slot]
    elif mission.k < most:
        there = replace(mission.goals[-1], task=None, completion=None, slot=True, added=True)
    else:
        slots = ', '.join(goal.name for goal in mission.goals if goal.slot)
        none = f'no slot is free of {shown(slots)}' if slots else 'the mission has no slots'
        _refuse(f'{none}, and for a further goal it has too many, {mission.k} of {most} at most')
    goal = replace(there, name=name, cell=cell, requested=requested)
    if worth is not None:
        goal = replace(goal, eta=worth, delta=worth)
    goals = *mission.goals[:slot], goal, *mission.goals[slot + 1 :]
    placed = replace(mission, goals=goals)
    mission_from_dict(placed.to_dict(), SOURCE)  # Its fleet section may name the slot.
    return placed, slot


def with_places_of(mission: Mission, placed: Mission, open_slots: Collection[int]) -> Mission:
    """Return a mission whose slots are where those of another one are, with its added goals.

    What was requested stays so for the `open_slots` alone, lest a goal that is done is revived.

    Raises
    ------
    ValueError
        As `changed_goals` does.
    """
    changed_goals(mission, placed)
    goals = []
    for number, other in enumerate(placed.goals):
        goal = mission.goals[number] if number < mission.k else other
        if goal.slot:
            there = {key: getattr(other, key) for key in ('name', 'cell', 'eta', 'delta')}
            requested = other.requested if number in open_slots else 0
            goal = replace(goal, **there, requested=requested)
        goals.append(goal)
    return replace(mission, goals=tuple(goals))


def changed_goals(old: Mission, new: Mission) -> tuple[int, ...]:
    """Return the numbers, from 0, of the goals that a mission has and another one has not.

    Raises
    ------
    ValueError
        One line: it cannot follow that one in flight, as it has another grid, or other goals than
        in slots and added ones.
    """
    if old.grid != new.grid:
        raise ValueError('the policy is for another grid')
    changed = tuple(
        number
        for number, (was, now) in enumerate(zip(old.goals, new.goals, strict=False))
        if (was.name, was.cell) != (now.name, now.cell)
    )
    bound = [old.goals[j].name for j in changed if not (old.goals[j].slot and new.goals[j].slot)]
    further = new.goals[old.k :]
    if bound or new.k < old.k or not all(goal.added for goal in further):
        raise ValueError(
            f'the policy is for other goals: {_listed(new.goals)}, not {_listed(old.goals)}'
        )
    return *changed, *range(old.k, new.k)


def _listed(goals: Collection[Goal]) -> str:
    return shown(', '.join(f'{goal.name} in cell {goal.cell}' for goal in goals))


def _refuse(why: str) -> NoReturn:
    raise MissionError(f'{SOURCE}: {why}')


def _read_json(text: str) -> dict[str, Any]:
    if len(text) > MAX_CHARACTERS:
        _refuse(f'{quoted(text)} has more than {MAX_CHARACTERS} characters')
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        _refuse(f'{quoted(text)} is not valid JSON: {shown(error)}')
    if not isinstance(data, dict):
        _refuse(f'{quoted(text)} is not a JSON object')
    return data


def _next_name(names: Collection[str]) -> str:
    numbers = (re.fullmatch('placed([1-9][0-9]{0,8})', name) for name in names)
    return f'placed{1 + max((int(found[1]) for found in numbers if found), default=0)}'


def _cell(section: Section, mission: Mission) -> int:
    """Return the cell of a request, after a look at its place and at what is flown to."""
    grid = mission.grid
    if 'cell' in section or not section.data.keys() & {'east', 'north', 'latitude', 'longitude'}:
        cell = section.get('cell', lambda cell: _on(grid, cell))
        places = [grid.position(cell)]
    else:
        if 'latitude' in section or 'longitude' in section:
            latitude, longitude = section.get('latitude'), section.get('longitude')
            if grid.origin is None:
                section.fail('latitude', 'needs grid.origin, which the mission has not')
            place = grid.origin.to_local(latitude, longitude)
        else:
            place = section.get('east'), section.get('north')
        if not grid.contains(*place):
            east, north = place
            _refuse(
                f'{east:.0f} m east, {north:.0f} m north of cell 0 is off the '
                f'{grid.rows}x{grid.cols} grid'
            )
        cell = grid.cell_at(*place)
        places = [place, grid.position(cell)]
    for fault in _breaches(mission, places):
        _refuse(f'cell {cell} is {fault}')
    return cell


def _on(grid: Grid, cell: int) -> int:
    if cell >= grid.q:
        raise Bad(f'{cell} is no cell of the {grid.rows}x{grid.cols} grid')
    return cell


def _breaches(mission: Mission, places: Collection[tuple[float, float]]) -> Iterator[str]:
    """Yield which areas forbid one of some places [m]."""
    areas, origin = mission.areas, mission.grid.origin
    if origin is None:  # Then there are no areas.
        return
    spots = [origin.to_geodetic(*place) for place in places]
    for area in areas.no_fly:
        if any(is_inside(area.polygon, *spot) for spot in spots):
            yield f'in the no-fly area {shown(area.name)}'
    if areas.fence is not None and not all(is_inside(areas.fence, *spot) for spot in spots):
        yield 'outside the fence'
