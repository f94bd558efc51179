"""One MAVLink link of the simulated autopilot, with the messages streamed on it."""

from __future__ import annotations

from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

DEFAULT_STREAM_INTERVALS = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: 10.0,
}
"""Interval [s] of each message that streams without being asked for, as on ArduCopter."""


class Writer(Protocol):
    """Where bytes go."""

    def write(self, data: bytes, /) -> object:
        """Send the bytes of one message."""


class SimulatedLink:
    """Both components' MAVLink encoders, a parser, and the intervals asked for on this link."""

    def __init__(self, writer: Writer, system: int = 1) -> None:
        self._writer, self._system = writer, system
        self.forget()

    def forget(self) -> None:
        """Know nothing of the peer, as after boot: default streams only, due at time 0."""
        self._autopilot = mavlink.MAVLink(
            self._writer, self._system, mavlink.MAV_COMP_ID_AUTOPILOT1
        )
        self._camera = mavlink.MAVLink(self._writer, self._system, mavlink.MAV_COMP_ID_CAMERA)
        self._autopilot.robust_parsing = True
        self._interval = dict(DEFAULT_STREAM_INTERVALS)  # [s]
        self._due = dict.fromkeys(DEFAULT_STREAM_INTERVALS, 0.0)  # [s] simulated

    def parse(self, data: bytes) -> list[Any]:
        """Return the messages that `data` completes."""
        return self._autopilot.parse_buffer(data) or []

    def send(self, message: Any) -> None:
        """Send as the autopilot; None, what a message without content is, sends nothing."""
        if message is not None:
            self._autopilot.send(message)

    def send_as_camera(self, message: Any) -> None:
        """Send as the camera."""
        self._camera.send(message)

    def stream(self, message: int, interval: float, now: float) -> None:
        """Send a message every `interval` seconds; 0 is its default, less is never."""
        if interval == 0.0:
            interval = DEFAULT_STREAM_INTERVALS.get(message, -1.0)
        self._interval[message] = interval
        self._due[message] = now + interval

    def due(self, now: float) -> list[int]:
        """Messages to send now; each counts as sent, and is due again one interval later."""
        ready = [
            message
            for message, interval in self._interval.items()
            if interval > 0.0 and now >= self._due[message] - 1e-9
        ]
        for message in ready:
            # An interval below the time step is met once a step and makes no backlog.
            self._due[message] = max(self._due[message] + self._interval[message], now)
        return ready
