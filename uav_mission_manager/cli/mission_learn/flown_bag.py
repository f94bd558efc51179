"""The epochs of a recorded flight: the manager's states, cut into epochs as long as the model's.

A step of the model ends at the centre of a cell, and on board a cell is told from its border on,
half an epoch earlier: so the cell of a state is the one of half an epoch ago.

An epoch is counted where the manager decided in all of it, and was in command. What is left at the
end counts as an epoch if it is at least half of one.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from uav_mission_manager.cli.mission_report.flight_record import (
    Decided,
    FlightRecord,
    flight_record,
)
from uav_mission_manager.echo import shown
from uav_mission_manager.learning import FlownEpochs, Measured
from uav_mission_manager.mdp import Mission, StateSpace
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.onboard import parse_command
from uav_mission_manager.solver.evaluation.forecast import epoch_length

IN_COMMAND = 'MANAGER'
"""Word of `InCommand` for the manager."""


class Stretch(NamedTuple):
    """A time in which the manager decided and was in command: from and until [s]."""

    start: float
    end: float


def recorded(bag: Path, vehicle: str | None, speedup: float, mission: Mission) -> FlightRecord:
    """Read a flight of this mission from a bag.

    Raises
    ------
    ValueError
        One line: it cannot be read, or was decided in another mission.
    """
    record = flight_record(bag, vehicle, speedup)
    space = StateSpace.of(mission)
    for at, decision in record.decided:
        if not decision.state:
            continue
        try:
            space.check([decision.state])
            parse_command(mission, decision.command)
        except ValueError as error:
            raise ValueError(
                f'{shown(bag)}: at {at:.2f} s: decided in another mission than '
                f'{shown(mission.name)}: {error}'
            ) from error
    return record


def seconds_per_epoch(mission: Mission, source: str) -> float:
    """Return the length of an epoch [s]. Raises `ValueError` where the file does not tell it."""
    try:
        return epoch_length(mission)
    except Bad as error:
        raise ValueError(f'{shown(source)}: {error}') from None


def measured(records: list[FlightRecord], mission: Mission, length: float) -> Measured:
    """Return the time per cell, one of each flight, and the power of each epoch in the air."""
    speeds = np.array([record.usual_speed() for record in records])
    speeds = speeds[np.isfinite(speeds) & (speeds > 0)]
    assert mission.energy is not None
    full = mission.energy.capacity * mission.energy.voltage * SECONDS_PER_HOUR
    powers: tuple[list[float], list[float]] = ([], [])
    for record in records:
        for start, end in epoch_times(record, length):
            used = record.charge_at(start) - record.charge_at(end)
            # A battery that was changed in between is fuller.
            if _in_air(record, start, end) and used >= 0:
                command = parse_command(mission, _decided_at(record, start).decision.command)
                powers[command.agile].append(full * used / (end - start))
    return Measured(mission.grid.cell_size / speeds, *map(np.array, powers))


def flown_epochs(record: FlightRecord, mission: Mission, length: float) -> FlownEpochs:
    """Return the epochs of a recorded flight, each of `length` [s]."""
    space = StateSpace.of(mission)
    times = list(epoch_times(record, length))
    shape = (len(times), len(space.shape))
    states, after = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    actions = np.zeros(len(times), np.int64)
    for row, (start, end) in enumerate(times):
        states[row] = _state_at(record, space, start, length)
        goes_on = times[row + 1 : row + 2] and times[row + 1].start == end
        # What is decided where a stretch ends is no part of it.
        last = end if goes_on else math.nextafter(end, start)
        after[row] = _state_at(record, space, last, length)
        command = _decided_at(record, start).decision.command
        actions[row] = parse_command(mission, command).number
    airborne = np.array([_in_air(record, *time) for time in times], bool)
    _let_charge_fall(space, states, after, airborne, times)
    completed = _completed(record, mission, times) & (space.split(states).g > 0)
    return FlownEpochs(states, actions, completed, after, airborne)


def epoch_times(record: FlightRecord, length: float) -> Iterator[Stretch]:
    """Yield when each epoch begins and ends [s]."""
    for start, end in stretches(record):
        epochs = int((end - start) / length + 0.5)
        for number in range(epochs):
            yield Stretch(start + number * length, min(start + (number + 1) * length, end))


def stretches(record: FlightRecord) -> Iterator[Stretch]:
    """Yield the times in which the manager decided and was in command."""
    changes = sorted({*(d.at for d in record.decided), *(at for at, _ in record.in_command)})
    start = None
    for at in [*changes, record.end]:
        good = at < record.end and _decides(record, at)
        if good and start is None:
            start = at
        elif not good and start is not None:
            yield Stretch(start, at)
            start = None


def _decides(record: FlightRecord, at: float) -> bool:
    place = bisect_right(record.decided, at, key=lambda entry: entry.at)
    if not place or not record.decided[place - 1].decision.state:
        return False
    told = bisect_right(record.in_command, at, key=lambda entry: entry[0])
    known = record.in_command[told - 1][1].word if told else ''
    return known == IN_COMMAND or not record.in_command


def _decided_at(record: FlightRecord, at: float) -> Decided:
    place = bisect_right(record.decided, at, key=lambda entry: entry.at)
    return record.decided[max(place - 1, 0)]


def _state_at(record: FlightRecord, space: StateSpace, at: float, length: float) -> IntArray:
    """Return the state of a time, with the cell of half an epoch before it."""
    state = np.array(_decided_at(record, at).decision.state)
    before = _decided_at(record, at - length / 2).decision.state
    if before:
        space.split(state).l[...] = space.split(np.array(before)).l
    return state


def _in_air(record: FlightRecord, start: float, end: float) -> bool:
    flown = sum(max(min(end, leg.end) - max(start, leg.start), 0.0) for leg in record.legs)
    return flown >= (end - start) / 2


def _let_charge_fall(
    space: StateSpace,
    states: IntArray,
    after: IntArray,
    airborne: BoolArray,
    times: list[Stretch],
) -> None:
    """Take the lowest level so far in a flight: a gauge that wavers drains nothing twice."""
    lowest: IntArray | None = None
    for row, (flown, time) in enumerate(zip(airborne, times)):
        goes_on = row > 0 and times[row - 1].end == time.start
        before, later = space.split(states[row]).b, space.split(after[row]).b
        if not flown:
            lowest = None
            continue
        if lowest is not None and goes_on:
            before[:] = np.minimum(before, lowest)
        later[:] = np.minimum(before, later)
        lowest = later


def _completed(record: FlightRecord, mission: Mission, times: list[Stretch]) -> BoolArray:
    """Tell the goals that were completed in each epoch; a completion is said more than once."""
    names = [goal.name for goal in mission.goals]
    out = np.zeros((len(times), mission.k), bool)
    starts: FloatArray = np.array([time.start for time in times])
    for at, name in record.completed:
        row = int(np.searchsorted(starts, at)) - 1
        if row >= 0 and at <= times[row].end and name in names:
            out[row, names.index(name)] = True
    return out
