"""The command line of `mission_report`."""

from __future__ import annotations

import argparse
from pathlib import Path

from uav_mission_manager.cli.bag_options import add_namespace, add_speedup
from uav_mission_manager.cli.errors import CommandParser, one_line_errors, require_folder
from uav_mission_manager.cli.mission_report.flight_page import flight_page
from uav_mission_manager.cli.mission_report.flight_record import FlightRecord, flight_record
from uav_mission_manager.cli.mission_report.policy_page import policy_page
from uav_mission_manager.console.messages import DECISION_TOPIC
from uav_mission_manager.echo import shown
from uav_mission_manager.onboard import parse_command
from uav_mission_manager.paths import write_whole
from uav_mission_manager.policy import Policy, load_policy

MANIFEST = 'manifest.json'
"""The file by which a policy set is told from a bag."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('mission_report'):
        options = _parser().parse_args(args)
        source, out = Path(options.source), Path(options.out)
        require_folder('--out', out)
        if (source / MANIFEST).is_file():
            _refuse_options_of_bags(options)
            text = policy_page(load_policy(source), options.source)
        else:
            text = _flight_report(options, source)
        write_whole(out, text)
        print(f'{shown(out)}: {len(text.encode()) / 1e6:.2f} MB')
        return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='mission_report',
        description='Write one HTML file, for a browser and for print, of a flight: what was '
        'asked, done, when and why, and what had been expected; or of a policy set.',
    )
    parser.add_argument(
        'source', metavar='DIR|BAG', help='policy set; or bag of mission_record or ros2 bag record'
    )
    parser.add_argument('--out', required=True, metavar='REPORT.html', help='file to write')
    parser.add_argument(
        '--policy', metavar='DIR', help='policy set that the bag was flown by: map, expectations'
    )
    add_namespace(parser)
    add_speedup(parser)
    return parser


def _refuse_options_of_bags(options: argparse.Namespace) -> None:
    given = [
        f'--{name}'
        for name, unset in (('policy', None), ('namespace', None), ('speedup', 1.0))
        if getattr(options, name) != unset
    ]
    if given:
        raise ValueError(f'{given[0]}: is for a bag, and {shown(options.source)} is a policy set')


def _flight_report(options: argparse.Namespace, bag: Path) -> str:
    policy = load_policy(options.policy) if options.policy is not None else None
    record = flight_record(bag, options.namespace, options.speedup)
    if policy is not None:
        _check_mission(options.source, record, policy)
    _check_states(options.source, record)
    return flight_page(record, options.source, policy)


def _check_states(bag: str, record: FlightRecord) -> None:
    """Refuse what is no state of any mission; length and threat were looked at before."""
    for at, decision in record.decided:
        state, space = decision.state, decision.space
        for name, value, values in zip(space.names, state, space.shape):
            low = int(name == 'f')
            if name != 'l' and not low <= value < low + values:
                raise ValueError(
                    f'{shown(bag)}: at {at:.2f} s: {DECISION_TOPIC}: state: {shown(state)} has '
                    f'{shown(value)} where {low} to {low + values - 1} may be'
                )


def _check_mission(bag: str, record: FlightRecord, policy: Policy) -> None:
    """Refuse decisions that no policy of this mission can have made."""
    mission = policy.mission
    actions, goals = 2 * mission.k + 4, tuple(shown(goal.name) for goal in mission.goals)
    for at, decision in record.decided:
        if not decision.state:
            continue
        try:
            policy.space.check([decision.state])
            if decision.goals not in ((), goals):
                raise ValueError(f'goals: {", ".join(decision.goals)}')
            parse_command(mission, decision.command)
            if len(decision.values) != actions:
                raise ValueError(f'values: {len(decision.values)} numbers, not {actions}')
        except ValueError as error:
            raise ValueError(
                f'{shown(bag)}: at {at:.2f} s: decided in another mission than '
                f'{shown(mission.name)}: {error}'
            ) from error
