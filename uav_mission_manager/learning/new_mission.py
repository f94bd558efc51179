"""A new mission file: what was learned, in the place of the old numbers, with its source."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from uav_mission_manager.learning.counts import Counts
from uav_mission_manager.learning.estimates import LearnedNumber, Path, estimates, field_name
from uav_mission_manager.learning.mission_edit import (
    Edit,
    edited,
    probabilities,
    rounded,
)
from uav_mission_manager.learning.posterior import LEVEL_TEXT, Posterior, mean_posterior
from uav_mission_manager.mdp import Mission, mission_from_dict
from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.strict_yaml import read_yaml

DEFAULT_WEIGHT = 10.0
"""Counts that the mission file is worth: a choice by measurement, see docs/learn.md."""

FEWEST_SAMPLES = 3
"""Of which a mean is learned, at least: a choice; fewer say nothing of how they vary."""


def _none() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True)
class Measured:
    """What was measured in flight, a sample each time.

    Attributes
    ----------
    cell_seconds : float array
        Time to fly straight through a cell, in normal flight [s].
    power, agile_power : float array
        Power drawn in epochs of normal flight and of agile flight [W].
    """

    cell_seconds: FloatArray = field(default_factory=_none)
    power: FloatArray = field(default_factory=_none)
    agile_power: FloatArray = field(default_factory=_none)


@dataclass(frozen=True)
class NewMission:
    """A mission file with what was learned.

    Attributes
    ----------
    text : str
        The file.
    mission : Mission
        What it says.
    learned : list of LearnedNumber
    """

    text: str
    mission: Mission
    learned: list[LearnedNumber]


def with_measured(text: str, source: str, measured: Measured, weight: float) -> NewMission:
    """Return a mission file with the speed and the power of flights.

    The length of an epoch follows from the speed, so this comes before epochs are counted.
    """
    mission = mission_from_dict(read_yaml(text), source)
    found = list(_measured(mission, measured, weight))
    return _rewritten(text, source, found)


def with_counts(text: str, source: str, counts: Counts, weight: float) -> NewMission:
    """Return a mission file with the probabilities and rates of what was counted.

    Parameters
    ----------
    text, source : str
        A mission file and its name.
    counts : Counts
    weight : float
        Counts that the file is worth, above 0.

    Raises
    ------
    ValueError
        If the text cannot be changed, or a rate is too high for the length of an epoch.
    """
    data = read_yaml(text)
    found = estimates(data, mission_from_dict(data, source), counts, weight)
    return _rewritten(text, source, found)


def _measured(mission: Mission, measured: Measured, weight: float) -> Iterator[LearnedNumber]:
    energy, size = mission.energy, mission.grid.cell_size
    if energy is None:
        return
    if (n := len(measured.cell_seconds)) >= FEWEST_SAMPLES:
        found = mean_posterior(size / energy.speed, measured.cell_seconds, weight)
        speeds = Posterior(*(size / seconds for seconds in (found.value, found.high, found.low)))
        yield LearnedNumber(('energy', 'speed'), energy.speed, speeds, n, n)
    powers = {'power': measured.power, 'agile_power': measured.agile_power}
    if energy.agile_power is None:
        powers = {'power': np.concatenate([*powers.values()])}
    for key, samples in powers.items():
        if (n := len(samples)) >= FEWEST_SAMPLES:
            old = getattr(energy, key)
            yield LearnedNumber(('energy', key), old, mean_posterior(old, samples, weight), n, n)


def _rewritten(text: str, source: str, found: list[LearnedNumber]) -> NewMission:
    data = read_yaml(text)
    edits = list(_edits(data, mission_from_dict(data, source), found))
    new = edited(text, source, edits) if edits else text
    return NewMission(new, mission_from_dict(read_yaml(new), source), found)


def _edits(
    data: Mapping[str, Any], mission: Mission, found: list[LearnedNumber]
) -> Iterator[Edit]:
    def place(estimate: LearnedNumber) -> tuple[Path, bool]:
        return (estimate.path[:-1], True) if estimate.row else (estimate.path, False)

    drains: dict[str | int, tuple[list[float], str]] = {}
    for (path, is_row), group in groupby(found, place):
        entries = list(group)
        value: Any
        if is_row:
            value, comment = probabilities(entries[0].row), _row_comment(path, entries)
        else:
            value, comment = rounded(path, entries[0].posterior.value), _comment(entries[0])
        if path[:3] == ('range', 'charge', 'drain') and 'drain' not in data['range']['charge']:
            drains[path[-1]] = value, comment
        elif value != (list if is_row else float)(_old(entries)):
            yield Edit(path, value, comment)
    if drains:
        yield _drain_edit(data['range']['charge'], mission, drains)


def _old(entries: Sequence[LearnedNumber]) -> Any:
    return [entry.old for entry in entries] if entries[0].row else entries[0].old


def _drain_edit(
    given: Mapping[str, Any], mission: Mission, drains: Mapping[str | int, tuple[list[float], str]]
) -> Edit:
    """Say outright what drains the charge, in place of the noise."""
    assert mission.range.charge is not None
    rows = {
        mode: drains[mode][0] if mode in drains else probabilities(row)
        for mode, row in vars(mission.range.charge.drain).items()
    }
    comment = '\n'.join(comment for _, comment in drains.values())
    instead_of = 'noise' if 'noise' in given else ''
    return Edit(('range', 'charge', 'drain'), rows, comment, instead_of)


def _comment(estimate: LearnedNumber) -> str:
    value, low, high = (short(x) for x in estimate.posterior)
    return (
        f'learned {_name(estimate.path)}: {value}, {LEVEL_TEXT} {low} to {high}; '
        f'{estimate.seen:g} of {estimate.of:g}; was {short(estimate.old)}'
    )


def _row_comment(path: Path, entries: Sequence[LearnedNumber]) -> str:
    bounds = ', '.join(f'{short(e.posterior.low)} to {short(e.posterior.high)}' for e in entries)
    counts = ', '.join(f'{e.seen:g}' for e in entries)
    was = ', '.join(short(e.old) for e in entries)
    return (
        f'learned {_name(path)}: {LEVEL_TEXT} {bounds}; {counts} of {entries[0].of:g}; was {was}'
    )


def _name(path: Path) -> str:
    """Return the last key of a field, with its place in a row."""
    return field_name(path[-2:] if isinstance(path[-1], int) else path[-1:])


def short(value: float) -> str:
    """Return a number in three digits."""
    return 'never' if value == math.inf else f'{value:.3g}'
