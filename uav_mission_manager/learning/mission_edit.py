"""Numbers of a mission file written anew in its text, which stays as it is otherwise.

A number takes the place of the old one, and comments come on lines of their own above it, where
they take the place of those that begin with the same word. What is then read is compared with
what was meant, so a text that is written in a way that this does not understand is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Context
from typing import Any

import yaml

from uav_mission_manager.echo import shown
from uav_mission_manager.learning.estimates import NEVER, Path, field_name
from uav_mission_manager.mdp.strict_yaml import read_yaml

NUMBER_DIGITS = 6
"""Significant digits of a number."""

ARITHMETIC_ERROR = 1e-12
"""Share of a number by which it is off by arithmetic alone, at most."""

TIMES = {'done_in', 'repair_in', 'lasts'}
"""Mean times [s] until something has happened."""

ROW_DECIMALS = 9
"""Decimals of the probabilities of a row, which have to sum to 1."""


@dataclass(frozen=True)
class Edit:
    """A new value of a field, and what a comment says of it.

    Attributes
    ----------
    path : tuple of str and int
        Where it is. Its last key may be missing in the file, or be `instead_of` another.
    value : number, text, or lists and mappings of them
    comment : str
    instead_of : str
        Key that gives way to the one of the path.
    """

    path: Path
    value: Any
    comment: str
    instead_of: str = ''


@dataclass(frozen=True)
class _Change:
    """Text in place of what is between two places of the file."""

    start: int
    end: int
    text: str
    comment: str


def edited(text: str, source: str, edits: Sequence[Edit]) -> str:
    """Return the text of a mission file with other values.

    Raises
    ------
    ValueError
        If it is written in a way in which a value cannot be changed; `source` names it.
    """
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert root is not None  # It was read before.
    changes = sorted((_change(root, edit) for edit in edits), key=lambda change: change.start)
    new = _applied(text, changes)
    meant = _unshared(read_yaml(text))
    for edit in edits:
        _set(meant, edit)
    if read_yaml(new) != meant:
        fields = ', '.join(field_name(edit.path) for edit in edits)
        raise ValueError(
            f'{shown(source)}: cannot be rewritten as it stands: write out, without anchors, one '
            f'of {shown(fields)}'
        )
    return new


def rounded(path: Path, value: float) -> float:
    """Round a number to what a file shows of it; mean times up, for none is below an epoch."""
    upwards = bool(TIMES & set(path))
    context = Context(NUMBER_DIGITS, ROUND_CEILING if upwards else ROUND_HALF_EVEN)
    return float(context.create_decimal_from_float(value * (1 - upwards * ARITHMETIC_ERROR)))


def probabilities(row: Sequence[float]) -> list[float]:
    """Round the probabilities of a row so that they sum to 1."""
    rounded = [round(value, ROW_DECIMALS) for value in row]
    largest = rounded.index(max(rounded))
    rest = sum(value for place, value in enumerate(rounded) if place != largest)
    rounded[largest] = round(1 - rest, ROW_DECIMALS)
    return rounded


def flow(value: Any) -> str:
    """Return a value as YAML in one line."""
    if isinstance(value, Mapping):
        return f'{{{", ".join(f"{key}: {flow(entry)}" for key, entry in value.items())}}}'
    if isinstance(value, (list, tuple)):
        return f'[{", ".join(map(flow, value))}]'
    if isinstance(value, float):
        if value == math.inf:
            return NEVER
        digits = repr(value)
        # For readers of YAML 1.1 an exponent makes no number of what has no point.
        return digits if '.' in digits or 'e' not in digits else digits.replace('e', '.0e')
    return str(value)


def _change(root: yaml.Node, edit: Edit) -> _Change:
    *above, last = edit.path
    parent = root
    for part in above:
        parent = _entry(parent, part)[1]
    key = edit.instead_of or last
    if isinstance(parent, yaml.MappingNode) and not _has(parent, key):
        where = _first(parent)
        line = '' if parent.flow_style else '\n' + ' ' * parent.start_mark.column
        end = line or (', ' if parent.value else '')
        return _Change(where, where, f'{last}: {flow(edit.value)}{end}', edit.comment)
    name, value = _entry(parent, key)
    start = name.start_mark.index if edit.instead_of and name else value.start_mark.index
    text = f'{last}: {flow(edit.value)}' if edit.instead_of else flow(edit.value)
    if start == value.start_mark.index and _is_block(value):
        text = f'  {text}'  # A block's dashes may be below its key, brackets may not.
    return _Change(start, _end(value), text, edit.comment)


def _is_block(node: yaml.Node) -> bool:
    return isinstance(node, yaml.CollectionNode) and not node.flow_style


def _first(mapping: yaml.MappingNode) -> int:
    """Where a first key of a mapping goes."""
    return mapping.start_mark.index + (1 if mapping.flow_style else 0)


def _has(mapping: yaml.MappingNode, key: str | int) -> bool:
    return any(name.value == str(key) for name, _ in mapping.value)


def _entry(node: yaml.Node, part: str | int) -> tuple[yaml.Node | None, yaml.Node]:
    """Return the key, if it has one, and the value of an entry."""
    if isinstance(node, yaml.MappingNode):
        return next(pair for pair in node.value if pair[0].value == str(part))
    return None, node.value[part]


def _end(node: yaml.Node) -> int:
    """Where a value ends, without the comments after it."""
    if not (_is_block(node) and node.value):
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if isinstance(node, yaml.MappingNode) else last)


def _applied(text: str, changes: Sequence[_Change]) -> str:
    """Make the changes, from the last to the first so that places stay what they are."""
    above: dict[int, list[str]] = {}
    for change in changes:
        line = text.rfind('\n', 0, change.start) + 1
        above.setdefault(line, []).append(change.comment)
    marks = [(change.start, change.end, change.text) for change in changes]
    for line, comments in above.items():
        rest = text[line:]
        indent = rest[: len(rest) - len(rest.lstrip(' '))]
        lines = dict.fromkeys(part for comment in comments for part in comment.splitlines())
        words = {part.partition(' ')[0] for part in lines}
        fresh = ''.join(f'{indent}# {part}\n' for part in lines)
        marks.append((_outdated(text, line, words), line, fresh))
    for start, end, replacement in sorted(marks, reverse=True):
        text = text[:start] + replacement + text[end:]
    return text


def _outdated(text: str, line: int, words: Collection[str]) -> int:
    """Where the comments above a line begin that an earlier edit with these words has left."""
    start = line
    while start > 0:
        before = text.rfind('\n', 0, start - 1) + 1
        found = re.match(r' *# (\w+)', text[before:start])
        if not (found and found[1] in words):
            break
        start = before
    return start


def _unshared(data: Any) -> Any:
    """Return a copy in which what several fields say by one anchor is several values."""
    if isinstance(data, dict):
        return {key: _unshared(value) for key, value in data.items()}
    return [_unshared(value) for value in data] if isinstance(data, list) else data


def _set(data: Any, edit: Edit) -> None:
    *above, last = edit.path
    for part in above:
        data = data[_own(data, part)]
    if edit.instead_of:
        data.pop(edit.instead_of, None)
    data[_own(data, last)] = NEVER if edit.value == math.inf else edit.value


def _own(data: Any, part: str | int) -> Any:
    """Return a key as the mapping has it: a cell's may be a number or its digits."""
    if isinstance(data, Mapping):
        return next((key for key in data if str(key) == str(part)), part)
    return part
