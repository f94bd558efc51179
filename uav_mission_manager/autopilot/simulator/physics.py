"""Physics of a small multirotor: a point mass with motors and a battery, in SI units.

Horizontal vectors are complex numbers north + i east, so that abs() is the length and
phase() the bearing; altitude and climb count upward from the ground at the origin.
"""

from __future__ import annotations

import cmath
import math
import random
from dataclasses import dataclass

from uav_mission_manager.autopilot.simulator.battery import SMALL_PACK, Pack, SimulatedBattery
from uav_mission_manager.autopilot.simulator.frames import QUAD_X, MotorFrame, motor_loads
from uav_mission_manager.geodesy import Origin

GRAVITY = 9.80665
"""Standard gravity [m/s2]."""

MAX_ACCELERATION, MAX_CLIMB_ACCELERATION = 2.5, 1.0
"""Largest change of the horizontal and of the vertical velocity [m/s2]. ArduCopter's defaults
(WPNAV_ACCEL, WPNAV_ACCEL_Z)."""

MAX_AIRSPEED = 18.0
"""Airspeed that the vehicle can hold [m/s]: a choice, for a small quadrotor."""

DRAG = 0.25
"""Deceleration in level flight over airspeed [1/s]: a choice."""

FALL_DRAG = 0.02
"""Deceleration in a fall over the sink rate squared [1/m]: a choice, some 22 m/s at the end."""

MAX_YAW_RATE = math.radians(90.0)
"""Fastest turn towards the course [rad/s]: a choice."""

STOPPED_PWM, MIN_SPINNING_PWM, HOVER_PWM, MAX_PWM = 1000.0, 1100.0, 1589.0, 1950.0
"""Outputs [us] of a motor at rest, idling, in hover and at its limit. Measured on ArduCopter."""

HOVER_SPAN, MAX_SPAN = HOVER_PWM - STOPPED_PWM, MAX_PWM - STOPPED_PWM
"""What hovering and the limit are above a motor at rest [us]; thrust is proportional to it."""

PWM_NOISE = 2.0
"""Standard deviation of the outputs [us]: a choice."""

REAR_MOTOR_LOAD = 0.0015
"""How much harder rear motors work, front ones less, over airspeed [1/(m/s)]: a choice."""

AIRSPEED_LOAD = 3e-4
"""Extra thrust over airspeed squared [1/(m/s)2]: a choice."""

TIPPING_FACTOR = 4.0
"""How much faster than thrust alone says a vehicle falls that its weak corner tips: a choice."""

IDLE_POWER, AVIONICS_POWER = 15.0, 5.0
"""Power of idling motors, and of what is always on [W]: choices."""

DRAG_POWER = 0.03
"""Extra power over airspeed cubed [W/(m/s)3]: a choice."""


@dataclass(frozen=True)
class SimulatedOrigin:
    """Geodetic origin of the local frame: degrees, metres above sea level."""

    latitude: float
    longitude: float
    altitude: float

    @property
    def _plane(self) -> Origin:
        return Origin(self.latitude, self.longitude, self.altitude)

    def to_geodetic(self, position: complex) -> tuple[float, float]:
        """Latitude and longitude [deg] of a local position."""
        return self._plane.to_geodetic(position.imag, position.real)

    def to_local(self, latitude: float, longitude: float) -> complex:
        """Local position of a latitude and longitude [deg]."""
        east, north = self._plane.to_local(latitude, longitude)
        return complex(north, east)


@dataclass(frozen=True)
class Demand:
    """What the flight modes ask of the body; a velocity of None lets it drift level."""

    velocity: complex | None
    climb: float


@dataclass(frozen=True)
class Conditions:
    """What is done to the body: wind velocity, motor effectiveness 0-1, battery."""

    wind: complex = 0j
    effectiveness: tuple[float, ...] = (1.0,) * 4  # as many as the frame has motors
    capacity: float = 5.0  # [Ah]
    forced_voltage: float = 0.0  # [V]; 0: from the charge


class Multirotor:
    """The body, moved by `step`; it starts on the ground at the origin, facing north."""

    def __init__(self, seed: int = 0, frame: MotorFrame = QUAD_X, pack: Pack = SMALL_PACK) -> None:
        self.frame = frame
        self._hover_power = pack.hover_power
        self.position = 0j
        self.altitude = 0.0
        self.velocity = 0j
        self.climb = 0.0
        self.heading = 0.0
        self.tilt = 0j  # lean of the thrust [rad], towards north and east
        self.on_ground = True
        self.impact = 0.0  # [m/s] of the last touch-down
        self.thrust_short = False  # the motors cannot carry the weight
        self.motors: tuple[float, ...] = (STOPPED_PWM,) * len(frame.angles)
        self.battery = SimulatedBattery(pack.cells)
        self._random = random.Random(seed)

    def step(self, dt: float, demand: Demand | None, conditions: Conditions, armed: bool) -> None:
        """Move on by `dt` seconds; without a demand the motors stand still or idle."""
        airspeed = abs(self.velocity - conditions.wind)
        load = 1.0 + AIRSPEED_LOAD * airspeed**2
        acceleration = self._move_vertically(dt, demand, load, conditions)
        self._move_horizontally(dt, demand, conditions.wind)
        if demand is None:
            idle = MIN_SPINNING_PWM if armed else STOPPED_PWM
            self.motors = (idle,) * len(self.motors)
            power = IDLE_POWER if armed else 0.0
        else:
            thrust = load * (1.0 + acceleration / GRAVITY)
            self._turn_motors(thrust, airspeed, conditions.effectiveness)
            effort = self.mean_span() / HOVER_SPAN
            power = self._hover_power * effort**1.5 + DRAG_POWER * airspeed**3
        self.battery.drain(
            power + AVIONICS_POWER, dt, conditions.capacity, conditions.forced_voltage
        )

    def mean_span(self) -> float:
        """Mean output of the motors above that of a motor at rest [us]."""
        return sum(self.motors) / len(self.motors) - STOPPED_PWM

    def _move_vertically(
        self, dt: float, demand: Demand | None, load: float, conditions: Conditions
    ) -> float:
        """Climb or fall; return the acceleration upward that the motors are asked for."""
        limit = wanted = -GRAVITY
        if demand is not None:
            reserve = self._lift(conditions) / load - 1.0
            limit = max(-GRAVITY, GRAVITY * reserve * (TIPPING_FACTOR if reserve < 0 else 1.0))
            change = (demand.climb - self.climb) / dt
            wanted = min(max(change, -MAX_CLIMB_ACCELERATION), MAX_CLIMB_ACCELERATION)
        self.thrust_short = demand is not None and limit < 0.0
        acceleration = min(wanted, limit)
        if self.on_ground and acceleration <= 0.0:
            return 0.0
        if limit < 0.0 and self.climb < 0.0:
            acceleration += FALL_DRAG * self.climb**2
        self.climb += acceleration * dt
        self.altitude += self.climb * dt
        self.on_ground = self.altitude <= 0.0 and self.climb <= 0.0
        if self.on_ground:
            self.impact = -self.climb
            self.altitude = self.climb = 0.0
        return wanted

    def _lift(self, conditions: Conditions) -> float:
        """Greatest lift over the weight: the motor that works hardest limits a level vehicle."""
        if self.battery.charge <= 0.0:
            return 0.0
        hover, _ = motor_loads(self.frame, conditions.effectiveness)
        return MAX_SPAN / HOVER_SPAN / max(hover)

    def _move_horizontally(self, dt: float, demand: Demand | None, wind: complex) -> None:
        before = self.velocity
        if self.on_ground:
            self.velocity = before = 0j
        elif demand is None or demand.velocity is None:
            self.velocity += (wind - self.velocity) * DRAG * dt
        else:
            goal = wind + shorten(demand.velocity - wind, MAX_AIRSPEED)
            self.velocity += shorten(goal - self.velocity, MAX_ACCELERATION * dt)
            self._turn_towards(demand.velocity, dt)
        self.position += self.velocity * dt
        push = 0j if self.on_ground else DRAG * (self.velocity - wind)
        lean = ((self.velocity - before) / dt + push) / GRAVITY
        self.tilt = cmath.rect(math.atan(abs(lean)), cmath.phase(lean))

    def _turn_towards(self, velocity: complex, dt: float) -> None:
        if abs(velocity) < 1.0:
            return
        error = cmath.phase(velocity * cmath.exp(-1j * self.heading))
        turn = min(max(error, -MAX_YAW_RATE * dt), MAX_YAW_RATE * dt)
        self.heading = (self.heading + turn) % math.tau

    def _turn_motors(
        self, thrust: float, airspeed: float, effectiveness: tuple[float, ...]
    ) -> None:
        """Set the outputs [us] that give `thrust` (1: the weight) with weakened motors."""
        hover, rear = motor_loads(self.frame, effectiveness)
        lean = REAR_MOTOR_LOAD * airspeed
        spans = (HOVER_SPAN * thrust * (a + lean * b) for a, b in zip(hover, rear, strict=True))
        noisy = (STOPPED_PWM + span + self._random.gauss(0.0, PWM_NOISE) for span in spans)
        self.motors = tuple(min(max(pwm, MIN_SPINNING_PWM), MAX_PWM) for pwm in noisy)


def shorten(vector: complex, length: float) -> complex:
    """Return `vector`, no longer than `length`."""
    size = abs(vector)
    return vector if size <= length else vector * (length / size)


def approach_speed(distance: float, limit: float, acceleration: float) -> float:
    """Speed at which one can still stop at `distance`, at most `limit`; soft at the end."""
    knee = acceleration  # [m]; within it, 1 m/s for each metre
    if distance <= knee:
        return min(distance, limit)
    return min(math.sqrt(2.0 * acceleration * (distance - knee / 2.0)), limit)
