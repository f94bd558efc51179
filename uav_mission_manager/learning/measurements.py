"""Reading measurements: CSV in, checked `Measurement`s out, or one line of what is wrong.

Columns: part, effectiveness [%], quantity, value; in any order, named in the first line. Empty
lines and lines that begin with # are passed over.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.learning.calibration import WHOLE, Measurement
from uav_mission_manager.likeness import nearest
from uav_mission_manager.mdp.fields import Bad, non_negative, probability, within
from uav_mission_manager.mdp.mission import Parts
from uav_mission_manager.paths import file_content

MOST_BYTES = 1_000_000
"""Bytes of a CSV file at most: a choice, tens of thousands of measurements."""

MEASURED_PARTS = tuple(field.name for field in fields(Parts))
"""Parts whose effectiveness was reduced."""

QUANTITIES: Mapping[str, Callable[[float], float]] = {
    'completion': probability,
    'failures_per_hour': non_negative,
    'cost': non_negative,
}
"""What was measured, and a check of its values."""

CSV_COLUMNS = Measurement._fields
"""Names of the columns."""


def read_measurements(path: Path) -> list[Measurement]:
    """Read a CSV file.

    Raises
    ------
    ValueError
        One line with file, line, column and value, at the first that is wrong.
    """
    try:
        text = file_content(path, MOST_BYTES).decode()
    except (OSError, ValueError) as error:
        problem = shown(getattr(error, 'strerror', None) or error)
        raise ValueError(f'{shown(path)}: cannot be read: {problem}') from error
    try:
        found = list(_measurements(text, str(path)))
    except csv.Error as error:
        raise ValueError(f'{shown(path)}: no CSV: {error}') from error
    if not found:
        raise ValueError(f'{shown(path)}: no measurements in it')
    return found


def _measurements(text: str, source: str) -> Iterator[Measurement]:
    lines = text.removeprefix('\ufeff').splitlines()
    kept = [
        (number, line)
        for number, line in enumerate(lines, 1)
        if line.strip() and not line.startswith('#')
    ]
    head: list[str] = []
    for number, line in kept:
        cells = [cell.strip() for cell in next(csv.reader([line], strict=True))]
        where = f'{shown(source)}: line {number}'
        if not head:
            head = _checked_head(cells, where)
        elif len(cells) != len(head):
            raise ValueError(f'{where}: {len(cells)} values, not {len(head)}: {shown(line)}')
        else:
            yield _measurement(dict(zip(head, cells)), where)


def _checked_head(cells: list[str], where: str) -> list[str]:
    for name in cells:
        if name not in CSV_COLUMNS:
            meant = nearest(name, CSV_COLUMNS)
            raise ValueError(f'{where}: column {quoted(name)} is unknown; the nearest is {meant}')
    for name in CSV_COLUMNS:
        if cells.count(name) != 1:
            problem = 'is missing' if name not in cells else 'is there twice'
            raise ValueError(f'{where}: column {name} {problem}')
    return cells


def _measurement(cells: Mapping[str, str], where: str) -> Measurement:
    for column, known in (('part', MEASURED_PARTS), ('quantity', tuple(QUANTITIES))):
        if cells[column] not in known:
            names = ', '.join(known)
            raise ValueError(f'{where}: {column}: {quoted(cells[column])} is none of {names}')
    numbers = []
    for column, check in (
        ('effectiveness', within(0.0, WHOLE)),
        ('value', QUANTITIES[cells['quantity']]),
    ):
        try:
            numbers.append(check(float(cells[column])))
        except Bad as error:
            raise ValueError(f'{where}: {column}: {error}') from None
        except ValueError:
            raise ValueError(
                f'{where}: {column}: {quoted(cells[column])} is not a number'
            ) from None
    return Measurement(cells['part'], numbers[0], cells['quantity'], numbers[1])
