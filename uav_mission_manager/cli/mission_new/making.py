"""From the options to a mission file, and what is said about it."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from uav_mission_manager.cli.check.clearance import breaches
from uav_mission_manager.cli.errors import require_folder
from uav_mission_manager.cli.mission_new.fitting import (
    advice,
    fitting,
    misfit,
    reach,
    with_waypoints,
)
from uav_mission_manager.cli.mission_new.found import Found, valid_name
from uav_mission_manager.cli.mission_new.geojson import read_geojson
from uav_mission_manager.cli.mission_new.json_value import read_json
from uav_mission_manager.cli.mission_new.kml import read_kml
from uav_mission_manager.cli.mission_new.layout import (
    chosen_size,
    fitted_bearing,
    laid_out,
    require_separate_cells,
)
from uav_mission_manager.cli.mission_new.mission_text import mission_text
from uav_mission_manager.cli.mission_new.options import FIT
from uav_mission_manager.cli.mission_new.qgc_plan import read_plan
from uav_mission_manager.cli.mission_new.report import print_report
from uav_mission_manager.cli.mission_new.selection import Selection, select
from uav_mission_manager.echo import quoted, shown, why_not
from uav_mission_manager.likeness import nearest
from uav_mission_manager.mdp import Grid, Mission, MissionError, mission_from_dict
from uav_mission_manager.mdp.mission_file import MAX_FILE_BYTES
from uav_mission_manager.mdp.range_model import flight_range, required_ranges
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.onboard.range_model import FULL_CHARGE
from uav_mission_manager.paths import file_content, write_whole

DEFAULT_SPEED = 5.0
"""Speed of flight [m/s]: a guess."""

LONGEST_EPOCH = 300.0
"""Time for one step from cell to cell at most [s]: a choice; nothing is decided on the way."""


def make(options: argparse.Namespace) -> None:
    """Write the mission file that the options ask for, and say what is in it.

    Raises
    ------
    MissionError, OSError
        Then nothing is written.
    """
    out = Path(options.out)
    require_folder('--out', out)
    if out.exists() and not options.force:
        raise FileExistsError(f'{shown(out)}: exists; --force overwrites it')
    found = _read(options.file) if options.file is not None else Found('options')
    selection = select(found, options)
    grid, why = _grid(selection, options)
    require_separate_cells(grid, selection.goals)
    selection, lost = _without_misfits(selection, grid, found)
    speed = (options.speed, '--speed') if options.speed else found.speed
    speed = speed or (DEFAULT_SPEED, 'a guess')
    if grid.cell_size / speed[0] > LONGEST_EPOCH:
        raise MissionError(
            f'cells of {grid.cell_size:g} m at {speed[0]:g} m/s: a step takes '
            f'{grid.cell_size / speed[0]:.0f} s, more than {LONGEST_EPOCH:g}; make --cell smaller'
        )
    height = (options.altitude, '--altitude') if options.altitude else found.height
    name = options.name or valid_name(out.stem)
    notes = [*_notes(found, height), f'The size of cells: {why}.']
    worths, high = _worths(selection, options), height and height[0]
    text = mission_text(name, selection, grid, worths, speed, notes, high)
    mission = mission_from_dict(read_yaml(text), str(out))
    write_whole(out, text)
    print_report(out, mission, selection, found, why, speed, height)
    places = {
        goal.name: grid.origin.to_local(goal.latitude, goal.longitude)
        for goal in selection.goals
        if grid.origin is not None
    }
    breached = (finding.text for finding in breaches(mission, places))
    for warning in (*lost, *_out_of_range(mission), *breached):
        warnings.warn(warning, stacklevel=2)


def _read(file: str) -> Found:
    """Read a file by what it is, whatever it is called."""
    try:
        content = file_content(Path(file), MAX_FILE_BYTES)
    except (OSError, ValueError) as error:
        raise MissionError(f'{shown(file)}: cannot be read: {why_not(error)}') from error
    if content.startswith(b'PK'):
        raise MissionError(
            f'{shown(file)}: is an archive, KMZ perhaps: unzip it, and give doc.kml'
        )
    if content.lstrip(b'\xef\xbb\xbf \t\r\n').startswith(b'<') or file.endswith('.kml'):
        return read_kml(content, file)
    try:
        text = content.decode('utf-8-sig')
    except ValueError as error:
        raise MissionError(f'{shown(file)}: is neither JSON nor KML: {shown(error)}') from error
    root = read_json(text, file)
    return read_plan(root) if root['fileType'].value == 'Plan' else read_geojson(root)


def _grid(selection: Selection, options: argparse.Namespace) -> tuple[Grid, str]:
    """Return the grid, and why its cells are of that size."""
    home, service, goals = selection.home, selection.service, selection.goals
    places = with_waypoints([home, service, *goals])
    bearing = fitted_bearing(places) if options.turn == FIT else options.turn
    if options.rows or options.cols:
        if options.cell or not (options.rows and options.cols):
            raise MissionError('--rows and --cols go together, in place of --cell')
        why = 'the least by which so many rows and columns hold all places'
        return laid_out(home, places, service, (options.rows, options.cols), bearing), why
    size, why = options.cell, '--cell'
    if not size:
        size, why = chosen_size(home, goals, [service, *places[2 + len(goals) :]], bearing)
    if any(goal.waypoints for goal in goals):
        grid = fitting(home, service, goals, size, bearing, larger=not options.cell)
        if grid is not None and grid.cell_size > size:
            widest = max(goals, key=reach)
            why = f'{shown(widest.name)} reaches {reach(widest):.0f} m from its middle'
        if grid is not None:
            return grid, why
    return laid_out(home, places, service, size, bearing), why


def _without_misfits(
    selection: Selection, grid: Grid, found: Found
) -> tuple[Selection, list[str]]:
    """Take tasks away whose waypoints are too far from their goals; return warnings of them."""
    home, service, goals = selection.home, selection.service, selection.goals
    problems = {goal.name: problem for goal in goals if (problem := misfit(grid, goal))}
    if not problems:
        return selection, []
    instead = advice(home, service, goals, grid)
    for goal in goals:
        if goal.name in problems:
            found.leave_out(goal.source, 'its waypoints: cells are too small')
    lost = [f'{shown(name)} has no task: {why}; {instead}' for name, why in problems.items()]
    kept = (replace(goal, task=None) if goal.name in problems else goal for goal in goals)
    return replace(selection, goals=tuple(kept)), lost


def _worths(selection: Selection, options: argparse.Namespace) -> dict[str, float]:
    names = [goal.name for goal in selection.goals]
    worths = {}
    for name, worth in options.worth:
        if valid_name(name) not in names:
            hint = quoted(nearest(name, names))
            raise MissionError(f'--worth: {quoted(name)} is no goal; the nearest is {hint}')
        worths[valid_name(name)] = worth
    return worths


def _notes(found: Found, height: tuple[float, str] | None) -> Iterator[str]:
    yield f'Made by mission_new from {shown(Path(found.source).name)}.'
    if height:
        yield f'Height of flight [m], for the bridge: flight_altitude:={height[0]:g}, {height[1]}.'


def _out_of_range(mission: Mission) -> Iterator[str]:
    """Warn of goals that a full battery does not reach from base, by the guessed energy."""
    assert mission.energy is not None
    reach = flight_range(mission.energy, FULL_CHARGE)
    needed = required_ranges(mission, mission.grid.position(mission.grid.base))
    for goal, length in zip(mission.goals, needed):
        if length > reach:
            yield (
                f'goal {shown(goal.name)} is {length:.0f} m of flight away, with the way to the '
                f'service cell; energy gives {max(reach, 0.0):.0f} m'
            )
