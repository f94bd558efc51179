# PYTHON_ARGCOMPLETE_OK
"""`mission_simulate`: what will probably happen when a policy is flown."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from uav_mission_manager.cli.errors import CommandParser, one_line_errors
from uav_mission_manager.cli.forecast_plot import draw_forecast, require_plotting
from uav_mission_manager.cli.forecast_view import print_simulation
from uav_mission_manager.cli.state_argument import STATE_FORM, parse_state
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import Mission, StateError
from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.policy import Policy, load_policy
from uav_mission_manager.solver.evaluation.flights import Flights, fly
from uav_mission_manager.solver.evaluation.forecast import (
    FORECAST_MINUTES,
    difference,
    epoch_length,
    forecast,
    forecast_epochs,
)
from uav_mission_manager.solver.evaluation.intervals import CONFIDENCE
from uav_mission_manager.solver.evaluation.occupancy import start_state

FORMAT = 1
"""Version of what `--json` prints: keys may come, but none changes or goes without a new one."""

FEWEST_EPISODES, MOST_EPISODES = 10, 1_000_000
"""Fewer say nothing, more take too much memory: a choice."""

CHARGE_NOT_MODELLED = (
    'charge: the battery is one range flag for each goal, lost by chance in flight; whether a '
    'full charge is drawn before a recharge follows from the time in the air, which the policy '
    'does not see'
)
"""What they are silent about besides, in missions without a charge."""

NOT_MODELLED = (
    'loss of control: parts fail, but the vehicle always flies on; the nearest to it are a failed '
    'actuator and faults in which no goal is possible',
    'turn-around: a recharge or a repair takes one epoch unless the mission says otherwise, '
    'take-off and landing none; agile flight takes no more power by default, there is no wind',
    'the base station: it withdraws and asks for goals by the chances in the mission file',
)
"""What the numbers are silent about."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('mission_simulate'):
        options = _parser().parse_args(args)
        if options.plot is not None:
            require_plotting(Path(options.plot))
        _simulate(options)
        return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='mission_simulate',
        description=f'Forecast {FORECAST_MINUTES} minutes of flying a policy by simulation: when '
        'goals are done, recharges, repairs, energy, faults, with 95 % confidence intervals.',
    )
    parser.add_argument('policy', help='directory of the policy set')
    parser.add_argument(
        '--from',
        dest='start',
        metavar='STATE',
        help=f'{STATE_FORM}; default: at base, all goals at high priority and in range, '
        'no fault, no threat',
    )
    parser.add_argument(
        '--episodes',
        type=_whole_number(FEWEST_EPISODES, MOST_EPISODES),
        default=10_000,
        metavar='N',
        help='simulated flights; default: %(default)s',
    )
    parser.add_argument(
        '--seed',
        type=_whole_number(0, 2**63 - 1),
        default=0,
        metavar='S',
        help='of the random numbers; the same gives the same flights; default: %(default)s',
    )
    parser.add_argument(
        '--compare',
        metavar='DIR2',
        help='another policy set, flown in the mission of the first with the same luck',
    )
    parser.add_argument('--plot', metavar='FILE', help='draw it, such as forecast.png or .svg')
    parser.add_argument('--json', action='store_true', help='print JSON')
    return parser


def _whole_number(low: int, high: int) -> Callable[[str], int]:
    """Return a check of an argument."""

    def check(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f'{quoted(text)} is not a whole number') from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f'{shown(value)} is not within {low}..{high}')
        return value

    return check


def _simulate(options: argparse.Namespace) -> None:
    names = [name for name in (options.policy, options.compare) if name is not None]
    policies = [load_policy(name) for name in names]
    mission = policies[0].mission
    _check_comparable(names, policies)
    start = _start(policies[0], options.start)
    try:
        epochs = forecast_epochs(mission)
    except Bad as error:
        raise ValueError(f'{shown(options.policy)}: mission {mission.name}: {error}') from None
    runs = []
    for name, policy in zip(names, policies):
        rows = np.repeat(start, options.episodes, axis=0)
        rng = np.random.default_rng(options.seed)
        with _progress(name) as tick:
            runs.append(fly(mission, policy.act, rows, epochs, rng, tick))
    answer = _answer(options, names, policies, start, runs)
    if options.plot is not None:
        draw_forecast(runs, [shown(name, 40) for name in names], Path(options.plot))
    if options.json:
        print(json.dumps(answer, allow_nan=False))
    else:
        print_simulation(answer)


def _check_comparable(names: list[str], policies: list[Policy]) -> None:
    first = policies[0].mission
    for name, policy in zip(names[1:], policies[1:]):
        if policy.mission.geography() != first.geography():
            raise ValueError(
                f'--compare: goals or grid of {shown(name)} are not those of {shown(names[0])}'
            )
        if policy.space != policies[0].space:
            variables = ' '.join(policy.space.names)
            raise ValueError(f'--compare: states of {shown(name)} are others, {variables}')
        if policy.mission.feasibility != first.feasibility:
            raise ValueError(
                f'--compare: feasibility of {shown(name)} is {policy.mission.feasibility}, '
                f'not {first.feasibility}'
            )


def _start(policy: Policy, text: str | None) -> IntArray:
    """The start state, shape (1, 2k+5)."""
    if text is None:
        return start_state(policy.mission)
    try:
        return policy.space.check(parse_state('--from', text))
    except StateError as error:
        raise ValueError(f'--from: {error}') from None


@contextmanager
def _progress(name: str) -> Iterator[Callable[[float], None]]:
    """Give what is told the share that is done, and shows it on a terminal."""
    console = Console(stderr=True)
    columns = TextColumn('{task.description}', markup=False), BarColumn(), TimeRemainingColumn()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(f'flying {shown(name, 40)}', total=1.0)
        yield lambda share: progress.update(task, completed=share)


def _answer(
    options: argparse.Namespace,
    names: list[str],
    policies: list[Policy],
    start: IntArray,
    runs: list[Flights],
) -> dict[str, Any]:
    """All that is found, as `--json` prints it (see docs/simulation.md)."""
    mission = policies[0].mission
    return {
        'format': FORMAT,
        'mission': mission.name,
        'start': dict(zip(policies[0].space.names, start[0].tolist())),
        'episodes': options.episodes,
        'seed': options.seed,
        'confidence': CONFIDENCE,
        'minutes': FORECAST_MINUTES,
        'epoch_seconds': epoch_length(mission),
        'policies': [
            {
                'directory': name,
                'method': policy.method,
                'digest': policy.digest,
                'bounds': _bounds(policy, start, mission),
                'forecast': _plain(asdict(forecast(flights))),
            }
            for name, policy, flights in zip(names, policies, runs)
        ],
        'difference': _plain(asdict(difference(*runs))) if runs[1:] else None,
        'not_modelled': [
            *([] if mission.range.charge else [CHARGE_NOT_MODELLED]),
            *NOT_MODELLED,
        ],
    }


def _bounds(policy: Policy, start: IntArray, mission: Mission) -> dict[str, Any] | None:
    """What the policy set says of its cost; None where it was made for another mission."""
    if policy.mission != mission:
        return None
    upper = float(policy.upper_bound(start)[0])
    return {
        'lower': float(policy.lower_bound(start)[0]),
        'upper': upper if math.isfinite(upper) else None,
        'upper_holds': policy.upper_bound_holds,
    }


def _plain(value: Any) -> Any:
    """Values that JSON has: None for infinite, tuples as lists."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


if __name__ == '__main__':
    raise SystemExit(main())
