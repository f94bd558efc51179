"""Where the flight mode in force wants to go, and how fast."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_mission_manager.autopilot.simulator.modes import SimulatedMode
from uav_mission_manager.autopilot.simulator.parameters import Parameters
from uav_mission_manager.autopilot.simulator.physics import (
    MAX_ACCELERATION,
    MAX_CLIMB_ACCELERATION,
    Demand,
    Multirotor,
    approach_speed,
    shorten,
)

LAND_SLOW_ALTITUDE = 10.0
"""Altitude [m] below which LAND descends slowly: ArduCopter's default (LAND_ALT_LOW)."""

STABILIZE_SINK_RATE = 5.0
"""Descent [m/s] in STABILIZE with nobody at the sticks: a choice."""

ARRIVAL_RADIUS = 1.0
"""Distance [m] within which home is reached, half of it for RTL's altitude, a quarter for that of
a take-off: choices."""

SPEED_PARAMETERS = ('WPNAV_SPEED', 'WPNAV_SPEED', 'WPNAV_SPEED_UP', 'WPNAV_SPEED_DN')
"""Name of the speed that MAV_CMD_DO_CHANGE_SPEED sets, by its param 1."""


@dataclass(frozen=True)
class Home:
    """Where RTL ends: local position, altitude over the origin [m]; locked once set by hand."""

    position: complex = 0j
    altitude: float = 0.0
    locked: bool = False


class Guidance:
    """The mode and its target; it is asked for a demand on the body at every step."""

    def __init__(self, body: Multirotor, parameters: Parameters) -> None:
        self.mode = SimulatedMode.STABILIZE
        self.taking_off = False
        self.landing = False
        self._body, self._parameters = body, parameters
        self._target, self._target_altitude = body.position, body.altitude
        self._speeds: dict[str, float] = {}
        self._to_position = False  # GUIDED flies to a position that was commanded
        self._spooling = self._arrived = 0.0
        self._returning = False

    def enter(self, mode: SimulatedMode, home: Home) -> None:
        """Begin a mode."""
        body = self._body
        self.mode = mode
        self.taking_off = self._to_position = False
        self.landing = mode == SimulatedMode.LAND
        self._speeds.clear()
        stop = body.velocity * abs(body.velocity) / (2.0 * MAX_ACCELERATION)
        self._target, self._target_altitude = body.position + stop, body.altitude
        self._returning = False
        self._arrived = 0.0
        if mode == SimulatedMode.RTL:
            height = home.altitude + self._parameters['RTL_ALT'] / 100.0
            self._target_altitude = max(body.altitude, height)

    def take_off(self, altitude: float, wait: float) -> None:
        """Climb to an altitude over the origin [m], after `wait` seconds for the motors."""
        if not self.taking_off:
            self._spooling = wait
        self._target, self._target_altitude = self._body.position, altitude
        self.taking_off, self._to_position = True, False

    def go_to(self, position: complex, altitude: float) -> None:
        """Fly to a position and altitude [m].

        The first such target after a take-off or a change of mode forgets the speeds set, as
        ArduCopter does on entering its position submode; the next ones keep them.
        """
        if not self._to_position:
            self._speeds.clear()
        self._target, self._target_altitude = position, altitude
        self.taking_off, self._to_position = False, True

    def set_speed(self, kind: int, speed: float) -> None:
        """Set the speed [m/s] over ground (0, 1), up (2) or down (3)."""
        self._speeds[SPEED_PARAMETERS[kind]] = speed

    def demand(self, dt: float, home: Home, position_ok: bool) -> Demand | None:
        """Ask of the body what the mode wants; None rests on the ground."""
        body = self._body
        if body.on_ground and not self._lifts_off(dt):
            return None
        if self.mode == SimulatedMode.STABILIZE:
            return Demand(None, -STABILIZE_SINK_RATE)
        if self.mode == SimulatedMode.RTL and not self.landing:
            self._return(dt, home)
        if self.landing:
            return Demand(self._to_target() if position_ok else None, -self._sink())
        if self.taking_off and body.altitude > self._target_altitude - ARRIVAL_RADIUS / 4.0:
            self.taking_off = False
        return Demand(self._to_target(), self._to_altitude())

    def _lifts_off(self, dt: float) -> bool:
        self._spooling = max(self._spooling - dt, 0.0)
        return self.taking_off and self._spooling == 0.0

    def _return(self, dt: float, home: Home) -> None:
        """RTL: climb, fly home, wait, then land."""
        if not self._returning:
            if self._body.altitude < self._target_altitude - ARRIVAL_RADIUS / 2.0:
                return
            self._returning = True
            self._target = home.position
        if abs(home.position - self._body.position) < ARRIVAL_RADIUS:
            self._arrived += dt
        self.landing = self._arrived > self._parameters['RTL_LOIT_TIME'] / 1000.0

    def _speed(self, name: str) -> float:
        return self._speeds.get(name, self._parameters[name] / 100.0)

    def _to_target(self) -> complex:
        error = self._target - self._body.position
        limit = self._speed('WPNAV_SPEED')
        return shorten(error, approach_speed(abs(error), limit, MAX_ACCELERATION))

    def _to_altitude(self) -> float:
        error = self._target_altitude - self._body.altitude
        limit = self._speed('WPNAV_SPEED_UP' if error > 0.0 else 'WPNAV_SPEED_DN')
        return math.copysign(approach_speed(abs(error), limit, MAX_CLIMB_ACCELERATION), error)

    def _sink(self) -> float:
        """Descent rate of a landing [m/s]."""
        slow = self._speed('LAND_SPEED')
        above = self._body.altitude - LAND_SLOW_ALTITUDE
        if above <= 0.0:
            return slow
        fast = self._speed('WPNAV_SPEED_DN')
        return max(slow, approach_speed(above, fast, MAX_CLIMB_ACCELERATION))
