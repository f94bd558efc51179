"""The autopilot's messages as plain values in SI units; what is unknown is None or NaN."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

EARTH_RADIUS = 6371000.0
"""Mean radius of the Earth [m]."""

POSITION_TIMEOUT = 2.0
"""Age [s] above which a position is too old to fly by: a choice, twenty messages at 10 Hz."""

MAX_BELIEVED_VOLTAGE = 62.0
"""Highest voltage [V] believed: above 14 full cells, below the 64.9 V that ArduCopter was seen to
send in place of 0 V."""

ON_GROUND_HEIGHT = 0.5
"""Height above home [m] below which the vehicle is on the ground, where nothing else says so: a
choice."""

STATE_TIMEOUT = 5.0
"""Age [s] above which a value that is sent again and again is forgotten: a choice, ten messages at
2 Hz."""

MOTOR_COUNTS = {
    mavlink.MAV_TYPE_QUADROTOR: 4,
    mavlink.MAV_TYPE_HEXAROTOR: 6,
    mavlink.MAV_TYPE_OCTOROTOR: 8,
    mavlink.MAV_TYPE_DECAROTOR: 10,
    mavlink.MAV_TYPE_DODECAROTOR: 12,
}
"""Number of motors by MAV_TYPE, where the motors are the first outputs."""


@dataclass(frozen=True)
class Position:
    """GLOBAL_POSITION_INT.

    Attributes
    ----------
    time : float
        When received [s].
    latitude, longitude : float
        [deg]
    altitude, height : float
        Above mean sea level, and above home [m].
    velocity : tuple of 3 floats
        East, north, up [m/s].
    heading : float
        Clockwise from north [rad], NaN unknown.
    """

    time: float
    latitude: float
    longitude: float
    altitude: float
    height: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = math.nan

    def distance_to(self, latitude: float, longitude: float) -> float:
        """Distance over ground [m] to a point [deg], on a sphere, for a few kilometres."""
        north = math.radians(latitude - self.latitude)
        east = math.radians(longitude - self.longitude) * math.cos(math.radians(latitude))
        return EARTH_RADIUS * math.hypot(north, east)


@dataclass(frozen=True)
class BatteryReading:
    """SYS_STATUS: charge 0 to 1, [V], [A] (discharge positive); NaN unknown."""

    charge: float
    voltage: float
    current: float
    healthy: bool = True


@dataclass(frozen=True)
class Telemetry:
    """The last known values; None until the message that carries them has come.

    Attributes
    ----------
    mode, armed, failsafe, motor_count
        HEARTBEAT: ArduCopter's mode number, armed, in a failsafe; motors of this frame,
        0 where their outputs are not known.
    unhealthy : int
        MAV_SYS_STATUS_SENSOR bits that are present, enabled and not healthy.
    ready : bool
        Whether the arming checks pass.
    landed : bool
        EXTENDED_SYS_STATE says on the ground.
    motors : tuple of int
        PWM [us] of each output, the motors first, received at `motors_time` [s]; 0 not sent.
    received : mapping of str to float
        When each message was received last [s].
    """

    mode: int | None = None
    armed: bool = False
    failsafe: bool = False
    motor_count: int = 4
    position: Position | None = None
    battery: BatteryReading | None = None
    unhealthy: int | None = None
    ready: bool | None = None
    fix_type: int | None = None
    ekf_flags: int | None = None
    landed: bool | None = None
    motors: tuple[int, ...] = ()
    motors_time: float = -math.inf
    received: Mapping[str, float] = field(default_factory=dict)

    def fix(self, now: float) -> Position | None:
        """Position that may be flown by: recent, and absolute in the EKF's own view."""
        position = self.position
        if position is None or now - position.time > POSITION_TIMEOUT:
            return None
        if self.ekf_flags is not None and not self.ekf_flags & mavlink.EKF_POS_HORIZ_ABS:
            return None
        return position

    @property
    def on_ground(self) -> bool:
        """Whether it stands on the ground, by its height where nothing else says so."""
        if not self.armed:
            return True
        if self.landed is not None:
            return self.landed
        return self.position is None or self.position.height < ON_GROUND_HEIGHT


def update(telemetry: Telemetry, message: Any, now: float) -> Telemetry:
    """Return `telemetry` with what one message of the autopilot says."""
    kind = message.get_type()
    decode = _DECODERS.get(kind)
    if decode is None:
        return telemetry
    received = {**telemetry.received, kind: now}
    return replace(telemetry, **decode(message, now), received=received)


def forget(telemetry: Telemetry, now: float) -> Telemetry:
    """Return `telemetry` without what was not said again for `STATE_TIMEOUT`."""
    old: dict[str, Any] = {
        name: None
        for kind, names in _STATES.items()
        for name in names
        if now - telemetry.received.get(kind, now) > STATE_TIMEOUT
    }
    return replace(telemetry, **old) if old else telemetry


def _heartbeat(message: Any, now: float) -> dict[str, Any]:
    return {
        'armed': bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
        'mode': message.custom_mode,
        'failsafe': message.system_status >= mavlink.MAV_STATE_CRITICAL,
        'motor_count': MOTOR_COUNTS.get(message.type, 0),
    }


def _sys_status(message: Any, now: float) -> dict[str, Any]:
    enabled = message.onboard_control_sensors_present & message.onboard_control_sensors_enabled
    unhealthy = enabled & ~message.onboard_control_sensors_health
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    charge, current = message.battery_remaining, message.current_battery
    voltage = message.voltage_battery / 1000.0
    battery = BatteryReading(
        charge / 100.0 if 0 <= charge <= 100 else math.nan,
        voltage if 0.0 < voltage <= MAX_BELIEVED_VOLTAGE else math.nan,
        current / 100.0 if current >= 0 else math.nan,
        not unhealthy & mavlink.MAV_SYS_STATUS_SENSOR_BATTERY,
    )
    ready = not unhealthy & prearm if enabled & prearm else None
    return {'unhealthy': unhealthy, 'battery': battery, 'ready': ready}


def _global_position(message: Any, now: float) -> dict[str, Any]:
    if message.lat == 0 and message.lon == 0:  # sent before there is a position
        return {'position': None}
    heading = math.radians(message.hdg / 100.0) if message.hdg <= 36000 else math.nan
    return {
        'position': Position(
            now,
            message.lat / 1e7,
            message.lon / 1e7,
            message.alt / 1000.0,
            message.relative_alt / 1000.0,
            (message.vy / 100.0, message.vx / 100.0, -message.vz / 100.0),
            heading,
        )
    }


def _servo_output(message: Any, now: float) -> dict[str, Any]:
    if message.port != 0:
        return {}
    pwm = tuple(getattr(message, f'servo{i}_raw') for i in range(1, 17))
    return {'motors': pwm, 'motors_time': now}


def _extended_sys_state(message: Any, now: float) -> dict[str, Any]:
    if message.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED:
        return {'landed': None}
    return {'landed': message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND}


_STATES = {
    'SYS_STATUS': ('unhealthy', 'ready', 'battery'),
    'GPS_RAW_INT': ('fix_type',),
    'EKF_STATUS_REPORT': ('ekf_flags',),
    'EXTENDED_SYS_STATE': ('landed',),
}
"""Values that stay true until the next message, by message."""

_DECODERS: dict[str, Callable[[Any, float], dict[str, Any]]] = {
    'HEARTBEAT': _heartbeat,
    'SYS_STATUS': _sys_status,
    'GLOBAL_POSITION_INT': _global_position,
    'GPS_RAW_INT': lambda message, now: {'fix_type': message.fix_type},
    'EKF_STATUS_REPORT': lambda message, now: {'ekf_flags': message.flags},
    'SERVO_OUTPUT_RAW': _servo_output,
    'EXTENDED_SYS_STATE': _extended_sys_state,
}
