"""The autopilot's messages as plain values in SI units; what is unknown is None or NaN."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.geodesy import ground_distance

POSITION_TIMEOUT = 2.0
"""Age [s] above which a position is too old to fly by: a choice, twenty messages at 10 Hz."""

SETTLING_TIME = 1.0
"""Time [s] for which positions must follow each other without a jump before one is flown by: a
choice, ten messages at 10 Hz."""

MAX_TRACK_SPEED, TRACK_MARGIN = 60.0, 10.0
"""A position farther from the last one than this speed [m/s] and this margin [m] allow is a jump:
choices, above the fastest flight that can be set, 50 m/s."""

MAX_TRACK_GAP = 2.0
"""Vehicle's time [s] between two positions after which they do not follow each other: a choice."""

MAX_BELIEVED_VOLTAGE = 62.0
"""Highest voltage [V] believed: above 14 full cells, below the 64.9 V that ArduCopter was seen to
send in place of 0 V."""

FLYING_HEIGHT = 0.5
"""Height above home [m] from which an armed vehicle flies, where nothing else says so: a
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
    boot_time : float
        When measured, since the autopilot's start [s].
    """

    time: float
    latitude: float
    longitude: float
    altitude: float
    height: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = math.nan
    boot_time: float = 0.0

    @property
    def home_altitude(self) -> float:
        """Altitude of home above mean sea level [m]."""
        return self.altitude - self.height

    @property
    def speed(self) -> float:
        """Speed over ground [m/s]."""
        return math.hypot(*self.velocity[:2])

    def distance_to(self, latitude: float, longitude: float) -> float:
        """Distance over ground [m] to a point [deg]."""
        return ground_distance(self.latitude, self.longitude, latitude, longitude)

    def follows(self, last: Position) -> bool:
        """Whether a vehicle at `last` can be here by now; if not, one of the two is wrong."""
        elapsed = self.boot_time - last.boot_time
        reach = MAX_TRACK_SPEED * elapsed + TRACK_MARGIN
        return (
            0.0 <= elapsed <= MAX_TRACK_GAP
            and abs(self.altitude - last.altitude) <= reach
            and last.distance_to(self.latitude, self.longitude) <= reach
        )


@dataclass(frozen=True)
class BatteryReading:
    """One battery: charge 0 to 1, [V], [A] (discharge positive); NaN unknown.

    `healthy` is what the autopilot says of it, by its own limits.
    """

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
    settled_at : float
        Time [s] from which the positions can be flown by: they have followed each other for
        `SETTLING_TIME` then. Infinite before there are any.
    batteries : mapping of int to BatteryReading
        What BATTERY_STATUS says, by battery id; SYS_STATUS is that of `battery`.
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
    settled_at: float = -math.inf
    battery: BatteryReading | None = None
    batteries: Mapping[int, BatteryReading] = field(default_factory=dict)
    unhealthy: int | None = None
    ready: bool | None = None
    fix_type: int | None = None
    ekf_flags: int | None = None
    landed: bool | None = None
    motors: tuple[int, ...] = ()
    motors_time: float = -math.inf
    received: Mapping[str, float] = field(default_factory=dict)

    def fix(self, now: float) -> Position | None:
        """Position that may be flown by: recent, settled, and absolute in the EKF's own view."""
        position = self.position
        if position is None or now - position.time > POSITION_TIMEOUT or now < self.settled_at:
            return None
        if self.ekf_flags is not None and not self.ekf_flags & mavlink.EKF_POS_HORIZ_ABS:
            return None
        return position

    @property
    def unheard(self) -> str:
        """What has not been heard yet of all that a decision in flight needs, '' if nothing."""
        missing = (what for kind, what in _NEEDED.items() if kind not in self.received)
        return ', '.join(missing)

    @property
    def on_ground(self) -> bool | None:
        """Whether it stands on the ground; None where that is not known, which is not the ground.

        Where nothing else says so, height says that it flies, but not that it stands: it may be
        in a valley below home.
        """
        if self.mode is None:
            return None
        if not self.armed:
            return True
        if self.landed is None and self.position is not None:
            return False if self.position.height >= FLYING_HEIGHT else None
        return self.landed

    @property
    def all_batteries(self) -> Mapping[int, BatteryReading]:
        """The batteries by id; one that says nothing of its charge is left out beside others.

        SYS_STATUS is about the first one, and says what its charge and health cannot be better
        than.
        """
        if self.battery is None:
            return {}
        first = self.batteries.get(0, self.battery)
        charges = [b.charge for b in (first, self.battery) if not math.isnan(b.charge)]
        charge = min(charges, default=math.nan)
        healthy = first.healthy and self.battery.healthy
        first = replace(self.battery, charge=charge, healthy=healthy)
        every = {**self.batteries, 0: first}
        said = {n: b for n, b in every.items() if not (math.isnan(b.charge) and b.healthy)}
        return said or {0: first}


def update(telemetry: Telemetry, message: Any, now: float) -> Telemetry:
    """Return `telemetry` with what one message of the autopilot says."""
    kind = message.get_type()
    decode = _DECODERS.get(kind)
    if decode is None:
        return telemetry
    received = {**telemetry.received, kind: now}
    return replace(telemetry, **decode(message, now, telemetry), received=received)


def forget(telemetry: Telemetry, now: float) -> Telemetry:
    """Return `telemetry` without what was not said again for `STATE_TIMEOUT`."""
    old: dict[str, Any] = {}
    for kind, unknown in _STATES.items():
        if now - telemetry.received.get(kind, now) > STATE_TIMEOUT:
            old.update(unknown)
    return replace(telemetry, **old) if old else telemetry


def _heartbeat(message: Any, now: float, _last: Telemetry) -> dict[str, Any]:
    return {
        'armed': bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
        'mode': message.custom_mode,
        'failsafe': message.system_status >= mavlink.MAV_STATE_CRITICAL,
        'motor_count': MOTOR_COUNTS.get(message.type, 0),
    }


def _sys_status(message: Any, now: float, _last: Telemetry) -> dict[str, Any]:
    enabled = message.onboard_control_sensors_present & message.onboard_control_sensors_enabled
    unhealthy = enabled & ~message.onboard_control_sensors_health
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    current, voltage = message.current_battery, message.voltage_battery / 1000.0
    battery = BatteryReading(
        _charge(message.battery_remaining),
        voltage if 0.0 < voltage <= MAX_BELIEVED_VOLTAGE else math.nan,
        current / 100.0 if current >= 0 else math.nan,
        not unhealthy & mavlink.MAV_SYS_STATUS_SENSOR_BATTERY,
    )
    ready = not unhealthy & prearm if enabled & prearm else None
    return {'unhealthy': unhealthy, 'battery': battery, 'ready': ready}


def _global_position(message: Any, now: float, last: Telemetry) -> dict[str, Any]:
    if message.lat == 0 and message.lon == 0:  # sent before there is a position
        return {'position': None}
    heading = math.radians(message.hdg / 100.0) if message.hdg <= 36000 else math.nan
    position = Position(
        now,
        message.lat / 1e7,
        message.lon / 1e7,
        message.alt / 1000.0,
        message.relative_alt / 1000.0,
        (message.vy / 100.0, message.vx / 100.0, -message.vz / 100.0),
        heading,
        message.time_boot_ms / 1000.0,
    )
    before = last.position
    if before is not None and position.boot_time < before.boot_time and before.follows(position):
        return {}  # It was overtaken on the way.
    if before is not None and position.follows(before):
        return {'position': position}
    return {'position': position, 'settled_at': now + SETTLING_TIME}


def _battery_status(message: Any, now: float, last: Telemetry) -> dict[str, Any]:
    healthy = message.charge_state in _GOOD_CHARGE_STATES
    current = message.current_battery
    # Without voltage: that of the mission's battery is nothing to measure another one by.
    reading = BatteryReading(
        _charge(message.battery_remaining),
        math.nan,
        current / 100.0 if current >= 0 else math.nan,
        healthy,
    )
    return {'batteries': {**last.batteries, message.id: reading}}


def _charge(percent: int) -> float:
    return percent / 100.0 if 0 <= percent <= 100 else math.nan


def _servo_output(message: Any, now: float, _last: Telemetry) -> dict[str, Any]:
    if message.port != 0:
        return {}
    pwm = tuple(getattr(message, f'servo{i}_raw') for i in range(1, 17))
    return {'motors': pwm, 'motors_time': now}


def _extended_sys_state(message: Any, now: float, _last: Telemetry) -> dict[str, Any]:
    if message.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED:
        return {'landed': None}
    return {'landed': message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND}


_GOOD_CHARGE_STATES = (
    mavlink.MAV_BATTERY_CHARGE_STATE_UNDEFINED,
    mavlink.MAV_BATTERY_CHARGE_STATE_OK,
    mavlink.MAV_BATTERY_CHARGE_STATE_CHARGING,
)

_NEEDED = {
    'HEARTBEAT': 'mode',
    'GLOBAL_POSITION_INT': 'position',
    'EXTENDED_SYS_STATE': 'landed state',
}
"""What to hear before anything is decided about a vehicle, by message."""

_STATES: dict[str, dict[str, Any]] = {
    'SYS_STATUS': {'unhealthy': None, 'ready': None, 'battery': None},
    'BATTERY_STATUS': {'batteries': {}},
    'GPS_RAW_INT': {'fix_type': None},
    'EKF_STATUS_REPORT': {'ekf_flags': None},
    'EXTENDED_SYS_STATE': {'landed': None},
}
"""What is unknown, and how, when a message does not come again, by message."""

_DECODERS: dict[str, Callable[[Any, float, Telemetry], dict[str, Any]]] = {
    'HEARTBEAT': _heartbeat,
    'SYS_STATUS': _sys_status,
    'GLOBAL_POSITION_INT': _global_position,
    'BATTERY_STATUS': _battery_status,
    'GPS_RAW_INT': lambda message, *_: {'fix_type': message.fix_type},
    'EKF_STATUS_REPORT': lambda message, *_: {'ekf_flags': message.flags},
    'SERVO_OUTPUT_RAW': _servo_output,
    'EXTENDED_SYS_STATE': _extended_sys_state,
}
