"""A number as an argument."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from uav_mission_manager.echo import quoted


def number_up_to(most: float) -> Callable[[str], float]:
    """Return what reads a number above 0, up to another one; else it says so."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value <= most:
            raise argparse.ArgumentTypeError(
                f'{quoted(text)} is not a number above 0, up to {most:g}'
            )
        return value

    return read
