"""Options of the commands that read bags: which vehicle's flight, and at which pace it was."""

from __future__ import annotations

import argparse

from uav_mission_manager.cli.number_argument import number_up_to

MOST_SPEEDUP = 1000.0
"""Seconds of a flight per second of its bag, at most: a choice, no simulation is so fast."""


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Add `--namespace`."""
    parser.add_argument(
        '--namespace', metavar='NAME', help='vehicle, such as /uav1; default: the only one'
    )


def add_speedup(parser: argparse.ArgumentParser) -> None:
    """Add `--speedup`."""
    parser.add_argument(
        '--speedup',
        type=number_up_to(MOST_SPEEDUP),
        default=1.0,
        metavar='N',
        help="seconds of the flight per second of the bag; the demo's have 8; default: 1",
    )
