"""What is known of the vehicle's state: how it comes after boot, and how it goes without GPS."""

from __future__ import annotations

import math

START_SHARE, ATTITUDE_SHARE, FIX_SHARE, ORIGIN_SHARE, CALM_SHARE = 0.065, 0.145, 0.24, 0.48, 0.565
"""Parts of the boot after which the autopilot runs, the attitude is known, GPS has a fix, home is
known, and the inertial sensors agree. Measured on ArduCopter, which needs 41.5 s in all."""

GPS_TIMEOUT = 1.0
"""Time [s] without signals after which the receiver has no fix: a choice; ArduCopter was seen to
take 1 s to 3 s."""

DEAD_RECKONING_TIME = 8.0
"""Time [s] without signals for which the estimator keeps a position. Measured on ArduCopter."""

AIDING_TIME = 16.0
"""Time [s] without signals after which the estimator stops to look for a position and holds one.
Measured on ArduCopter."""


class Estimator:
    """What is known since boot, `boot_seconds` before there is a position.

    Attributes
    ----------
    started, attitude_ok, calm : bool
        Whether the autopilot runs, knows the attitude, and has inertial sensors that agree.
    gps_fix, gps_found : bool
        Whether the receiver has a fix, and had one since boot. From then on a position is told,
        long before the estimator has one to fly by.
    home_known : bool
        Whether home has a place.
    position_ok : bool
        Whether there is a position to fly by; it lives on for a while without GPS.
    coasting : bool
        Whether that position was lost a short while ago.
    """

    def __init__(self, boot_seconds: float) -> None:
        self._boot_seconds = boot_seconds
        self._silent = math.inf  # [s] since the last signals
        self.started = self.attitude_ok = self.calm = False
        self.gps_fix = self.gps_found = False
        self.home_known = self.position_ok = self.coasting = False

    def update(self, time: float, dt: float, signals: bool) -> None:
        """Go on by `dt` seconds, with GPS signals or without; `time` counts from boot."""
        share = time / self._boot_seconds
        self.started = share >= START_SHARE
        self.attitude_ok = share >= ATTITUDE_SHARE
        self.calm = share >= CALM_SHARE
        self._silent = 0.0 if signals and share >= FIX_SHARE else self._silent + dt
        self.gps_fix = self._silent < GPS_TIMEOUT
        self.gps_found |= self.gps_fix
        self.home_known |= self.gps_fix and share >= ORIGIN_SHARE
        had = self.position_ok or self.coasting
        keeps = self.position_ok and self._silent < DEAD_RECKONING_TIME
        self.position_ok = share >= 1.0 and (self.gps_fix or keeps)
        self.coasting = had and not self.position_ok and self._silent < AIDING_TIME
