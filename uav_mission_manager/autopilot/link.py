"""A MAVLink 2 connection to one autopilot, driven by `poll` and `repeat`, never blocking."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.exchange import Answer, CommandExchange, MavCommand
from uav_mission_manager.autopilot.identity import Identity
from uav_mission_manager.autopilot.overtaking import Overtaking
from uav_mission_manager.autopilot.port import MAX_PORT_READS, open_port, read_port
from uav_mission_manager.autopilot.streams import STREAM_RATES, Streams

HEARTBEAT_INTERVAL = 1.0
"""Time [s] between this program's own heartbeats, as MAVLink asks for."""

MAX_POLL_GAP = 1.0
"""Time [s] without `poll` after which what waits in the port is out of date: a choice, twenty
looks at 20 Hz."""

MAX_PARSERS = 16
"""Addresses whose unfinished frames are kept: a choice, so that forged ones fill no memory."""

REBOOT_STEP = 1000
"""How far [ms] the autopilot's time since boot goes back when it has rebooted, at least: a choice,
as datagrams can overtake each other."""

EVENTS = ('COMMAND_ACK', 'STATUSTEXT')
"""Messages that count although a later one has come first; others say what is true now."""

BOOTING = (mavlink.MAV_STATE_UNINIT, mavlink.MAV_STATE_BOOT)
"""States of an autopilot that has just started."""


class AutopilotLink:
    """One ArduCopter, found by its HEARTBEAT, on one MAVLink connection.

    Only MAVLink 2 counts, and of the vehicle's ids only one address (see `Identity`). `now` is
    the caller's time [s].

    Parameters
    ----------
    connection : str or object
        A pymavlink connection string, `udpin:127.0.0.1:14550` for one, or an open port with
        `recv(size)`, `write(data)` and `close()`.
    source_system, source_component : int
        MAVLink ids of this program.
    target_system : int
        System id of the vehicle; 0 takes the first ArduCopter heard and stays with it.
    timeout : float
        Seconds without HEARTBEAT after which the link is lost.
    streams : mapping of int to float
        Message ids to ask for, with their rates [Hz].

    Attributes
    ----------
    up : bool
        Whether the autopilot is heard. Nothing is sent to it before.
    rebooted : bool
        Whether the last `poll` found that the autopilot had rebooted.

    Raises
    ------
    ValueError
        The connection can never be opened; says which and why.
    """

    def __init__(
        self,
        connection: str | Any,
        *,
        source_system: int = 1,
        source_component: int = 191,
        target_system: int = 1,
        timeout: float = 3.0,
        streams: Mapping[int, float] = STREAM_RATES,
    ) -> None:
        self._port = open_port(connection) if isinstance(connection, str) else connection
        self._mav = mavlink.MAVLink(None, source_system, source_component)
        self._parsers: dict[Any, Any] = {}
        self._own = (source_system, source_component)
        self._timeout = timeout
        self._identity = Identity(target_system, timeout)
        self._exchange = CommandExchange(self._transmit)
        self._answers: list[Answer] = []
        self._streams = Streams(streams)
        self._read_error = ''
        self._polled_at: float | None = None
        self._beat_at = -math.inf
        self._up_since = 0.0
        self._stale_since: float | None = None
        self._status = mavlink.MAV_STATE_BOOT
        self._boot_time = 0
        self._overtaking = Overtaking()
        self.up = self.rebooted = False

    @property
    def error(self) -> str:
        """What is wrong with the connection, '' if nothing is."""
        return getattr(self._port, 'error', '') or self._read_error

    @property
    def target_system(self) -> int:
        """System id of the vehicle, 0 until the first is heard."""
        return self._identity.target_system

    @property
    def vehicle(self) -> str:
        """The autopilot in words, '' until there is one."""
        return self._identity.vehicle

    @property
    def rejected(self) -> str:
        """Why the wanted vehicle is not commanded, '' if nothing is wrong."""
        return self._identity.rejected

    @property
    def others(self) -> tuple[str, ...]:
        """Whoever else is heard."""
        return self._identity.others

    @property
    def mode_told(self) -> bool:
        """Whether the mode was told after the last answer to DO_SET_MODE, and came by then."""
        return self._overtaking.mode_told

    @property
    def refused(self) -> dict[str, str]:
        """Why, by the command's name, until the same command is accepted."""
        return self._exchange.refused

    @property
    def boot_time(self) -> float:
        """Time [s] since the autopilot's start, as it last said, 0 until it does."""
        return self._boot_time / 1000.0

    def poll(self, now: float) -> list[Any]:
        """Send the own heartbeat and return the autopilot's new messages; call it often.

        After a gap nothing is returned of what came meanwhile, and the link is lost until the
        next HEARTBEAT. Nor is a state that a later one has overtaken on the way: it is over.
        """
        if self._polled_at is not None and not 0 <= now - self._polled_at <= MAX_POLL_GAP:
            self._stale_since, self._beat_at = now, -math.inf
            self._identity.lose(now)
            self._forget()
        self._polled_at = now
        self._beat(now)
        self.rebooted = False
        messages: list[Any] = []
        for message, address in self._read(now):
            if self._stale_since is not None:
                continue
            if not self._identity.hear(message, address, now):
                self._take_from_component(message, now)
                continue
            if self._overtaking.is_over(message, now) and message.get_type() not in EVENTS:
                continue
            if self._has_rebooted(message):
                self.rebooted = True
                messages = []
                self._forget()
            self._take(message, now)
            messages.append(message)
        self._watch(now)
        return messages

    def repeat(self, now: float) -> None:
        """Repeat unanswered commands and ask for missing streams; call it often.

        Call it after the messages of `poll` have been handled: they may lead to `cancel`.
        """
        if self.up:
            self._exchange.repeat(now)
            self._sort_answers()
            self._ask_streams(now)

    def send(self, commands: Sequence[MavCommand], now: float) -> None:
        """Send the first command, repeated until its answer, and each other once it is accepted.

        It replaces what is under way with the first command's number. Without link nothing is
        sent, now or later.
        """
        if self.up:
            self._exchange.send(commands, now)

    def cancel(self) -> None:
        """Give commands up, refused ones too; streams are asked for as before."""
        self._exchange.cancel()

    def take_answers(self) -> list[Answer]:
        """Return the commands that ended since the last call."""
        answers, self._answers = self._answers, []
        return answers

    def expect(self, component: int) -> None:
        """Count a component of the vehicle as heard before: it is missed if it is not heard."""
        self._identity.expect(component)

    def component_age(self, component: int, now: float) -> float | None:
        """Seconds since a component of the vehicle was heard, None if it never was.

        Time without link does not count: nothing can be heard then.
        """
        heard = self._identity.component_heard(component)
        return None if heard is None else now - max(heard, self._up_since)

    def close(self) -> None:
        """Close the connection."""
        self._port.close()

    def _beat(self, now: float) -> None:
        if now - self._beat_at < HEARTBEAT_INTERVAL:
            return
        self._beat_at = now
        ids = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
        self._write(mavlink.MAVLink_heartbeat_message(*ids, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))

    def _read(self, now: float) -> Iterator[tuple[Any, Any]]:
        """Yield messages with their senders' addresses.

        What is out of date has ended where the port is empty, and its peer has had time to send
        what it had kept back.
        """
        reads = 0
        try:
            for data in read_port(self._port):
                reads += 1
                address = getattr(self._port, 'last_address', None)
                for message in self._parser(address).parse_buffer(data) or ():
                    if message.get_msgId() >= 0:  # Neither noise nor unknown.
                        yield message, address
            self._read_error = ''
        except OSError as error:
            self._read_error = error.strerror or str(error)
        patience = getattr(self._port, 'backlog_time', 0.0)
        since = now if self._stale_since is None else self._stale_since
        if reads < MAX_PORT_READS and now - since >= patience:
            self._stale_since = None

    def _parser(self, address: Any) -> Any:
        """Return an address's own parser: nobody's half a frame may swallow another's."""
        parser = self._parsers.pop(address, None)
        if parser is None:
            parser = mavlink.MAVLink(None)
            parser.robust_parsing = True
        self._parsers[address] = parser
        if len(self._parsers) > MAX_PARSERS:
            del self._parsers[next(iter(self._parsers))]
        return parser

    def _take_from_component(self, message: Any, now: float) -> None:
        """Take an answer of the vehicle's other components: nothing else of them is believed."""
        origin = message.get_srcSystem(), message.get_srcComponent()
        theirs = origin[0] == self.target_system and origin[1] != mavlink.MAV_COMP_ID_AUTOPILOT1
        if theirs and message.get_type() == 'COMMAND_ACK' and self.up:
            self._acknowledge(message, now)

    def _acknowledge(self, message: Any, now: float) -> None:
        target = message.target_system, message.target_component
        own = zip(target, self._own, strict=True)
        if all(said in (0, mine) for said, mine in own):
            self._exchange.acknowledge(message, now)
            self._sort_answers()

    def _take(self, message: Any, now: float) -> None:
        kind = message.get_type()
        if kind == 'COMMAND_ACK':
            self._acknowledge(message, now)
        elif kind == 'STATUSTEXT':
            self._exchange.hear(message, now)
        asked_for = self._streams.seen(message.get_msgId(), now)
        if asked_for is not None:
            self.refused.pop(asked_for.name, None)

    def _has_rebooted(self, message: Any) -> bool:
        kind = message.get_type()
        if kind == 'HEARTBEAT':
            last, self._status = self._status, message.system_status
            rebooted = self._status in BOOTING and last not in BOOTING
        elif kind == 'GLOBAL_POSITION_INT':
            last, self._boot_time = self._boot_time, message.time_boot_ms
            rebooted = self._boot_time < last - REBOOT_STEP
        else:
            return False
        if rebooted:  # Each of the two says it; once is enough.
            self._status, self._boot_time = mavlink.MAV_STATE_BOOT, 0
        return rebooted

    def _watch(self, now: float) -> None:
        """Set `up`; when the link is lost, forget pending commands and streams."""
        self._identity.watch(now)
        up = now - self._identity.beat_at <= self._timeout
        if up and not self.up:
            self._up_since = now
        if not up:
            self._forget()
        self.up = up

    def _forget(self) -> None:
        self._exchange.clear()
        self._streams.clear()

    def _sort_answers(self) -> None:
        """Keep the answers to `send`; those about streams are for `refused` alone."""
        for answer in self._exchange.take_answers():
            if answer.command.number != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._answers.append(answer)

    def _ask_streams(self, now: float) -> None:
        """Ask for one stream that does not arrive; one at a time, as an ACK names no stream."""
        if self._exchange.waits_for(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL):
            return
        request = self._streams.due(now)
        if request is not None:
            self._exchange.send((request,), now)

    def _transmit(self, command: MavCommand, confirmation: int) -> None:
        self._write(command.message(self.target_system, confirmation), self._identity.address)

    def _write(self, message: Any, address: Any = None) -> None:
        """Send to one address where there is one, else to all."""
        data = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        try:
            if address is not None and hasattr(self._port, 'write_to'):
                self._port.write_to(data, address)
            else:
                self._port.write(data)
        except OSError as error:
            self._read_error = error.strerror or str(error)
