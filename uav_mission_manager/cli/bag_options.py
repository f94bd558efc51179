"""Options of the commands that read bags: which vehicle's flight, and at which pace it was."""

from __future__ import annotations

import argparse
import math

from uav_mission_manager.echo import quoted

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
        type=_speedup,
        default=1.0,
        metavar='N',
        help="seconds of the flight per second of the bag; the demo's have 8; default: 1",
    )


def _speedup(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= MOST_SPEEDUP:
        raise argparse.ArgumentTypeError(
            f'{quoted(text)} is not a number above 0, up to {MOST_SPEEDUP:g}'
        )
    return value
