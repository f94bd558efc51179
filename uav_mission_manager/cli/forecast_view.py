"""A forecast for people: tables of at most 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from uav_mission_manager.echo import shown

WIDTH = 80
"""Columns where the output is not a terminal."""

MEAN_NAMES = {
    'recharges': 'recharges',
    'repairs': 'repairs (tries)',
    'agile_minutes': 'time in agile mode [min]',
    'air_minutes': 'time in the air [min]',
    'energy_wh': 'energy [Wh]',
}
"""What `means` of a forecast are called."""

EVENT_NAMES = {
    'actuator_failed': 'actuator failed [%]',
    'no_goal_possible': 'no goal possible [%]',
    'full_charge_drawn': 'full charge drawn [%]',
}
"""What `events` of a forecast are called."""

PERCENT = 100
"""Percent in 1."""

MAX_DECIMALS = 4
"""Decimals that are shown, at most."""


def print_simulation(answer: dict[str, Any]) -> None:
    """Print what `mission_simulate --json` says, for people."""
    width = None if Console().is_terminal else WIDTH
    console = Console(width=width, markup=False, emoji=False, highlight=False)
    _print_head(console, answer)
    if answer['difference'] is None:
        found = answer['policies'][0]['forecast']
        console.print(_goal_table(found, answer['minutes']))
        console.print(_quantity_table(found, answer['minutes']))
    else:
        console.print(_comparison_table(answer))
        console.print('* the 95 % interval excludes 0; differences are of paired flights')
    for policy in answer['policies']:
        _print_bounds(console, policy)
    console.print('Not in the model:')
    for line in answer['not_modelled']:
        table = Table.grid(padding=(0, 1))
        table.add_row(' -', line)
        console.print(table)


def _print_head(console: Console, answer: dict[str, Any]) -> None:
    letters = [''] if answer['difference'] is None else ['A: ', 'B: ']
    for letter, policy in zip(letters, answer['policies']):
        console.print(f'{letter}{shown(policy["directory"])}, method {policy["method"]}')
    start = ' '.join(f'{name}={value}' for name, value in answer['start'].items())
    console.print(f'mission {answer["mission"]}, from {start}')
    console.print(
        f'{answer["episodes"]:,} flights, seed {answer["seed"]}, {answer["minutes"]} minutes, '
        f'an epoch lasts {answer["epoch_seconds"]:g} s'
    )


def _table(title: str) -> Table:
    return Table(title=title, title_justify='left', box=SIMPLE_HEAD, pad_edge=False)


def _goal_table(found: dict[str, Any], minutes: int) -> Table:
    limits = list(found['goals'][0]['done_within'])
    table = _table('goals: done within, in %, and below it the 95 % interval')
    table.add_column('goal', overflow='fold')
    for head in (*(f'{limit} min' for limit in limits), 'median\n[min]', 'withdrawn\nfirst'):
        table.add_column(head, justify='right', no_wrap=True)
    for goal in found['goals']:
        cells = [percent_texts(goal['done_within'][limit]) for limit in limits]
        median = interval_texts(goal['median_minutes'], beyond=f'> {minutes}')
        cells += [median, percent_texts(goal['withdrawn'])]
        table.add_row(goal['name'], *(f'{value}\n{bounds}' for value, bounds in cells))
    return table


def _quantity_table(found: dict[str, Any], minutes: int) -> Table:
    table = _table(f'in {minutes} minutes: means and probabilities')
    table.add_column('')
    for head in ('estimate', '95 % interval'):
        table.add_column(head, justify='right', no_wrap=True)
    for name, value in quantities(found):
        table.add_row(name, *interval_texts(value))
    return table


def quantities(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """All that is not of a goal: its name and interval."""
    for key, name in MEAN_NAMES.items():
        yield name, found['means'][key]
    for key, name in EVENT_NAMES.items():
        yield name, _scaled(found['events'][key])
    yield 'discounted cost, in all', found['cost']


def _comparison_table(answer: dict[str, Any]) -> Table:
    table = _table(f'in {answer["minutes"]} minutes: means and probabilities')
    table.add_column('', overflow='fold')
    for head in ('A', 'B', 'B - A', '95 % interval  '):
        table.add_column(head, justify='right', no_wrap=True)
    found = [policy['forecast'] for policy in answer['policies']]
    rows = (_all_rows(forecast) for forecast in (*found, answer['difference']))
    for (name, first), (_, second), (_, gained) in zip(*rows):
        value, bounds = interval_texts(gained, sign='+')
        mark = '*' if gained['low'] > 0 or gained['high'] < 0 else ' '
        table.add_row(
            name, interval_texts(first)[0], interval_texts(second)[0], value, f'{bounds} {mark}'
        )
    return table


def _all_rows(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for goal in found['goals']:
        for limit, done in goal['done_within'].items():
            yield f'{goal["name"]} done in {limit} min [%]', _scaled(done)
        yield f'{goal["name"]} mean time, cut [min]', goal['minutes']
        yield f'{goal["name"]} withdrawn first [%]', _scaled(goal['withdrawn'])
    yield from quantities(found)


def _print_bounds(console: Console, policy: dict[str, Any]) -> None:
    bounds, name = policy['bounds'], shown(policy['directory'])
    if bounds is None:
        console.print(f'{name} was made for a mission with other numbers, and flown in this one.')
    elif bounds['upper'] is not None:
        console.print(
            f'{name}: the policy set puts its cost between {bounds["lower"]:.6g} and '
            f'{bounds["upper"]:.6g} (upper bound: {bounds["upper_holds"]}).'
        )


def percent_texts(interval: dict[str, Any]) -> tuple[str, str]:
    """Return `interval_texts` of a probability in percent."""
    return interval_texts(_scaled(interval))


def _scaled(interval: dict[str, Any]) -> dict[str, Any]:
    return {key: PERCENT * value for key, value in interval.items()}


def interval_texts(interval: dict[str, Any], beyond: str = '', sign: str = '') -> tuple[str, str]:
    """Texts of the value and its bounds, to the digits that the interval gives."""
    low, high = interval['low'], interval['high']
    width = high - low if None not in (low, high) else 0.0
    decimals = min(max(-math.floor(math.log10(width / 2)), 0), MAX_DECIMALS) if width > 0 else 1

    def text(value: float | None) -> str:
        return beyond if value is None else f'{value:{sign}.{decimals}f}'

    return text(interval['value']), f'{text(low)}..{text(high)}'
