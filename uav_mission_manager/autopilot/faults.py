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

LOAD_FILTER_TIME = 2.0
"""Time constant [s] of the low-pass filter of the motors' loads: a choice."""

MAX_LOAD_GAP = 2.0
"""Time [s] without outputs after which the filter starts anew: a choice, ten messages at 5 Hz."""

CAMERA_TIMEOUT = 3.0
"""Time [s] without the camera's heartbeat after which it has failed: three missing, at 1 Hz."""

MIN_MOTOR_CHECK_HEIGHT = 2.0
"""Height above home [m] below which ground effect and touch-down unbalance motors: a choice."""

IDLE_PWM = 1100.0
"""PWM [us] below which the motors idle and say nothing of their thrust: ArduCopter's default
(MOT_SPIN_ARM, a tenth of 1000 to 2000)."""

ZERO_THRUST_PWM = 1000.0
"""PWM [us] of a motor at rest: ArduCopter's default (MOT_PWM_MIN)."""

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


def effectiveness_by_load(loads: Sequence[float]) -> tuple[float, ...]:
    """Effectiveness of each motor, 0 to 1, if it alone is weak.

    The controller commands u = M x, where the n rows of M say what each motor does for thrust,
    roll, pitch and yaw, and x balances the vehicle: with motor j at effectiveness e,
    M'(u - (1-e) u_j i_j) = M' u0, i_j the unit vector of j and u0 the command of every healthy
    motor. As u0 is a column of M, u = u0 + (1-e) u_j P i_j with the projection
    P = M (M'M)^-1 M'. Its columns add up to 1: mean(u) = u0 + (1-e) u_j / n. Where all motors
    have the same part in the four axes, P_jj = 4/n: u_j = u0 + (1-e) u_j 4/n. Subtracting,
    1-e = (n/3) (1 - mean(u)/u_j): exact for regular frames of n arms or n/2 coaxial pairs.

    Parameters
    ----------
    loads : sequence of float
        Command of each motor over the mean of all.
    """
    scale = len(loads) / MOMENT_AXES
    return tuple(max(0.0, 1.0 - scale * (1.0 - 1.0 / max(load, 1.0))) for load in loads)


class FaultEstimator:
    """Faults that have lasted; an actuator fault stays until `serviced`.

    A fault is set after 1 s; sensor and camera faults are cleared after 5 s of health. Motors
    are judged in the air by `effectiveness_by_load`, from loads low-pass filtered over 2 s.

    Parameters
    ----------
    threshold : float
        Effectiveness below which a motor counts as failed.
    """

    def __init__(self, threshold: float = 0.85) -> None:
        self._threshold = threshold
        self._faults = Fault(0)
        self._since: dict[Fault, float] = {}
        self._located = False
        self._loads: tuple[float, ...] = ()
        self._loads_time = -math.inf

    @property
    def effectiveness(self) -> tuple[float, ...]:
        """Effectiveness of each motor, empty where it is not judged."""
        return effectiveness_by_load(self._loads)

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
        self._filter_loads(telemetry)
        self._debounce(Fault.SENSOR, not located or bool(unhealthy & SENSOR_HEALTH_BITS), now)
        weak = min(self.effectiveness, default=1.0) < self._threshold
        self._debounce(Fault.ACTUATOR, weak or bool(unhealthy & PROPULSION_HEALTH_BIT), now)
        self._debounce(Fault.CAMERA, camera_age is not None and camera_age > CAMERA_TIMEOUT, now)
        return self._faults

    def serviced(self) -> None:
        """Forget the actuator fault: the vehicle was repaired."""
        self._faults &= ~Fault.ACTUATOR
        self._since.pop(Fault.ACTUATOR, None)
        self._loads = ()

    def link_lost(self) -> None:
        """Say nothing until the vehicle is located again; faults that were set stay."""
        self._located = False
        self._since.clear()
        self._loads = ()

    def rebooted(self) -> None:
        """Judge sensors and camera anew; an actuator fault stays until `serviced`."""
        self.link_lost()
        self._faults &= Fault.ACTUATOR

    def _debounce(self, fault: Fault, seen: bool, now: float) -> None:
        """Set or clear a fault once the change has lasted."""
        delay = FAULT_SET_DELAY if seen else FAULT_CLEAR_DELAY
        if seen == bool(self._faults & fault) or (fault is Fault.ACTUATOR and not seen):
            self._since.pop(fault, None)
        elif now - self._since.setdefault(fault, now) >= delay:
            self._faults ^= fault
            del self._since[fault]

    def _filter_loads(self, telemetry: Telemetry) -> None:
        height = telemetry.position.height if telemetry.position else 0.0
        if telemetry.on_ground is not False or height < MIN_MOTOR_CHECK_HEIGHT:
            self._loads = ()
            return
        motors = telemetry.motors[: telemetry.motor_count]
        elapsed = telemetry.motors_time - self._loads_time
        self._loads_time = telemetry.motors_time
        unknown = len(motors) < telemetry.motor_count or not all(motors)
        if elapsed <= 0.0 or not motors or unknown or fmean(motors) < IDLE_PWM:
            return
        spans = [max(pwm - ZERO_THRUST_PWM, 0.0) for pwm in motors]
        if len(self._loads) != len(spans) or elapsed > MAX_LOAD_GAP:
            self._loads = (1.0,) * len(spans)
            return
        mean, gain = fmean(spans), 1.0 - math.exp(-elapsed / LOAD_FILTER_TIME)
        self._loads = tuple(
            old + gain * (span / mean - old) for old, span in zip(self._loads, spans, strict=True)
        )
