"""Reading mission files: YAML in, a checked `Mission` out, or one clear line of what is wrong.

A mission is per epoch; what a file gives in physical units is converted here (`mdp.epoch`).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from uav_mission_manager.echo import quoted, shown, why_not
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import fields
from uav_mission_manager.mdp.areas import Areas, NoFlyArea, Polygon, fault_of_polygon
from uav_mission_manager.mdp.charge import drain_by_energy
from uav_mission_manager.mdp.energy import ByMode, Charge, Drain, Energy, Range
from uav_mission_manager.mdp.epoch import Epoch
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.mdp.fleet_rules import FleetRules, PriorityWeights
from uav_mission_manager.mdp.goal_tasks import read_slot, read_task
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.mission import (
    Faults,
    Goal,
    Matrix,
    Mission,
    Parts,
    Row,
    ServiceCost,
    Threat,
)
from uav_mission_manager.mdp.mission_table import MAX_CELLS, MISSION_TABLE
from uav_mission_manager.mdp.strict_yaml import read_yaml
from uav_mission_manager.mdp.tables import CELL_NUMBER, MissionError, Section, as_given
from uav_mission_manager.paths import file_content

MAX_FILE_BYTES = 8_000_000
"""Bytes of a mission file at most: a choice, several times those of one with 90,000 zones."""


def load_mission(path: str | Path) -> Mission:
    """Read and check a mission file.

    Raises
    ------
    MissionError
        If the file cannot be read, is not YAML or holds a bad, missing or unknown field.
    """
    text = mission_file_text(path)
    try:
        data = read_yaml(text)
    except (yaml.YAMLError, RecursionError) as error:
        problem = shown(' '.join(str(error).replace('"<unicode string>", ', '').split()))
        raise MissionError(f'{shown(path)}: not valid YAML: {problem}') from error
    return mission_from_dict(data, str(path))


def mission_file_text(path: str | Path) -> str:
    """Return what a mission file says, unread. Raises `MissionError`."""
    try:
        return file_content(Path(path), MAX_FILE_BYTES).decode()
    except (OSError, ValueError) as error:
        raise MissionError(f'{shown(path)}: cannot be read: {why_not(error)}') from error


def mission_from_dict(data: Any, source: str) -> Mission:
    """Check a mission in the mission file's schema; `source` names it in errors.

    Raises
    ------
    MissionError
        At the first field that is bad, missing or unknown.
    """
    root = Section(MISSION_TABLE, data, source)
    grid = root.below('grid', _grid)
    energy = root.below('energy', _energy)
    epoch = Epoch(grid.cell_size, energy.speed if energy else None)
    cost = _cost(root, epoch)
    return Mission(
        name=root.get('name'),
        discount=_either(root, 'discount', 'horizon', lambda mean: _discount(mean, epoch)),
        feasibility=root.get('feasibility', _feasibility(source)),
        grid=grid,
        faults=(faults := root.below('faults', lambda section: _faults(section, epoch, cost))),
        goals=(goals := _goals(root, grid, epoch, cost, faults.completion)),
        range=root.below('range', lambda section: _range(section, grid, energy, cost)),
        threat=root.below('threat', lambda section: _threat(section, grid, epoch, cost)),
        distance_weight=root.get('distance_weight', cost),
        service_cost=root.below('service_cost', lambda section: ServiceCost(**section.all(cost))),
        energy=energy,
        areas=root.below('areas', lambda section: _areas(section, grid)) or Areas(),
        fleet=root.below('fleet', lambda section: _fleet(section, goals)),
    )


def _cost(root: Section, epoch: Epoch) -> Callable[[Any], Any]:
    """Return what makes a cost per epoch of a cost in the file, or of lists of them."""

    def per_epoch(value: Any) -> Any:
        return tuple(map(per_epoch, value)) if isinstance(value, tuple) else epoch.minute(value)

    return per_epoch if root.get('costs_per') == 'minute' else as_given


def _either(section: Section, per_epoch: str, physical: str, then: Callable[[Any], Any]) -> Any:
    """Return a value per epoch, or what `then` makes of the one in physical units."""
    return section.get(physical, then) if physical in section else section.get(per_epoch)


def _discount(horizon: float, epoch: Epoch) -> float:
    discount = 1 - epoch.end(horizon)
    if not 0 < discount < 1:
        raise Bad(f'{horizon:.6g} s is a discount of {discount:g} in {epoch}, not within 0..1')
    return discount


def _feasibility(source: str) -> Callable[[str], str]:
    def current(word: str) -> str:
        if word == 'seed':
            problem = "'seed' is the old word for 'paper'; please write 'paper'"
            text = f'{shown(source)}: feasibility: {problem}'
            warnings.warn(text, FutureWarning, stacklevel=2)
            return 'paper'
        return word

    return current


def _cell(grid: Grid) -> Callable[[Any], int]:
    def check(value: Any) -> int:
        try:
            return fields.integer(0, grid.q - 1)(value)
        except Bad as error:
            raise Bad(f'{error}: no cell of the {grid.rows}x{grid.cols} grid') from None

    return check


def _cell_key(grid: Grid) -> Callable[[Any], int]:
    """Return a check of a key that is a cell: a whole number, in JSON its digits."""

    def check(key: Any) -> int:
        whole = isinstance(key, str) and re.fullmatch(CELL_NUMBER, key)
        return _cell(grid)(int(key) if whole else key)

    return check


def _grid(section: Section) -> Grid:
    rows = section.get('rows')
    size = Grid(rows, section.get('cols', fields.integer(1, MAX_CELLS // rows)), 0, 0)
    return Grid(
        rows=size.rows,
        cols=size.cols,
        base=section.get('base', _cell(size)),
        service=section.get('service', _cell(size)),
        cell_size=section.get('cell_size'),
        origin=section.below('origin', lambda origin: Origin(**origin.all())),
        elevation=section.cells('elevation', _cell_key(size)),
        bearing=section.get('bearing'),
    )


def _energy(section: Section) -> Energy:
    return Energy(**section.all())


def _areas(section: Section, grid: Grid) -> Areas:
    origin = grid.origin
    if origin is None:
        raise MissionError(f'{shown(section.source)}: areas: need grid.origin, which is missing')

    def sound(polygon: Polygon) -> Polygon:
        if fault := fault_of_polygon(polygon, origin):
            raise Bad(fault)
        return polygon

    no_fly: list[NoFlyArea] = []
    for entry in section.entries('no_fly') if 'no_fly' in section else ():
        area = NoFlyArea(entry.get('name'), entry.get('polygon', sound))
        if area.name in [other.name for other in no_fly]:
            entry.fail('name', f'{quoted(area.name)} is the name of another no-fly area')
        no_fly.append(area)
    fence = section.get('fence', sound) if 'fence' in section else None
    return Areas(fence, tuple(no_fly))


def _fleet(section: Section, goals: tuple[Goal, ...]) -> FleetRules:
    try:
        weights = section.below('weights', lambda weights: PriorityWeights(**weights.all()))
        plain = {r.key: section.get(r.key) for r in section.table.rows if r.key != 'weights'}
        rules = FleetRules(weights, **plain)
        rules.limits([goal.name for goal in goals])
    except MissionError:
        raise
    except ValueError as error:
        raise MissionError(f'{shown(section.source)}: {section.place}: {error}') from error
    return rules


def _goals(
    root: Section, grid: Grid, epoch: Epoch, cost: Callable[[Any], Any], completion: Row
) -> tuple[Goal, ...]:
    shared = _priorities(root, epoch)
    goals: list[Goal] = []
    for section in root.entries('goals'):
        if 'worth' in section:
            eta = delta = section.get('worth', epoch.minute)
        else:
            eta, delta = section.get('eta', cost), section.get('delta', cost)
        transition = _priorities(section, epoch) or shared
        if transition is None:
            section.fail('priority_transition', 'is missing')
        name, cell = section.get('name'), section.get('cell', _cell(grid))
        task = section.below('task', partial(read_task, grid=grid, cell=cell))
        done = partial(_done, epoch=epoch, shared=completion)
        own = _either(section, 'completion', 'done_in', done)
        slot = read_slot(section, task, bool(goals and goals[-1].added))
        goal = Goal(name, cell, eta, delta, transition, task, own, *slot)
        if goal.name in (other.name for other in goals):
            section.fail('name', f'{quoted(goal.name)} is the name of another goal too')
        goals.append(goal)
    return tuple(goals)


def _done(means: float | Row, epoch: Epoch, shared: Row) -> Row:
    """Return P(a goal is completed | f) of its mean times [s], or of that with all in order.

    Failed parts then make it as many times longer as they do in `faults`, whose completion is
    `shared`, but it takes an epoch at least.
    """
    if isinstance(means, tuple):
        return tuple(map(epoch.end, means))
    if not shared[0]:
        raise Bad('needs 8 values where faults.completion (done_in) is 0 (never) of the first')
    nominal = epoch.end(means)
    return tuple(min(nominal * probability / shared[0], 1.0) for probability in shared)


def _priorities(section: Section, epoch: Epoch) -> Matrix | None:
    """Return the priorities' transitions that the mission or one goal gives, in either way."""
    if 'requests_per_hour' not in section:
        return section.get('priority_transition')
    rates = section.below('requests_per_hour', Section.all)
    to = {
        0: (0.0, rates['low'], rates['high']),
        1: (rates['withdrawn'], 0.0, rates['raised']),
        2: (rates['withdrawn'], rates['lowered'], 0.0),
    }
    try:
        return tuple(epoch.jump(level, per_hour) for level, per_hour in to.items())
    except Bad as error:
        section.fail('requests_per_hour', str(error))


def _faults(section: Section, epoch: Epoch, cost: Callable[[Any], Any]) -> Faults:
    if 'mtbf' in section:
        rate = section.below('mtbf', lambda parts: _parts(parts, epoch.failure))
    else:
        rate = section.below('rate', _parts)
    return Faults(
        rate=rate,
        agile_factor=section.below('agile_factor', _parts),
        repair_success=_either(section, 'repair_success', 'repair_in', epoch.end),
        completion=_either(
            section, 'completion', 'done_in', lambda means: tuple(map(epoch.end, means))
        ),
        cost=section.get('cost', cost),
    )


def _parts(section: Section, then: Callable[[Any], Any] = as_given) -> Parts:
    return Parts(*(section.get(part, then) for part in ('sensor', 'actuator', 'camera')))


def _by_mode(section: Section, then: Callable[[Any], Any] = as_given) -> ByMode:
    return ByMode(*(section.get(mode, then) for mode in ('normal', 'agile')))


def _range(
    section: Section, grid: Grid, energy: Energy | None, cost: Callable[[Any], Any]
) -> Range:
    loss = charge = None
    if 'charge' in section:
        if energy is None:
            section.fail('charge', 'needs the section energy, which is missing')
        charge = section.below('charge', lambda levels: _charge(levels, grid, energy, cost))
    elif 'lasts' in section:
        epoch = Epoch(grid.cell_size, energy.speed if energy else None)
        loss = section.below('lasts', lambda modes: _by_mode(modes, epoch.end))
    else:
        loss = section.below('loss', _by_mode)
    return Range(section.get('cost', cost), loss, charge)


def _charge(section: Section, grid: Grid, energy: Energy, cost: Callable[[Any], Any]) -> Charge:
    levels = section.get('levels')
    if 'drain' in section:
        drain = section.below('drain', lambda modes: Drain(**modes.all()))
    else:
        try:
            drain = drain_by_energy(energy, grid.cell_size, levels, section.get('noise'))
        except Bad as error:
            section.fail('levels', str(error))
    return Charge(
        levels=levels,
        reserve=section.get('reserve'),
        drain=drain,
        empty_cost=section.get('empty_cost', cost),
        rate=section.get('rate'),
    )


def _threat(section: Section, grid: Grid, epoch: Epoch, cost: Callable[[Any], Any]) -> Threat:
    if 'zones_per_hour' in section:
        zones = section.cells('zones_per_hour', _cell_key(grid), epoch.event)
    else:
        zones = section.cells('zones', _cell_key(grid))
    if 'lasts' in section:
        from_low, from_high = section.below('lasts', lambda lasts: _levels(lasts, epoch))
    else:
        from_low, from_high = section.get('from_low'), section.get('from_high')
    return Threat(
        onset=_either(section, 'onset', 'per_hour', epoch.event),
        zones=zones,
        high_share=section.get('high_share'),
        from_low=from_low,
        from_high=from_high,
        cost=section.get('cost', cost),
    )


def _levels(section: Section, epoch: Epoch) -> tuple[Row, Row]:
    """Return the rows from a low and from a high threat."""
    low, high = section.get('low', epoch.end), section.get('high', epoch.end)
    rises, falls = section.get('rises'), section.get('falls')
    return (
        (low * (1 - rises), 1 - low, low * rises),
        (high * (1 - falls), high * falls, 1 - high),
    )
