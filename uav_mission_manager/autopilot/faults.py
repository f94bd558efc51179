"""Which parts of the vehicle have failed, estimated from its telemetry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntFlag
from statistics import fmean

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.telemetry import Telemetry

FAULT_SET_DELAY = 1.0
"""Time [s] that a fault must be seen before it is set: a choice, two messages at 2 Hz."""

FAULT_CLEAR_DELAY = 5.0
"""Time [s] of health after which a sensor or camera fault is cleared: a choice."""

THRUST_FILTER_TIME = 1.5
"""Time constant [s] of the low-pass filter of the motors' thrusts: a choice."""

USUAL_FILTER_TIME = 120.0
"""Time constant [s] of the motors' usual thrusts, or the time in the air while that is less: a
choice. Within 4 s of a fault 3 % of it are taken for usual then."""

MAX_OUTPUT_GAP = 2.0
"""Time [s] without outputs after which the filter starts anew: a choice, ten messages at 5 Hz."""

CAMERA_TIMEOUT = 3.0
"""Time [s] without the camera's heartbeat after which it has failed: three missing, at 1 Hz."""

MIN_MOTOR_CHECK_HEIGHT = 2.0
"""Height above home [m] below which ground effect and touch-down unbalance motors: a choice."""

IDLE_PWM = 1100.0
"""PWM [us] below which the motors idle and say nothing of their thrust: ArduCopter's default
(MOT_SPIN_ARM, a tenth of 1000 to 2000)."""

ZERO_THRUST_PWM = 1000.0
"""PWM [us] of a motor at rest: ArduCopter's default (MOT_PWM_MIN). Around hover, thrust goes with
the square of the PWM above it (exponent 2.0 to 2.2 for 1400 to 1700 us with ArduCopter's defaults,
MOT_THST_EXPO 0.65 and MOT_SPIN_MIN 0.15)."""

MOMENT_AXES = 3
"""Roll, pitch and yaw: what the motors' differences control."""

FIX_3D = mavlink.GPS_FIX_TYPE_3D_FIX
"""GPS_RAW_INT.fix_type from which a receiver knows its position in three dimensions."""

SENSOR_HEALTH_BITS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
)
"""SYS_STATUS bits of the sensors whose failure is a sensor fault."""

PROPULSION_HEALTH_BIT = mavlink.MAV_SYS_STATUS_SENSOR_PROPULSION
"""SYS_STATUS bit of the motors, the actuators of the vehicle."""

EKF_NEEDED_FLAGS = (
    mavlink.EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_VELOCITY_VERT
    | mavlink.EKF_POS_HORIZ_ABS
)
"""EKF_STATUS_REPORT flags of an estimator that knows attitude, velocity and position."""

EKF_FAILURE_FLAGS = (
    mavlink.EKF_CONST_POS_MODE | mavlink.EKF_GPS_GLITCHING | mavlink.EKF_UNINITIALIZED
)
"""EKF_STATUS_REPORT flags any of which says that there is no position to trust."""


class Fault(IntFlag):
    """Failed parts; the value is the fault mode f - 1."""

    SENSOR = 1
    ACTUATOR = 2
    CAMERA = 4


def effectiveness_by_thrust(
    thrusts: Sequence[float], before: Sequence[float]
) -> tuple[float, ...]:
    """Effectiveness of each motor, 0 to 1, were it the only weak one.

    The thrusts that the controller asks of n motors are u = M x: the columns of M are the
    motors' parts in thrust, roll, pitch and yaw, and x keeps the vehicle balanced. If motor j
    gives e u_j only, balance needs M'(u - (1-e) u_j i_j) = M' u0, where i_j is j's unit vector
    and u0 the thrusts without the fault. As u and u0 are in the range of M, on which
    P = M (M'M)^-1 M' projects, u = u0 + (1-e) u_j P i_j. In a regular frame, n arms or n/2
    coaxial pairs, P_jj = 4/n, and the mean of P i_j is 1/n. So over the mean of the motors, and
    with u0 near 1 each, d = u - u0 has

        1-e = (n/3) d_j / u_j    and    d_j^2 = (3/n) |d|^2.

    Other imbalances of roll, pitch and yaw fall short of the second equation, by what lies in the
    two dimensions that are not j's. Half of that, one dimension's part, is taken to lie in j's as
    well, and its root is taken off d_j: turning in yaw reads 1 then, and a centre of gravity that
    is off towards j counts half.

    The effectiveness is the root of e: of a command, which the thrust follows with its square.

    Parameters
    ----------
    thrusts, before : sequence of float
        Thrust asked of each motor over the mean of all: now, and without the fault.
    """
    leverage = MOMENT_AXES / max(len(thrusts), 1)
    changes = [thrust - old for thrust, old in zip(thrusts, before, strict=True)]
    imbalance = leverage * sum(change**2 for change in changes)
    result = []
    for thrust, change in zip(thrusts, changes, strict=True):
        excess = change - math.sqrt(max(imbalance - change**2, 0.0) / 2.0)
        loss = excess / thrust / leverage if excess > 0.0 else 0.0
        result.append(math.sqrt(max(1.0 - loss, 0.0)))
    return tuple(result)


class FaultEstimator:
    """Faults that have lasted; an actuator fault stays until `serviced`.

    A fault is set after 1 s; sensor and camera faults are cleared after 5 s of health. Motors
    are judged in the air by `effectiveness_by_thrust`, low-pass filtered over 1.5 s, twice:
    against even thrusts, and against those usual in the last minutes. Without the second, a
    centre of gravity off by 4 % of the arms hid 20 % weaker motors of a hexacopter; without the
    first, a motor weak from the start would go unseen. An offset of 4 % read 0.88 at the lowest
    there, when it turned about at 15 m/s; one of 8 % read 0.93 in hover, but 0.78 then: an alarm.

    Parameters
    ----------
    threshold : float
        Effectiveness below which a motor counts as failed: of its command, not of its thrust;
        0.85 is a motor that gives 0.72 of the thrust asked for.
    """

    def __init__(self, threshold: float = 0.85) -> None:
        self._threshold = threshold
        self._faults = Fault(0)
        self._since: dict[Fault, float] = {}
        self._located = False
        self._thrusts: tuple[float, ...] = ()
        self._usual: tuple[float, ...] = ()
        self._motors_time = self._judged_since = -math.inf

    @property
    def effectiveness(self) -> tuple[float, ...]:
        """Effectiveness of each motor, empty where it is not judged."""
        even = (1.0,) * len(self._thrusts)
        by_shape = effectiveness_by_thrust(self._thrusts, even)
        by_change = effectiveness_by_thrust(self._thrusts, self._usual)
        return tuple(map(min, by_shape, by_change))

    def update(self, telemetry: Telemetry, camera_age: float | None, now: float) -> Fault | None:
        """Judge a snapshot; None while too little is known.

        Parameters
        ----------
        telemetry : Telemetry
        camera_age : float or None
            Seconds since the camera's heartbeat, None if there never was one.
        now : float
            Time [s].
        """
        unhealthy, fix, ekf = telemetry.unhealthy, telemetry.fix_type, telemetry.ekf_flags
        if unhealthy is None or fix is None or ekf is None:
            self._since.clear()
            return None
        flags = ekf & (EKF_NEEDED_FLAGS | EKF_FAILURE_FLAGS)
        located = fix >= FIX_3D and flags == EKF_NEEDED_FLAGS
        self._located = self._located or located
        if not self._located:
            return None
        self._filter_thrusts(telemetry)
        self._debounce(Fault.SENSOR, not located or bool(unhealthy & SENSOR_HEALTH_BITS), now)
        weak = min(self.effectiveness, default=1.0) < self._threshold
        self._debounce(Fault.ACTUATOR, weak or bool(unhealthy & PROPULSION_HEALTH_BIT), now)
        self._debounce(Fault.CAMERA, camera_age is not None and camera_age > CAMERA_TIMEOUT, now)
        return self._faults

    def serviced(self) -> None:
        """Forget the actuator fault: the vehicle was repaired."""
        self._faults &= ~Fault.ACTUATOR
        self._since.pop(Fault.ACTUATOR, None)
        self._forget_motors()

    def link_lost(self) -> None:
        """Say nothing until the vehicle is located again; faults that were set stay.

        One that could not be located is not waited for: that is its fault.
        """
        self._located = bool(self._faults & Fault.SENSOR)
        self._since.clear()
        self._forget_motors()

    @property
    def memory(self) -> int:
        """What `restore` takes."""
        return int(self._faults)

    def restore(self, memory: int) -> None:
        """Go on with the faults of a `memory`."""
        self._faults = Fault(memory)
        self.link_lost()

    def rebooted(self) -> None:
        """Judge sensors and camera anew; an actuator fault stays until `serviced`."""
        self._faults &= Fault.ACTUATOR
        self.link_lost()

    def _debounce(self, fault: Fault, seen: bool, now: float) -> None:
        """Set or clear a fault once the change has lasted."""
        delay = FAULT_SET_DELAY if seen else FAULT_CLEAR_DELAY
        if seen == bool(self._faults & fault) or (fault is Fault.ACTUATOR and not seen):
            self._since.pop(fault, None)
        elif now - self._since.setdefault(fault, now) >= delay:
            self._faults ^= fault
            del self._since[fault]

    def _forget_motors(self) -> None:
        self._thrusts = self._usual = ()

    def _filter_thrusts(self, telemetry: Telemetry) -> None:
        height = telemetry.position.height if telemetry.position else 0.0
        if telemetry.on_ground is not False or height < MIN_MOTOR_CHECK_HEIGHT:
            self._forget_motors()
            return
        motors = telemetry.motors[: telemetry.motor_count]
        elapsed = telemetry.motors_time - self._motors_time
        self._motors_time = telemetry.motors_time
        unknown = len(motors) < telemetry.motor_count or not all(motors)
        if elapsed <= 0.0 or not motors or unknown or fmean(motors) < IDLE_PWM:
            return
        thrusts = [max(pwm - ZERO_THRUST_PWM, 0.0) ** 2 for pwm in motors]
        if len(self._thrusts) != len(thrusts) or elapsed > MAX_OUTPUT_GAP:
            self._thrusts = self._usual = (1.0,) * len(thrusts)
            self._judged_since = telemetry.motors_time
            return
        mean = fmean(thrusts)
        shares = [thrust / mean for thrust in thrusts]
        age = telemetry.motors_time - self._judged_since
        self._thrusts = low_pass(self._thrusts, shares, elapsed / THRUST_FILTER_TIME)
        self._usual = low_pass(self._usual, shares, elapsed / min(age, USUAL_FILTER_TIME))


def low_pass(
    old: Sequence[float], new: Sequence[float], time_constants: float
) -> tuple[float, ...]:
    """Filter values of first order, `time_constants` later."""
    gain = 1.0 - math.exp(-time_constants)
    return tuple(a + gain * (b - a) for a, b in zip(old, new, strict=True))
