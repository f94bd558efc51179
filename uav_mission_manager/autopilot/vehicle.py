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


@dataclass(frozen=True)
class TakePhoto:
    """Take a picture, the n-th of the goal."""

    number: int


Request = SetMode | Arm | TakeOff | Fly | TakePhoto
"""What may be asked of the vehicle."""


REQUESTED_BY: dict[int, type[Request]] = {
    mavlink.MAV_CMD_DO_SET_MODE: SetMode,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: Arm,
    mavlink.MAV_CMD_NAV_TAKEOFF: TakeOff,
    mavlink.MAV_CMD_DO_REPOSITION: Fly,
    mavlink.MAV_CMD_IMAGE_START_CAPTURE: TakePhoto,
}
"""Kind of request by the command that decides whether it is taken."""


def commands(
    request: Request, camera: int = mavlink.MAV_COMP_ID_AUTOPILOT1
) -> tuple[MavCommand, ...]:
    """Return the commands of a request, each to be sent when the one before was accepted.

    `camera` is the component that takes pictures. ArduPilot does so since 4.4, and says whether it
    could; to MAV_CMD_DO_DIGICAM_CONTROL it always answers that it did.

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
    if isinstance(request, TakePhoto):  # All cameras, one picture each, with its number.
        params = (0, 0, 1, request.number, 0, 0, 0)
        return (MavCommand(mavlink.MAV_CMD_IMAGE_START_CAPTURE, params, component=camera),)
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
