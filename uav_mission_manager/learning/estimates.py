"""The numbers of a mission file anew, each in its own field and unit, of what was counted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from uav_mission_manager.learning.counts import Counts
from uav_mission_manager.learning.posterior import (
    Posterior,
    probability_posterior,
    rate_posterior,
    row_posterior,
)
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.arrays import FloatArray
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR
from uav_mission_manager.mdp.mission import Parts
from uav_mission_manager.solver.evaluation.forecast import epoch_length

Path = tuple[str | int, ...]
"""Keys and places from the top of a mission file to one of its values."""

NEVER = 'never'
"""What a file says for a mean time without end."""

LIKELIEST_PRIOR = 1 - 1e-9
"""Probability of failing in an epoch above which the file's rate is taken as that of this one."""


@dataclass(frozen=True)
class LearnedNumber:
    """One number of a mission file.

    Attributes
    ----------
    path : tuple of str and int
        Where it is in the file.
    old, posterior : float, Posterior
        What the file says, and what is believed now, in the field's unit.
    seen, of : float
        How often it was seen, and in how many epochs (of each part, or goal) it could be.
    row : tuple of float
        All new probabilities of its row, empty for a number that stands alone.
    """

    path: Path
    old: float
    posterior: Posterior
    seen: float
    of: float
    row: tuple[float, ...] = ()

    @property
    def field(self) -> str:
        """Its name, such as `threat.from_low[1]`."""
        return field_name(self.path)


def field_name(path: Path) -> str:
    """Return the name of a field by its path, such as `goals[0].eta`."""
    parts = (f'[{part}]' if isinstance(part, int) else f'.{part}' for part in path)
    return ''.join(parts).removeprefix('.')


def estimates(
    data: Mapping[str, Any], mission: Mission, counts: Counts, weight: float
) -> list[LearnedNumber]:
    """Return what is learned of each number of which anything was seen.

    Parameters
    ----------
    data : mapping
        The mission file, as it was read.
    mission : Mission
        What it says.
    counts : Counts
        Of epochs as long as the mission's.
    weight : float
        Counts that the file is worth, above 0.
    """
    learner = _Learner(data, mission, counts, weight)
    return [
        *learner.priorities(),
        *learner.faults(),
        *learner.range(),
        *learner.threat(),
    ]


class _Learner:
    def __init__(
        self, data: Mapping[str, Any], mission: Mission, counts: Counts, weight: float
    ) -> None:
        self._data, self._mission, self._counts, self._weight = data, mission, counts, weight

    def priorities(self) -> Iterator[LearnedNumber]:
        """Of each goal that has requests of its own, and of all others together."""
        own = [
            bool({'priority_transition', 'requests_per_hour'} & set(goal))
            for goal in self._data['goals']
        ]
        sources: list[tuple[Path, list[int]]] = [
            ((), [j for j, is_own in enumerate(own) if not is_own])
        ]
        sources += [(('goals', j), [j]) for j, is_own in enumerate(own) if is_own]
        for place, goals in sources:
            if goals:
                seen = self._counts.priority[goals].sum(axis=0)
                yield from self._requests(place, goals[0], seen)

    def _requests(self, place: Path, goal: int, seen: FloatArray) -> Iterator[LearnedNumber]:
        given = self._at(place)
        if 'requests_per_hour' not in given:
            rows = self._mission.goals[goal].priority_transition
            for level, row in enumerate(rows):
                yield from self._row((*place, 'priority_transition', level), row, seen[level])
            return
        time = seen.sum(axis=1) - (seen.sum(axis=1) - seen.diagonal()) / 2
        kinds = {
            'low': (seen[0, 1], time[0]),
            'high': (seen[0, 2], time[0]),
            'raised': (seen[1, 2], time[1]),
            'lowered': (seen[2, 1], time[2]),
            'withdrawn': (seen[1, 0] + seen[2, 0], time[1] + time[2]),
        }
        for kind, (events, epochs) in kinds.items():
            path = (*place, 'requests_per_hour', kind)
            yield from self._per_hour(
                path, given['requests_per_hour'].get(kind, 0.0), events, epochs
            )

    def faults(self) -> Iterator[LearnedNumber]:
        """Failures of each part, completion by fault mode, repairs."""
        faults, given = self._mission.faults, self._data['faults']
        for bit, part in enumerate(field.name for field in fields(Parts)):
            failed, whole = self._counts.failure[:, bit].T
            factors = np.array([1.0, getattr(faults.agile_factor, part)])
            # Where it failed, half an epoch was flown with it in the mean.
            time = float(factors @ (failed / 2 + whole))
            events, epochs = float(failed.sum()), float((failed + whole).sum())
            rate = -math.log1p(-min(getattr(faults.rate, part), LIKELIEST_PRIOR))
            key, then = ('mtbf', self._hours) if 'mtbf' in given else ('rate', _in_an_epoch)
            if time:
                found = rate_posterior(rate, events, time, self._weight)
                yield self._estimate(('faults', key, part), found, then, events, epochs)
        yield from self._completions()
        lasts = 'repair_in' in given
        path = ('faults', 'repair_in' if lasts else 'repair_success')
        yield from self._probability(path, faults.repair_success, self._counts.repair, lasts)

    def _completions(self) -> Iterator[LearnedNumber]:
        """Of each goal that has a time of its own, and of all others together."""
        own = [bool({'completion', 'done_in'} & set(goal)) for goal in self._data['goals']]
        shared = self._counts.completion[~np.array(own)].sum(axis=0)
        yield from self._by_fault_mode(('faults',), self._mission.faults.completion, shared)
        for j, goal in enumerate(self._mission.goals):
            if goal.completion is not None:
                done = self._counts.completion[j]
                yield from self._by_fault_mode(('goals', j), goal.completion, done)

    def _by_fault_mode(
        self, place: Path, completion: Sequence[float], done: FloatArray
    ) -> Iterator[LearnedNumber]:
        key = 'done_in' if 'done_in' in self._at(place) else 'completion'
        path = (*place, key)
        if not isinstance(self._at(path), Sequence):  # Of no failed part; `faults` tells the rest.
            yield from self._probability(path, completion[0], done[0], True)
            return
        for f, old in enumerate(completion):
            yield from self._probability((*path, f), old, done[f], key == 'done_in')

    def range(self) -> Iterator[LearnedNumber]:
        """Loss of range, or what drains the charge."""
        given, modes = self._data['range'], ('normal', 'agile')
        loss, charge = self._mission.range.loss, self._mission.range.charge
        for mode, lost, drained in zip(modes, self._counts.lost, self._counts.drain):
            if loss is not None:
                path = ('range', 'lasts' if 'lasts' in given else 'loss', mode)
                yield from self._probability(path, getattr(loss, mode), lost, 'lasts' in given)
            if charge is not None:
                row = getattr(charge.drain, mode)
                size = max(len(row), int(np.flatnonzero(drained).max(initial=-1)) + 1)
                known = (*row, *(0.0,) * (size - len(row)))
                yield from self._row(('range', 'charge', 'drain', mode), known, drained[:size])

    def threat(self) -> Iterator[LearnedNumber]:
        """Onset in ordinary cells together and in each zone, and the levels."""
        threat, given = self._mission.threat, self._data['threat']
        zones = dict(threat.zones)
        ordinary = [cell for cell in range(self._mission.grid.q) if cell not in zones]
        key = 'per_hour' if 'per_hour' in given else 'onset'
        yield from self._onset(('threat', key), threat.onset, ordinary)
        key = 'zones_per_hour' if 'zones_per_hour' in given else 'zones'
        for cell, onset in zones.items():
            yield from self._onset(('threat', key, _key_of(given[key], cell)), onset, [cell])
        _, low, high = self._counts.onset.sum(axis=0)
        yield from self._probability(('threat', 'high_share'), threat.high_share, (high, low))
        yield from self._levels(given)

    def _onset(self, path: Path, onset: float, cells: list[int]) -> Iterator[LearnedNumber]:
        none, *came = self._counts.onset[cells].sum(axis=0)
        if path[1] in ('onset', 'zones'):
            yield from self._probability(path, onset, (sum(came), none))
        else:
            old = float(self._at(path))
            yield from self._per_hour(path, old, sum(came), none + sum(came) / 2)

    def _levels(self, given: Mapping[str, Any]) -> Iterator[LearnedNumber]:
        threat, seen = self._mission.threat, self._counts.threat
        if 'lasts' not in given:
            yield from self._row(('threat', 'from_low'), threat.from_low, seen[1])
            yield from self._row(('threat', 'from_high'), threat.from_high, seen[2])
            return
        rows = ((1, 2, 'low', 'rises', threat.from_low), (2, 1, 'high', 'falls', threat.from_high))
        for stays, other, level, share, row in rows:
            leaves = seen[stays].sum() - seen[stays, stays]
            path: Path = ('threat', 'lasts')
            ended = (leaves, seen[stays, stays])
            yield from self._probability((*path, level), 1 - row[stays], ended, True)
            old = given['lasts'].get(share, 0.0)
            kinds = (seen[stays, other], leaves - seen[stays, other])
            yield from self._probability((*path, share), old, kinds)

    def _at(self, path: Path) -> Any:
        found: Any = self._data
        for part in path:
            found = found[part]
        return found

    def _row(self, path: Path, old: Sequence[float], seen: FloatArray) -> Iterator[LearnedNumber]:
        if not seen.any():
            return
        found = row_posterior(old, seen, self._weight)
        row = tuple(entry.value for entry in found)
        for place, (before, entry) in enumerate(zip(old, found)):
            count, total = float(seen[place]), float(seen.sum())
            yield LearnedNumber((*path, place), before, entry, count, total, row)

    def _probability(
        self, path: Path, old: float, seen: Sequence[float] | FloatArray, lasts: bool = False
    ) -> Iterator[LearnedNumber]:
        """Of a probability, or of the mean time until what has it each epoch."""
        yes, no = map(float, seen)
        if yes + no:
            found = probability_posterior(old, yes, no, self._weight)
            yield self._estimate(
                path, found, self._seconds if lasts else float, yes, yes + no, old
            )

    def _per_hour(
        self, path: Path, old: float, events: float, epochs: float
    ) -> Iterator[LearnedNumber]:
        if epochs:
            hours = epoch_length(self._mission) / SECONDS_PER_HOUR
            found = rate_posterior(old * hours, events, epochs, self._weight)
            hourly = Posterior(*(rate / hours for rate in found))
            yield LearnedNumber(path, old, hourly, float(events), float(epochs + events / 2))

    def _estimate(
        self,
        path: Path,
        found: Posterior,
        then: Callable[[float], float],
        seen: float,
        of: float,
        old: float | None = None,
    ) -> LearnedNumber:
        value, *bounds = map(then, found)
        given = then(old) if old is not None else self._at(path)
        return LearnedNumber(path, given, Posterior(value, *sorted(bounds)), seen, of)

    def _seconds(self, probability: float) -> float:
        return epoch_length(self._mission) / probability if probability else math.inf

    def _hours(self, rate: float) -> float:
        return epoch_length(self._mission) / SECONDS_PER_HOUR / rate if rate else math.inf


def _in_an_epoch(rate: float) -> float:
    return -math.expm1(-rate)


def _key_of(cells: Mapping[Any, Any], cell: int) -> Any:
    """Return the key by which a mapping has a cell, a number or its digits."""
    return next(key for key in cells if str(key) == str(cell))
