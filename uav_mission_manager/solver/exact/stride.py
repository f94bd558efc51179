"""Sweeps that go further than a backup, where backups come closer but slowly.

Where a policy never leaves some states, such as a base that an empty battery holds it at, the
changes d = T W - W soon shrink by hardly more than the discount, and all in one direction: by
lambda d, lambda^2 d, .. The rest of that way is lambda / (1 - lambda) d, so one sweep takes it at
once (Lyusternik 1947). That makes other errors larger, which the sweeps after it take away.
Whatever W a sweep starts from, the bounds that its backup gives hold.
"""

from __future__ import annotations

from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.span_bounds import SpanBounds

PLAIN_SWEEPS = 15
"""Backups between two longer strides, for what a stride made larger to fade: a choice. Measured on
missions with a charge: 145 to 185 sweeps in place of 185 to 370."""

SLOW = 0.9
"""Part of the discount by which the span shrinks at the fastest before a longer stride."""


class Stride:
    """How far the next sweep goes; with range flags, where it hardly matters, never further.

    Parameters
    ----------
    mission : Mission

    Attributes
    ----------
    further : float
        By how many times its change the next sweep goes on; 0 for a plain backup.
    """

    def __init__(self, mission: Mission) -> None:
        self.discount, self.further = mission.discount, 0.0
        self._helps = mission.range.charge is not None
        self._plain, self._span, self._long_ago = 0, 0.0, 0.0

    def note(self, bounds: SpanBounds) -> None:
        """Take note of a sweep."""
        if self.further:
            self.further, self._plain, self._span, self._long_ago = 0.0, 0, 0.0, bounds.span
            return
        self._plain += 1
        before, self._span = self._span, bounds.span
        if self._plain < PLAIN_SWEEPS or not before or not self._helps:
            return
        guaranteed = self.discount ** (self._plain + 1) * self._long_ago
        if self._long_ago and not bounds.span < guaranteed:
            self._helps = False
        elif bounds.span >= SLOW * self.discount * before:
            shrinks = min(bounds.span / before, self.discount)
            self.further = shrinks / (1 - shrinks)
