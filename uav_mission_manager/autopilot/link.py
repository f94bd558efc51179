"""A MAVLink 2 connection to one autopilot, driven by `poll` and `repeat`, never blocking."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

HEARTBEAT_INTERVAL = 1.0
"""Time [s] between this program's own heartbeats, as MAVLink asks for."""

ACK_TIMEOUT = 1.0
"""Time [s] to wait for the answer to a command: a choice."""

MAX_TRANSMISSIONS = 3
"""How often an unanswered command is sent at most: a choice."""

STREAM_TIMEOUT = 3.0
"""Time [s] without a message after which it is asked for: a choice, six messages at 2 Hz."""

STREAM_REFUSED_RETRY = 30.0
"""Extra time [s] to wait before a refused message is asked for again: a choice."""

UDP_PEER_TIMEOUT = 10.0
"""Time [s] after which a silent UDP peer is forgotten: a choice."""

MAX_PORT_READS = 200
"""Reads from a port at a time, at most, so that this ends however much arrives. A choice: at 20
looks a second 4,000 datagrams a second, a hundred times more than the bridge asks for."""

PORT_READ_BYTES = 4096
"""Bytes of a read, at most. A choice; a MAVLink 2 message has no more than 280."""

STREAM_RATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
}
"""Rate [Hz] by id of each message that the bridge needs: choices, 10 Hz to fly by."""


@dataclass(frozen=True)
class MavCommand:
    """A MAV_CMD: COMMAND_LONG, or COMMAND_INT where `frame` is given.

    `params` are param1 to param7; as COMMAND_INT params 5 and 6 are degrees.
    """

    number: int
    params: tuple[float, ...]
    frame: int | None = None

    @property
    def name(self) -> str:
        """Name of the command in the MAVLink dialect."""
        return enum_name('MAV_CMD', self.number)


@dataclass(frozen=True)
class _Pending:
    command: MavCommand
    sent_at: float
    transmissions: int = 1


def enum_name(enum: str, value: int) -> str:
    """Name of a MAVLink enum's value, the number where it has none."""
    entry = mavlink.enums[enum].get(value)
    return entry.name if entry else str(value)


def read_port(port: Any) -> Iterator[bytes]:
    """Yield what has arrived at a pymavlink port, up to `MAX_PORT_READS` times."""
    for _ in range(MAX_PORT_READS):
        data = port.recv(PORT_READ_BYTES)
        if not data:
            return
        yield data


class AutopilotLink:
    """One autopilot, found by its HEARTBEAT, on one MAVLink connection.

    Parameters
    ----------
    connection : str
        Any pymavlink connection string, `udpin:127.0.0.1:14550` for one.
    source_system, source_component : int
        MAVLink ids of this program.
    target_system : int
        System id of the vehicle; 0 takes the first ArduPilot heard and stays with it.
    timeout : float
        Seconds without HEARTBEAT after which the link is lost.
    streams : mapping of int to float
        Message ids to ask for, with their rates [Hz].

    Raises
    ------
    ValueError
        The connection cannot be opened; says which and why.
    """

    def __init__(
        self,
        connection: str,
        *,
        source_system: int = 1,
        source_component: int = 191,
        target_system: int = 1,
        timeout: float = 3.0,
        streams: Mapping[int, float] = STREAM_RATES,
    ) -> None:
        # UDP forgets silent peers; with one retry TCP reconnects without sleeping in between.
        try:
            self._port = mavutil.mavlink_connection(
                connection, udp_timeout=UDP_PEER_TIMEOUT, autoreconnect=True, retries=1
            )
        except (OSError, ValueError, ImportError) as error:
            raise ValueError(f'MAVLink connection {connection!r}: {error}') from error
        # mavutil's own encoder may be MAVLink 1 and of another dialect.
        self._mav = mavlink.MAVLink(self._port, source_system, source_component)
        self._mav.robust_parsing = True
        self._own = (source_system, source_component)
        self._timeout = timeout
        self.target_system = target_system
        self.target_component: int | None = None
        self.up = False
        self.error = ''
        self.refused: dict[str, str] = {}
        self._streams = dict(streams)
        self._stream_seen: dict[int, float] = {}
        self._stream_asked: dict[int, float] = {}
        self._pending: dict[int, _Pending] = {}
        self._heard: dict[int, float] = {}
        self._up_since = 0.0
        self._beat_at = -math.inf

    def poll(self, now: float) -> list[Any]:
        """Send the own heartbeat and return the autopilot's new messages; call it often."""
        if now - self._beat_at >= HEARTBEAT_INTERVAL:
            self._beat_at = now
            self._send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                    mavlink.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    mavlink.MAV_STATE_ACTIVE,
                    3,
                )
            )
        messages = [message for message in self._read() if self._accept(message, now)]
        self._watch(now)
        return messages

    def repeat(self, now: float) -> None:
        """Repeat unanswered commands and ask for missing streams; call it often.

        Call it after the messages of `poll` have been handled: they may lead to `cancel`.
        """
        if self.up:
            self._repeat_commands(now)
            self._ask_streams(now)

    def send(self, command: MavCommand, now: float) -> None:
        """Send a command, repeated until its ACK; it replaces an unanswered one of its number."""
        if self.up:
            self._pending[command.number] = _Pending(command, now)
            self._transmit(command, 0)

    def cancel(self) -> None:
        """Stop repeating commands; streams are asked for as before."""
        streams = self._pending.get(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)
        self._pending = {streams.command.number: streams} if streams else {}

    def component_age(self, component: int, now: float) -> float | None:
        """Seconds since a component of the vehicle was heard, None if it never was.

        Time without link does not count: nothing can be heard then.
        """
        heard = self._heard.get(component)
        return None if heard is None else now - max(heard, self._up_since)

    def close(self) -> None:
        """Close the connection."""
        self._port.close()

    def _read(self) -> list[Any]:
        messages: list[Any] = []
        try:
            for data in read_port(self._port):
                messages += self._mav.parse_buffer(data) or []
            self.error = ''
        except OSError as error:
            self.error = str(error)
        return messages

    def _accept(self, message: Any, now: float) -> bool:
        """Take note of a message; return whether it is the autopilot's."""
        kind, component = message.get_type(), message.get_srcComponent()
        if kind == 'HEARTBEAT':
            self._find_autopilot(message)
        if kind == 'BAD_DATA' or message.get_srcSystem() != self.target_system:
            return False
        if kind == 'HEARTBEAT':
            self._heard[component] = now
        if component != self.target_component:
            return False
        if kind == 'COMMAND_ACK':
            self._acknowledge(message, now)
        self._stream_seen[message.get_msgId()] = now
        return True

    def _find_autopilot(self, heartbeat: Any) -> None:
        ardupilot = (
            heartbeat.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            and heartbeat.type != mavlink.MAV_TYPE_GCS
        )
        wanted = self.target_system in (0, heartbeat.get_srcSystem())
        if ardupilot and wanted and self.target_component is None:
            self.target_system = heartbeat.get_srcSystem()
            self.target_component = heartbeat.get_srcComponent()

    def _watch(self, now: float) -> None:
        """Set `up`; when the link is lost, forget pending commands and streams."""
        heard = -math.inf if self.target_component is None else self._heard[self.target_component]
        up = now - heard <= self._timeout
        if up and not self.up:
            self._up_since = now
        if not up:
            self._pending.clear()
            self._stream_seen.clear()
            self._stream_asked.clear()
            self.refused.clear()
        self.up = up

    def _acknowledge(self, ack: Any, now: float) -> None:
        if (ack.target_system or self._own[0], ack.target_component or self._own[1]) != self._own:
            return
        pending = self._pending.get(ack.command)
        if pending is None:
            return
        if ack.result == mavlink.MAV_RESULT_IN_PROGRESS:
            self._pending[ack.command] = replace(pending, sent_at=now)
            return
        del self._pending[ack.command]
        self.refused.pop(pending.command.name, None)
        if ack.result != mavlink.MAV_RESULT_ACCEPTED:
            self._refuse(pending.command, enum_name('MAV_RESULT', ack.result), now)

    def _refuse(self, command: MavCommand, why: str, now: float) -> None:
        if command.number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            self._stream_asked[int(command.params[0])] = now + STREAM_REFUSED_RETRY
        else:
            self.refused[command.name] = why

    def _repeat_commands(self, now: float) -> None:
        for number, pending in list(self._pending.items()):
            if now - pending.sent_at < ACK_TIMEOUT:
                continue
            if pending.transmissions < MAX_TRANSMISSIONS:
                self._transmit(pending.command, pending.transmissions)
                self._pending[number] = _Pending(pending.command, now, pending.transmissions + 1)
            else:
                del self._pending[number]
                self._refuse(pending.command, 'no answer', now)

    def _ask_streams(self, now: float) -> None:
        """Ask for one stream that does not arrive; one at a time, as an ACK names no stream."""
        if mavlink.MAV_CMD_SET_MESSAGE_INTERVAL in self._pending:
            return
        for message, rate in self._streams.items():
            last = max(
                self._stream_seen.get(message, -math.inf),
                self._stream_asked.get(message, -math.inf),
            )
            if now - last > STREAM_TIMEOUT:
                self._stream_asked[message] = now
                self.send(
                    MavCommand(
                        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (message, 1e6 / rate, 0, 0, 0, 0, 0)
                    ),
                    now,
                )
                return

    def _transmit(self, command: MavCommand, confirmation: int) -> None:
        target = self.target_system, self.target_component
        if command.frame is None:
            self._send(
                mavlink.MAVLink_command_long_message(
                    *target, command.number, confirmation, *command.params
                )
            )
        else:
            *params, latitude, longitude, z = command.params
            self._send(
                mavlink.MAVLink_command_int_message(
                    *target,
                    command.frame,
                    command.number,
                    0,
                    0,
                    *params,
                    round(latitude * 1e7),
                    round(longitude * 1e7),
                    z,
                )
            )

    def _send(self, message: Any) -> None:
        try:
            self._mav.send(message)
        except OSError as error:
            self.error = str(error)
