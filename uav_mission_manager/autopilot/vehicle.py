"""What the pilot may ask of an ArduCopter, and the MAVLink commands that say it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.link import MavCommand


class FlightMode(IntEnum):
    """ArduCopter's flight modes (HEARTBEAT.custom_mode) by name."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17
    SMART_RTL = 21


def mode_name(mode: int | None) -> str:
    """Name of a flight mode, `mode 27` where it has none here."""
    return next((known.name for known in FlightMode if known == mode), f'mode {mode}')


@dataclass(frozen=True)
class SetMode:
    """Change the flight mode."""

    mode: FlightMode


@dataclass(frozen=True)
class Arm:
    """Start the motors."""


@dataclass(frozen=True)
class TakeOff:
    """Climb to a height above home [m].

    All are one: home's altitude, on which the height depends, trembles by millimetres.
    """

    height: float = field(compare=False)


@dataclass(frozen=True)
class Fly:
    """Fly to a point [deg], an altitude above sea level [m], at a speed [m/s], and stay there."""

    latitude: float
    longitude: float
    altitude: float
    speed: float


Request = SetMode | Arm | TakeOff | Fly
"""What may be asked of the vehicle."""


REQUESTED_BY: dict[int, type[Request]] = {
    mavlink.MAV_CMD_DO_SET_MODE: SetMode,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: Arm,
    mavlink.MAV_CMD_NAV_TAKEOFF: TakeOff,
    mavlink.MAV_CMD_DO_REPOSITION: Fly,
}
"""Kind of request by the command that decides whether it is taken."""


def commands(request: Request) -> tuple[MavCommand, ...]:
    """Return the commands of a request, each to be sent when the one before was accepted.

    None of them changes the mode but SetMode: nothing else may take the vehicle from a pilot.
    The speed comes after the destination, for ArduCopter forgets it when it starts to fly to one.
    """
    if isinstance(request, SetMode):
        return (
            MavCommand(
                mavlink.MAV_CMD_DO_SET_MODE,
                (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, request.mode, 0, 0, 0, 0, 0),
            ),
        )
    if isinstance(request, Arm):
        return (MavCommand(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1, 0, 0, 0, 0, 0, 0)),)
    if isinstance(request, TakeOff):
        return (MavCommand(mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, request.height)),)
    reposition = MavCommand(
        mavlink.MAV_CMD_DO_REPOSITION,
        (-1, 0, 0, math.nan, request.latitude, request.longitude, request.altitude),
        frame=mavlink.MAV_FRAME_GLOBAL_INT,
    )
    speed = MavCommand(
        mavlink.MAV_CMD_DO_CHANGE_SPEED,
        (mavlink.SPEED_TYPE_GROUNDSPEED, request.speed, -1, 0, 0, 0, 0),
    )
    return reposition, speed
