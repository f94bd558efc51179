# PYTHON_ARGCOMPLETE_OK
"""`mission_replay`: what a policy decides in a flight that was recorded."""

from __future__ import annotations

import argparse
import json
import math
from functools import partial
from pathlib import Path
from typing import Any

from uav_mission_manager.cli.bag_options import add_namespace
from uav_mission_manager.cli.errors import CommandParser, one_line_errors
from uav_mission_manager.cli.recorded_flight import replayed_steps
from uav_mission_manager.cli.replay_view import print_replay
from uav_mission_manager.cli.served_flight import serve_flight
from uav_mission_manager.console import DEFAULT_PORT
from uav_mission_manager.echo import quoted
from uav_mission_manager.mdp import Mission, global_actions
from uav_mission_manager.onboard import format_command
from uav_mission_manager.onboard.trace import RecordedOutcome, Replay, ReplayedStep, outcome_values
from uav_mission_manager.policy import Policy, load_policy

REPLAY_FORMAT = 1
"""Of the JSON; it changes when a reader of it has to."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('mission_replay'):
        options = _parser().parse_args(args)
        if options.serve:
            serve_flight(Path(options.bag), options.namespace, options.policy, options.port)
        policies = [load_policy(directory) for directory in options.policy]
        answer = _answer(options.bag, options.namespace, dict(zip(options.policy, policies)))
        if options.json:
            print(json.dumps(answer, allow_nan=False))
        else:
            print_replay(answer, [policy.space for policy in policies])
        return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='mission_replay',
        description='Let the manager decide anew in a recorded flight, by any policy set of the '
        'same goals and grid, and show where it decides otherwise. By the same policy set it '
        'decides the same, bit for bit.',
    )
    parser.add_argument('bag', help='folder of mission_record or `ros2 bag record`, or its file')
    parser.add_argument(
        '--policy',
        required=True,
        action='append',
        metavar='DIR',
        help='directory of the policy set to decide by; one more for each mission with other '
        'goals, where some were requested in flight',
    )
    add_namespace(parser)
    how = parser.add_mutually_exclusive_group()
    how.add_argument('--json', action='store_true', help='print JSON')
    how.add_argument(
        '--serve',
        action='store_true',
        help='show the flight on a page of the console, with play, pause and speed, and beside it '
        'what this policy set decides',
    )
    parser.add_argument(
        '--port',
        type=_port,
        default=DEFAULT_PORT,
        help='TCP port of the page; 0 is any that is free; default: %(default)d',
    )
    return parser


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) < 2**16):
        raise argparse.ArgumentTypeError(f'{quoted(text)} is no port from 0 to 65535')
    return int(text)


def _answer(bag: str, vehicle: str | None, policies: dict[str, Policy]) -> dict[str, Any]:
    """All that is found by policies of directories, as `--json` prints it (docs/record.md)."""
    replay, comparison = Replay(*policies.values()), Comparison()
    told, *further = (
        {'directory': directory, 'method': policy.method, 'digest': policy.digest}
        for directory, policy in policies.items()
    )
    seconds = 0.0
    for seconds, step in replayed_steps(Path(bag), vehicle, replay):
        comparison.add(seconds, step)
    return {
        'format': REPLAY_FORMAT,
        'bag': bag,
        'mission': next(iter(policies.values())).mission.name,
        'policy': told,
        'further_policies': further,
        'flown_by': replay.policies,
        'seconds': seconds,
        'manager_starts': replay.runs,
        'gaps': replay.gaps,
        'not_replayed': replay.skipped,
        **comparison.counts,
        'differences': comparison.differences,
    }


class Comparison:
    """Counts what is decided as it was, and keeps what is not.

    Attributes
    ----------
    counts : dict
        Of decisions: all, bit for bit as they were, with the same command, with another one.
    differences : list of dict
        One for each stretch in which one command takes the place of another.
    """

    def __init__(self) -> None:
        self.counts = dict.fromkeys(('decisions', 'identical', 'same', 'different'), 0)
        self.differences: list[dict[str, Any]] = []
        self._current: object = None

    def add(self, seconds: float, step: ReplayedStep) -> None:
        """Take a decision that was recorded `seconds` after the bag's beginning."""
        recorded, replayed = step.recorded, outcome_values(step.replayed)
        pair = recorded.get('action'), replayed.get('action')
        same = pair[0] == pair[1]
        self.counts['decisions'] += 1
        self.counts['same' if same else 'different'] += 1
        self.counts['identical'] += same and (pair == (None, None) or recorded == replayed)
        if same:
            self._current = None
            return
        if pair != self._current:
            self._current = pair
            told = partial(_told, step.mission)
            both = {'recorded': told(recorded), 'replayed': told(replayed)}
            self.differences.append({'seconds': seconds, **both, 'decisions': 0})
        self.differences[-1]['decisions'] += 1
        self.differences[-1]['until'] = seconds


def _told(mission: Mission, outcome: RecordedOutcome) -> dict[str, Any]:
    """Return an outcome with its command, in values that JSON has."""
    if 'refused' in outcome:
        return outcome
    command, runner_up = (
        number and format_command(mission, global_actions(mission)[number - 1])
        for number in (outcome['action'], outcome['runner_up'])
    )
    return {
        **outcome,
        'command': command,
        'runner_up_command': runner_up,
        'values': [_plain(value) for value in outcome['values']],
        'margin': _plain(outcome['margin']),
    }


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None


if __name__ == '__main__':
    raise SystemExit(main())
