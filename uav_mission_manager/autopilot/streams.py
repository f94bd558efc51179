"""The messages that the bridge needs: asked for when they do not come, with growing pauses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.exchange import MavCommand

STREAM_TIMEOUT = 3.0
"""Time [s] without a message after which it is asked for: a choice, six messages at 2 Hz."""

MAX_STREAM_PAUSE = 60.0
"""Longest time [s] after which a message that does not come is asked for again: a choice."""

STREAM_RATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
}
"""Rate [Hz] by id of each message that the bridge needs: choices, 10 Hz to fly by."""


@dataclass
class _Stream:
    """A message that is asked for: when it came and was asked for last, and how long to wait."""

    seen: float = -math.inf
    asked: float = -math.inf
    pause: float = STREAM_TIMEOUT


class Streams:
    """Which messages come.

    Parameters
    ----------
    rates : mapping of int to float
        Message ids to ask for, with their rates [Hz].
    """

    def __init__(self, rates: Mapping[int, float]) -> None:
        self._requests = {number: _interval(number, rate) for number, rate in rates.items()}
        self._streams: dict[int, _Stream] = {}

    def seen(self, number: int, now: float) -> MavCommand | None:
        """Take note of a message; return the command that asks for it, if one does."""
        request = self._requests.get(number)
        if request is not None:
            self._streams[number] = _Stream(seen=now)
        return request

    def due(self, now: float) -> MavCommand | None:
        """Return the command that asks for one that does not come, as an ACK names no stream."""
        for number, request in self._requests.items():
            stream = self._streams.setdefault(number, _Stream())
            if now - max(stream.seen, stream.asked) > stream.pause:
                if stream.asked > stream.seen:
                    stream.pause = min(2.0 * stream.pause, MAX_STREAM_PAUSE)
                stream.asked = now
                return request
        return None

    def clear(self) -> None:
        """Begin anew: the link was lost."""
        self._streams.clear()


def _interval(message: int, rate: float) -> MavCommand:
    """Return the command that asks for a message at a rate [Hz]."""
    params = (float(message), 1e6 / rate, 0.0, 0.0, 0.0, 0.0, 0.0)
    return MavCommand(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, params)
