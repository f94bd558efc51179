"""What a bag tells of a flight, each thing with its time: what reports are made of."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from uav_mission_manager.cli.recorded_flight import DECISIONS, heard_messages
from uav_mission_manager.console.heard import Heard, HeardDecision, LogLine
from uav_mission_manager.console.messages import (
    DIAGNOSTICS_TOPIC,
    Moment,
    bridge_reports,
    heard_after,
)
from uav_mission_manager.console.words import InCommand, authority
from uav_mission_manager.drawing.trail import TRAIL_BREAK

OFF_GROUND = 0.5
"""Height [m] above the place where it stood from which a vehicle counts as in the air: a choice,
more than its height is off by in a minute."""

ORDER_SLACK = 1.0
"""Time of the bag [s] by which what was said later may be recorded earlier: a choice, of two
processes on a busy machine."""

SPEED_WINDOW = 2.0
"""Time [s] over which the speed is measured, at least: a choice, a few positions."""


class TrackPoint(NamedTuple):
    """Where the vehicle was at a time [s]: east, north and height [m]."""

    at: float
    east: float
    north: float
    height: float


class Happening(NamedTuple):
    """What was heard at a time [s], beside decisions."""

    at: float
    line: LogLine


class Decided(NamedTuple):
    """A decision, and from when on it held [s]."""

    at: float
    decision: HeardDecision


class AirTime(NamedTuple):
    """A time in the air: from and until [s]."""

    start: float
    end: float


@dataclass
class FlightRecord:
    """All that a report tells of a flight; times are of the flight [s], from the bag's beginning.

    Attributes
    ----------
    vehicle : str
    began : float
        When the bag begins [s], since 1970.
    speedup : float
        Seconds of the flight per second of the bag.
    end : float
    decided : list of Decided
        Each differs from the one before in state or command.
    happened : list of Happening
    in_command : list of (time, InCommand)
        Each differs from the one before in who it is.
    asked : list of (time, priorities)
    completed : list of (time, goal)
    refused : list of (time, goal)
        Out of reach, or its task failed.
    track : list of TrackPoint
    charges : list of (time, charge)
        Of the worst battery, 0 to 1.
    legs : list of AirTime
        When it was in the air.
    batteries : int
        How many were heard.
    """

    vehicle: str
    began: float
    speedup: float
    end: float = 0.0
    decided: list[Decided] = field(default_factory=list)
    happened: list[Happening] = field(default_factory=list)
    in_command: list[tuple[float, InCommand]] = field(default_factory=list)
    asked: list[tuple[float, tuple[int, ...]]] = field(default_factory=list)
    completed: list[tuple[float, str]] = field(default_factory=list)
    refused: list[tuple[float, str]] = field(default_factory=list)
    track: list[TrackPoint] = field(default_factory=list)
    charges: list[tuple[float, float]] = field(default_factory=list)
    legs: list[AirTime] = field(default_factory=list)
    batteries: int = 0

    @property
    def flown_by(self) -> list[str]:
        """Digests of the policy sets that decided, in order, without repetitions."""
        return list(dict.fromkeys(d.decision.digest for d in self.decided if d.decision.state))

    @property
    def slack(self) -> float:
        """Time of the flight [s] by which two things may be recorded in the wrong order."""
        return ORDER_SLACK * self.speedup

    def in_air(self, at: float) -> bool:
        """Whether it was in the air at a time [s]."""
        return any(leg.start <= at < leg.end for leg in self.legs)

    def decided_at(self, at: float) -> HeardDecision:
        """Return the last decision in a state by a time [s]; an empty one where there is none."""
        found = [each.decision for each in self.decided if each.at <= at and each.decision.state]
        return found[-1] if found else HeardDecision('')

    def charge_at(self, at: float) -> float:
        """Return the charge last heard at a time [s]; NaN where none was heard."""
        place = bisect_right(self.charges, at, key=lambda entry: entry[0])
        return self.charges[max(place - 1, 0)][1] if self.charges else math.nan

    def way(self) -> float:
        """Length of the track [m], jumps left out."""
        steps = (math.dist(a[1:], b[1:]) for a, b in zip(self.track, self.track[1:]))
        return sum(step for step in steps if step < TRAIL_BREAK)

    def usual_speed(self) -> float:
        """Ground speed [m/s] over half of the way, at least; NaN where it was nowhere flown."""
        speeds, first = [], None
        for place in self.track:
            if first is None or place.at - first.at >= SPEED_WINDOW:
                if first is not None and place.at > first.at:
                    way = math.dist(first[1:3], place[1:3])
                    speeds.append((way / (place.at - first.at), way))
                first = place
        half, flown = sum(way for _, way in speeds) / 2, 0.0
        for speed, way in sorted(speeds, reverse=True):
            flown += way
            if flown > half:
                return speed
        return math.nan

    def place_at(self, at: float) -> TrackPoint | None:
        """Where it was last heard to be at a time."""
        count = bisect_right(self.track, at, key=lambda place: place.at)
        return self.track[count - 1] if count else None


def flight_record(path: Path, vehicle: str | None, speedup: float = 1.0) -> FlightRecord:
    """Read a flight from a bag.

    Parameters
    ----------
    path : Path
        A folder with `metadata.yaml`, or one of its files.
    vehicle : str or None
        Its namespace, such as `/uav1`; None for the only one.
    speedup : float
        Seconds of the flight per second of the bag.

    Raises
    ------
    ValueError
        One line: it is no bag, cannot be read, or has no decisions.
    """
    with heard_messages(path, vehicle, DECISIONS) as heard:
        record = FlightRecord(heard.vehicle, heard.start, speedup)
        _Listener(record).take_all(heard.messages)
        return record


class _Listener:
    """Writes a flight down, message by message."""

    def __init__(self, record: FlightRecord) -> None:
        self._record, self._heard = record, Heard()
        self._ground: float | None = None
        self._took_off: float | None = None
        self._refusal = ''

    def take_all(self, messages: Iterable[tuple[Moment, str, Any]]) -> None:
        for moment, topic, message in messages:
            at = moment.at * self._record.speedup
            self._record.end = at
            reports = [message]
            if topic == DIAGNOSTICS_TOPIC:
                vehicle = self._record.vehicle
                reports = [status for name, status in bridge_reports(message) if name == vehicle]
            for report in reports:
                before = self._heard
                self._heard = heard_after(before, topic, report, Moment(at, moment.time_of_day))
                self._note(before, topic, report, at)
        if self._took_off is not None:
            self._record.legs.append(AirTime(self._took_off, self._record.end))

    def _note(self, before: Heard, topic: str, message: Any, at: float) -> None:
        now, record = self._heard, self._record
        told_otherwise = now.decision is not before.decision or now.asked is not before.asked
        if now.epochs is not before.epochs and now.decision is not None:
            record.decided.append(Decided(at, now.decision.value))
        if now.asked and (not before.asked or now.asked.value != before.asked.value):
            record.asked.append((at, now.asked.value))
        if now.pose is not before.pose and now.pose is not None:
            pose = now.pose.value
            record.track.append(TrackPoint(at, pose.east, pose.north, pose.height))
            self._rise_or_land(at, pose.height)
        if now.batteries is not before.batteries:
            record.batteries = len(now.batteries)
            record.charges.append((at, min(noted.value for noted in now.batteries.values())))
        if now.bridge is not before.bridge:
            self._note_bridge(at, message)
        elif now.log is not before.log and not told_otherwise:
            record.happened.append(Happening(at, now.log[-1]))
        for kind, found in (
            ('goal_completed', record.completed),
            ('goal_refused', record.refused),
            ('goal_failed', record.refused),
        ):
            if topic == kind and message.data:
                found.append((at, message.data))

    def _note_bridge(self, at: float, status: Any) -> None:
        record, now = self._record, self._heard
        assert now.bridge is not None
        who = authority(now, at, math.inf)
        if not record.in_command or record.in_command[-1][1].word != who.word:
            record.in_command.append((at, who))
        if not now.bridge.value.armed and now.bridge.value.link_up:
            self._land(at)
            self._ground = now.pose.value.height if now.pose else None
        refusal = next((pair.value for pair in status.values if pair.key == 'command_refused'), '')
        if refusal and refusal != self._refusal:
            line = LogLine('', f'the autopilot refuses: {refusal}', 'warning')
            record.happened.append(Happening(at, line))
        self._refusal = refusal

    def _rise_or_land(self, at: float, height: float) -> None:
        if self._ground is None:
            return
        if height - self._ground < OFF_GROUND:
            self._land(at)
        elif self._took_off is None:
            self._took_off = at

    def _land(self, at: float) -> None:
        if self._took_off is not None:
            self._record.legs.append(AirTime(self._took_off, at))
            self._took_off = None
