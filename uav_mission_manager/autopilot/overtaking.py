"""Messages that overtake each other on the way, told apart by the autopilot's count of them."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

OVERTAKING_TIME, OVERTAKING_COUNT = 0.5, 50
"""By how much time [s] and how many messages one may overtake another, at most: choices. MAVLink
counts messages of all kinds, and begins anew after 256, and after a reboot."""

MODE_ANSWER = 'answer to DO_SET_MODE'
"""A kind of COMMAND_ACK: a HEARTBEAT sent before it may tell the mode before."""


class Overtaking:
    """Knows the newest message of each kind, by the autopilot's count."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[int, float]] = {}  # its number, and when it came

    def is_over(self, message: Any, now: float) -> bool:
        """Whether one of its kind that the autopilot sent later has come before.

        The answer to a change of mode makes a HEARTBEAT old, too.
        """
        kind, number = message.get_type(), message.get_seq()
        if kind == 'COMMAND_ACK' and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            kind = MODE_ANSWER
        kinds = (kind, MODE_ANSWER) if kind == 'HEARTBEAT' else (kind,)
        if any(self._has_come(other, number, now) for other in kinds):
            return True
        self._newest[kind] = number, now
        return False

    @property
    def mode_told(self) -> bool:
        """Whether the mode was told after the last answer to DO_SET_MODE, and came by then."""
        answer = self._newest.get(MODE_ANSWER)
        return answer is not None and self._has_come('HEARTBEAT', *answer)

    def _has_come(self, kind: str, number: int, now: float) -> bool:
        """Whether one of a kind that was sent after the message of this number has come before."""
        newest, at = self._newest.get(kind, (number, now))
        behind = (newest - number) % 256
        return 0 < behind <= OVERTAKING_COUNT and 0.0 <= now - at <= OVERTAKING_TIME
