"""Values from outside, echoed: one short, printable line, whatever they are."""

from __future__ import annotations

import time
import tracemalloc
from array import array
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_mission_manager.echo import LONGEST_ECHO, quoted, shown

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.integers(600, 20_000).map(lambda bits: -(3**bits))
    | st.floats()
    | st.binary()
    | st.text()
    | st.text(st.characters(categories=['Cs', 'Cc', 'Cf', 'Zl', 'Zp']))
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
)


class Raises:
    def __repr__(self):
        raise RuntimeError('no text')


class NoText:
    def __repr__(self):
        return 7


class Lies:
    __class__ = str


def nested(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


def own_entry():
    value = {}
    value['self'] = value
    return value


ODD = {
    'repr raises': Raises(),
    'repr is no text': NoText(),
    'odd entry': [1, Raises()],
    'lies about its class': Lies(),
    'class of a long name': type('a\n' * 1000, (Raises,), {})(),
    'huge int': 10**1_000_000,
    'deep': nested(100_000),
    'in itself': own_entry(),
    'surrogate': '\ud800',
    'error': ValueError('one\ntwo'),
    'path': Path('a\nb'),
    'array': array('B', bytes(1000)),
    'many quotes': '\'"' * 1000,
}


def assert_harmless(text, limit):
    assert len(text) <= limit
    assert text.isprintable()
    text.encode()


@given(VALUES, st.integers(-1, 300))
def test_one_printable_line_of_bounded_length(value, limit):
    assert_harmless(shown(value, limit), max(limit, 0))
    assert_harmless(quoted(value, limit), max(limit, 0))


@pytest.mark.parametrize('value', ODD.values(), ids=ODD)
@pytest.mark.parametrize('limit', [0, 1, 20, LONGEST_ECHO, 5000])
def test_odd_values(value, limit):
    assert_harmless(shown(value, limit), limit)
    assert_harmless(quoted(value, limit), limit)


@given(st.text(max_size=60) | st.lists(st.integers() | st.text(max_size=5), max_size=5))
def test_what_fits_is_shown_whole(value):
    assert quoted(value, 1000) == repr(value)


@pytest.mark.parametrize(
    ('value', 'says', 'quotes'),
    [
        ('plain text, São', 'plain text, São', "'plain text, São'"),
        ('C:\\temp', 'C:\\temp', "'C:\\\\temp'"),
        ("pilot's", "pilot's", '"pilot\'s"'),
        ('one\ntwo', 'one\\ntwo', "'one\\ntwo'"),
        ('\x1b[2J\x1b]0;x\x07', '\\x1b[2J\\x1b]0;x\\x07', "'\\x1b[2J\\x1b]0;x\\x07'"),
        ('\x9b31m', '\\x9b31m', "'\\x9b31m'"),
        ('abc\u202egpj', 'abc\\u202egpj', "'abc\\u202egpj'"),
        (7, '7', '7'),
        ({'a': (1,)}, "{'a': (1,)}", "{'a': (1,)}"),
        (ValueError('bad'), 'bad', "ValueError('bad')"),
        (array('B', [1, 2]), '[1, 2]', '[1, 2]'),
    ],
)
def test_text(value, says, quotes):
    assert (shown(value), quoted(value)) == (says, quotes)


@pytest.mark.parametrize(
    ('value', 'end'),
    [
        ('x' * 1000, "x' ... (1,000 characters)"),
        ('\x1b' * 1000, "\\x1b' ... (1,000 characters)"),
        (bytes(1000), "' ... (1,000 bytes)"),
        ([1] * 1000, ', 1 ... (1,000 entries)'),
        (dict.fromkeys(range(1000), 0), ' ... (1,000 entries)'),
        (object(), ' ...'),
    ],
    ids=lambda x: type(x).__name__,
)
def test_what_is_cut_off_is_counted(value, end):
    limit = LONGEST_ECHO if hasattr(value, '__len__') else 20
    text = quoted(value, limit)
    assert text.endswith(end)
    assert limit - 10 < len(text) <= limit


def test_integers_too_large_to_write_out():
    assert shown(-(10**600)).endswith('000 ...')
    assert shown(10**5000) == '<an integer of some 5000 digits>'
    assert shown(10**5000, 10) == '<an in ...'


@pytest.mark.parametrize(
    'make',
    [
        lambda: 'x' * 100_000_000,
        lambda: b'x' * 100_000_000,
        lambda: ['x' * 100_000_000],
        lambda: array('B', bytes(100_000_000)),
        lambda: [0] * 10_000_000,
        lambda: dict.fromkeys(range(1_000_000)),
        lambda: 1 << 400_000_000,
    ],
)
def test_a_huge_value_costs_next_to_nothing(make):
    value = make()
    tracemalloc.start()
    start = time.process_time()
    texts = shown(value), quoted(value)
    seconds, (_, peak) = time.process_time() - start, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 0.5
    assert peak < 1_000_000
    assert max(map(len, texts)) <= LONGEST_ECHO
