"""One leg of a flight, watched for progress."""

from __future__ import annotations

import math
from dataclasses import replace

from uav_mission_manager.autopilot.telemetry import Position
from uav_mission_manager.autopilot.vehicle import Fly

PROGRESS_STEP = 1.0
"""How much nearer [m] the vehicle must get for that to count as progress: a choice."""

LOST_GROUND = 10.0
"""How much farther away [m] than before the vehicle must be to count as carried away: a choice."""


class Leg:
    """A flight to a point, with the climb before it, and how near the vehicle has come.

    Parameters
    ----------
    end : Fly
        Where it leads.
    now : float
        Time [s] when it begins.

    Attributes
    ----------
    blocked_at : float or None
        Time [s] since when it is known to lead nowhere.
    losing_ground : bool
        Whether the vehicle is farther away than it has been.
    """

    def __init__(self, end: Fly, now: float) -> None:
        self._end = end
        self._best = math.inf
        self._better_at = now
        self.blocked_at: float | None = None
        self.losing_ground = False

    def same(self, end: Fly) -> bool:
        """Whether a flight leads to the same end, at whatever speed."""
        return replace(end, speed=self._end.speed) == self._end

    def watch(self, position: Position, now: float) -> None:
        """Take note of where the vehicle is."""
        left = position.distance_to(self._end.latitude, self._end.longitude)
        left += abs(position.altitude - self._end.altitude)
        self.losing_ground = left > self._best + LOST_GROUND
        if left < self._best - PROGRESS_STEP:
            self._best, self._better_at = left, now

    def stuck(self, timeout: float, now: float) -> str:
        """Say so where the vehicle has got no nearer for `timeout` [s], '' where it has."""
        if now - self._better_at <= timeout:
            return ''
        return f'no nearer for {timeout:.0f} s' + (', carried away' if self.losing_ground else '')
