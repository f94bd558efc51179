"""Text of values from outside, for logs, errors and diagnostics: short, one line, harmless."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator, Mapping
from typing import Any

LONGEST_ECHO = 200
"""Characters that are shown of one value: a choice, two lines of a terminal."""

MAX_INT_BITS = 2048
"""Bits of the largest integer that is written out: 617 digits, fewer than Python ever refuses."""

BITS_PER_DIGIT = math.log2(10)
"""Bits of a decimal digit."""

_BRACKETS: dict[type, tuple[str, str]] = {
    list: ('[', ']'),
    array: ('[', ']'),
    tuple: ('(', ')'),
    set: ('{', '}'),
    frozenset: ('{', '}'),
}


def shown(value: object, limit: int = LONGEST_ECHO) -> str:
    """Return the text of a value in one line of at most `limit` characters.

    What does not fit is cut off and counted, what is not printable is escaped. It never raises,
    and does not write out more of a large value than it shows.
    """
    return _text(value, limit, quotes=False)


def quoted(value: object, limit: int = LONGEST_ECHO) -> str:
    """Return what `repr` says of a value, in the same way as `shown`."""
    return _text(value, limit, quotes=True)


def said_by(error: BaseException) -> str:
    """Return what an error says; one of the system as `PATH: why`, without its number."""
    why = getattr(error, 'strerror', None)
    path = getattr(error, 'filename', None)
    return f'{path}: {why}' if why and path else why or str(error)


def why_not(error: BaseException) -> str:
    """Return the reason in an error, for a line that has its path already."""
    return shown(getattr(error, 'strerror', None) or error)


def _text(value: Any, limit: int, quotes: bool) -> str:
    kept, length = [], 0
    try:
        for piece in _pieces(value, limit, quotes):
            kept.append(piece)
            length += len(piece)
            if length > limit:
                break
        else:
            return ''.join(kept)
        end = _end(value, kept[0] if quotes else '')
    except Exception:  # What an object from outside raises when asked for its text.
        kept, end = list(_escaped(type(value).__name__[:limit])), ''
    while kept and sum(map(len, kept)) + len(end) > limit:
        kept.pop()
    return (''.join(kept) + end)[: max(limit, 0)]


def _pieces(value: Any, limit: int, quotes: bool) -> Iterator[str]:
    """Yield the text piece by piece, an escaped character undivided, as far as it is needed."""
    if isinstance(value, str):
        head = value[: limit + 1]
        quote = ('"' if "'" in head and '"' not in head else "'") if quotes else ''
        yield quote
        yield from _escaped(head, f'\\{quote}' if quotes else '')
        yield quote
    elif isinstance(value, (bytes, bytearray)):
        yield from repr(bytes(value[: limit + 1]))
    elif isinstance(value, Mapping):
        yield '{'
        for position, (key, entry) in enumerate(value.items()):
            yield ', ' if position else ''
            yield from _pieces(key, limit, quotes=True)
            yield ': '
            yield from _pieces(entry, limit, quotes=True)
        yield '}'
    elif type(value) in _BRACKETS:
        opening, closing = _BRACKETS[type(value)]
        yield opening
        for position, entry in enumerate(value):
            yield ', ' if position else ''
            yield from _pieces(entry, limit, quotes=True)
        yield f',{closing}' if isinstance(value, tuple) and len(value) == 1 else closing
    elif type(value) is int and value.bit_length() > MAX_INT_BITS:
        yield from f'<an integer of some {value.bit_length() / BITS_PER_DIGIT:.0f} digits>'
    else:
        yield from _escaped((repr(value) if quotes else str(value))[: limit + 1])


def _escaped(text: str, also: str = '') -> Iterator[str]:
    """Yield the characters; one not printable as Python writes it, `also` after a backslash."""
    for character in text:
        if character in also:
            yield f'\\{character}'
        else:
            yield character if character.isprintable() else repr(character)[1:-1]


def _end(value: Any, quote: str) -> str:
    """What follows the part of a value that is shown."""
    if isinstance(value, str):
        return f'{quote} ... ({len(value):,} characters)'
    if isinstance(value, (bytes, bytearray)):
        return f"' ... ({len(value):,} bytes)"
    if isinstance(value, Mapping) or type(value) in _BRACKETS:
        return f' ... ({len(value):,} entries)'
    return ' ...'
