"""A value of a JSON file that knows where it stands, for errors that say so."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import MissionError
from uav_mission_manager.mdp.fields import Bad

_T = TypeVar('_T')


@dataclass(frozen=True)
class JsonValue:
    """A value, the file that it is of, and its place there.

    All methods raise `MissionError` where the value is not what they need.
    """

    value: Any
    source: str
    place: str = ''

    def fail(self, problem: str) -> NoReturn:
        """Raise a `MissionError` about this value."""
        raise MissionError(f'{shown(self.source)}: {self.place or "file"}: {problem}')

    def __getitem__(self, key: str) -> JsonValue:
        """Return the value of a key; it is None where there is none."""
        if not isinstance(self.value, dict):
            self.fail(f'{quoted(self.value)} is no object')
        return JsonValue(self.value.get(key), self.source, f'{self.place}.{key}'.strip('.'))

    def __bool__(self) -> bool:
        """Whether there is a value."""
        return self.value is not None

    def entries(self) -> list[JsonValue]:
        """Return the entries of a list, none where there is no list."""
        if self.value is None:
            return []
        if not isinstance(self.value, list):
            self.fail(f'{quoted(self.value)} is no list')
        return [
            JsonValue(entry, self.source, f'{self.place}[{number}]')
            for number, entry in enumerate(self.value)
        ]

    def read(self, check: Callable[[Any], _T]) -> _T:
        """Return what `check` makes of the value; it may raise `Bad`."""
        try:
            return check(self.value)
        except Bad as error:
            self.fail(str(error))


def read_json(text: str, source: str) -> JsonValue:
    """Read a JSON file.

    Raises
    ------
    MissionError
        If it is none; NaN and Infinity are none of JSON.
    """
    try:
        return JsonValue(json.loads(text, parse_constant=_refuse), source)
    except (ValueError, RecursionError) as error:
        raise MissionError(f'{shown(source)}: not valid JSON: {shown(error)}') from error


def _refuse(word: str) -> NoReturn:
    raise ValueError(f'{word} is no number')
