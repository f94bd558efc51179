"""YAML as people mean it: each text is that, or refused by the field that it is for."""

from __future__ import annotations

import math
import re
import time

import pytest
import yaml
from strategies import CASE_STUDY

from uav_mission_manager.mdp import MissionError, load_mission
from uav_mission_manager.mdp.strict_yaml import read_yaml


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('1', 1),
        ('+5', 5),
        ('-0', 0),
        ('0x1F', 31),
        ('0b101', 5),
        ('1_000', 1000),
        ('12_000_000', 12_000_000),
        ('!!int 7', 7),
        ('1e3', 1000.0),
        ('1e-3', 1e-3),
        ('.5', 0.5),
        ('5.', 5.0),
        ('-.5E+1', -5.0),
        ('1_000.5', 1000.5),
        ('007.5', 7.5),
        ('!!float 7', '7'),
        ('.inf', math.inf),
        ('-.Inf', -math.inf),
        ('1e999', math.inf),
        ('0e5', 0.0),
        ('5e-324', 5e-324),
        ('true', True),
        ('FALSE', False),
        ('~', None),
        ('null', None),
        ('', None),
        ('"1"', '1'),
    ],
)
def test_what_people_mean(text, value):
    read = read_yaml(f'key: {text}')['key']
    assert (read, type(read)) == (value, type(value))


TEXTS = """
    010 00 -01 0o10 08 0_1 1_0 1_ _1 1__000 1_00 0x 0b_ 0x1G 1:30 1:30.5 190:20:30 1,5 1- --1 1e e3
    . 1.2.3 1.000_5 1e-400 -1E-999 inf nan Infinity yes no on off Y N NO tRUE = 2020-01-02
    2020-13-45 2020-01-02T03:04:05Z
"""


@pytest.mark.parametrize('text', [*TEXTS.split(), '1 000', '1' * 5000, '\u0663', '\uff11', '\xbd'])
def test_what_is_text(text):
    assert read_yaml(f'key: {text}') == {'key': text}


@pytest.mark.parametrize(
    ('tagged', 'text'),
    [
        ('!!int 010', '010'),
        ('!!int 1:30', '1:30'),
        ('!!int many', 'many'),
        ('!!float 1:30', '1:30'),
        ('!!float ""', ''),
        ('!!bool maybe', 'maybe'),
        ('!!bool yes', 'yes'),
        ('!!str 5', '5'),
    ],
)
def test_what_is_not_what_its_tag_says(tagged, text):
    assert read_yaml(f'key: {tagged}') == {'key': text}


@pytest.mark.parametrize(
    'text',
    [
        'a: 1\na: 2',
        'a: 1\n"a": 2',
        '1: a\n0x1: b',
        '1: a\n1.0: b',
        '1: a\n+1: b',
        'a: {b: 1, c: 2, b: 3}',
        'a: {<<: 1, <<: 2}',
        'a: !!timestamp x',
        'a: !!binary "é"',
        'a: !!set {x}',
        'a: !!omap [x: 1]',
        'a: !!python/name:os.system',
        'a:\tb:\tc: 1',
        '\tb: 1',
        'a: *unknown',
        '? [a]\n: b',
        'a: \x00',
        '--- 1\n--- 2',
        '[' * 5000,
    ],
)
def test_what_is_refused(text):
    with pytest.raises((yaml.YAMLError, RecursionError)):
        read_yaml(text)


def test_aliases_and_keys_that_would_merge():
    text = 'base: &base {k: 1}\nsame: *base\nother: {<<: *base, k: 2}'
    base = {'k': 1}
    assert read_yaml(text) == {'base': base, 'same': base, 'other': {'<<': base, 'k': 2}}


@pytest.mark.parametrize(
    'change',
    [
        lambda text: text.replace('\n', '\r\n').encode(),
        lambda text: text.replace('\n', '\r').encode(),
        lambda text: b'\xef\xbb\xbf' + text.encode(),
        lambda text: text.replace('# ', '# é ').encode(),
    ],
    ids=['CRLF', 'CR', 'byte order mark', 'UTF-8'],
)
def test_files_of_other_editors(change, tmp_path):
    file = tmp_path / 'mission.yaml'
    file.write_bytes(change(CASE_STUDY.read_text()))
    assert load_mission(file) == load_mission(CASE_STUDY)


@pytest.mark.parametrize('encoding', ['utf-16', 'utf-16-le', 'utf-32', 'latin-1'])
def test_files_in_other_encodings(encoding, tmp_path):
    file = tmp_path / 'mission.yaml'
    file.write_bytes(f'# é\n{CASE_STUDY.read_text()}'.encode(encoding))
    with pytest.raises(MissionError, match=rf'^{re.escape(str(file))}: .*$'):
        load_mission(file)


def test_many_keys_take_a_time_that_grows_with_their_number():
    text = '{' + ', '.join(f'{key}: 1' for key in range(20_000)) + '}'
    start = time.process_time()
    assert len(read_yaml(text)) == 20_000
    assert time.process_time() - start < 15
