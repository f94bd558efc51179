"""`mission_check`: whether a mission file says what was meant, and whether that is plausible."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from uav_mission_manager.cli.check import terminal
from uav_mission_manager.cli.check.facts import epoch_seconds, full_range, goal_facts
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.geojson import geojson
from uav_mission_manager.cli.check.html_page import html_page
from uav_mission_manager.cli.check.plausibility import findings
from uav_mission_manager.cli.check.solving import Solved, obstacle_to_solving, solve
from uav_mission_manager.cli.errors import CommandParser, one_line_errors
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission, load_mission
from uav_mission_manager.paths import write_whole
from uav_mission_manager.policy.prediction import obstacle_to_exact, predictions
from uav_mission_manager.solver.progress import Progress, Report

CHECK_FORMAT = 1
"""Version of what `--json` prints: keys may come, but none changes or goes without a new one."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('mission_check'):
        return _check(_parser().parse_args(args))


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='mission_check',
        description='Show what a mission file says, and warn of what is implausible or pointless.',
    )
    parser.add_argument('mission', help='mission file (YAML)')
    parser.add_argument('--map', metavar='OUT.html', help='draw a map, as a page for a browser')
    parser.add_argument(
        '--geojson', metavar='OUT', help='write cells and goals in degrees; needs grid.origin'
    )
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.add_argument(
        '--strict', action='store_true', help='end with exit code 1 where there is a warning'
    )
    return parser


def _check(options: argparse.Namespace) -> int:
    mission = load_mission(options.mission)
    areas = _areas(options.mission, mission) if options.geojson else ''
    unchecked = obstacle_to_solving(mission)
    solved = None
    if not unchecked:
        with _bar() as progress:
            solved = solve(mission, progress)
    found = [*findings(mission), *(solved.findings if solved else ())]
    if options.map:
        write_whole(Path(options.map), html_page(mission, found))
    if options.geojson:
        write_whole(Path(options.geojson), areas)
    if options.json:
        print(json.dumps(_answer(mission, found, solved, unchecked), allow_nan=False))
    else:
        _print(mission, found, solved, unchecked)
    return int(options.strict and any(not finding.note for finding in found))


def _areas(path: str, mission: Mission) -> str:
    try:
        return json.dumps(geojson(mission)) + '\n'
    except ValueError as error:
        raise ValueError(f'{shown(path)}: {error}') from None


@contextmanager
def _bar() -> Iterator[Progress]:
    """Show how far the sensitivities are, on a terminal."""
    console = Console(stderr=True)
    columns = TextColumn('sensitivities'), BarColumn(), TimeRemainingColumn()
    with ProgressBar(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task('', total=1.0)

        def show(report: Report) -> None:
            bar.update(task, completed=report.done)

        yield show


def _print(mission: Mission, found: list[Finding], solved: Solved | None, unchecked: str) -> None:
    console = terminal.new_console()
    terminal.print_mission(console, mission)
    terminal.print_methods(console, predictions(mission), _auto(mission))
    if solved is not None:
        terminal.print_sensitivities(console, mission, solved)
    terminal.print_findings(console, found, unchecked)


def _auto(mission: Mission) -> str:
    obstacle = obstacle_to_exact(mission)
    return f'expansion: {obstacle}' if obstacle else 'exact, if its first sweeps are quick enough'


def _answer(
    mission: Mission, found: list[Finding], solved: Solved | None, unchecked: str
) -> dict[str, Any]:
    """All that is found, as `--json` prints it."""
    grid = mission.grid
    obstacle = obstacle_to_exact(mission)
    return {
        'format': CHECK_FORMAT,
        'mission': mission.name,
        'grid': {'rows': grid.rows, 'cols': grid.cols, 'cell_size_m': grid.cell_size},
        'epoch_seconds': epoch_seconds(mission),
        'full_range_m': full_range(mission),
        'goals': [_finite(asdict(goal)) for goal in goal_facts(mission)],
        'methods': [asdict(prediction) for prediction in predictions(mission)],
        'auto': {'method': 'expansion' if obstacle else 'exact', 'why': obstacle},
        'warnings': [_plain(finding) for finding in found if not finding.note],
        'notes': [_plain(finding) for finding in found if finding.note],
        'not_checked': unchecked,
        'value_at_start': solved.value if solved else None,
        'sensitivity_method': solved.method if solved else None,
        'sensitivities': [asdict(s) for s in solved.sensitivities] if solved else None,
    }


def _plain(finding: Finding) -> dict[str, Any]:
    return {'field': finding.field, 'value': finding.value, 'text': finding.text}


def _finite(entries: dict[str, Any]) -> dict[str, Any]:
    """Values that JSON has: None for infinite."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in entries.items()
    }


if __name__ == '__main__':
    raise SystemExit(main())
