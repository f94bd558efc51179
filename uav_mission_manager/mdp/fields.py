"""Checks of single values of a mission file, each with what it says as JSON Schema."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp.areas import MAX_CORNERS, Polygon
from uav_mission_manager.mdp.mission import Matrix, Row

ROW_SUM_TOLERANCE = 1e-9
"""Largest distance of a sum of probabilities from 1: a choice, room for rounding."""

MAX_NAME_LENGTH = 100
"""Characters of a name: a choice, room for several of them in a line."""

_T = TypeVar('_T')


class Bad(ValueError):
    """What is wrong with one value; the section that reads it adds where (`mdp.tables`)."""


@dataclass(frozen=True)
class Check(Generic[_T]):
    """What a value must be: a function that checks it, and the same said in JSON Schema.

    Attributes
    ----------
    read : callable
        Returns the checked value, or raises `Bad`.
    schema : mapping
        Accepts every value that `read` accepts, and as few others as it can.
    """

    read: Callable[[Any], _T]
    schema: Mapping[str, Any]

    def __call__(self, value: Any) -> _T:
        """Return the checked value."""
        return self.read(value)


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


def within(low: float, high: float) -> Check[float]:
    """Return a check for a number within low..high."""

    def check(value: Any) -> float:
        checked = number(value)
        if not low <= checked <= high:
            raise Bad(f'{quoted(value)} is outside {low:g}..{high:g}')
        return checked

    return Check(check, {'type': 'number', 'minimum': low, 'maximum': high})


probability = within(0.0, 1.0)
"""Check a number within 0..1."""


def _non_negative(value: Any) -> float:
    checked = number(value)
    if checked < 0:
        raise Bad(f'{quoted(value)} is negative')
    return checked


def _positive(value: Any) -> float:
    checked = number(value)
    if checked <= 0:
        raise Bad(f'{quoted(value)} is not above 0')
    return checked


def _open_unit(value: Any) -> float:
    checked = number(value)
    if not 0 < checked < 1:
        raise Bad(f'{quoted(value)} is not between 0 and 1')
    return checked


non_negative = Check(_non_negative, {'type': 'number', 'minimum': 0})
"""Check a number that is not negative."""

positive = Check(_positive, {'type': 'number', 'exclusiveMinimum': 0})
"""Check a number above 0."""

open_unit = Check(_open_unit, {'type': 'number', 'exclusiveMinimum': 0, 'exclusiveMaximum': 1})
"""Check a number between 0 and 1, both excluded."""


def positive_or(word: str, meaning: float) -> Check[float]:
    """Return a check for a number above 0, or a word that stands for a number."""

    def check(value: Any) -> float:
        if value == word:
            return meaning
        try:
            return positive(value)
        except Bad as error:
            raise Bad(f'{error}, nor {word}') from None

    return Check(check, {'anyOf': [positive.schema, {'const': word}]})


def integer(low: int, high: int | None = None) -> Check[int]:
    """Return a check for a whole number from low, to high if given."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise Bad(f'{quoted(value)} is not a whole number')
        if value < low or (high is not None and value > high):
            raise Bad(f'{quoted(value)} is outside {low}..{"" if high is None else high}')
        return value

    top = {} if high is None else {'maximum': high}
    return Check(check, {'type': 'integer', 'minimum': low, **top})


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value or value.split() != [value]:
        raise Bad(f'{quoted(value)} is not a name (a string without white space)')
    if len(value) > MAX_NAME_LENGTH:
        raise Bad(f'{quoted(value)} has more than {MAX_NAME_LENGTH} characters')
    if not value.isprintable():
        raise Bad(f'{quoted(value)} has characters that cannot be printed')
    return value


name = Check(_name, {'type': 'string', 'pattern': r'^\S+$', 'maxLength': MAX_NAME_LENGTH})
"""Check a string without white space, which every log and topic can carry."""


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise Bad(f'{quoted(value)} is neither true nor false')
    return value


boolean = Check(_boolean, {'type': 'boolean'})
"""Check true or false."""


def _names(value: Any) -> tuple[str, ...]:
    if not isinstance(value, (list, tuple)):
        raise Bad(f'{quoted(value)} is not a list of names')
    return tuple(name(entry) for entry in value)


names = Check(_names, {'type': 'array', 'items': name.schema, 'minItems': 0})
"""Check a list of names."""


def by_name(check: Check[_T]) -> Check[dict[str, _T]]:
    """Return a check for a mapping from names to values that pass one check."""

    def check_mapping(value: Any) -> dict[str, _T]:
        if not isinstance(value, Mapping):
            raise Bad(f'{quoted(value)} is not a mapping')
        found = {}
        for key, entry in value.items():
            try:
                found[name(key)] = check(entry)
            except Bad as error:
                raise Bad(f'{shown(key)}: {error}') from None
        return found

    return Check(check_mapping, {'type': 'object', 'additionalProperties': dict(check.schema)})


def one_of(*names: str) -> Check[str]:
    """Return a check for one of several names."""

    def check(value: Any) -> str:
        if value not in names:
            raise Bad(f'{quoted(value)} is none of {", ".join(names)}')
        return str(value)

    return Check(check, {'enum': list(names)})


def _list_of(length: int, entry: Mapping[str, Any]) -> dict[str, Any]:
    return {'type': 'array', 'items': dict(entry), 'minItems': length, 'maxItems': length}


def row(length: int, check: Check[float]) -> Check[Row]:
    """Return a check for a list of numbers."""

    def check_row(value: Any) -> Row:
        if not isinstance(value, (list, tuple)) or len(value) != length:
            raise Bad(f'{quoted(value)} is not a list of {length} numbers')
        return tuple(check(entry) for entry in value)

    return Check(check_row, _list_of(length, check.schema))


def one_or_row(one: Check[float], several: Check[Row]) -> Check[float | Row]:
    """Return a check for a number, or for a list of numbers."""

    def check(value: Any) -> float | Row:
        return several(value) if isinstance(value, (list, tuple)) else one(value)

    return Check(check, {'anyOf': [one.schema, several.schema]})


def matrix(rows: int, check_row: Check[Row]) -> Check[Matrix]:
    """Return a check for a list of rows."""

    def check_matrix(value: Any) -> Matrix:
        if not isinstance(value, (list, tuple)) or len(value) != rows:
            raise Bad(f'{quoted(value)} is not a list of {rows} rows')
        return tuple(check_row(row) for row in value)

    return Check(check_matrix, _list_of(rows, check_row.schema))


_three_probabilities = row(3, probability)


latitude = within(-89.0, 89.0)
"""Check a latitude [deg]: beyond 89 a local plane with an east axis makes no sense."""

longitude = within(-180.0, 180.0)
"""Check a longitude [deg]."""


def _corner(value: Any) -> tuple[float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise Bad(f'{quoted(value)} is not a corner [latitude, longitude]')
    return latitude(value[0]), longitude(value[1])


def _polygon(value: Any) -> Polygon:
    if not isinstance(value, (list, tuple)) or not 3 <= len(value) <= MAX_CORNERS:
        raise Bad(f'{quoted(value)} is not a list of 3 to {MAX_CORNERS} corners')
    return tuple(_corner(corner) for corner in value)


polygon = Check(
    _polygon,
    {
        'type': 'array',
        'items': {
            'type': 'array',
            'prefixItems': [dict(latitude.schema), dict(longitude.schema)],
            'minItems': 2,
            'maxItems': 2,
        },
        'minItems': 3,
        'maxItems': MAX_CORNERS,
    },
)
"""Check a list of corners [latitude, longitude] in degrees."""


def _distribution(value: Any) -> Row:
    return _summing_to_1(value, _three_probabilities(value))


def _summing_to_1(value: Any, values: Row) -> Row:
    if abs(sum(values) - 1) > ROW_SUM_TOLERANCE:
        raise Bad(f'row {quoted(value)} sums to {sum(values):.12g}, not to 1')
    return values


distribution = Check(_distribution, _three_probabilities.schema)
"""Check three probabilities that sum to 1."""


def distribution_of(most: int) -> Check[Row]:
    """Return a check for a list of up to so many probabilities that sum to 1."""

    def check(value: Any) -> Row:
        if not isinstance(value, (list, tuple)) or not 1 <= len(value) <= most:
            raise Bad(f'{quoted(value)} is not a list of 1 to {most} probabilities')
        return _summing_to_1(value, tuple(probability(entry) for entry in value))

    schema = {'type': 'array', 'items': dict(probability.schema), 'minItems': 1, 'maxItems': most}
    return Check(check, schema)


stochastic_matrix = matrix(3, distribution)
"""Check a list of three rows of three probabilities, each of which sums to 1."""
