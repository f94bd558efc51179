"""MAV_CMDs of the simulated autopilot, with the results measured on ArduCopter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.guidance import Home
from uav_mission_manager.autopilot.simulator.link import SimulatedLink
from uav_mission_manager.autopilot.simulator.messages import MESSAGE_BUILDERS
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
"""Results of a command: MAVLink's numbers (MAV_RESULT)."""

FORCE_ARM, FORCE_DISARM = 2989, 21196
"""Param 2 of MAV_CMD_COMPONENT_ARM_DISARM that skips all checks, on ArduPilot."""

HEIGHT_ABOVE_HOME_FRAMES = (
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)
"""Frames of places whose height is that above home."""

HEIGHT_ABOVE_SEA_FRAMES = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
"""Frames of places whose height is that above mean sea level."""

MAX_COMMANDED_ALTITUDE = 1e5
"""Height [m] above which a place is none: a choice, beyond any aircraft's."""


@dataclass(frozen=True)
class ReceivedCommand:
    """A COMMAND_LONG or COMMAND_INT: params 1-4, latitude and longitude [deg], z [m]."""

    params: tuple[float, float, float, float]
    latitude: float
    longitude: float
    z: float
    frame: int
    as_int: bool

    @classmethod
    def of(cls, message: Any) -> ReceivedCommand:
        """Read either message."""
        params = (message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == 'COMMAND_INT':
            return cls(params, message.x / 1e7, message.y / 1e7, message.z, message.frame, True)
        return cls(
            params,
            message.param5,
            message.param6,
            message.param7,
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            False,
        )

    def integer(self, index: int) -> int:
        """Param `index` (from 1) as an integer, -1 if it is not finite."""
        value = self.params[index - 1]
        return int(value) if math.isfinite(value) else -1


def place(
    flight: SimulatedFlight, latitude: float, longitude: float, z: float, frame: int
) -> tuple[complex, float] | None:
    """Local position and altitude over the origin of a geodetic place; None if it is none."""
    sane = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and abs(z) <= MAX_COMMANDED_ALTITUDE
    if not sane or frame not in HEIGHT_ABOVE_HOME_FRAMES + HEIGHT_ABOVE_SEA_FRAMES:
        return None
    base = flight.home.altitude if frame in HEIGHT_ABOVE_HOME_FRAMES else -flight.origin.altitude
    return flight.origin.to_local(latitude, longitude), base + z


def execute(
    flight: SimulatedFlight, link: SimulatedLink, number: int, command: ReceivedCommand
) -> int:
    """Do a command, return its MAV_RESULT."""
    handler = _HANDLERS.get(number)
    return handler(flight, link, command) if handler else UNSUPPORTED


def _done(success: bool) -> int:
    return ACCEPTED if success else FAILED


def _arm_disarm(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    wanted, magic = command.integer(1), command.integer(2)
    if wanted == 1:
        return _done(flight.arm(force=magic == FORCE_ARM))
    return _done(flight.disarm(force=magic == FORCE_DISARM)) if wanted == 0 else UNSUPPORTED


def _set_mode(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    if not command.integer(1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return DENIED
    return _done(flight.set_mode(command.integer(2)))


def _take_off(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    if command.frame not in HEIGHT_ABOVE_HOME_FRAMES or not math.isfinite(command.z):
        return DENIED
    return _done(flight.take_off(command.z))


def _reposition(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    if not command.as_int:
        return UNSUPPORTED
    target = place(flight, command.latitude, command.longitude, command.z, command.frame)
    change = command.integer(2) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
    if target is None or (flight.mode != SimulatedMode.GUIDED and not change):
        return DENIED
    within = flight.inside_fence(*target)  # asked first: outside, the mode stays too
    return _done(within and flight.set_mode(SimulatedMode.GUIDED) and flight.go_to(*target))


def _change_speed(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    kind, speed = command.integer(1), command.params[1]
    if kind not in range(4) or not (math.isfinite(speed) and speed > 0.0):
        return DENIED
    return _done(flight.set_speed(kind, speed))


def _set_home(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    here: tuple[complex, float] | None = (flight.body.position, flight.body.altitude)
    if command.integer(1) != 1:
        here = place(flight, command.latitude, command.longitude, command.z, command.frame)
    if here is None or not flight.position_ok:
        return DENIED if here is None else FAILED
    flight.home = Home(*here, locked=True)
    return ACCEPTED


def _set_interval(flight: SimulatedFlight, link: SimulatedLink, command: ReceivedCommand) -> int:
    message, microseconds = command.integer(1), command.params[1]
    if message not in MESSAGE_BUILDERS or not math.isfinite(microseconds):
        return DENIED
    link.stream(message, microseconds / 1e6, flight.time)
    return ACCEPTED


def _request_message(
    flight: SimulatedFlight, link: SimulatedLink, command: ReceivedCommand
) -> int:
    build = MESSAGE_BUILDERS.get(command.integer(1))
    if build is None:
        return FAILED
    link.send(build(flight))
    return ACCEPTED


def _reset_battery(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    """Set the charge of the batteries in a mask; there is the first one only."""
    percent = command.params[1]
    if math.isfinite(percent) and command.integer(1) & 1:
        flight.set_charge(min(max(percent, 0.0), 100.0))
    return ACCEPTED


def _reboot(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    if command.integer(1) != 1:
        return UNSUPPORTED
    return _done(flight.reboot())


def _take_picture(flight: SimulatedFlight, _link: SimulatedLink, command: ReceivedCommand) -> int:
    """One picture; ArduPilot's series by interval are not simulated."""
    if command.params[2] != 1.0:
        return UNSUPPORTED
    return _done(not flight.parameters['SIM_CAM_REFUSE'])


def _mode_command(
    mode: SimulatedMode,
) -> Callable[[SimulatedFlight, SimulatedLink, ReceivedCommand], int]:
    return lambda flight, _link, _command: _done(flight.set_mode(mode))


_HANDLERS: dict[int, Callable[[SimulatedFlight, SimulatedLink, ReceivedCommand], int]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_LAND: _mode_command(SimulatedMode.LAND),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _mode_command(SimulatedMode.RTL),
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_BATTERY_RESET: _reset_battery,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    mavlink.MAV_CMD_REQUEST_MESSAGE: _request_message,
    mavlink.MAV_CMD_IMAGE_START_CAPTURE: _take_picture,
}
