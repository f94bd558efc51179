"""Reading mission files: YAML in, a checked `Mission` out, or one clear line of what is wrong."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import fields
from uav_mission_manager.mdp.fields import Bad, MissionError, Section
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.mission import (
    ByMode,
    Energy,
    Faults,
    Goal,
    Matrix,
    Mission,
    Parts,
    Range,
    ServiceCost,
    Threat,
)
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.paths import opened_file

MAX_FILE_BYTES = 8_000_000
"""Bytes of a mission file at most: a choice, several times those of one with 90,000 zones."""

MAX_CELLS = 1_000_000
"""Cells of a grid at most: a choice; one goal on so many takes a minute and gigabytes."""


def load_mission(path: str | Path) -> Mission:
    """Read and check a mission file.

    Raises
    ------
    MissionError
        If the file cannot be read, is not YAML or holds a bad, missing or unknown field.
    """
    try:
        with open(opened_file(Path(path)), 'rb') as file:
            content = file.read(MAX_FILE_BYTES + 1)
        text = content.decode()
    except (OSError, ValueError) as error:
        problem = shown(getattr(error, 'strerror', None) or error)  # Not the path once more.
        raise MissionError(f'{shown(path)}: cannot be read: {problem}') from error
    if len(content) > MAX_FILE_BYTES:
        raise MissionError(
            f'{shown(path)}: is no mission file: more than {MAX_FILE_BYTES:,} bytes'
        )
    try:
        data = read_yaml(text)
    except (yaml.YAMLError, RecursionError) as error:
        problem = shown(' '.join(str(error).replace('"<unicode string>", ', '').split()))
        raise MissionError(f'{shown(path)}: not valid YAML: {problem}') from error
    return mission_from_dict(data, str(path))


def mission_from_dict(data: Any, source: str) -> Mission:
    """Check a mission in the mission file's schema; `source` names it in errors.

    Raises
    ------
    MissionError
        At the first field that is bad, missing or unknown.
    """
    root = Section(data, source, '')
    grid = root.section('grid', _grid)
    shared = root.get('priority_transition', fields.stochastic_matrix, None)
    mission = Mission(
        name=root.get('name', fields.name),
        discount=root.get('discount', fields.open_unit),
        feasibility=root.get('feasibility', _feasibility(source), 'strict'),
        grid=grid,
        goals=_goals(root, grid, shared),
        faults=root.section('faults', _faults),
        range=root.section('range', _range),
        threat=root.section('threat', lambda section: _threat(section, grid)),
        distance_weight=root.get('distance_weight', fields.non_negative),
        service_cost=root.section('service_cost', _service_cost, ServiceCost()),
        energy=root.section('energy', _energy, None),
    )
    root.end()
    return mission


def _feasibility(source: str) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        if value == 'seed':
            problem = "'seed' is the old word for 'paper'; please write 'paper'"
            text = f'{shown(source)}: feasibility: {problem}'
            warnings.warn(text, FutureWarning, stacklevel=2)
            return 'paper'
        return fields.one_of('strict', 'paper')(value)

    return check


def _cell(grid: Grid) -> Callable[[Any], int]:
    def check(value: Any) -> int:
        try:
            return fields.integer(0, grid.q - 1)(value)
        except Bad as error:
            raise Bad(f'{error}: no cell of the {grid.rows}x{grid.cols} grid') from None

    return check


def _grid(section: Section) -> Grid:
    rows = section.get('rows', fields.integer(1, MAX_CELLS))
    size = Grid(rows, section.get('cols', fields.integer(1, MAX_CELLS // rows)), 0, 0)
    return Grid(
        rows=size.rows,
        cols=size.cols,
        base=section.get('base', _cell(size)),
        service=section.get('service', _cell(size)),
        cell_size=section.get('cell_size', fields.positive, 50.0),
        origin=section.section('origin', _origin, None),
        elevation=section.section(
            'elevation', lambda cells: _by_cell(cells, size, fields.within(-9000.0, 9000.0)), ()
        ),
    )


def _origin(section: Section) -> Origin:
    # Beyond 89 degrees a local plane with an east axis makes no sense.
    return Origin(
        latitude=section.get('latitude', fields.within(-89.0, 89.0)),
        longitude=section.get('longitude', fields.within(-180.0, 180.0)),
        # Dry land lies between -430 and 8850 m.
        altitude=section.get('altitude', fields.within(-500.0, 9000.0)),
    )


def _goals(root: Section, grid: Grid, shared: Matrix | None) -> tuple[Goal, ...]:
    entries = root.get('goals', _list_of_goals)
    goals: list[Goal] = []
    for index, entry in enumerate(entries):
        section = Section(entry, root.source, f'goals[{index}]')
        goal = Goal(
            name=section.get('name', fields.name),
            cell=section.get('cell', _cell(grid)),
            eta=section.get('eta', fields.non_negative),
            delta=section.get('delta', fields.non_negative),
            priority_transition=section.get(
                'priority_transition', fields.stochastic_matrix, shared or fields.NO_DEFAULT
            ),
        )
        if goal.name in (other.name for other in goals):
            section.fail('name', f'{quoted(goal.name)} is the name of another goal too')
        section.end()
        goals.append(goal)
    return tuple(goals)


def _list_of_goals(value: Any) -> list[Any]:
    if not isinstance(value, (list, tuple)) or not value:
        raise Bad(f'{quoted(value)} is not a list of at least one goal')
    return list(value)


def _faults(section: Section) -> Faults:
    return Faults(
        rate=section.section('rate', lambda part: _parts(part, fields.probability)),
        agile_factor=section.section(
            'agile_factor', lambda part: _parts(part, fields.non_negative)
        ),
        repair_success=section.get('repair_success', fields.probability, 1.0),
        completion=section.get('completion', fields.row(8, fields.probability)),
        cost=section.get('cost', fields.row(8, fields.non_negative)),
    )


def _parts(section: Section, check: Callable[[Any], float]) -> Parts:
    return Parts(*(section.get(part, check) for part in ('sensor', 'actuator', 'camera')))


def _range(section: Section) -> Range:
    return Range(
        loss=section.section(
            'loss',
            lambda loss: ByMode(*(loss.get(m, fields.probability) for m in ('normal', 'agile'))),
        ),
        cost=section.get('cost', fields.non_negative),
    )


def _threat(section: Section, grid: Grid) -> Threat:
    return Threat(
        onset=section.get('onset', fields.probability),
        zones=section.section(
            'zones', lambda zones: _by_cell(zones, grid, fields.probability), ()
        ),
        high_share=section.get('high_share', fields.probability),
        from_low=section.get('from_low', fields.distribution),
        from_high=section.get('from_high', fields.distribution),
        cost=section.get('cost', fields.matrix(3, fields.row(2, fields.non_negative))),
    )


def _by_cell(
    section: Section, grid: Grid, check: Callable[[Any], float]
) -> tuple[tuple[int, float], ...]:
    values = {}
    for key in section.data:
        value = section.get(key, check)
        try:  # Keys are whole numbers, in JSON their digits.
            whole = isinstance(key, str) and re.fullmatch('0|[1-9][0-9]{,17}', key)
            cell = _cell(grid)(int(key) if whole else key)
        except Bad as error:
            section.fail(key, str(error))
        if cell in values:
            section.fail(key, f'{quoted(key)} names a cell that another key names too')
        values[cell] = value
    return tuple(sorted(values.items()))


def _service_cost(section: Section) -> ServiceCost:
    return ServiceCost(
        recharge=section.get('recharge', fields.non_negative, 0.0),
        repair=section.get('repair', fields.non_negative, 0.0),
    )


def _energy(section: Section) -> Energy:
    return Energy(
        capacity=section.get('capacity', fields.positive),
        voltage=section.get('voltage', fields.positive),
        power=section.get('power', fields.positive),
        speed=section.get('speed', fields.positive),
        wind=section.get('wind', fields.non_negative),
        wind_penalty=section.get('wind_penalty', fields.non_negative),
        payload=section.get('payload', fields.non_negative),
        payload_penalty=section.get('payload_penalty', fields.non_negative),
    )
