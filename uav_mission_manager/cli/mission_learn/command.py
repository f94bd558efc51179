"""The command line of `mission_learn`."""

from __future__ import annotations

import argparse
from pathlib import Path

from uav_mission_manager.cli.bag_options import add_namespace, add_speedup
from uav_mission_manager.cli.check.solving import obstacle_to_solving
from uav_mission_manager.cli.errors import CommandParser, one_line_errors, require_folder
from uav_mission_manager.cli.mission_learn.certificates import certificate_lines
from uav_mission_manager.cli.mission_learn.changes import Learning, as_html, as_markdown, sections
from uav_mission_manager.cli.mission_learn.flown_bag import (
    flown_epochs,
    measured,
    recorded,
    seconds_per_epoch,
)
from uav_mission_manager.cli.number_argument import number_up_to
from uav_mission_manager.echo import shown
from uav_mission_manager.learning import (
    DEFAULT_WEIGHT,
    count,
    effect,
    joined,
    with_counts,
    with_measured,
)
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.mdp.mission_file import mission_file_text
from uav_mission_manager.paths import write_whole

MOST_WEIGHT = 1e9
"""Events that a mission file is worth at most: a choice, more than any fleet sees."""

PAGE_MAKERS = {'.html': as_html, '.md': as_markdown}
"""What makes a page, by how its file's name ends."""


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('mission_learn'):
        options = _parser().parse_args(args)
        _check_outputs(options)
        learning = _learned(options)
        report = sections(learning)
        print(as_markdown(report))
        write_whole(Path(options.out), learning.new.text)
        if options.report is not None:
            write_whole(Path(options.report), PAGE_MAKERS[Path(options.report).suffix](report))
        print(f'{shown(options.out)}: written')
        return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='mission_learn',
        description='Learn the numbers of a mission file from recorded flights: probabilities, '
        'rates, speed and power, each with its 90 % interval, and what that does to the policy.',
    )
    parser.add_argument(
        'bags', nargs='+', metavar='BAG', help='bag of mission_record or ros2 bag record'
    )
    parser.add_argument(
        '--mission', required=True, metavar='FILE', help='mission file that they were flown by'
    )
    parser.add_argument('--out', required=True, metavar='NEW.yaml', help='mission file to write')
    parser.add_argument(
        '--weight',
        type=number_up_to(MOST_WEIGHT),
        default=DEFAULT_WEIGHT,
        metavar='N',
        help='events that what the mission file says is worth, in each of its rows; '
        'default: %(default)g',
    )
    parser.add_argument(
        '--report', metavar='PAGE', help='page to write of what changed, PAGE.html or PAGE.md'
    )
    parser.add_argument(
        '--certificate',
        action='store_true',
        help='build the expansion of both files, too, and show what is certified of it',
    )
    add_namespace(parser)
    add_speedup(parser)
    return parser


def _check_outputs(options: argparse.Namespace) -> None:
    """Refuse what cannot be written before the work; the old file stays for the next time."""
    out = Path(options.out)
    if out.exists() and out.samefile(options.mission):
        raise ValueError('--out: is the file of --mission, which is the prior: keep it')
    for name, path in (('--out', options.out), ('--report', options.report)):
        if path is not None:
            require_folder(name, Path(path))
    if options.report is not None and Path(options.report).suffix not in PAGE_MAKERS:
        raise ValueError(f'--report: {shown(options.report)} ends in none of .html, .md')


def _learned(options: argparse.Namespace) -> Learning:
    old, text = load_mission(options.mission), mission_file_text(options.mission)
    records = [
        recorded(Path(bag), options.namespace, options.speedup, old) for bag in options.bags
    ]
    found = measured(records, old, seconds_per_epoch(old, options.mission))
    first = with_measured(text, options.mission, found, options.weight)
    length = seconds_per_epoch(first.mission, options.mission)
    epochs = joined([flown_epochs(record, first.mission, length) for record in records])
    counts = count(first.mission, epochs)
    new = with_counts(first.text, options.mission, counts, options.weight)
    unsolved = obstacle_to_solving(new.mission)
    return Learning(
        bags=options.bags,
        file=options.mission,
        weight=options.weight,
        epochs=len(epochs.actions),
        flown=int(epochs.airborne.sum()),
        seconds_per_epoch=length,
        learned=[*first.learned, *new.learned],
        new=new,
        effect=None if unsolved else effect(old, new.mission),
        unsolved=unsolved,
        certificates=certificate_lines(old, new.mission) if options.certificate else [],
    )
