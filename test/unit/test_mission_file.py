"""A mission file is read whole and exactly, or refused in one line: file, field, value."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import re

import pytest
import yaml
from hypothesis import given
from strategies import CASE_STUDY, case_study, charged_missions, missions

from uav_mission_manager.mdp import MissionError, load_mission, mission_from_dict
from uav_mission_manager.paths import share_directory

OPTIONAL = [
    ('feasibility',),
    ('grid', 'cell_size'),
    ('grid', 'origin'),
    ('faults', 'repair_success'),
    ('threat', 'zones'),
    ('service_cost',),
    ('energy',),
]
OPTIONAL_WITHIN = [
    ('service_cost', 'recharge'),
    ('service_cost', 'repair'),
    *(('threat', 'zones', cell) for cell in (0, 1, 2, 6)),
]
WHOLE = [*(('grid', name) for name in ('rows', 'cols', 'base', 'service')), ('goals', 0, 'cell')]
GRIDS = [(1, 1), (2, 3), (4, 5)]
TEXT = {('name',), ('goals', 0, 'name')}


def paths(node, place=()):
    """Every field of a document, of lists of goals only the first goal's, rows as one field."""
    for key, value in node.items() if isinstance(node, dict) else [(0, node[0])]:
        yield (*place, key)
        if isinstance(value, dict) or key == 'goals':
            yield from paths(value, (*place, key))


FIELDS = [path for path in paths(case_study()) if path != ('goals', 0)]
KEYS = [path for path in FIELDS if path != ('priority_transition',)]


def name_of(path):
    return '.'.join(map(str, path)).replace('goals.0', 'goals[0]')


def parent(document, path):
    for key in path[:-1]:
        document = document[key]
    return document


def value_at(document, path):
    return parent(document, path)[path[-1]]


def put(path, value):
    document = case_study()
    parent(document, path)[path[-1]] = value
    return document


def refusal(tmp_path, content):
    """Return what load_mission says of a document, or of a file's text, after the file's name."""
    file = tmp_path / 'mission.yaml'
    if not isinstance(content, (str, bytes)):
        content = yaml.safe_dump(content)
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(MissionError) as error:
        load_mission(file)
    message = str(error.value)
    assert message.startswith(f'{file}: ')
    assert len(message.splitlines()) == 1
    return message.removeprefix(f'{file}: ')


@pytest.mark.parametrize('path', KEYS, ids=name_of)
def test_field_absent(path, tmp_path):
    document = case_study()
    del parent(document, path)[path[-1]]
    if path in OPTIONAL + OPTIONAL_WITHIN:
        mission_from_dict(document, 'test')
    else:
        assert refusal(tmp_path, document) == f'{name_of(path)}: is missing'


def test_defaults():
    document = case_study()
    for path in OPTIONAL:
        parent(document, path).pop(path[-1], None)  # The case study leaves some to its default.
    mission = mission_from_dict(document, 'test')
    assert mission.feasibility == 'strict'
    assert (mission.grid.cell_size, mission.grid.origin, mission.energy) == (50.0, None, None)
    assert mission.faults.repair_success == 1.0
    assert mission.threat.zones == ()
    assert (mission.service_cost.recharge, mission.service_cost.repair) == (0.0, 0.0)


def test_priority_transition_of_the_goal_before_the_missions():
    document = case_study()
    own = [[0.0, 0.0, 1.0]] * 3
    document['goals'][1]['priority_transition'] = own
    mission = mission_from_dict(document, 'test')
    assert [list(map(list, goal.priority_transition)) == own for goal in mission.goals] == [
        False,
        True,
        False,
    ]
    del document['priority_transition']
    with pytest.raises(MissionError, match=r'^test: goals\[0\]\.priority_transition: is missing$'):
        mission_from_dict(document, 'test')
    for goal in document['goals']:
        goal['priority_transition'] = own
    mission_from_dict(document, 'test')


def numbers(value):
    """Copies of a field with each number in it replaced by NaN and by infinity in turn."""
    if isinstance(value, (int, float)):
        yield math.nan
        yield -math.inf
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            for bad in numbers(entry):
                yield [*value[:i], bad, *value[i + 1 :]]


@pytest.mark.parametrize('path', FIELDS, ids=name_of)
def test_every_number_must_be_finite(path, tmp_path):
    for bad in numbers(value_at(case_study(), path)):
        message = refusal(tmp_path, put(path, bad))
        assert re.match(rf'{re.escape(name_of(path))}: \(?-?(nan|inf)', message)


@pytest.mark.parametrize('path', FIELDS, ids=name_of)
def test_wrong_type(path, tmp_path):
    text = ['two words', ''] if path in TEXT else ['many', '1']
    mapping = [] if isinstance(value_at(case_study(), path), dict) else [{}]
    for bad in (True, None, [], *text, *mapping):
        message = refusal(tmp_path, put(path, bad))
        assert message.startswith(f'{name_of(path)}: {bad!r} ')


OUT_OF_RANGE = [
    *((path, value) for path in WHOLE for value in (-1, 0.5, 1.0, math.nan)),
    *((path, 8) for path in WHOLE if path not in {('grid', 'rows'), ('grid', 'cols')}),
    (('grid', 'rows'), 0),
    (('grid', 'cols'), 0),
    *((('discount',), value) for value in (0, 1, 1.0, -0.1, 1.5, 95)),
    *(
        (('faults', 'rate', part), value)
        for part in ('sensor', 'actuator', 'camera')
        for value in (-0.01, 1.01)
    ),
    *((('faults', 'agile_factor', part), -0.5) for part in ('sensor', 'actuator', 'camera')),
    *((('range', 'loss', mode), value) for mode in ('normal', 'agile') for value in (-1e-9, 2)),
    *(
        (path, value)
        for path in [('threat', 'onset'), ('threat', 'high_share'), ('threat', 'zones', 2)]
        for value in (-0.1, 1.1)
    ),
    *(
        (path, -1.0)
        for path in [
            ('goals', 0, 'eta'),
            ('goals', 0, 'delta'),
            ('range', 'cost'),
            ('distance_weight',),
            ('service_cost', 'recharge'),
            ('service_cost', 'repair'),
        ]
    ),
    *(
        (('energy', key), value)
        for key in ('capacity', 'voltage', 'power', 'speed')
        for value in (0, -1.5)
    ),
    *((('energy', key), -0.5) for key in ('wind', 'wind_penalty', 'payload', 'payload_penalty')),
    (('grid', 'cell_size'), 0),
    (('grid', 'cell_size'), -50.0),
    (('grid', 'origin', 'latitude'), 90.5),
    *((('grid', 'origin', 'latitude'), value) for value in (-89.5, 89.5, -353632620)),
    *((('grid', 'origin', 'longitude'), value) for value in (180.5, 360.0)),
    *((('grid', 'origin', 'altitude'), value) for value in (-500.5, 9000.5, 584000)),
    (('grid', 'origin', 'longitude'), -180.5),
    (('feasibility',), 'lax'),
    (('name',), ''),
    (('name',), 'two words'),
    (('name',), 'two\nlines'),
    (('goals',), []),
    (('goals', 0, 'name'), 'goal 1'),
]


@pytest.mark.parametrize(('path', 'bad'), OUT_OF_RANGE, ids=lambda x: str(x)[:30])
def test_value_out_of_range(path, bad, tmp_path):
    message = refusal(tmp_path, put(path, bad))
    assert message.startswith(f'{name_of(path)}: {bad!r} ')


def test_grid_of_too_many_cells(tmp_path):
    document = case_study()
    document['grid'] |= {'rows': 1000, 'cols': 1001}
    assert refusal(tmp_path, document) == 'grid.cols: 1001 is outside 1..1000'
    document['grid'] |= {'cols': 1000}
    mission_from_dict(document, 'test')


ROWS = [('priority_transition', 1), ('threat', 'from_low'), ('threat', 'from_high')]


@pytest.mark.parametrize('path', ROWS, ids=name_of)
@pytest.mark.parametrize(
    ('row', 'says'),
    [
        ([0.9, 0.0, 0.0], r'row \[0\.9, 0\.0, 0\.0\] sums to 0\.9'),
        ([0.5, 0.5, 1e-6], r'sums to 1\.000001'),
        ([1.5, -0.5, 0.0], r'1\.5 is outside 0\.\.1'),
        ([0.5, 0.5], r'\[0\.5, 0\.5\] is not a list of 3 numbers'),
    ],
)
def test_row_that_is_no_distribution(path, row, says, tmp_path):
    message = refusal(tmp_path, put(path, row))
    assert re.match(rf'{re.escape(name_of(path[:1]))}.*: .*{says}', message)


def test_row_of_thirds_is_a_distribution():
    mission_from_dict(put(('threat', 'from_low'), [1 / 3, 1 / 3, 0.3333333333]), 'test')


@pytest.mark.parametrize(
    ('path', 'length'),
    [
        (('priority_transition',), 2),
        (('faults', 'completion'), 7),
        (('faults', 'cost'), 9),
        (('threat', 'cost'), 2),
    ],
    ids=str,
)
def test_list_of_the_wrong_length(path, length, tmp_path):
    good = value_at(case_study(), path)
    bad = (good * 2)[:length]
    assert refusal(tmp_path, put(path, bad)).startswith(f'{name_of(path)}: {bad!r} ')


@pytest.mark.parametrize(
    ('place', 'key', 'nearest'),
    [
        ((), 'discont', 'discount'),
        ((), 'nam', 'name'),
        (('goals', 0), 'request_per_hour', 'requests_per_hour'),
        (('threat',), 'last', 'lasts'),
        (('grid',), 'row', 'rows'),
        (('goals', 1), 'Eta', 'eta'),
        (('faults', 'rate'), 'sensors', 'sensor'),
        (('threat',), 'fromlow', 'from_low'),
        (('energy',), 'winds', 'wind'),
        (('grid', 'origin'), 'lat', 'latitude'),
        (('service_cost',), 'recharging', 'recharge'),
        ((), 'two\nlines', None),
        ((), 3, None),
    ],
)
def test_unknown_key(place, key, nearest, tmp_path):
    document = case_study()
    parent(document, (*place, ''))[key] = 0.5
    message = refusal(tmp_path, document)
    assert ' is unknown' in message
    assert nearest is None or message.endswith(
        f'{key}: is unknown; the nearest known key is {nearest!r}'
    )


def test_a_misspelt_key_is_told_before_the_one_that_it_leaves_missing(tmp_path):
    document = case_study()
    document['nam'] = document.pop('name')
    assert refusal(tmp_path, document) == "nam: is unknown; the nearest known key is 'name'"


@pytest.mark.parametrize('cell', [8, -1, 'two', 1.5, '2'], ids=repr)
def test_zone_off_the_grid_or_given_twice(cell, tmp_path):
    document = case_study()
    document['threat']['zones'][cell] = 0.1
    assert re.match(rf'threat\.zones\.{cell}: {cell!r} ', refusal(tmp_path, document))


def test_elevation_of_the_ground():
    document = case_study()
    flat = mission_from_dict(case_study(), 'test')
    document['grid']['elevation'] = {5: 12.5, 2: -3}
    mission = mission_from_dict(document, 'test')
    assert [mission.grid.ground(cell) for cell in range(4)] == [0.0, 0.0, -3.0, 0.0]
    assert mission.grid.ground(5) == 12.5
    assert mission.to_dict()['grid']['elevation'] == {'2': -3.0, '5': 12.5}
    assert mission_from_dict(json.loads(json.dumps(mission.to_dict())), 'test') == mission
    assert mission.digest() != flat.digest()


@pytest.mark.parametrize('elevation', [None, {}])
def test_a_mission_without_elevation_keeps_its_digest(elevation):
    document = case_study()
    if elevation is not None:
        document['grid']['elevation'] = elevation
    mission = mission_from_dict(document, 'test')
    assert {mission.grid.ground(cell) for cell in range(8)} == {0.0}
    assert 'elevation' not in mission.to_dict()['grid']
    manifest = share_directory() / 'policies' / 'case_study' / 'manifest.json'
    assert json.loads(manifest.read_text())['mission_sha256'] == mission.digest()


@pytest.mark.parametrize(
    ('cell', 'metres', 'says'),
    [
        (8, 1.0, '8 is outside 0..7: no cell of the 2x4 grid'),
        (-1, 1.0, '-1 is outside 0..7: no cell of the 2x4 grid'),
        ('hill', 1.0, "'hill' is not a whole number: no cell of the 2x4 grid"),
        (True, 1.0, 'True is not a whole number: no cell of the 2x4 grid'),
        (2, math.nan, 'nan is not finite'),
        (2, math.inf, 'inf is not finite'),
        (2, 9000.5, '9000.5 is outside -9000..9000'),
        (2, -9001, '-9001 is outside -9000..9000'),
        (2, '12', "'12' is not a number"),
        (2, None, 'None is not a number'),
    ],
)
def test_elevation_refused(cell, metres, says, tmp_path):
    document = case_study()
    document['grid']['elevation'] = {0: 1.0, cell: metres}
    assert refusal(tmp_path, document) == f'grid.elevation.{cell}: {says}'


def test_elevation_that_is_no_mapping(tmp_path):
    message = refusal(tmp_path, put(('grid', 'elevation'), [1.0, 2.0]))
    assert message == 'grid.elevation: [1.0, 2.0] is not a mapping'


def test_two_goals_of_one_name(tmp_path):
    message = refusal(tmp_path, put(('goals', 2, 'name'), 'goal1'))
    assert re.match(r"goals\[2\]\.name: 'goal1' ", message)


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('name: a\nname: b\n', "'name'"),
        ('grid: {rows: 1, cols: 1, rows: 2}', "'rows'"),
        ('goals: [a', 'not valid YAML'),
        ('a: !!python/object:os.system 1', 'not valid YAML'),
        ('[' * 5000, 'not valid YAML'),
        ('? [a]\n: b', 'not valid YAML'),
        ('', 'None is not a mapping'),
        ('- 1', '[1] is not a mapping'),
        (b'\xff\xfe\x00', 'cannot be read'),
    ],
    ids=lambda x: str(x)[:20],
)
def test_file_that_is_no_mission(text, says, tmp_path):
    assert says in refusal(tmp_path, text)


def written(place, text):
    """Return the case study's file with one number written another way."""
    before, found, after = CASE_STUDY.read_text().partition(place)
    assert found
    key, _, _ = place.rpartition(' ')
    return f'{before}{key} {text}{after}'


@pytest.mark.parametrize('text', ['010', '00', '-01', '0_1', '1:30', '0o10', '08'])
@pytest.mark.parametrize(
    ('place', 'field'),
    [
        ('cell: 5', 'goals[0].cell'),
        ('base: 0', 'grid.base'),
        ('distance_weight: 1.0', 'distance_weight'),
    ],
)
def test_number_that_YAML_versions_read_differently(text, place, field, tmp_path):  # noqa: N802
    message = refusal(tmp_path, written(place, text))
    assert re.match(rf"{re.escape(field)}: '{text}' is not a (whole )?number(:|$)", message)


@pytest.mark.parametrize('key', ['01', '011', "'01'", '0_1', '1:1'])
def test_cell_that_YAML_versions_read_differently(key, tmp_path):  # noqa: N802
    message = refusal(tmp_path, CASE_STUDY.read_text().replace(', 6: 0.25', f', {key}: 0.25'))
    plain = key.strip("'")
    assert message == (
        f"threat.zones.{plain}: '{plain}' is not a whole number: no cell of the 2x4 grid"
    )


@pytest.mark.parametrize('key', ['1' + '0' * 18, '9' * 5000])
def test_cell_of_very_many_digits(key):
    document = case_study()
    document['threat']['zones'][key] = 0.1
    with pytest.raises(MissionError, match='no cell of the 2x4 grid'):
        mission_from_dict(document, 'test')


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('1e-3', 1e-3),
        ('1E-3', 1e-3),
        ('5e2', 500.0),
        ('1.5e2', 150.0),
        ('.5e+1', 5.0),
        ('+.5', 0.5),
        ('1_000.5', 1000.5),
        ('1_000', 1000.0),
        ('0x1F', 31.0),
        ('7.', 7.0),
        ('0', 0.0),
    ],
)
def test_number_in_every_common_way(text, value, tmp_path):
    file = tmp_path / 'mission.yaml'
    file.write_text(written('distance_weight: 1.0', text))
    assert load_mission(file).distance_weight == value


@pytest.mark.parametrize('text', ['.inf', '-.Inf', '.NaN', '1e999'])
def test_number_that_is_none(text, tmp_path):
    message = refusal(tmp_path, written('distance_weight: 1.0', text))
    assert re.fullmatch(r'distance_weight: (-?inf|nan) is not finite', message)


def test_file_that_cannot_be_read(tmp_path):
    for place in (tmp_path, tmp_path / 'nowhere.yaml'):
        with pytest.raises(MissionError, match=rf'^{re.escape(str(place))}: cannot be read: .*$'):
            load_mission(place)


FILES = [
    *(share_directory() / 'config').glob('case_*.yaml'),
    *(share_directory() / 'test' / 'missions').glob('*.yaml'),
]
"""Files that are per epoch throughout."""


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.stem)
def test_mission_holds_what_its_file_says_and_has_its_hash(file):
    """A file per epoch is the mission, number by number, and so is the hash in a policy set."""
    mission, document = load_mission(file), yaml.safe_load(file.read_text())
    shared = document.pop('priority_transition', None)
    for goal in document['goals']:
        goal.setdefault('priority_transition', shared)
    document.setdefault('service_cost', {'recharge': 0.0, 'repair': 0.0})
    document['grid'].setdefault('cell_size', 50.0)
    document['faults'].setdefault('repair_success', 1.0)
    zones = document['threat'].get('zones', {})
    document['threat']['zones'] = {str(cell): p for cell, p in zones.items()}
    assert json.loads(json.dumps(mission.to_dict())) == document
    text = json.dumps(document, sort_keys=True, separators=(',', ':'))
    assert mission.digest() == hashlib.sha256(text.encode()).hexdigest()


@given(missions(GRIDS, [1, 2, 5]) | charged_missions(GRIDS, [1, 2, 5]))
def test_round_trip(document):
    mission = mission_from_dict(document, 'test')
    assert mission_from_dict(mission.to_dict(), 'test') == mission
    again = mission_from_dict(json.loads(json.dumps(mission.to_dict())), 'test')
    assert again == mission
    assert again.digest() == mission.digest()


def test_digest_tells_missions_apart():
    mission = mission_from_dict(case_study(), 'test')
    other = dataclasses.replace(mission, distance_weight=math.nextafter(1.0, 2.0))
    assert other.digest() != mission.digest()


def test_paper_was_called_seed(tmp_path):
    """Files with the old word load with a warning, and are the same mission."""
    file = tmp_path / 'old.yaml'
    file.write_text(yaml.safe_dump(case_study(feasibility='seed')))
    with pytest.warns(FutureWarning, match=rf"^{re.escape(str(file))}: .*write 'paper'$"):
        old = load_mission(file)
    new = mission_from_dict(case_study(feasibility='paper'), 'test')
    assert old == new
    assert old.digest() == new.digest()


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / 'mission.yaml')
    with pytest.raises(MissionError, match=r'mission\.yaml: cannot be read: no regular file'):
        load_mission(tmp_path / 'mission.yaml')
