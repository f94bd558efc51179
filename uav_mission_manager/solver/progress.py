"""How far work has come: one protocol for everything that takes long."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Report:
    """How far a piece of work has come.

    Attributes
    ----------
    step : int
        Sweeps, rounds or iterations made so far.
    done : float
        Estimated share of the work, 0 to 1; 1 exactly when it is finished.
    text : str
        For people, such as `sweep 12, within 3.1e-04 of V*`.
    task : str
        Which part of a larger work this is about; empty where there is one only.
    """

    step: int
    done: float
    text: str
    task: str = ''


class Progress(Protocol):
    """Is told how far work has come, after each step."""

    def __call__(self, report: Report) -> None:
        """Take a report; raising an exception ends the work."""


def ignore(report: Report) -> None:
    """Progress that nobody looks at."""


def share_of_decades(first: float, now: float, last: float) -> float:
    """Share done of work that brings a number from `first` down to `last` at a steady rate."""
    if not 0 < last < first:
        return 1.0
    return min(max(math.log(first / max(now, last)) / math.log(first / last), 0.0), 1.0)
