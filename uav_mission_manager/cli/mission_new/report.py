"""What `mission_new` says: what it took from where, and what it left out."""

from __future__ import annotations

from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from uav_mission_manager.cli.check.facts import grid_text
from uav_mission_manager.cli.mission_new.found import Found
from uav_mission_manager.cli.mission_new.selection import Selection
from uav_mission_manager.cli.tasks import in_words
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission

MOST_ROWS = 500
"""Things left out that are shown: a choice, more than anybody reads."""

COLUMNS = 80
"""Width where the output is not a terminal."""


def print_report(
    out: Path,
    mission: Mission,
    selection: Selection,
    found: Found,
    why: str,
    speed: tuple[float, str],
    height: tuple[float, str] | None,
) -> None:
    """Print it."""
    width = None if Console().is_terminal else COLUMNS
    console = Console(width=width, markup=False, emoji=False, highlight=False)
    grid = mission.grid
    table = _table('taken', 'as', 'from')
    table.add_row('base', f'cell {grid.base}', shown(selection.home.source))
    table.add_row('service', f'cell {grid.service}', shown(selection.service.source))
    for goal, place in zip(mission.goals, selection.goals):
        task = f', {in_words(goal.task)}' if goal.task else ''
        table.add_row(f'goal {shown(goal.name)}', f'cell {goal.cell}{task}', shown(place.source))
    if selection.fence:
        table.add_row('fence', _corners(selection.fence.polygon), shown(selection.fence.source))
    for area in selection.no_fly:
        table.add_row(f'no-fly {shown(area.name)}', _corners(area.polygon), shown(area.source))
    table.add_row('speed', f'{speed[0]:g} m/s', speed[1])
    if height:
        table.add_row('height, for the bridge', f'{height[0]:g} m', height[1])
    console.print(table)
    if found.left_out:
        table = _table('left out', 'because')
        for what, reason in found.left_out[:MOST_ROWS]:
            table.add_row(shown(what), shown(reason))
        if len(found.left_out) > MOST_ROWS:
            table.add_row(f'and {len(found.left_out) - MOST_ROWS:,} more', '')
        console.print(table)
    for line in (
        f'grid: {grid_text(grid)}: {why}',
        f'{shown(out)}: written. Requests, faults, range, threats, costs and energy',
        'in it are guesses: replace them, as docs/mission_file.md says.',
    ):
        console.print(line, soft_wrap=True)


def _table(*heads: str) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for head in heads:
        table.add_column(head, overflow='fold')
    return table


def _corners(polygon: tuple[tuple[float, float], ...]) -> str:
    return f'{len(polygon)} corners'
