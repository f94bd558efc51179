"""Arming, commands and state of the simulated autopilot, without MAVLink."""

from __future__ import annotations

from uav_mission_manager.autopilot.simulator.battery import (
    LOW_CELL,
    SMALL_PACK,
    BatteryMonitor,
    Pack,
)
from uav_mission_manager.autopilot.simulator.estimator import Estimator
from uav_mission_manager.autopilot.simulator.failsafes import CRITICAL, INFO, WARNING, Failsafes
from uav_mission_manager.autopilot.simulator.frames import QUAD_X, MotorFrame
from uav_mission_manager.autopilot.simulator.guidance import Guidance, Home
from uav_mission_manager.autopilot.simulator.modes import (
    ARMABLE_MODES,
    MODES_WITHOUT_POSITION,
    SimulatedMode,
)
from uav_mission_manager.autopilot.simulator.parameters import Parameters
from uav_mission_manager.autopilot.simulator.physics import (
    Conditions,
    Multirotor,
    SimulatedOrigin,
)
from uav_mission_manager.autopilot.simulator.wind import SimulatedWind

CRASH_SPEED = 2.5
"""Sink rate [m/s] of a touch-down above which the vehicle has crashed: a choice."""

LANDED_TIME, TOUCHDOWN_TIME = 1.6, 2.1
"""Time [s] on the ground before the autopilot believes it, and before a landing disarms. Measured
on ArduCopter."""

ARMING_TO_LIFT_OFF, TAKE_OFF_TO_LIFT_OFF = 3.4, 1.0
"""Time [s] from arming and from an accepted take-off to lift-off, whichever is later. Measured on
ArduCopter, whose motors wait, then spool up."""

REBOOT_TIME = 1.0
"""Time [s] of a reboot in which nothing is sent or heard: a choice; ArduCopter's was below 3 s."""

ARMING_CHECK_PERIOD, ARMING_NEWS_PERIOD, ARMING_REPORT_PERIOD = 1.0, 4.0, 30.0
"""Time [s] between two looks at what keeps the vehicle from arming, and between two reports of it
unasked, when it has just begun and when it lasts. ArduCopter's."""

MAX_LOW_THROTTLE = 1030.0
"""Throttle [us] that counts as low for arming: ArduCopter's defaults, RC3_MIN and RC3_DZ."""


class SimulatedFlight:
    """A vehicle in flight or on the ground; `step` moves it on, methods command it.

    A command returns whether it was taken. What there is to tell the pilot is appended
    to `texts` as (severity, text); the caller takes it from there.

    Attributes
    ----------
    time : float
        Seconds since boot; below 0 the autopilot is rebooting, and deaf and mute.
    boots : int
        Reboots so far.
    landed : bool
        Whether the autopilot believes that it is on the ground: a while after touch-down, and
        always when the motors stand still.
    """

    def __init__(
        self,
        origin: SimulatedOrigin,
        boot_seconds: float = 5.0,
        seed: int = 0,
        frame: MotorFrame = QUAD_X,
        pack: Pack = SMALL_PACK,
    ) -> None:
        self.origin = origin
        self.parameters = Parameters()
        self.parameters['SIM_BATT_CAP_AH'] = pack.capacity
        self.parameters['BATT_LOW_VOLT'] = LOW_CELL * pack.cells
        self.body = Multirotor(seed, frame, pack)
        self.boots = 0
        self._boot_seconds = boot_seconds
        self._wind = SimulatedWind(seed)
        self._start(0.0)

    def _start(self, time: float) -> None:
        """Know nothing, as after power-up."""
        self.time = time
        self.texts: list[tuple[int, str]] = []
        self.armed = False
        self.landed = True
        self.home = Home(self.body.position, self.body.altitude)
        self.estimator = Estimator(self._boot_seconds)
        self.failsafes = Failsafes()
        self.guidance = Guidance(self.body, self.parameters)
        self._armed_at = self._ground_time = 0.0
        self._check_due = ARMING_CHECK_PERIOD
        self._reported = 0.0
        self._was_ready = self._news = False
        self.body.battery.start_counting()

    # What can be seen from outside

    @property
    def mode(self) -> SimulatedMode:
        """The flight mode."""
        return self.guidance.mode

    @property
    def taking_off(self) -> bool:
        """Whether a take-off is under way, from its acceptance on."""
        return self.guidance.taking_off

    @property
    def landing(self) -> bool:
        """Whether the mode is descending to land."""
        return self.guidance.landing

    @property
    def position_ok(self) -> bool:
        """Whether the estimator has a position."""
        return self.estimator.position_ok

    @property
    def battery(self) -> BatteryMonitor:
        """The watch over the battery."""
        return self.failsafes.battery

    @property
    def failsafe(self) -> bool:
        """Whether a failsafe is active."""
        return self.failsafes.active

    @property
    def thrust_loss(self) -> bool:
        """Whether the motors were found too weak."""
        return self.failsafes.thrust_loss

    @property
    def wind(self) -> complex:
        """Velocity of the air [m/s]."""
        return self._wind.velocity

    def say(self, severity: int, text: str) -> None:
        """Tell the pilot."""
        self.texts.append((severity, text))

    def arming_faults(self) -> list[str]:
        """Name what keeps the vehicle from arming, in ArduPilot's words; empty when ready."""
        values, voltage = self.parameters, self.body.battery.voltage
        low = max(values['BATT_LOW_VOLT'], values['BATT_CRT_VOLT'])
        throttle_ok = values['SIM_RC3'] >= values['FS_THR_VALUE'] or not values['FS_THR_ENABLE']
        located = self.position_ok and self.estimator.gps_fix
        checks = (
            (self.estimator.attitude_ok, 'EKF attitude is bad'),
            (self.estimator.calm, 'Gyros inconsistent'),
            (located or self.mode in MODES_WITHOUT_POSITION, 'Need Position Estimate'),
            (not values['SIM_MAG1_FAIL'], 'Compass not healthy'),
            (not values['SIM_BARO_DISABLE'], 'Barometer not healthy'),
            (voltage >= low, 'Battery 1 low voltage failsafe'),
            (self.battery.level == 0, 'Battery failsafe'),
            (throttle_ok, 'Throttle below failsafe'),
            (not self.failsafes.radio, 'Radio failsafe on'),
            (not self.failsafes.ground, 'GCS failsafe on'),
        )
        return [text for passed, text in checks if not passed]

    # Commands

    def arm(self, force: bool = False) -> bool:
        """Start the motors; home moves here unless it was set by hand."""
        if self.armed:
            return True
        faults = [] if force else self.arming_faults()
        if not faults and not force and self.parameters['SIM_RC3'] > MAX_LOW_THROTTLE:
            faults.append('Throttle (RC3) is not neutral')
        if self.mode not in ARMABLE_MODES:
            faults.append(f'{self.mode.name} mode not armable')
        for text in faults:
            self.say(CRITICAL, f'Arm: {text}')
        if faults:
            return False
        if not self.home.locked:
            self.home = Home(self.body.position, self.body.altitude)
        self.armed = True
        self._armed_at = self.time
        self._ground_time = 0.0
        self.say(INFO, 'Arming motors')
        return True

    def disarm(self, force: bool = False) -> bool:
        """Stop the motors: on the ground, or anywhere by force."""
        if self.armed and not self.body.on_ground and not force:
            return False
        if self.armed:
            self.armed = self.guidance.taking_off = self.failsafes.thrust_loss = False
            self.landed = True  # as far as the autopilot knows
            self.say(INFO, 'Disarming motors')
        return True

    def set_mode(self, number: int) -> bool:
        """Change the flight mode; armed, its needs are checked, and AUTO has no mission."""
        if number not in set(SimulatedMode):
            self.say(WARNING, f'No such mode {number}')
            return False
        mode, reason = SimulatedMode(number), ''
        if self.armed and mode not in MODES_WITHOUT_POSITION and not self.position_ok:
            reason = 'requires position'
        elif self.armed and mode == SimulatedMode.AUTO:
            reason = 'init failed'
        if reason:
            self.say(WARNING, f'Mode change to {mode.name} failed: {reason}')
        elif mode != self.mode:
            self.change_mode(mode)
        return not reason

    def change_mode(self, mode: SimulatedMode) -> None:
        """Begin a mode, whether or not it can do its work."""
        self.guidance.enter(mode, self.home)

    def take_off(self, altitude: float) -> bool:
        """Climb to `altitude` [m] over home; only armed, in GUIDED and on the ground."""
        if not (self.armed and self.mode == SimulatedMode.GUIDED and self.landed):
            return False
        if self.home.altitude + altitude <= self.body.altitude:
            return False
        spooled_up = self._armed_at + ARMING_TO_LIFT_OFF - self.time
        wait = max(spooled_up, TAKE_OFF_TO_LIFT_OFF)
        self.guidance.take_off(self.home.altitude + altitude, wait)
        return True

    def inside_fence(self, position: complex, altitude: float) -> bool:
        """Whether a local position and altitude [m] are inside the fence, if there is one."""
        if not self.parameters['FENCE_ENABLE']:
            return True
        above = altitude - self.home.altitude
        distance = abs(position - self.home.position)
        limits = self.parameters['FENCE_ALT_MAX'], self.parameters['FENCE_RADIUS']
        return above <= limits[0] and distance <= limits[1]

    def go_to(self, position: complex, altitude: float) -> bool:
        """Fly to a local position and altitude over the origin [m], in GUIDED and in the fence.

        On the ground it is taken but lifts nothing: that needs `take_off`.
        """
        if self.mode != SimulatedMode.GUIDED or not self.inside_fence(position, altitude):
            return False
        self.guidance.go_to(position, altitude)
        return True

    def set_speed(self, kind: int, speed: float) -> bool:
        """Set the speed [m/s] over ground (0, 1), up (2) or down (3) until the mode changes."""
        if self.mode not in (SimulatedMode.GUIDED, SimulatedMode.RTL):
            return False
        self.guidance.set_speed(kind, speed)
        return True

    def set_charge(self, percent: float) -> None:
        """Set the battery's charge now, as by another battery; its failsafe begins anew."""
        self.body.battery.charge = percent / 100.0
        self.battery.reset()

    def reboot(self) -> bool:
        """Start anew where the vehicle is; parameters stay. Only disarmed."""
        if not self.armed:
            self.boots += 1
            self._start(-REBOOT_TIME)
        return not self.armed

    # One step

    def step(self, dt: float) -> None:
        """Move on by `dt` seconds of simulated time."""
        self.time = round(self.time + dt, 9)  # without a sum of rounding errors
        self._wind.update(dt, self.parameters)
        self.estimator.update(self.time, dt, bool(self.parameters['SIM_GPS1_ENABLE']))
        self.failsafes.update(dt, self)
        self._report()
        demand = self.guidance.demand(dt, self.home, self.position_ok) if self.armed else None
        was_on_ground = self.body.on_ground
        self.body.step(dt, demand, self._conditions(), self.armed)
        if self.body.on_ground:
            self._rest(dt, touched=not was_on_ground)
        else:
            self._ground_time = 0.0
            self.landed = not self.armed

    def _report(self) -> None:
        """Tell now and then what keeps the vehicle from arming, and soon when it begins."""
        if self.time < self._check_due:
            return
        self._check_due += ARMING_CHECK_PERIOD
        faults = [] if self.armed else self.arming_faults()
        self._news |= self._was_ready and bool(faults)
        self._was_ready = not faults
        period = ARMING_NEWS_PERIOD if self._news else ARMING_REPORT_PERIOD
        if self.time - self._reported >= period:
            self._reported, self._news = self.time, False
            self.texts += [(CRITICAL, f'PreArm: {text}') for text in faults]

    def _conditions(self) -> Conditions:
        weak = int(self.parameters['SIM_ENGINE_FAIL'])
        share = self.parameters['SIM_ENGINE_MUL']
        motors = range(len(self.body.motors))
        return Conditions(
            self.wind,
            tuple(share if weak >> motor & 1 else 1.0 for motor in motors),
            self.parameters['SIM_BATT_CAP_AH'],
            self.parameters['SIM_BATT_VOLTAGE'],
        )

    def _rest(self, dt: float, touched: bool) -> None:
        """On the ground: crash, end of a landing, or armed too long without a take-off."""
        self._ground_time = 0.0 if touched or self.taking_off else self._ground_time + dt
        self.landed |= self._ground_time >= LANDED_TIME
        crashed = touched and self.body.impact > CRASH_SPEED
        if not self.armed:
            return
        if crashed:
            self.say(CRITICAL, 'Crash: Disarming')
        ending = self.mode in (SimulatedMode.LAND, SimulatedMode.RTL)
        limit = TOUCHDOWN_TIME if ending else self.parameters['DISARM_DELAY']
        if crashed or 0.0 < limit <= self._ground_time:
            self.disarm()
