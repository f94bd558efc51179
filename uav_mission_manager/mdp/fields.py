"""Reading one field after the other: values checked, errors in one line with their place."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NoReturn, TypeVar

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp.mission import Matrix, Row

ROW_SUM_TOLERANCE = 1e-9
"""Largest distance of a sum of probabilities from 1: a choice, room for rounding."""

MAX_NAME_LENGTH = 100
"""Characters of a name: a choice, room for several of them in a line."""

_T = TypeVar('_T')


class MissionError(ValueError):
    """A mission that cannot be used; the message names the source, the field and the value."""


class Bad(ValueError):
    """What is wrong with one value; the section that reads it adds where."""


NO_DEFAULT: Any = object()
"""Default of a field that must be given."""


class Section:
    """A mapping being read: every key once, by name; `end` refuses what is left."""

    def __init__(self, data: Any, source: str, place: str) -> None:
        self.source, self.place = source, place
        if not isinstance(data, Mapping):
            self.fail('', f'{quoted(data)} is not a mapping')
        self.data: Mapping[Any, Any] = data
        self.known: dict[Any, None] = {}  # In the order they were asked for.

    def fail(self, key: object, problem: str) -> NoReturn:
        """Raise a `MissionError` about one field."""
        field = f'{self.place}.{shown(key)}'.strip('.') or 'mission'
        raise MissionError(f'{shown(self.source)}: {field}: {problem}')

    def get(self, key: str, check: Callable[[Any], _T], default: Any = NO_DEFAULT) -> _T:
        """Return the checked value of a field, or its default."""
        self.known[key] = None
        if key not in self.data:
            if default is NO_DEFAULT:
                self.fail(key, 'is missing')
            return default
        try:
            return check(self.data[key])
        except Bad as error:
            self.fail(key, str(error))

    def section(self, key: str, read: Callable[[Section], _T], default: Any = NO_DEFAULT) -> _T:
        """Return what `read` makes of a mapping below, or the default."""
        value = self.get(key, lambda data: data, default)
        if key not in self.data:
            return value
        section = Section(value, self.source, f'{self.place}.{key}'.strip('.'))
        result = read(section)
        section.end()
        return result

    def end(self) -> None:
        """Refuse fields nobody asked for, naming the nearest known one."""
        for key in self.data:
            if key not in self.known:
                near = difflib.get_close_matches(shown(key), self.known, n=1, cutoff=0.0)
                self.fail(key, f'is unknown; the nearest known key is {near[0]!r}')


def number(value: Any) -> float:
    """Check a finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise Bad(f'{quoted(value)} is not a number')
    try:
        number = float(value)
    except OverflowError:
        raise Bad(f'{quoted(value)} is too large') from None
    if not math.isfinite(number):
        raise Bad(f'{quoted(value)} is not finite')
    return number


def numbers(data: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """Return some fields as they are, each of them a finite number or a truth value."""
    for key in names:
        if not isinstance(data[key], bool):
            try:
                number(data[key])
            except Bad as error:
                raise Bad(f'{key}: {error}') from None
    return {key: data[key] for key in names}


def within(low: float, high: float) -> Callable[[Any], float]:
    """Return a check for a number within low..high."""

    def check(value: Any) -> float:
        checked = number(value)
        if not low <= checked <= high:
            raise Bad(f'{quoted(value)} is outside {low:g}..{high:g}')
        return checked

    return check


probability = within(0.0, 1.0)
"""Check a number within 0..1."""


def non_negative(value: Any) -> float:
    """Check a number that is not negative."""
    checked = number(value)
    if checked < 0:
        raise Bad(f'{quoted(value)} is negative')
    return checked


def positive(value: Any) -> float:
    """Check a number above 0."""
    checked = number(value)
    if checked <= 0:
        raise Bad(f'{quoted(value)} is not above 0')
    return checked


def open_unit(value: Any) -> float:
    """Check a number between 0 and 1, both excluded."""
    checked = number(value)
    if not 0 < checked < 1:
        raise Bad(f'{quoted(value)} is not between 0 and 1')
    return checked


def integer(low: int, high: int | None = None) -> Callable[[Any], int]:
    """Return a check for a whole number from low, to high if given."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise Bad(f'{quoted(value)} is not a whole number')
        if value < low or (high is not None and value > high):
            raise Bad(f'{quoted(value)} is outside {low}..{"" if high is None else high}')
        return value

    return check


def name(value: Any) -> str:
    """Check a string without white space, which every log and topic can carry."""
    if not isinstance(value, str) or not value or value.split() != [value]:
        raise Bad(f'{quoted(value)} is not a name (a string without white space)')
    if len(value) > MAX_NAME_LENGTH:
        raise Bad(f'{quoted(value)} has more than {MAX_NAME_LENGTH} characters')
    if not value.isprintable():
        raise Bad(f'{quoted(value)} has characters that cannot be printed')
    return value


def one_of(*names: str) -> Callable[[Any], str]:
    """Return a check for one of several names."""

    def check(value: Any) -> str:
        if value not in names:
            raise Bad(f'{quoted(value)} is none of {", ".join(names)}')
        return str(value)

    return check


def row(length: int, check: Callable[[Any], float]) -> Callable[[Any], Row]:
    """Return a check for a list of numbers."""

    def check_row(value: Any) -> Row:
        if not isinstance(value, (list, tuple)) or len(value) != length:
            raise Bad(f'{quoted(value)} is not a list of {length} numbers')
        return tuple(check(entry) for entry in value)

    return check_row


def matrix(rows: int, check_row: Callable[[Any], Row]) -> Callable[[Any], Matrix]:
    """Return a check for a list of rows."""

    def check_matrix(value: Any) -> Matrix:
        if not isinstance(value, (list, tuple)) or len(value) != rows:
            raise Bad(f'{quoted(value)} is not a list of {rows} rows')
        return tuple(check_row(row) for row in value)

    return check_matrix


def distribution(value: Any) -> Row:
    """Check three probabilities that sum to 1."""
    values = row(3, probability)(value)
    if abs(sum(values) - 1) > ROW_SUM_TOLERANCE:
        raise Bad(f'row {quoted(value)} sums to {sum(values):.12g}, not to 1')
    return values


stochastic_matrix = matrix(3, distribution)
"""Check a list of three rows of three probabilities, each of which sums to 1."""
