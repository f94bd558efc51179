"""Wind with gusts."""

from __future__ import annotations

import cmath
import math
import random

from uav_mission_manager.autopilot.simulator.parameters import Parameters

GUST_TIME = 3.0
"""Time [s] in which a gust fades to 1/e: a choice, that of a few lengths of the vehicle's leg."""


class SimulatedWind:
    """Velocity of the air [m/s]: mean wind, and gusts that come and go on both axes."""

    def __init__(self, seed: int = 0) -> None:
        self.velocity = 0j
        self._gust = 0j  # of unit standard deviation on either axis
        self._random = random.Random(seed)

    def update(self, dt: float, parameters: Parameters) -> None:
        """Move on by `dt` seconds."""
        bearing = math.radians(parameters['SIM_WIND_DIR'])
        self.velocity = -cmath.rect(parameters['SIM_WIND_SPD'], bearing)
        strength = parameters['SIM_WIND_TURB']
        if strength:
            kept = math.exp(-dt / GUST_TIME)
            new = complex(self._random.gauss(0.0, 1.0), self._random.gauss(0.0, 1.0))
            self._gust = kept * self._gust + math.sqrt(1.0 - kept**2) * new
            self.velocity += strength * self._gust
