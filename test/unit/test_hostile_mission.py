"""Whatever a mission file holds: a mission, or one short line of what is wrong."""

from __future__ import annotations

import os

import pytest
import yaml
from strategies import case_study, in_units

from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import MissionError, load_mission, mission_from_dict
from uav_mission_manager.mdp.mission_file import MAX_FILE_BYTES

LONGEST_LINE = 500
"""Characters of a refusal: two echoes, a key's or file's and a value's, and what is said of it."""


HOSTILE = {
    'long': 'x' * 1_000_000,
    'lines': 'one\ntwo\r\n' * 1000,
    'terminal': '\x1b[2J\x1b]0;title\x07\x9b31m',
    'bidi': 'a\u202eb\u2028c',
    'surrogate': '\ud800',
    'markup': '[/b][link=file:///etc]:fire:' * 100,
    'huge': 10**100_000,
    'huge float': 1e308,
    'negative': -(10**400),
    'many': [0] * 1_000_000,
    'deep': yaml.safe_load('[' * 100 + ']' * 100),
    'long in a list': ['x' * 1_000_000] * 8,
    'long key': {'x' * 1_000_000: 1},
    'huge key': {10**5000: 1},
    'odd keys': {None: 1, (1, 2): 2, '\x1b[2J': 3},
    'bytes': b'\0' * 1000,
    'set': {1, 2},
}


def places(node, place=()):
    """Every field of a document, and the first entry of each list."""
    entries = node.items() if isinstance(node, dict) else enumerate(node[:1])
    for key, value in entries:
        yield (*place, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*place, key))


def put(place, value, document=case_study):
    """A document with one field replaced, or all of it."""
    document = {'': document()}
    *above, last = ('', *place)
    node = document
    for key in above:
        node = node[key]
    node[last] = value
    return document['']


def assert_one_short_line(error, source):
    text = str(error)
    assert text.startswith(f'{source}: ')
    assert text.isprintable()
    assert len(text) <= LONGEST_LINE


@pytest.mark.parametrize('document', [case_study, in_units])
@pytest.mark.parametrize('name', HOSTILE)
def test_every_field(name, document):
    for place in [(), *places(document())]:
        try:
            mission_from_dict(put(place, HOSTILE[name], document), 'test')
        except MissionError as error:
            assert_one_short_line(error, 'test')
        else:
            assert name == 'huge float'  # A cost or a time may be as large as it likes.


@pytest.mark.parametrize(
    'key', ['x' * 1_000_000, 'a\n\x1b[2J', '\ud800', 10**5000, None], ids=range(5)
)
def test_every_key(key):
    mappings = [('goals', 0), *places(case_study())]
    for place in [(), *mappings]:
        document = case_study()
        node = document
        for step in place:
            node = node[step]
        if isinstance(node, dict):
            node[key] = 0.5
            with pytest.raises(MissionError) as error:
                mission_from_dict(document, 'test')
            assert_one_short_line(error.value, 'test')


@pytest.mark.parametrize(
    'text',
    [
        '<?xml version="1.0"?>\n<kml>\n<Placemark>a b</Placemark>\n' + '<a>1 2 3</a>\n' * 10_000,
        'name: ' + 'x' * 1_000_000,
        'name: "' + 'x' * 1_000_000,
        'name: !' + 'x' * 10_000 + ' 1',
        'name: *' + 'x' * 10_000,
        '? ' + 'x' * 1000 + '\n: 1\n? ' + 'x' * 1000 + '\n: 2',
        '%' + 'x' * 10_000,
        'name: "\\u001b[2J"',
        'name: \x1b[2J',
        'a: &a {grid: *a}',
        '&a [*a]',
        '[' * 100_000,
        '{a: ' * 1000 + '}' * 1000,
        'x' * MAX_FILE_BYTES + 'x',
    ],
    ids=range(14),
)
def test_every_file(text, tmp_path):
    file = tmp_path / 'mission.yaml'
    file.write_text(text)
    with pytest.raises(MissionError) as error:
        load_mission(file)
    assert_one_short_line(error.value, file)


def test_every_path(tmp_path):
    for path in (
        f'{tmp_path}/\x1b[2J',
        f'{tmp_path}/{"x" * 5000}',
        f'{tmp_path}/{"x/" * 2000}',
        '\0',
    ):
        with pytest.raises(MissionError) as error:
            load_mission(path)
        assert_one_short_line(error.value, shown(path))


def test_a_large_file_is_read_no_further_than_needed(tmp_path):
    path = tmp_path / 'large.yaml'
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(MissionError, match=r'large\.yaml: cannot be read: more than 8,000,000 '):
        load_mission(path)


def test_a_file_without_end_is_not_read():
    with pytest.raises(MissionError, match=r'^/dev/zero: cannot be read: no regular file'):
        load_mission('/dev/zero')


def test_names_that_all_logs_and_topics_can_carry():
    for name in ('site[north]', '[/b]', 'A:fire:', 'São', '渡', 'x' * 100):
        document = put(('goals', 0, 'name'), name)
        assert mission_from_dict(document, 'test').goals[0].name == name
