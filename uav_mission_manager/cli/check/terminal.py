"""What `mission_check` prints for people, on 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from uav_mission_manager.cli.check.facts import (
    done_text,
    duration_text,
    epoch_seconds,
    full_range,
    goal_facts,
    grid_text,
    marks,
    task_text,
    worth_a_minute,
)
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.solving import Solved
from uav_mission_manager.cli.forecast_view import WIDTH
from uav_mission_manager.drawing.places import area_shapes, onsets
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy.prediction import Prediction
from uav_mission_manager.solver.memory import size_text

MAP_COLUMNS, MAP_ROWS = 20, 20
"""Cells, or blocks of cells, that a map shows at most: 4 columns each."""

SHOWN_GOALS, LONGEST_NAME_SHOWN = 30, 16
"""Goals of the table at most, and characters of their names: a choice."""

LARGEST_COUNT = 1_000_000_000
"""Number from which two digits say all that a person reads: a choice."""

SHOWN_SENSITIVITIES = 10
"""Parameters whose sensitivity is shown."""

ZONE, CALM = '!', '-'
"""Marks of cells in which threats are likelier, and less likely, than in ordinary ones."""


def new_console() -> Console:
    """Return where all is printed; goals may be called [b] or :b:."""
    width = None if Console().is_terminal else WIDTH
    return Console(width=width, markup=False, emoji=False, highlight=False)


def print_mission(console: Console, mission: Mission) -> None:
    """Print the map, the goals and the length of an epoch."""
    seconds, had = epoch_seconds(mission), full_range(mission)
    console.print(f'mission {shown(mission.name)}: {grid_text(mission.grid)}')
    if seconds is not None and had is not None:
        console.print(
            f'an epoch takes {seconds:.4g} s; a full battery has a range of {had:,.0f} m'
        )
    console.print()
    for line in map_lines(mission):
        console.print(line, no_wrap=True, overflow='crop')
    console.print(
        f'B base, S service, 1.. goals, {ZONE} threats likelier, {CALM} less likely than elsewhere'
    )
    console.print()
    console.print(_goal_table(mission))
    if mission.k > SHOWN_GOALS:
        console.print(f'and {mission.k - SHOWN_GOALS} more: see --json')
    for text in (*_task_lines(mission), *_area_lines(mission)):
        console.print(text, soft_wrap=True)


def _task_lines(mission: Mission) -> Iterator[str]:
    for goal in goal_facts(mission)[:SHOWN_GOALS]:
        if goal.task:
            yield f'task at {shown(goal.name)}: {task_text(goal)}'


def _area_lines(mission: Mission) -> Iterator[str]:
    for area in area_shapes(mission)[:SHOWN_GOALS]:
        kind = 'fence' if area.stay_inside else f'no-fly area {shown(area.name)}'
        yield f'{kind}: {len(area.ring) - 1} corners'


def map_lines(mission: Mission) -> list[Text]:
    """Return the grid, row by row; of a large one blocks of cells."""
    grid = mission.grid
    block = max(math.ceil(grid.cols / MAP_COLUMNS), math.ceil(grid.rows / MAP_ROWS))
    places, zones = marks(mission), onsets(mission)
    signs: dict[tuple[int, int], str] = {}
    hues: dict[tuple[int, int], str] = {}
    for cell in sorted({*places, *zones}):
        at = cell // grid.cols // block, cell % grid.cols // block
        signs[at] = signs.get(at, '') + places.get(cell, '')
        if cell in zones:
            hues[at] = ZONE if zones[cell] > mission.threat.onset else hues.get(at, CALM)
    rows, cols = math.ceil(grid.rows / block), math.ceil(grid.cols / block)
    lines = []
    if block > 1:
        lines.append(Text(f'each place stands for {block} x {block} cells'))
    for row in range(rows):
        line = Text()
        for col in range(cols):
            line.append(' ' if col else '')
            _draw(line, signs.get((row, col), ''), hues.get((row, col), ''))
        lines.append(line)
    return lines


def _draw(line: Text, sign: str, hue: str) -> None:
    """Add one place of four columns: what is there, how threatened it is."""
    style = {ZONE: 'on dark_red', CALM: 'on dark_green'}.get(hue, '')
    fits = sign if len(sign) <= 3 else f'{sign[:2]}+'
    text = f'{fits or "."}{hue}' if len(fits) < 3 else fits
    line.append(f'{text:<3}', style=f'bold {style}' if sign else f'dim {style}')


def _goal_table(mission: Mission) -> Table:
    seconds = epoch_seconds(mission)
    unit = 'an epoch' if seconds is None else 'a minute'
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    ways = 'from base', 'to service', 'needs'
    for head in ('', 'goal', 'cell', *ways, 'done in', f'worth {unit}'):
        table.add_column(head, justify='left' if head in ('', 'goal') else 'right')
    for number, goal in enumerate(goal_facts(mission)[:SHOWN_GOALS], 1):
        eta, delta = worth_a_minute(goal, seconds) or (goal.eta, goal.delta)
        both = f'{eta:.4g}' if eta == delta else f'{eta:.4g}, {delta:.4g}'
        table.add_row(
            str(number),
            shown(goal.name)[:LONGEST_NAME_SHOWN],
            str(goal.cell),
            f'{goal.from_base:,.0f} m',
            f'{goal.to_service:,.0f} m',
            f'{goal.needed:,.0f} m',
            done_text(goal),
            both,
        )
    return table


def print_methods(console: Console, methods: Sequence[Prediction], auto: str) -> None:
    """Print what each method takes."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    heads = ('method', 'sub-MDPs', 'states', 'reduced', 'memory', 'time, about')
    for head in heads:
        table.add_column(head, justify='left' if head == 'method' else 'right')
    for p in methods:
        numbers = str(p.sub_mdps), _count(p.states), _count(p.unknowns)
        time = 'not known' if p.seconds is None else duration_text(p.seconds)
        table.add_row(p.method, *numbers, size_text(p.memory), time)
    console.print(table)
    console.print('states: of the largest sub-MDP; reduced: what is solved for, of all of them')
    console.print(f'policy_build --method auto takes {auto}')


def _count(number: int) -> str:
    return f'{number:,}' if number < LARGEST_COUNT else f'{number:.1e}'


def print_sensitivities(console: Console, mission: Mission, solved: Solved) -> None:
    """Print the parameters that V* depends on most."""
    console.print(
        f'\nV* at the start (at base, all goals wanted): {solved.value:.4f}; it changes by'
    )
    for s in solved.sensitivities[:SHOWN_SENSITIVITIES]:
        section, _, rest = s.name.partition('.')
        whose = ''
        if section == 'goals':
            whose = (
                f' ({shown(mission.goals[int(rest.partition(".")[0])].name)[:LONGEST_NAME_SHOWN]})'
            )
        console.print(f'  {s.relative:+8.2%}  {s.name} {s.value:.4g} -> {s.changed:.4g}{whose}')
    console.print('where one number is 10 % larger, or smaller if it is at its limit; of discount')
    console.print(f'its horizon ({solved.method})')


def print_findings(console: Console, findings: Sequence[Finding], unchecked: str) -> None:
    """Print warnings and notes, each in one line, however long."""
    console.print()
    for line in finding_lines(findings, unchecked):
        console.print(line, soft_wrap=True)


def finding_lines(findings: Sequence[Finding], unchecked: str) -> Iterator[str]:
    """Yield warnings and notes."""
    warnings = [finding for finding in findings if not finding.note]
    yield from (f'WARNING {finding}' for finding in warnings)
    yield from (f'note    {finding}' for finding in findings if finding.note)
    if unchecked:
        what = 'whether goals are worth committing to, and sensitivities'
        yield f'not checked: {what}: {unchecked}'
    yield f'{len(warnings) or "no"} warning{"" if len(warnings) == 1 else "s"}'
