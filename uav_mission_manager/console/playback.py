"""A recorded flight as what was heard at each moment, and where in it a page is."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from uav_mission_manager.console.heard import Heard, HeardEpoch
from uav_mission_manager.console.messages import (
    DIAGNOSTICS_TOPIC,
    Moment,
    bridge_reports,
    heard_after,
)
from uav_mission_manager.console.other_policy import OtherPolicy

FLIGHT_STEP = 0.2
"""Time [s] between two moments that are kept, at least: a choice, little to an eye."""

MOST_MOMENTS = 5000
"""Moments that are kept, at most: a choice, a quarter of an hour at `FLIGHT_STEP`."""

SPEEDS = (0.5, 1, 2, 5, 20)
"""Seconds of the flight per second: a choice."""


@dataclass(frozen=True)
class RecordedFlight:
    """What was known of a vehicle at each of some times [s], in their order.

    Of each epoch of the timeline it has when it began, too.
    """

    vehicle: str
    times: tuple[float, ...]
    heard: tuple[Heard, ...]
    epochs: tuple[tuple[float, HeardEpoch], ...] = ()

    @property
    def duration(self) -> float:
        """Time [s] of the last moment."""
        return self.times[-1]

    def at(self, seconds: float) -> Heard:
        """Return what was known then."""
        return self.heard[max(bisect_right(self.times, seconds) - 1, 0)]


def heard_flight(
    vehicle: str, messages: Iterable[tuple[Moment, str, Any]], duration: float
) -> RecordedFlight:
    """Return what is known of a vehicle, message by message, in moments that are not too many.

    Parameters
    ----------
    vehicle : str
        Its namespace.
    messages : iterable
        When each was recorded [s] since the beginning; a key of `HEARD_CHANGES`; what it says.
    duration : float
        About how long that takes [s].
    """
    step = max(FLIGHT_STEP, duration / MOST_MOMENTS)
    times, moments, heard, at = [0.0], [Heard()], Heard(), 0.0
    epochs: list[tuple[float, HeardEpoch]] = []
    for moment, topic, message in messages:
        at = moment.at
        if at - times[-1] >= step:
            times.append(at)
            moments.append(heard)
        reports = [message]
        if topic == DIAGNOSTICS_TOPIC:
            reports = [status for name, status in bridge_reports(message) if name == vehicle]
        for report in reports:
            heard = heard_after(heard, topic, report, moment)
        if heard.epochs and (not epochs or heard.epochs[-1] is not epochs[-1][1]):
            epochs.append((at, heard.epochs[-1]))
    return RecordedFlight(vehicle, (*times, at), (*moments, heard), tuple(epochs))


class Playback:
    """Where in a flight the page is; it begins paused.

    Parameters
    ----------
    flight : RecordedFlight
    clock : callable
        Returns the time [s] of who looks.
    other : OtherPolicy or None
        A policy whose decisions are shown beside those flown.

    Attributes
    ----------
    flight, other
    playing : bool
    speed : float
        Seconds of the flight per second.
    """

    def __init__(
        self,
        flight: RecordedFlight,
        clock: Callable[[], float],
        other: OtherPolicy | None = None,
    ) -> None:
        self.flight, self.other, self._clock = flight, other, clock
        self._from, self._since = 0.0, clock()
        self.playing, self.speed = False, 1.0

    @property
    def position(self) -> float:
        """Time [s] since the beginning; at the end it stays."""
        passed = (self._clock() - self._since) * self.speed if self.playing else 0.0
        return min(self._from + passed, self.flight.duration)

    @property
    def ended(self) -> bool:
        """Whether it is at the end."""
        return self.position >= self.flight.duration

    def heard(self) -> Heard:
        """Return what was known at this position."""
        return self.flight.at(self.position)

    def seek(self, seconds: float) -> None:
        """Go to a time since the beginning [s]."""
        self._from, self._since = min(max(seconds, 0.0), self.flight.duration), self._clock()

    def seek_difference(self) -> None:
        """Go to where the other policy next decides otherwise; from the last, to the first."""
        starts = [start for start, _ in self.other.differences] if self.other else []
        later = [start for start in starts if start > self.position]
        if starts:
            self.seek((later or starts)[0] + FLIGHT_STEP)  # What is decided there is then known.

    def toggle(self) -> None:
        """Pause; or play, from the beginning where the end is reached."""
        if self.playing and not self.ended:
            self.seek(self.position)
            self.playing = False
        else:
            self.seek(0.0 if self.ended else self.position)
            self.playing = True

    def set_speed(self, speed: float) -> None:
        """Go on from here so fast."""
        self.seek(self.position)
        self.speed = speed
