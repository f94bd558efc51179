"""Reading mission files: YAML in, a checked `Mission` out, or one clear line of what is wrong."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import yaml

from uav_mission_manager.mdp.grid import Grid, Origin
from uav_mission_manager.mdp.mission import (
    ByMode,
    Energy,
    Faults,
    Goal,
    Matrix,
    Mission,
    Parts,
    Range,
    Row,
    ServiceCost,
    Threat,
)

ROW_SUM_TOLERANCE = 1e-9

T = TypeVar('T')


class MissionError(ValueError):
    """A mission that cannot be used; the message names the source, the field and the value."""


def load_mission(path: str | Path) -> Mission:
    """Read and check a mission file.

    Raises
    ------
    MissionError
        If the file cannot be read, is not YAML or holds a bad, missing or unknown field.
    """
    try:
        data = yaml.load(Path(path).read_text(encoding='utf-8'), Loader=_StrictLoader)
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f'{path}: cannot be read: {error}') from error
    except yaml.YAMLError as error:
        raise MissionError(f'{path}: not valid YAML: {" ".join(str(error).split())}') from error
    return mission_from_dict(data, str(path))


def mission_from_dict(data: Any, source: str) -> Mission:
    """Check a mission in the mission file's schema; `source` names it in errors.

    Raises
    ------
    MissionError
        At the first field that is bad, missing or unknown.
    """
    root = _Section(data, source, '')
    grid = root.section('grid', _grid)
    shared = root.get('priority_transition', _stochastic_matrix, None)
    mission = Mission(
        name=root.get('name', _name),
        discount=root.get('discount', _open_unit),
        feasibility=root.get('feasibility', _one_of('strict', 'seed'), 'strict'),
        grid=grid,
        goals=_goals(root, grid, shared),
        faults=root.section('faults', _faults),
        range=root.section('range', _range),
        threat=root.section('threat', lambda section: _threat(section, grid)),
        distance_weight=root.get('distance_weight', _non_negative),
        service_cost=root.section('service_cost', _service_cost, ServiceCost()),
        energy=root.section('energy', _energy, None),
    )
    root.end()
    return mission


class _StrictLoader(yaml.SafeLoader):
    """YAML without its silent trap: a key given twice is an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        if len(mapping) != len(node.value):
            keys = [self.construct_object(key, deep=True) for key, _ in node.value]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise yaml.YAMLError(f'key {twice!r} twice in one mapping{node.start_mark}')
        return mapping


class _Bad(ValueError):
    """What is wrong with one value; the section that reads it adds where."""


_REQUIRED: Any = object()


class _Section:
    """A mapping being read: every key once, by name; `end` refuses what is left."""

    def __init__(self, data: Any, source: str, place: str) -> None:
        self.source, self.place = source, place
        if not isinstance(data, Mapping):
            self.fail('', f'{data!r} is not a mapping')
        self.data: Mapping[Any, Any] = data
        self.known: list[str] = []

    def fail(self, key: str, problem: str) -> NoReturn:
        field = f'{self.place}.{key}'.strip('.') or 'mission'
        raise MissionError(f'{self.source}: {field}: {problem}')

    def get(self, key: str, check: Callable[[Any], T], default: Any = _REQUIRED) -> T:
        self.known.append(key)
        if key not in self.data:
            if default is _REQUIRED:
                self.fail(key, 'is missing')
            return default
        try:
            return check(self.data[key])
        except _Bad as error:
            self.fail(key, str(error))

    def section(self, key: str, read: Callable[[_Section], T], default: Any = _REQUIRED) -> T:
        value = self.get(key, lambda data: data, default)
        if key not in self.data:
            return value
        section = _Section(value, self.source, f'{self.place}.{key}'.strip('.'))
        result = read(section)
        section.end()
        return result

    def end(self) -> None:
        for key in self.data:
            if key not in self.known:
                near = difflib.get_close_matches(str(key), self.known, n=1, cutoff=0.0)
                self.fail(str(key), f'is unknown; the nearest known key is {near[0]!r}')


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _Bad(f'{value!r} is not a number')
    if not math.isfinite(value):
        raise _Bad(f'{value!r} is not finite')
    return float(value)


def _within(low: float, high: float) -> Callable[[Any], float]:
    def check(value: Any) -> float:
        number = _number(value)
        if not low <= number <= high:
            raise _Bad(f'{value!r} is outside {low:g}..{high:g}')
        return number

    return check


_probability = _within(0.0, 1.0)


def _non_negative(value: Any) -> float:
    number = _number(value)
    if number < 0:
        raise _Bad(f'{value!r} is negative')
    return number


def _positive(value: Any) -> float:
    number = _number(value)
    if number <= 0:
        raise _Bad(f'{value!r} is not above 0')
    return number


def _open_unit(value: Any) -> float:
    number = _number(value)
    if not 0 < number < 1:
        raise _Bad(f'{value!r} is not between 0 and 1')
    return number


def _integer(low: int, high: int | None = None) -> Callable[[Any], int]:
    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise _Bad(f'{value!r} is not a whole number')
        if value < low or (high is not None and value > high):
            raise _Bad(f'{value!r} is outside {low}..{"" if high is None else high}')
        return value

    return check


def _cell(grid: Grid) -> Callable[[Any], int]:
    def check(value: Any) -> int:
        try:
            return _integer(0, grid.q - 1)(value)
        except _Bad as error:
            raise _Bad(f'{error}: no cell of the {grid.rows}x{grid.cols} grid') from None

    return check


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value or value.split() != [value]:
        raise _Bad(f'{value!r} is not a name (a string without white space)')
    return value


def _one_of(*names: str) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        if value not in names:
            raise _Bad(f'{value!r} is none of {", ".join(names)}')
        return str(value)

    return check


def _row(length: int, check: Callable[[Any], float]) -> Callable[[Any], Row]:
    def check_row(value: Any) -> Row:
        if not isinstance(value, (list, tuple)) or len(value) != length:
            raise _Bad(f'{value!r} is not a list of {length} numbers')
        return tuple(check(entry) for entry in value)

    return check_row


def _matrix(rows: int, check_row: Callable[[Any], Row]) -> Callable[[Any], Matrix]:
    def check_matrix(value: Any) -> Matrix:
        if not isinstance(value, (list, tuple)) or len(value) != rows:
            raise _Bad(f'{value!r} is not a list of {rows} rows')
        return tuple(check_row(row) for row in value)

    return check_matrix


def _distribution(value: Any) -> Row:
    row = _row(3, _probability)(value)
    if abs(sum(row) - 1) > ROW_SUM_TOLERANCE:
        raise _Bad(f'row {value!r} sums to {sum(row):.12g}, not to 1')
    return row


_stochastic_matrix = _matrix(3, _distribution)


def _grid(section: _Section) -> Grid:
    size = Grid(section.get('rows', _integer(1)), section.get('cols', _integer(1)), 0, 0)
    return Grid(
        rows=size.rows,
        cols=size.cols,
        base=section.get('base', _cell(size)),
        service=section.get('service', _cell(size)),
        cell_size=section.get('cell_size', _positive, 50.0),
        origin=section.section('origin', _origin, None),
    )


def _origin(section: _Section) -> Origin:
    # Beyond 89 degrees a local plane with an east axis makes no sense.
    return Origin(
        latitude=section.get('latitude', _within(-89.0, 89.0)),
        longitude=section.get('longitude', _within(-180.0, 180.0)),
        altitude=section.get('altitude', _number),
    )


def _goals(root: _Section, grid: Grid, shared: Matrix | None) -> tuple[Goal, ...]:
    entries = root.get('goals', _list_of_goals)
    goals: list[Goal] = []
    for index, entry in enumerate(entries):
        section = _Section(entry, root.source, f'goals[{index}]')
        goal = Goal(
            name=section.get('name', _name),
            cell=section.get('cell', _cell(grid)),
            eta=section.get('eta', _non_negative),
            delta=section.get('delta', _non_negative),
            priority_transition=section.get(
                'priority_transition', _stochastic_matrix, shared or _REQUIRED
            ),
        )
        if goal.name in (other.name for other in goals):
            section.fail('name', f'{goal.name!r} is the name of another goal too')
        section.end()
        goals.append(goal)
    return tuple(goals)


def _list_of_goals(value: Any) -> list[Any]:
    if not isinstance(value, (list, tuple)) or not value:
        raise _Bad(f'{value!r} is not a list of at least one goal')
    return list(value)


def _faults(section: _Section) -> Faults:
    return Faults(
        rate=section.section('rate', lambda part: _parts(part, _probability)),
        agile_factor=section.section('agile_factor', lambda part: _parts(part, _non_negative)),
        repair_success=section.get('repair_success', _probability, 1.0),
        completion=section.get('completion', _row(8, _probability)),
        cost=section.get('cost', _row(8, _non_negative)),
    )


def _parts(section: _Section, check: Callable[[Any], float]) -> Parts:
    return Parts(*(section.get(part, check) for part in ('sensor', 'actuator', 'camera')))


def _range(section: _Section) -> Range:
    return Range(
        loss=section.section(
            'loss', lambda loss: ByMode(*(loss.get(m, _probability) for m in ('normal', 'agile')))
        ),
        cost=section.get('cost', _non_negative),
    )


def _threat(section: _Section, grid: Grid) -> Threat:
    return Threat(
        onset=section.get('onset', _probability),
        zones=section.section('zones', lambda zones: _zones(zones, grid), ()),
        high_share=section.get('high_share', _probability),
        from_low=section.get('from_low', _distribution),
        from_high=section.get('from_high', _distribution),
        cost=section.get('cost', _matrix(3, _row(2, _non_negative))),
    )


def _zones(section: _Section, grid: Grid) -> tuple[tuple[int, float], ...]:
    zones = {}
    for key in section.data:
        onset = section.get(key, _probability)
        try:  # Keys are whole numbers, in JSON their digits.
            cell = _cell(grid)(int(key) if isinstance(key, str) and key.isdecimal() else key)
        except _Bad as error:
            section.fail(str(key), str(error))
        zones[cell] = onset
    return tuple(sorted(zones.items()))


def _service_cost(section: _Section) -> ServiceCost:
    return ServiceCost(
        recharge=section.get('recharge', _non_negative, 0.0),
        repair=section.get('repair', _non_negative, 0.0),
    )


def _energy(section: _Section) -> Energy:
    return Energy(
        capacity=section.get('capacity', _positive),
        voltage=section.get('voltage', _positive),
        power=section.get('power', _positive),
        speed=section.get('speed', _positive),
        wind=section.get('wind', _non_negative),
        wind_penalty=section.get('wind_penalty', _non_negative),
        payload=section.get('payload', _non_negative),
        payload_penalty=section.get('payload_penalty', _non_negative),
    )
