"""The text of a new mission file: physical units, and a comment at each number."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from uav_mission_manager.cli.mission_new.layout import cell_of
from uav_mission_manager.cli.mission_new.selection import Selection
from uav_mission_manager.cli.tasks import task_seconds
from uav_mission_manager.goal_task import Waypoints, task_to_dict
from uav_mission_manager.mdp import Grid
from uav_mission_manager.mdp.areas import Polygon

DECIMALS = 7
"""Decimals of latitudes and longitudes: a centimetre."""

PARAMETERS_TEXT = """
# From here on every number is a guess to be replaced: docs/mission_file.md says how to come by
# each. {epoch}
requests_per_hour: {{low: 2.0, high: 1.0, raised: 1.0}}   # [1/h] how often a goal is asked for
faults:
  # Eight values are by fault mode: nominal, sensor, actuator, both, and the same without camera.
  mtbf: {{sensor: 100.0, actuator: 50.0, camera: 100.0}}   # [h] mean time between failures
  agile_factor: {{sensor: 1.0, actuator: 2.0, camera: 1.0}}
  # Time at a goal until it is done [s]{done_by_goal}:
  done_in: [{done}, {slow}, {slow}, {slower}, never, never, never, never]
  repair_in: {repair}   # [s]
  cost: [0.0, 2.0, 6.0, 10.0, 1.0, 3.0, 7.0, 12.0]
range:
  lasts: {{normal: {normal}, agile: {agile}}}   # [s] of flight until a goal is out of range
  cost: 2.0
threat:
  per_hour: 1.0   # [1/h] threats; zones_per_hour says it by cell
  high_share: 0.3
  lasts: {{low: {low}, high: {high}, rises: 0.2, falls: 0.5}}   # [s]
  cost:   # none, low, high; normal, agile flight
    - [0.0, 1.0]
    - [5.0, 2.0]
    - [60.0, 10.0]
distance_weight: 0.1
energy:
  speed: {speed!r}   # [m/s] {speed_from}; let the bridge's cruise_speed be the same
  capacity: 5.0   # [Ah]
  voltage: 14.8   # [V]
  power: 250.0   # [W] in flight
  wind: 5.0   # [m/s] worst wind
  wind_penalty: 50.0   # [m/(m/s)] range lost to it
  payload: 0.0   # [kg]
  payload_penalty: 0.0   # [m/kg] range lost to it
"""
"""The part of which no plan says anything."""

GUESSES = {
    'repair': (120.0, 1),
    'normal': (900.0, 4),
    'agile': (600.0, 3),
    'low': (60.0, 2),
    'high': (40.0, 2),
    'horizon': (1800.0, 20),
}
"""Mean times [s], and how many epochs they are at least: what is shorter the model cannot tell."""

DONE, SLOWER_BY = 30.0, 30.0
"""Mean time [s] at a goal without a task, and how much longer each failed part makes it."""


def mission_text(
    name: str,
    selection: Selection,
    grid: Grid,
    worths: Mapping[str, float],
    speed: tuple[float, str],
    notes: Iterable[str],
    height: float | None = None,
) -> str:
    """Return the text of a mission file.

    Parameters
    ----------
    name : str
        Of the mission.
    selection : Selection
    grid : Grid
        With its origin.
    worths : mapping
        From goals' names to what they are worth; 1 where it is not there.
    speed : (float, str)
        Cruise speed [m/s], and where it is from.
    notes : iterable of str
        Lines of the comment at the top.
    height : float or None
        Of flight [m]; None is the bridge's default.
    """
    epoch = grid.cell_size / speed[0]
    tasks = _task_times(selection, grid, speed[0], height)
    guesses = GUESSES | {
        key: (DONE + parts * SLOWER_BY, 1) for parts, key in enumerate(('done', 'slow', 'slower'))
    }
    times = {key: f'{max(least, math.ceil(n * epoch)):.1f}' for key, (least, n) in guesses.items()}
    rest = PARAMETERS_TEXT.format(
        **times,
        speed=speed[0],
        speed_from=speed[1],
        epoch=f'An epoch, one step from cell to cell, takes {epoch:.3g} s.',
        done_by_goal='; of goals with their own only the ratios count'
        if any(goal.task for goal in selection.goals)
        else '',
    )
    head = [f'# {note}' for note in notes]
    goals = ['goals:', *_goal_lines(selection, grid, worths, tasks, epoch)]
    lines = [
        *head,
        f'name: {_quoted(name)}',
        f'horizon: {times["horizon"]}   # [s] for which costs count; a guess',
        'costs_per: minute   # of the measure of all costs: a goal of worth 1 that is open',
        *_grid_lines(grid, selection),
        *goals,
        *_area_lines(selection),
    ]
    return '\n'.join(lines) + rest


def _quoted(text: str) -> str:
    """Return a text as YAML has it: a string in JSON is one."""
    return json.dumps(text, ensure_ascii=False)


def _remark(text: str) -> str:
    """Return a text from a file as it may stand in a comment."""
    return ' '.join(''.join(c if c.isprintable() else ' ' for c in text).split())


def _grid_lines(grid: Grid, selection: Selection) -> Iterator[str]:
    origin = grid.origin
    assert origin is not None
    guess = '' if selection.home.altitude is not None else '; 0 is a guess'
    yield 'grid:   # rows from north to south, columns from west to east: it cannot be turned'
    yield f'  rows: {grid.rows}'
    yield f'  cols: {grid.cols}'
    yield f'  base: {grid.base}   # {_remark(selection.home.source)}'
    yield f'  service: {grid.service}   # {_remark(selection.service.source)}'
    yield f'  cell_size: {grid.cell_size!r}   # [m]'
    if grid.bearing:
        yield f'  bearing: {grid.bearing!r}   # [deg] clockwise from north: where columns lead to'
    yield f'  origin:   # centre of cell 0 [deg, deg, m above mean sea level{guess}]'
    yield f'    latitude: {origin.latitude:.{DECIMALS}f}'
    yield f'    longitude: {origin.longitude:.{DECIMALS}f}'
    yield f'    altitude: {origin.altitude!r}'


def _task_times(
    selection: Selection, grid: Grid, speed: float, height: float | None
) -> dict[str, float | None]:
    """Return how long [s] it takes at each goal by name."""
    bridge = {} if height is None else {'flight_altitude': height}
    return {
        goal.name: task_seconds(goal.task, grid, cell_of(grid, goal), speed, **bridge)
        for goal in selection.goals
    }


def _goal_lines(
    selection: Selection,
    grid: Grid,
    worths: Mapping[str, float],
    times: Mapping[str, float | None],
    epoch: float,
) -> Iterator[str]:
    assert grid.origin is not None
    for goal in selection.goals:
        cell = cell_of(grid, goal)
        point = grid.origin.to_local(goal.latitude, goal.longitude)
        offset = math.dist(point, grid.position(cell))
        fields = {'name': _quoted(goal.name), 'cell': cell, 'worth': worths.get(goal.name, 1.0)}
        remark = f'{_remark(goal.source)}: {offset:.0f} m from the centre of its cell'
        seconds = times[goal.name]
        if goal.task is not None and seconds is not None:
            fields['done_in'] = float(math.ceil(max(seconds, epoch)))
        if isinstance(goal.task, Waypoints):
            head, *rest = (f'{key}: {value}' for key, value in fields.items())
            yield f'  - {head}   # {remark}'
            yield from (f'    {line}' for line in rest)
            yield from _waypoint_lines(goal.task, seconds)
            continue
        if goal.task is not None:
            fields['task'] = _flow(task_to_dict(goal.task))
            remark += f'; about {seconds:.0f} s'
        yield f'  - {_flow(fields)}   # {remark}'


def _flow(value: Any) -> str:
    """Return numbers, texts and mappings of them as YAML has them in one line."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{key}: {_flow(entry)}' for key, entry in value.items()) + '}'
    return str(value)


def _waypoint_lines(task: Waypoints, seconds: float | None) -> Iterator[str]:
    yield '    task:'
    yield f'      waypoints:   # latitude, longitude, height above ground; about {seconds:.0f} s'
    for point in task.points:
        height = '' if point.height is None else f', {point.height!r}'
        place = f'{point.latitude:.{DECIMALS}f}, {point.longitude:.{DECIMALS}f}'
        yield f'        - [{place}{height}]'


def _area_lines(selection: Selection) -> Iterator[str]:
    if selection.fence or selection.no_fly:
        yield 'areas:   # corners [latitude, longitude]'
    if selection.fence:
        yield f'  fence:   # {_remark(selection.fence.source)}'
        yield from _corner_lines(selection.fence.polygon, '    ')
    if selection.no_fly:
        yield '  no_fly:'
    for outline in selection.no_fly:
        yield f'    - name: {_quoted(outline.name)}   # {_remark(outline.source)}'
        yield '      polygon:'
        yield from _corner_lines(outline.polygon, '        ')


def _corner_lines(polygon: Polygon, indent: str) -> Iterator[str]:
    for latitude, longitude in polygon:
        yield f'{indent}- [{latitude:.{DECIMALS}f}, {longitude:.{DECIMALS}f}]'
