"""The receiver's fix and the estimator's position: how they come after boot, and how they go."""

from __future__ import annotations

import math

ATTITUDE_SHARE, FIX_SHARE = 0.3, 0.6
"""Parts of the boot after which the attitude is known and the receiver has a fix: choices.
ArduCopter, which needs some 42 s for a position, has both well before."""

GPS_TIMEOUT = 1.0
"""Time [s] without signals after which the receiver has no fix: a choice; ArduCopter was seen to
take no more than 3 s."""

DEAD_RECKONING_TIME = 8.0
"""Time [s] without signals for which the estimator keeps a position. Measured on ArduCopter."""


class Estimator:
    """What is known of attitude and position, `boot_seconds` from power-up to a position.

    Attributes
    ----------
    attitude_ok, gps_found, gps_fix, position_ok : bool
        Whether there is an attitude, was a fix since boot, is a fix, is a position; the position
        lives on for a while without GPS.
    located : bool
        Whether there was a position since boot: from then on one is reported, right or wrong.
    """

    def __init__(self, boot_seconds: float) -> None:
        self._boot_seconds = boot_seconds
        self._silent = math.inf  # [s] since the last signals
        self.attitude_ok = self.gps_found = self.gps_fix = False
        self.position_ok = self.located = False

    def update(self, time: float, dt: float, signals: bool) -> None:
        """Go on by `dt` seconds, with GPS signals or without; `time` counts from boot."""
        share = time / self._boot_seconds
        self._silent = 0.0 if signals and share >= FIX_SHARE else self._silent + dt
        self.attitude_ok = share >= ATTITUDE_SHARE
        self.gps_fix = self._silent < GPS_TIMEOUT
        self.gps_found |= self.gps_fix
        was_ok = self.position_ok
        known = self.gps_fix or (was_ok and self._silent < DEAD_RECKONING_TIME)
        self.position_ok = share >= 1.0 and known
        self.located |= self.position_ok
