"""The options of what records by default: where to, or not at all."""

from __future__ import annotations

import argparse
from pathlib import Path

from uav_mission_manager.onboard.recording import require_rosbags


def add_recording_options(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--record` and `--no-record`; `what` says what is recorded, and where by default."""
    recording = parser.add_mutually_exclusive_group()
    recording.add_argument('--record', type=Path, metavar='DIR', help=what)
    recording.add_argument('--no-record', action='store_true', help='make no bags')


def place_of_bags(options: argparse.Namespace, default: Path) -> Path | None:
    """Return where to record, None for nowhere.

    Without the library nothing is recorded, and that is said.

    Raises
    ------
    ValueError
        If `--record` is given, and the library is missing.
    """
    if options.no_record:
        return None
    try:
        require_rosbags()
    except ValueError as error:
        if options.record is not None:
            raise ValueError(f'--record: {error}') from error
        print(f'not recorded: {error}')
        return None
    return Path(options.record or default)
