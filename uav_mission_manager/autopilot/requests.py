"""What was asked of the vehicle, how it answered, and when to ask again."""

from __future__ import annotations

from dataclasses import dataclass

from uav_mission_manager.autopilot.task import Phase, PilotOutput
from uav_mission_manager.autopilot.vehicle import Fly, Request

FIRST_REPEAT, LAST_REPEAT = 2.0, 30.0
"""Time [s] after which a request that telemetry does not show as done is made again: twice as long
each time, up to the second. Choices."""

FLY_REPEAT_PERIOD = 5.0
"""The same [s] for a flight that was not refused, in case someone sent the vehicle elsewhere: a
choice."""

MAX_SPEED_SHARE = 1.1
"""Share of the speed asked for above which the vehicle has forgotten it, and is told again."""

SLOWING_TIME = 3.0
"""Time [s] that a vehicle may take to slow down before it is told again: a choice, 10 to 5 m/s
at ArduCopter's 2.5 m/s2."""


@dataclass
class _Asked:
    request: Request
    at: float
    times: int = 1
    refusals: int = 0
    why: str = ''


class Requests:
    """The last request of each kind."""

    def __init__(self) -> None:
        self._asked: dict[type[Request], _Asked] = {}

    def clear(self) -> None:
        """Forget all requests: the vehicle has changed its mode or arming."""
        self._asked.clear()

    def forget_refusals(self) -> None:
        """Start to count refusals anew: something else is commanded."""
        for asked in self._asked.values():
            asked.refusals = 0

    def refusals(self, kind: type[Request]) -> tuple[int, str]:
        """Return how often in a row a request of this kind was refused, and why."""
        asked = self._asked.get(kind)
        return (asked.refusals, asked.why) if asked else (0, '')

    def answered(self, kind: type[Request], accepted: bool, why: str) -> None:
        """Take the autopilot's answer."""
        asked = self._asked.get(kind)
        if asked is not None:
            asked.refusals = 0 if accepted else asked.refusals + 1
            asked.why = why

    def ask(
        self, request: Request, phase: Phase, why: str, now: float, speed: float = 0.0
    ) -> PilotOutput:
        """Return a step with the request, if it is new or was made long enough ago.

        `speed` is how fast the vehicle is [m/s], for a `Fly` that asks for less.
        """
        due = self._due(request, now, speed)
        return PilotOutput(phase, why, (request,) if due else ())

    def _due(self, request: Request, now: float, speed: float) -> bool:
        asked = self._asked.get(type(request))
        if asked is None or asked.request != request:
            refusals = asked.refusals if asked else 0
            self._asked[type(request)] = _Asked(request, now, refusals=refusals)
            return True
        if now - asked.at < _pause(asked, speed):
            return False
        asked.at, asked.times = now, asked.times + 1
        return True


def _pause(asked: _Asked, speed: float) -> float:
    """Time [s] from one request to the next."""
    doublings = asked.times - 1
    if isinstance(asked.request, Fly):
        if not asked.refusals:
            too_fast = speed > MAX_SPEED_SHARE * asked.request.speed
            return SLOWING_TIME if too_fast else FLY_REPEAT_PERIOD
        doublings = asked.refusals - 1
    return min(FIRST_REPEAT * 2.0**doublings, LAST_REPEAT)
