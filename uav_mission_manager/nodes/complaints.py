"""Complaints in the log: bad inputs come at the rate of good ones, and say ever new things."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

QUIET_TIME = 5.0
"""Time [s] between two lines of one kind: a choice, for a log that a person can follow."""


@dataclass
class _Kind:
    """What is wrong now ('' if nothing), when something was said, and what waits to be said."""

    current: str = ''
    said_at: float = -math.inf
    waiting: str = ''
    left_out: int = 0


class Complaints:
    """Says of each kind of trouble what is new about it, at most once in `QUIET_TIME`.

    What comes too soon is counted, and the last of it is said later: by the next complaint of its
    kind, or by `flush`.

    Parameters
    ----------
    say : callable
        Takes a line for the log. A lambda: rclpy wants a place in the code for each severity.
    clock : callable
        Returns a time [s].
    """

    def __init__(
        self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._clock = say, clock
        self._kinds: dict[str, _Kind] = {}

    @property
    def current(self) -> dict[str, str]:
        """What is wrong now, by kind."""
        return {name: kind.current for name, kind in self._kinds.items() if kind.current}

    def add(self, name: str, text: str) -> None:
        """Take a complaint; one that goes on is said once."""
        kind = self._kinds.setdefault(name, _Kind())
        if text != kind.current:
            kind.left_out += bool(kind.waiting)
            kind.current = kind.waiting = text
            self._speak(kind)

    def settle(self, name: str) -> None:
        """All is well with this kind again."""
        if name in self._kinds:
            self._kinds[name].current = ''

    def flush(self) -> None:
        """Say what has waited long enough; call it now and then."""
        for kind in self._kinds.values():
            self._speak(kind)

    def _speak(self, kind: _Kind) -> None:
        if kind.waiting and self._clock() - kind.said_at >= QUIET_TIME:
            more = f' ({kind.left_out:,} more like this left out)' if kind.left_out else ''
            self._say(kind.waiting + more)
            kind.said_at, kind.waiting, kind.left_out = self._clock(), '', 0
