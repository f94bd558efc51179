"""MAVLink front of the simulated autopilot: what arrives on a link, what leaves on all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.simulator import commands
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.link import SimulatedLink
from uav_mission_manager.autopilot.simulator.messages import MESSAGE_BUILDERS, heartbeat
from uav_mission_manager.autopilot.simulator.parameters import SIMULATED_PARAMETERS

NO_PARAMETER_INDEX = 65535
"""PARAM_VALUE.param_index of a value sent because it was set, as on ArduPilot."""

IGNORE_POSITION = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
)
"""Bits of a set-point's type_mask, any of which leaves it without a whole position."""


class SimulatedAutopilot:
    """A `SimulatedFlight` behind MAVLink links; `receive` and `step` are all that moves it."""

    def __init__(
        self,
        flight: SimulatedFlight,
        links: Sequence[SimulatedLink],
        system: int = 1,
        camera: bool = False,
    ) -> None:
        self.flight = flight
        self._links = links
        self._system = system
        self._camera = camera
        self._start()

    def _start(self) -> None:
        """Begin as after boot."""
        self._boots = self.flight.boots
        self._camera_due = 0.0
        self._told_mode = self.flight.mode

    def _notice_reboot(self) -> None:
        if self.flight.boots != self._boots:
            for link in self._links:
                link.forget()
            self._start()

    def step(self, dt: float) -> None:
        """Fly on by `dt` seconds of simulated time and send what is due."""
        self._notice_reboot()
        self.flight.step(dt)
        if self.flight.time < 0.0:
            return
        self._send_texts()
        self._send_new_mode()
        for link in self._links:
            for message in link.due(self.flight.time):
                link.send(MESSAGE_BUILDERS[message](self.flight))
        if self._camera and self.flight.time >= self._camera_due - 1e-9:
            self._camera_due += 1.0
            if not self.flight.parameters['SIM_CAM_FAIL']:
                self._send_camera_heartbeat()

    def receive(self, link: SimulatedLink, data: bytes) -> None:
        """Act on what arrived on a link; what is not for this system is left alone."""
        for message in link.parse(data):
            handler = _HANDLERS.get(message.get_type())
            booted = self.flight.time >= 0.0
            if booted and handler is not None and self._is_for_us(message):
                handler(self, link, message)
        self._send_texts()
        self._send_new_mode()
        self._notice_reboot()

    def _is_for_us(self, message: Any) -> bool:
        system = getattr(message, 'target_system', 0)
        component = getattr(message, 'target_component', 0)
        ours = component in (0, mavlink.MAV_COMP_ID_AUTOPILOT1) or self._is_for_camera(message)
        return system in (0, self._system) and ours

    def _is_for_camera(self, message: Any) -> bool:
        """Whether a camera that works is to take a picture."""
        to_camera = getattr(message, 'target_component', 0) == mavlink.MAV_COMP_ID_CAMERA
        command = getattr(message, 'command', None)
        works = self._camera and not self.flight.parameters['SIM_CAM_FAIL']
        return works and to_camera and command == mavlink.MAV_CMD_IMAGE_START_CAPTURE

    def _send_texts(self) -> None:
        for severity, text in self.flight.texts:
            for link in self._links:
                link.send(mavlink.MAVLink_statustext_message(severity, text.encode()[:50]))
        self.flight.texts.clear()

    def _send_new_mode(self) -> None:
        """Send HEARTBEAT at once when the mode changed; arming has to wait for the next one."""
        if self.flight.mode != self._told_mode and self.flight.boots == self._boots:
            self._told_mode = self.flight.mode
            for link in self._links:
                link.send(heartbeat(self.flight))

    def _send_camera_heartbeat(self) -> None:
        for link in self._links:
            link.send_as_camera(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_CAMERA,
                    mavlink.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    mavlink.MAV_STATE_ACTIVE,
                    3,
                )
            )

    def _command(self, link: SimulatedLink, message: Any) -> None:
        result = commands.execute(
            self.flight, link, message.command, commands.ReceivedCommand.of(message)
        )
        self._acknowledge(link, message, message.command, result)

    def _set_mode(self, link: SimulatedLink, message: Any) -> None:
        """SET_MODE is acknowledged like a command of its message id."""
        custom = message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        result = commands.DENIED
        if custom:
            done = self.flight.set_mode(message.custom_mode)
            result = commands.ACCEPTED if done else commands.FAILED
        self._acknowledge(link, message, mavlink.MAVLINK_MSG_ID_SET_MODE, result)

    def _acknowledge(self, link: SimulatedLink, message: Any, command: int, result: int) -> None:
        send = link.send_as_camera if self._is_for_camera(message) else link.send
        send(
            mavlink.MAVLink_command_ack_message(
                command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
        )

    def _position_target(self, _link: SimulatedLink, message: Any) -> None:
        """Fly to the target; there is no answer, whatever becomes of it."""
        target = commands.place(
            self.flight,
            message.lat_int / 1e7,
            message.lon_int / 1e7,
            message.alt,
            message.coordinate_frame,
        )
        if target is not None and not message.type_mask & IGNORE_POSITION:
            self.flight.go_to(*target)

    def _heartbeat(self, _link: SimulatedLink, message: Any) -> None:
        if message.get_srcSystem() == self.flight.parameters['MAV_GCS_SYSID']:
            self.flight.failsafes.hear_ground_station()

    def _timesync(self, link: SimulatedLink, message: Any) -> None:
        if message.tc1 == 0:
            link.send(mavlink.MAVLink_timesync_message(round(self.flight.time * 1e9), message.ts1))

    def _read_parameter(self, link: SimulatedLink, message: Any) -> None:
        names = list(self.flight.parameters)
        name = message.param_id
        if 0 <= message.param_index < len(names):
            name = names[message.param_index]
        if name in self.flight.parameters:
            self._send_parameter(link, name, names.index(name))

    def _list_parameters(self, link: SimulatedLink, _message: Any) -> None:
        for index, name in enumerate(self.flight.parameters):
            self._send_parameter(link, name, index)

    def _set_parameter(self, _link: SimulatedLink, message: Any) -> None:
        """All links hear the value taken; an unknown name or no number is ignored."""
        name, parameters = message.param_id, self.flight.parameters
        if name not in parameters or not math.isfinite(message.param_value):
            return
        parameters[name] = message.param_value
        if name == 'SIM_BATT_PCT':
            self.flight.set_charge(parameters[name])
        for link in self._links:
            self._send_parameter(link, name, NO_PARAMETER_INDEX)

    def _send_parameter(self, link: SimulatedLink, name: str, index: int) -> None:
        value = self.flight.parameters[name]
        if name == 'SIM_BATT_PCT':
            value = self.flight.body.battery.charge * 100.0
        link.send(
            mavlink.MAVLink_param_value_message(
                name.encode(),
                value,
                SIMULATED_PARAMETERS[name].type,
                len(SIMULATED_PARAMETERS),
                index,
            )
        )


_HANDLERS: dict[str, Callable[[SimulatedAutopilot, SimulatedLink, Any], None]] = {
    'HEARTBEAT': SimulatedAutopilot._heartbeat,
    'COMMAND_LONG': SimulatedAutopilot._command,
    'COMMAND_INT': SimulatedAutopilot._command,
    'SET_MODE': SimulatedAutopilot._set_mode,
    'SET_POSITION_TARGET_GLOBAL_INT': SimulatedAutopilot._position_target,
    'TIMESYNC': SimulatedAutopilot._timesync,
    'PARAM_REQUEST_READ': SimulatedAutopilot._read_parameter,
    'PARAM_REQUEST_LIST': SimulatedAutopilot._list_parameters,
    'PARAM_SET': SimulatedAutopilot._set_parameter,
}
