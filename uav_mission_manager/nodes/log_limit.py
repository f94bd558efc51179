"""How many lines of one kind a log takes, however fast they come."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

BURST = 10
"""Lines of a kind that may come at once: a choice, as many as an autopilot says that boots."""

LINE_PERIOD = 3.0
"""Time [s] after which one more line passes: a choice, for a log that a person can follow."""


@dataclass
class _Allowance:
    lines: float
    at: float
    left_out: int = 0


class LogLimit:
    """Lets a burst of lines of each kind pass, then one in `LINE_PERIOD`.

    Parameters
    ----------
    clock : callable
        Returns a time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._kinds: dict[str, _Allowance] = {}

    def passed(self, kind: str, text: str) -> str:
        """Return the line to log, with the number of those left out before; '' for none."""
        now = self._clock()
        kept = self._kinds.setdefault(kind, _Allowance(BURST, now))
        kept.lines = min(kept.lines + (now - kept.at) / LINE_PERIOD, BURST)
        kept.at = now
        if kept.lines < 1.0:
            kept.left_out += 1
            return ''
        more = f' ({kept.left_out:,} lines before it left out)' if kept.left_out else ''
        kept.lines, kept.left_out = kept.lines - 1.0, 0
        return text + more
