"""What is implausible or pointless in a mission, by looking at its numbers alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from uav_mission_manager.cli.check.costs import cost_findings
from uav_mission_manager.cli.check.facts import epoch_seconds, full_range, goal_facts
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.limits import LIMITS
from uav_mission_manager.cli.check.probabilities import probability_findings
from uav_mission_manager.cli.check.tasks_and_areas import area_findings, task_findings
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.range_model import endurance


def findings(mission: Mission) -> list[Finding]:
    """Return everything odd, in the order of the mission file."""
    rules: tuple[Callable[[Mission], Iterator[Finding]], ...] = (
        _horizon,
        _grid,
        _goals,
        task_findings,
        area_findings,
        probability_findings,
        cost_findings,
        _energy,
    )
    return [finding for rule in rules for finding in rule(mission)]


def beyond(field: str, value: float, instead: str, limits: str = '') -> Iterator[Finding]:
    """Warn where a value is beyond its limits, with what to do instead."""
    limit = LIMITS[limits or field]
    if not limit.hold(value):
        unit = f' {limit.unit}' if limit.unit else ''
        bounds = f'not within {limit.low:g} to {limit.high:g}{unit}'
        yield Finding(field, value, f'{bounds} ({limit.reason}): {instead}')


def _horizon(mission: Mission) -> Iterator[Finding]:
    limit, epochs = LIMITS['horizon'], 1 / (1 - mission.discount)
    if not limit.hold(epochs):
        yield Finding(
            'discount or horizon',
            mission.discount,
            f'costs count for {epochs:.3g} epochs, not for {limit.low:g} to {limit.high:g} '
            f'({limit.reason}): 0.95 looks 20 epochs ahead',
        )


def _grid(mission: Mission) -> Iterator[Finding]:
    grid = mission.grid
    yield from beyond('grid.cell_size', grid.cell_size, 'choose other cells, in metres')
    seconds = epoch_seconds(mission)
    if mission.energy and seconds is not None and seconds > endurance(mission.energy, 1.0):
        yield Finding(
            'grid.cell_size',
            grid.cell_size,
            f'a step takes {seconds:,.0f} s, a full battery lasts '
            f'{endurance(mission.energy, 1.0):,.0f} s: make the cells smaller',
        )
    if grid.origin is None:
        text = 'the mission can be planned and not flown: say where cell 0 is'
        yield Finding('grid.origin', 'missing', text, note=True)


def _goals(mission: Mission) -> Iterator[Finding]:
    grid, had = mission.grid, full_range(mission)
    for j, goal in enumerate(goal_facts(mission)):
        field = f'goals.{j}.cell'
        for name, cell in (('base', grid.base), ('service', grid.service)):
            if goal.cell == cell:
                text = f'is grid.{name}: there is nothing to fly to; choose another cell'
                yield Finding(field, goal.cell, text)
        if had is not None and goal.needed > had:
            yield Finding(
                field,
                goal.cell,
                f'takes a range of {goal.needed:,.0f} m, a full battery has {max(had, 0):,.0f} m: '
                'out of range always; move it, the service cell or base nearer, or check energy',
            )


def _energy(mission: Mission) -> Iterator[Finding]:
    energy = mission.energy
    if energy is None:
        text = 'neither ranges nor the length of an epoch can be checked; needed on board'
        yield Finding('energy', 'missing', text, note=True)
        return
    for name, instead in (
        ('capacity', 'give Ah, a thousandth of mAh'),
        ('voltage', 'give the nominal voltage of the battery'),
        ('power', 'give the power drawn in flight in W'),
        ('speed', 'give the cruise speed in m/s'),
        ('wind', 'give the worst wind to fly in in m/s'),
        ('payload', 'give its mass in kg'),
    ):
        yield from beyond(f'energy.{name}', getattr(energy, name), instead)
    seconds = endurance(energy, 1.0)
    if not LIMITS['endurance'].hold(seconds):
        limit = LIMITS['endurance']
        yield Finding(
            'energy.power',
            energy.power,
            f'a full battery lasts {seconds:,.0f} s, not {limit.low:g} to {limit.high:g} s '
            f'({limit.reason}): check capacity, voltage and power',
        )
