"""Flight modes, arming and failsafes of the simulated autopilot, without MAVLink."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from uav_mission_manager.autopilot.simulator.battery import BatteryMonitor
from uav_mission_manager.autopilot.simulator.modes import (
    ARMABLE_MODES,
    BATTERY_FAILSAFE_MODES,
    MODES_WITHOUT_POSITION,
    SimulatedMode,
)
from uav_mission_manager.autopilot.simulator.parameters import Parameters
from uav_mission_manager.autopilot.simulator.physics import (
    MAX_ACCELERATION,
    MAX_CLIMB_ACCELERATION,
    Conditions,
    Demand,
    Multirotor,
    SimulatedOrigin,
    approach_speed,
    shorten,
)

GPS_TIMEOUT = 1.0
"""Time [s] without signals after which the receiver has no fix: a choice; ArduCopter was seen to
take no more than 3 s."""

DEAD_RECKONING_TIME = 8.0
"""Time [s] without signals for which the estimator keeps a position. Measured on ArduCopter."""

THRUST_LOSS_TIME = 1.0
"""Time [s] of too little thrust after which it is reported, as in ArduCopter's own check."""

CRASH_SPEED = 2.5
"""Sink rate [m/s] of a touch-down above which the vehicle has crashed: a choice."""

LAND_SLOW_ALTITUDE = 10.0
"""Altitude [m] below which LAND descends slowly: ArduCopter's default (LAND_ALT_LOW)."""

TOUCHDOWN_TIME = 1.0
"""Time [s] on the ground before a landing disarms, as of ArduCopter's land detector."""

STABILIZE_SINK_RATE = 5.0
"""Descent [m/s] in STABILIZE with nobody at the sticks: a choice."""

ARRIVAL_RADIUS = 1.0
"""Distance [m] within which home is reached, half of it for RTL's altitude, a quarter for that of
a take-off: choices."""

CRITICAL, WARNING, INFO = 2, 4, 6
"""Severities of a text to the pilot: MAVLink's numbers (MAV_SEVERITY)."""

SPEED_PARAMETERS = ('WPNAV_SPEED', 'WPNAV_SPEED', 'WPNAV_SPEED_UP', 'WPNAV_SPEED_DN')
"""Name of the speed that MAV_CMD_DO_CHANGE_SPEED sets, by its param 1."""


@dataclass(frozen=True)
class Home:
    """Where RTL ends: local position, altitude over the origin [m]; locked once set by hand."""

    position: complex = 0j
    altitude: float = 0.0
    locked: bool = False


class SimulatedFlight:
    """A vehicle in flight or on the ground; `step` moves it on, methods command it.

    A command returns whether it was taken. What there is to tell the pilot is appended
    to `texts` as (severity, text); the caller takes it from there.
    """

    def __init__(self, origin: SimulatedOrigin, boot_seconds: float = 5.0, seed: int = 0) -> None:
        self.origin = origin
        self.parameters = Parameters()
        self.body = Multirotor(seed)
        self.home = Home()
        self.battery = BatteryMonitor()
        self.texts: list[tuple[int, str]] = []
        self.time = 0.0
        self.armed = False
        self.mode = SimulatedMode.STABILIZE
        self.taking_off = False
        self.landing = False
        self.thrust_loss = False
        self._boot_seconds = boot_seconds
        self._steps = 0
        self._gps_silent = 0.0
        self._ekf_failsafe = False
        self._short = self._ground_time = self._arrived = 0.0
        self._returning = False
        self._target, self._target_altitude = 0j, 0.0
        self._speeds: dict[str, float] = {}

    # What can be seen from outside

    @property
    def booted(self) -> bool:
        """Whether the estimator has settled after start-up."""
        return self.time >= self._boot_seconds

    @property
    def gps_fix(self) -> bool:
        """Whether the receiver has a position."""
        return self.booted and self._gps_silent < GPS_TIMEOUT

    @property
    def position_ok(self) -> bool:
        """Whether the estimator has a position; it lives on for a while without GPS."""
        return self.booted and self._gps_silent < DEAD_RECKONING_TIME

    @property
    def failsafe(self) -> bool:
        """Whether a failsafe is active."""
        return self._ekf_failsafe or (self.armed and self.battery.level > 0)

    @property
    def wind(self) -> complex:
        """Velocity of the air [m/s]."""
        bearing = math.radians(self.parameters['SIM_WIND_DIR'])
        return -cmath.rect(self.parameters['SIM_WIND_SPD'], bearing)

    def arming_faults(self) -> list[str]:
        """Name what keeps the vehicle from arming, in ArduPilot's words; empty when ready."""
        checks = (
            (self.booted, 'EKF3 still initialising'),
            (self.position_ok and self.gps_fix, 'Need Position Estimate'),
            (not self.parameters['SIM_MAG1_FAIL'], 'Compass not healthy'),
            (not self.parameters['SIM_BARO_DISABLE'], 'Barometer not healthy'),
            (self.battery.level == 0, 'Battery 1 low voltage failsafe'),
        )
        return [f'PreArm: {text}' for passed, text in checks if not passed]

    # Commands

    def arm(self, force: bool = False) -> bool:
        """Start the motors; home moves here unless it was set by hand."""
        if self.armed:
            return True
        faults = [] if force else self.arming_faults()
        if self.mode not in ARMABLE_MODES:
            faults.append(f'Arm: {self.mode.name} mode not armable')
        self.texts += [(CRITICAL, text) for text in faults]
        if faults:
            return False
        if not self.home.locked:
            self.home = Home(self.body.position, self.body.altitude)
        self.armed = True
        self._ground_time = 0.0
        self.texts.append((INFO, 'Arming motors'))
        return True

    def disarm(self, force: bool = False) -> bool:
        """Stop the motors: on the ground, or anywhere by force."""
        if self.armed and not self.body.on_ground and not force:
            return False
        if self.armed:
            self.armed = self.taking_off = self.thrust_loss = False
            self._ekf_failsafe = False
            self.texts.append((INFO, 'Disarming motors'))
        return True

    def set_mode(self, number: int) -> bool:
        """Change the flight mode; AUTO needs a mission, which cannot be uploaded."""
        name, reason = str(number), ''
        if number not in set(SimulatedMode):
            reason = 'no such mode'
        else:
            name = SimulatedMode(number).name
            if number not in MODES_WITHOUT_POSITION and not self.position_ok:
                reason = 'requires position'
            elif number == SimulatedMode.AUTO:
                reason = 'init failed'
        if reason:
            self.texts.append((WARNING, f'Mode change to {name} failed: {reason}'))
        elif number != self.mode:
            self._enter(SimulatedMode(number))
        return not reason

    def take_off(self, altitude: float) -> bool:
        """Climb to `altitude` [m] over home; only armed, in GUIDED and on the ground."""
        if not (self.armed and self.mode == SimulatedMode.GUIDED and self.body.on_ground):
            return False
        if self.taking_off or self.home.altitude + altitude <= self.body.altitude:
            return False
        self.go_to(self.body.position, self.home.altitude + altitude)
        self.taking_off = True
        return True

    def go_to(self, position: complex, altitude: float) -> bool:
        """Fly to a local position and altitude over the origin [m]; only in GUIDED.

        On the ground it is taken but lifts nothing: that needs `take_off`.
        """
        if self.mode != SimulatedMode.GUIDED:
            return False
        self._target, self._target_altitude = position, altitude
        self.taking_off = False
        return True

    def set_speed(self, kind: int, speed: float) -> bool:
        """Set the speed [m/s] over ground (0, 1), up (2) or down (3) until the mode changes."""
        if self.mode not in (SimulatedMode.GUIDED, SimulatedMode.RTL):
            return False
        self._speeds[SPEED_PARAMETERS[kind]] = speed
        return True

    # One step

    def step(self, dt: float) -> None:
        """Move on by `dt` seconds of simulated time."""
        self._steps += 1
        self.time = self._steps * dt
        self._watch(dt)
        demand = self._demand(dt) if self.armed else None
        was_on_ground = self.body.on_ground
        self.body.step(dt, demand, self._conditions(), self.armed)
        if self.body.on_ground:
            self._rest(dt, touched=not was_on_ground)
        else:
            self._ground_time = 0.0

    def set_charge(self, percent: float) -> None:
        """Set the battery's charge now."""
        self.body.battery.charge = percent / 100.0

    def _conditions(self) -> Conditions:
        weak = int(self.parameters['SIM_ENGINE_FAIL'])
        share = self.parameters['SIM_ENGINE_MUL']
        a, b, c, d = (share if weak >> motor & 1 else 1.0 for motor in range(4))
        return Conditions(
            self.wind,
            (a, b, c, d),
            self.parameters['SIM_BATT_CAP_AH'],
            self.parameters['SIM_BATT_VOLTAGE'],
        )

    def _watch(self, dt: float) -> None:
        """Failsafes."""
        self._gps_silent = 0.0 if self.parameters['SIM_GPS1_ENABLE'] else self._gps_silent + dt
        battery = self.body.battery
        if self.battery.update(dt, battery.voltage, self.parameters, self.armed):
            name, mode = BATTERY_FAILSAFE_MODES[self.battery.level - 1]
            self.texts.append((WARNING, f'Battery 1 is {name} {battery.voltage:.2f}V'))
            self.texts.append((WARNING, 'Battery Failsafe'))
            self._flee(mode)
        lost = self.armed and not self.position_ok
        if lost and not self._ekf_failsafe and self.mode != SimulatedMode.STABILIZE:
            self.texts.append((CRITICAL, 'EKF Failsafe: changed to LAND Mode'))
            self._enter(SimulatedMode.LAND)
        self._ekf_failsafe = lost
        self._short = self._short + dt if self.body.thrust_short else 0.0
        if self._short > THRUST_LOSS_TIME and self.armed and not self.thrust_loss:
            self.thrust_loss = True
            self.texts.append((CRITICAL, 'Potential Thrust Loss (1)'))

    def _flee(self, mode: SimulatedMode) -> None:
        """Change to a failsafe's mode, never out of LAND; on the ground disarm."""
        if self.body.on_ground:
            self.disarm()
        elif self.mode != SimulatedMode.LAND and self.mode != mode:
            self._enter(mode if self.position_ok else SimulatedMode.LAND)

    def _rest(self, dt: float, touched: bool) -> None:
        """On the ground: crash, end of a landing, or armed too long without a take-off."""
        self._ground_time = 0.0 if touched or self.taking_off else self._ground_time + dt
        crashed = touched and self.body.impact > CRASH_SPEED
        if not self.armed:
            return
        if crashed:
            self.texts.append((CRITICAL, 'Crash: Disarming'))
        ending = self.mode in (SimulatedMode.LAND, SimulatedMode.RTL)
        limit = TOUCHDOWN_TIME if ending else self.parameters['DISARM_DELAY']
        if crashed or 0.0 < limit <= self._ground_time:
            self.disarm()

    # The modes

    def _enter(self, mode: SimulatedMode) -> None:
        self.mode = mode
        self.taking_off = False
        self.landing = mode == SimulatedMode.LAND
        self._speeds.clear()
        self._target, self._target_altitude = self._stopping_point(), self.body.altitude
        self._returning = False
        self._arrived = 0.0
        if mode == SimulatedMode.RTL:
            height = self.home.altitude + self.parameters['RTL_ALT'] / 100.0
            self._target_altitude = max(self.body.altitude, height)

    def _stopping_point(self) -> complex:
        velocity = self.body.velocity
        return self.body.position + velocity * abs(velocity) / (2.0 * MAX_ACCELERATION)

    def _speed(self, name: str) -> float:
        return self._speeds.get(name, self.parameters[name] / 100.0)

    def _demand(self, dt: float) -> Demand | None:
        """Ask of the body what the mode wants; None rests on the ground."""
        if self.body.on_ground and not self.taking_off:
            return None
        if self.mode == SimulatedMode.STABILIZE:
            return Demand(None, -STABILIZE_SINK_RATE)
        if self.mode == SimulatedMode.RTL and not self.landing:
            self._return(dt)
        if self.landing:
            return Demand(self._to_target() if self.position_ok else None, -self._sink())
        if self.taking_off and self.body.altitude > self._target_altitude - ARRIVAL_RADIUS / 4.0:
            self.taking_off = False
        return Demand(self._to_target(), self._to_altitude())

    def _return(self, dt: float) -> None:
        """RTL: climb, fly home, wait, then land."""
        if not self._returning:
            if self.body.altitude < self._target_altitude - ARRIVAL_RADIUS / 2.0:
                return
            self._returning = True
            self._target = self.home.position
        if abs(self.home.position - self.body.position) < ARRIVAL_RADIUS:
            self._arrived += dt
        self.landing = self._arrived > self.parameters['RTL_LOIT_TIME'] / 1000.0

    def _to_target(self) -> complex:
        error = self._target - self.body.position
        limit = self._speed('WPNAV_SPEED')
        return shorten(error, approach_speed(abs(error), limit, MAX_ACCELERATION))

    def _to_altitude(self) -> float:
        error = self._target_altitude - self.body.altitude
        limit = self._speed('WPNAV_SPEED_UP' if error > 0.0 else 'WPNAV_SPEED_DN')
        return math.copysign(approach_speed(abs(error), limit, MAX_CLIMB_ACCELERATION), error)

    def _sink(self) -> float:
        """Descent rate of a landing [m/s]."""
        slow = self._speed('LAND_SPEED')
        above = self.body.altitude - LAND_SLOW_ALTITUDE
        if above <= 0.0:
            return slow
        return max(
            slow, approach_speed(above, self._speed('WPNAV_SPEED_DN'), MAX_CLIMB_ACCELERATION)
        )
