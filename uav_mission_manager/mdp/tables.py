"""Tables of the fields of a mapping: what a file is read by, and what its JSON Schema says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NoReturn, TypeVar

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.likeness import nearest
from uav_mission_manager.mdp.fields import Bad, Check

CELL_NUMBER = '^(0|[1-9][0-9]{0,17})$'
"""Regular expression of a key that is a cell: its number in digits."""


class MissionError(ValueError):
    """A mission that cannot be used; the message names the source, the field and the value."""


NO_DEFAULT: Any = object()
"""Default of a field that must be given."""

_T = TypeVar('_T')


@dataclass(frozen=True)
class Cells:
    """A mapping from cells to values that pass one check."""

    check: Check[float]


@dataclass(frozen=True)
class Entries:
    """A list of at least one mapping, each with the fields of one table."""

    table: Table


@dataclass(frozen=True)
class Field:
    """One row of a table.

    Attributes
    ----------
    key : str
    kind : Check, Table, Cells or Entries
        What its value must be.
    text : str
        What it means, with the unit in brackets.
    default : object
        As a file would have it; None for a field that is not there if it is not given.
    """

    key: str
    kind: Check[Any] | Table | Cells | Entries
    text: str
    default: Any = NO_DEFAULT


@dataclass(frozen=True)
class Table:
    """The fields of a mapping.

    Attributes
    ----------
    rows : Field
    alternatives : tuple of groups
        Each group has some ways of saying one thing, each a tuple of keys; a file has one of
        them. If it has none, what is missing is the first.
    """

    rows: tuple[Field, ...]
    alternatives: tuple[tuple[tuple[str, ...], ...], ...] = ()

    def field(self, key: str) -> Field:
        """Return the row of a key."""
        return next(row for row in self.rows if row.key == key)

    def exclusive(self) -> Iterator[tuple[str, str]]:
        """Yield the pairs of keys that exclude each other."""
        for ways in self.alternatives:
            for one, other in combinations(ways, 2):
                yield from ((a, b) for a in one for b in other)


def as_given(value: Any) -> Any:
    """Return the value."""
    return value


class Section:
    """A mapping being read by its table.

    Raises
    ------
    MissionError
        If it is none, has a key that the table has not, or says one thing in two ways.
    """

    def __init__(self, table: Table, data: Any, source: str, place: str = '') -> None:
        self.table, self.source, self.place = table, source, place
        if not isinstance(data, Mapping):
            self.fail('', f'{quoted(data)} is not a mapping')
        self.data: Mapping[Any, Any] = data
        known = [row.key for row in table.rows]
        for key in data:
            if key not in known:
                meant = nearest(shown(key), known)
                self.fail(key, f'is unknown; the nearest known key is {meant!r}')
        for first, other in table.exclusive():
            if first in data and other in data:
                twin = f'{place}.{first}'.strip('.')
                self.fail(other, f'is given besides {twin}: keep one of them')

    def __contains__(self, key: str) -> bool:
        """Whether a field is given."""
        return key in self.data

    def fail(self, key: object, problem: str) -> NoReturn:
        """Raise a `MissionError` about one field."""
        field = f'{self.place}.{shown(key)}'.strip('.') or 'mission'
        raise MissionError(f'{shown(self.source)}: {field}: {problem}')

    def all(self, then: Callable[[Any], Any] = as_given) -> dict[str, Any]:
        """Return every field of a section of plain values, see `get`."""
        return {row.key: self.get(row.key, then) for row in self.table.rows}

    def get(self, key: str, then: Callable[[Any], Any] = as_given) -> Any:
        """Return the checked value of a field, or its default.

        `then` makes something of a value that was given, and may raise `Bad` too.
        """
        kind, value = self._kind(key, Check), self._given(key)
        if key not in self.data:
            return value
        try:
            return then(kind(value))
        except Bad as error:
            self.fail(key, str(error))

    def below(self, key: str, read: Callable[[Section], Any]) -> Any:
        """Return what `read` makes of a mapping below; None if there is none, nor a default."""
        table, value = self._kind(key, Table), self._given(key)
        if key not in self.data and value is None:
            return None
        return read(Section(table, value, self.source, f'{self.place}.{key}'.strip('.')))

    def cells(
        self,
        key: str,
        cell: Callable[[Any], int],
        then: Callable[[float], float] = as_given,
    ) -> tuple[tuple[int, float], ...]:
        """Return the pairs (cell, value) of a mapping by cell; `cell` checks a key."""
        check, given = self._kind(key, Cells).check, self._given(key)
        if not isinstance(given, Mapping):
            self.fail(key, f'{quoted(given)} is not a mapping')
        values: dict[int, float] = {}
        for name, value in given.items():
            try:
                checked, number = then(check(value)), cell(name)
            except Bad as error:
                self.fail(f'{key}.{shown(name)}', str(error))
            if number in values:
                twice = f'{quoted(name)} names a cell that another key names too'
                self.fail(f'{key}.{shown(name)}', twice)
            values[number] = checked
        return tuple(sorted(values.items()))

    def entries(self, key: str) -> list[Section]:
        """Return the sections of a list of mappings."""
        table, value = self._kind(key, Entries).table, self._given(key)
        if not isinstance(value, (list, tuple)) or not value:
            self.fail(key, f'{quoted(value)} is not a list of at least one {key.rstrip("s")}')
        place = f'{self.place}.{key}'.strip('.')
        return [
            Section(table, entry, self.source, f'{place}[{index}]')
            for index, entry in enumerate(value)
        ]

    def _kind(self, key: str, expected: type[_T]) -> _T:
        kind = self.table.field(key).kind
        assert isinstance(kind, expected)
        return kind

    def _given(self, key: str) -> Any:
        default = self.table.field(key).default
        if key not in self.data and default is NO_DEFAULT:
            self.fail(key, 'is missing')
        return self.data.get(key, default)
