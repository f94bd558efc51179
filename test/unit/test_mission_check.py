"""`mission_check`: implausible missions get their warning, plausible ones none."""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from functools import cache

import pytest
import yaml
from strategies import CASE_STUDY, case_study, in_units

from uav_mission_manager import build_policy
from uav_mission_manager.cli.check import limits, solving
from uav_mission_manager.cli.check.facts import duration_text
from uav_mission_manager.cli.check.plausibility import findings
from uav_mission_manager.cli.check.terminal import map_lines
from uav_mission_manager.cli.mission_check import main
from uav_mission_manager.mdp import load_mission, mission_from_dict
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy.prediction import predictions

SHIPPED = sorted((share_directory() / 'config').glob('case_*.yaml'))


def edited(*path, value, base=None):
    document = case_study() if base is None else base
    node = document
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return document


def with_costs(**costs):
    """The case study, without any cost but these."""
    document = case_study(distance_weight=costs.get('distance_weight', 0.0), service_cost={})
    for goal in document['goals']:
        goal['eta'] = goal['delta'] = costs.get('goals', 0.0)
    document['faults']['cost'] = [0.0] * 7 + [costs.get('faults', 0.0)]
    document['range']['cost'] = costs.get('range', 0.0)
    document['threat']['cost'] = [[0.0, 0.0], [0.0, 0.0], [costs.get('threat', 0.0), 0.0]]
    return document


GRID = {'rows': 2, 'cols': 4, 'base': 0, 'service': 1}
STAYS = [[0.94, 0.04, 0.02], [1.0, 0.0, 0.0], [0.01, 0.05, 0.94]]
AT_ONCE = [[0.0, 0.5, 0.5], [0.01, 0.94, 0.05], [0.01, 0.05, 0.94]]
PARTS = ('sensor', 'actuator', 'camera')

IMPLAUSIBLE = {
    'capacity in mAh': (edited('energy', 'capacity', value=5000.0), 'energy.capacity', 'mAh'),
    'power in kW': (edited('energy', 'power', value=0.25), 'energy.power', 'kW'),
    'voltage of the mains': (edited('energy', 'voltage', value=230.0), 'energy.voltage', '230'),
    'speed in km/h': (edited('energy', 'speed', value=72.0), 'energy.speed', 'km/h'),
    'storm': (edited('energy', 'wind', value=60.0), 'energy.wind', '60'),
    'payload in grams': (edited('energy', 'payload', value=500.0), 'energy.payload', 'kg'),
    'flies for a day': (edited('energy', 'power', value=6.0), 'energy.power', 'lasts 44,400 s'),
    'out of range': (edited('grid', 'cell_size', value=900.0), 'goals.1.cell', 'range of 4,500 m'),
    'all range lost to wind': (
        edited('energy', 'wind_penalty', value=1000.0),
        'goals.0.cell',
        'a full battery has 0 m',
    ),
    'cells of kilometres': (edited('grid', 'cell_size', value=2000.0), 'grid.cell_size', '2000'),
    'a step outlasts the battery': (
        edited('grid', 'cell_size', value=6000.0),
        'grid.cell_size',
        'a step takes 1,200 s, a full battery lasts 1,066 s',
    ),
    'cells of centimetres': (edited('grid', 'cell_size', value=0.5), 'grid.cell_size', '0.5'),
    'goal on base': (edited('goals', 0, 'cell', value=0), 'goals.0.cell', 'grid.base'),
    'goal on service': (edited('goals', 2, 'cell', value=1), 'goals.2.cell', 'grid.service'),
    'agile factor': (
        edited('faults', 'agile_factor', 'actuator', value=25.0),
        'faults.agile_factor.actuator',
        '25',
    ),
    'nothing is ever done': (
        edited('faults', 'completion', value=[0.0] * 8),
        'faults.completion (done_in)',
        'no goal can ever be done',
    ),
    'a goal is never done': (
        edited('goals', 1, 'completion', value=[0.0] * 8),
        'goals.1.completion (done_in)',
        'it can never be done',
    ),
    'a goal is done with failed parts only': (
        edited('goals', 2, 'done_in', value=['never', *[20.0] * 7]),
        'goals.2.completion (done_in).0',
        'never with all in order',
    ),
    'done with failed parts only': (
        edited('faults', 'completion', 0, value=0.0),
        'faults.completion (done_in).0',
        'never with all in order',
    ),
    'no repair succeeds': (
        edited('faults', 'repair_success', value=0.0),
        'faults.repair_success (repair_in)',
        'for ever',
    ),
    'fails at once': (
        edited('faults', 'rate', 'camera', value=1.0),
        'faults.rate.camera (mtbf)',
        'first epoch',
    ),
    'nothing fails': (
        edited('faults', 'rate', value=dict.fromkeys(PARTS, 0.0)),
        'faults.rate (mtbf)',
        'nothing ever fails',
    ),
    'range lost at once': (
        edited('range', 'loss', 'normal', value=1.0),
        'range.loss.normal (lasts)',
        'out of range after an epoch',
    ),
    'range never lost': (
        edited('range', 'loss', value={'normal': 0.0, 'agile': 0.0}),
        'range.loss (lasts)',
        'lasts for ever',
    ),
    'threat never ends': (
        edited('threat', 'from_high', value=[0.0, 0.0, 1.0]),
        'threat.from_high (lasts)',
        'never ends',
    ),
    'threats change and never end': (
        edited(
            'threat',
            'from_high',
            value=[0.0, 0.5, 0.5],
            base=edited('threat', 'from_low', value=[0.0, 0.5, 0.5]),
        ),
        'threat.from_low (lasts)',
        'never ends',
    ),
    'always threatened': (
        edited('threat', 'zones', 2, value=1.0),
        'threat.zones.2 (zones_per_hour)',
        'in every epoch',
    ),
    'never threatened': (
        edited('threat', 'zones', value={}, base=edited('threat', 'onset', value=0.0)),
        'threat.onset (per_hour)',
        'no threat ever comes',
    ),
    'never a high threat': (
        edited(
            'threat',
            'from_low',
            value=[0.6, 0.4, 0.0],
            base=edited('threat', 'high_share', value=0.0),
        ),
        'threat.high_share',
        'ever high',
    ),
    'agile flight for nothing': (
        edited('threat', 'cost', value=[[0.0, 2.0], [4.0, 5.0], [12.0, 12.0]]),
        'threat.cost',
        'pointless',
    ),
    'withdrawn at once': (
        edited('priority_transition', value=STAYS),
        'goals.0.priority_transition (requests_per_hour)',
        'withdrawn',
    ),
    'wanted at once': (
        edited('priority_transition', value=AT_ONCE),
        'goals.0.priority_transition (requests_per_hour)',
        'again at once',
    ),
    'short-sighted': (edited('discount', value=0.4), 'discount or horizon', '1.67 epochs'),
    'for ever': (edited('discount', value=0.999999), 'discount or horizon', '1e+06 epochs'),
    'a cost drowns all': (
        edited('threat', 'cost', 2, 0, value=1e6),
        'threat.cost',
        'bring the costs into one scale',
    ),
    'goals drown all': (
        with_costs(goals=1e6, faults=1.0, threat=1.0),
        'goals[].eta, .delta (worth)',
        'bring the costs into one scale',
    ),
    'no costs': (with_costs(), 'costs', 'nothing to decide'),
    'a goal for nothing': (
        edited('goals', 1, value={'name': 'g', 'cell': 3, 'eta': 0.0, 'delta': 0.0}),
        'goals.1.eta (worth)',
        'costs nothing while it is open',
    ),
}
"""Mission, field of the warning that it gets, and what that says."""


@pytest.mark.parametrize(
    ('document', 'field', 'says'), IMPLAUSIBLE.values(), ids=IMPLAUSIBLE.keys()
)
def test_an_implausible_mission_gets_its_warning(document, field, says):
    found = findings(mission_from_dict(document, 'test'))
    assert any(f.field == field and says in str(f) and not f.note for f in found)
    assert all(re.fullmatch(r'[^\n]{20,300}', str(f)) for f in found)


@cache
def answer_of(path):
    """The answer of `mission_check --strict --json`, which finds nothing to warn of."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert main([str(path), '--strict', '--json']) == 0
    return json.loads(said.getvalue())


@pytest.mark.parametrize('path', SHIPPED, ids=lambda path: path.stem)
def test_shipped_missions_get_none(path):
    answer = answer_of(path)
    assert (answer['warnings'], answer['notes'], answer['not_checked']) == ([], [], '')


def test_a_mission_in_physical_units_gets_none():
    assert findings(mission_from_dict(in_units(), 'test')) == []


@pytest.mark.parametrize(('value', 'warned'), [(500.0, False), (500.1, True), (0.09, True)])
def test_limits_are_plausible_themselves(value, warned):
    energy = case_study()['energy'] | {'capacity': value, 'power': 20.0 * value}
    found = findings(mission_from_dict(case_study(energy=energy), 'test'))
    assert ('energy.capacity' in [f.field for f in found]) == warned


def test_every_limit_has_a_reason():
    for limit in limits.LIMITS.values():
        assert limit.low < limit.high
        assert len(limit.reason) > 20


def write(path, document):
    path.write_text(yaml.safe_dump(document))
    return str(path)


def test_what_is_missing_is_a_note_and_no_warning(tmp_path, capsys):
    document = case_study(1, grid=GRID)
    del document['energy']
    assert main([write(tmp_path / 'm.yaml', document), '--strict']) == 0
    printed = capsys.readouterr().out
    assert re.search(r'^note    grid.origin: missing: .*flown', printed, re.MULTILINE)
    assert re.search(r'^note    energy: missing: ', printed, re.MULTILINE)
    assert printed.endswith('no warnings\n')


def test_strict_ends_with_1_where_there_is_a_warning(tmp_path, capsys):
    path = write(
        tmp_path / 'm.yaml', edited('energy', 'capacity', value=5000.0, base=case_study(1))
    )
    assert main([path]) == 0
    assert main([path, '--strict']) == 1
    printed = capsys.readouterr().out
    assert printed.count('WARNING energy.capacity: 5000: not within 0.1 to 500 Ah') == 2


def test_a_goal_that_the_best_policy_never_gets_done():
    """Flying to it costs more in distance alone than it does open for ever."""
    document = case_study(distance_weight=20.0)
    document['goals'][1] |= {'eta': 0.01, 'delta': 0.01}
    policy = build_policy(mission_from_dict(document, 'test'), 'exact')
    found = list(solving.flown_findings(policy))
    assert [f.field for f in found if f.field.startswith('goals')] == ['goals.1']
    assert 'goal2' in str(found[0])


def test_a_fault_that_is_cheaper_to_keep_than_to_repair():
    """A sensor that costs nothing, and completes as well, is not worth the service."""
    document = case_study(1, service_cost={'recharge': 2.0, 'repair': 1000.0})
    document['faults'] |= {'cost': [0.0] * 8, 'completion': [1.0] * 8}
    policy = build_policy(mission_from_dict(document, 'test'), 'exact')
    fields = {f.field for f in solving.flown_findings(policy)}
    assert {'faults.cost.1', 'faults.cost.2'} <= fields


def test_a_mission_too_large_to_be_solved_says_what_is_not_checked(tmp_path, capsys):
    document = case_study()
    document['goals'] = [
        {'name': f'g{j}', 'cell': 2 + j % 6, 'eta': 10.0, 'delta': 5.0} for j in range(9)
    ]
    assert main([write(tmp_path / 'm.yaml', document)]) == 0
    printed = capsys.readouterr().out
    assert 'not checked: whether goals are worth committing to, and sensitivities: ' in printed
    assert 'policy_build --method auto takes expansion: ' in printed


def test_json_has_the_ways_and_ranges():
    answer = answer_of(CASE_STUDY)
    goal = answer['goals'][1]
    # Cells 0, 3 and 1 lie in one row, 50 m each.
    assert (goal['from_base'], goal['to_service'], goal['needed']) == (150.0, 100.0, 250.0)
    # 5 m/s for 5 Ah * 14.8 V / 250 W, less 100 m for each of 8 m/s, and 400 m/kg for 0.5 kg.
    had = 5 * 5 * 14.8 / 250 * 3600 - 800 - 200
    assert answer['full_range_m'] == pytest.approx(had)
    assert goal['charge'] == pytest.approx((250 + 1000) / (had + 1000))
    assert goal['done_seconds'] == 10.0
    assert answer['epoch_seconds'] == 10.0
    assert answer['auto'] == {'method': 'exact', 'why': ''}
    exact = next(m for m in answer['methods'] if m['method'] == 'exact')
    assert (exact['states'], exact['unknowns']) == (331_776, 41_472)
    assert max(answer['sensitivities'], key=lambda s: abs(s['relative']))['name'] == 'discount'


def test_the_keys_of_json_are_documented():
    text = (share_directory() / 'docs' / 'mission_check.md').read_text('utf-8')
    rows = re.findall(r'^\| (`[^|]*) \| ', text[text.index('`--json` prints') :], re.MULTILINE)
    answer = answer_of(SHIPPED[0])
    assert set(re.findall(r'`(\w+)`', ' '.join(rows))) == set(answer)


def test_predicted_sizes_are_those_of_what_is_built():
    mission = load_mission(CASE_STUDY)
    for prediction in predictions(mission):
        policy = build_policy(mission, prediction.method, certificate=False)
        states = policy.info['sub_mdp_states']
        assert (prediction.sub_mdps, prediction.states) == (len(states), max(states))
        arrays = policy.contents()
        if prediction.method == 'expansion':
            assert prediction.unknowns == arrays.expansion.theta.size
        else:
            assert prediction.unknowns == sum(s.value.size for s in arrays.solutions)
        assert prediction.memory > 0


def test_output_fits_80_columns(tmp_path, capsys):
    document = case_study(
        grid={'rows': 300, 'cols': 300, 'base': 0, 'service': 89_999, 'cell_size': 100.0}
    )
    names = ['x' * 60, '[/b]', ':fire:']
    document['threat']['zones'] = {}
    document['goals'] = [
        {'name': name, 'cell': 300 * 299 + j, 'eta': 1234.5, 'delta': 98765.4}
        for j, name in enumerate(names)
    ]
    assert main([write(tmp_path / 'm.yaml', document)]) == 0
    lines = capsys.readouterr().out.splitlines()
    whole = [x for x in lines if not x.startswith(('WARNING', 'note', 'not checked'))]
    assert max(map(len, whole)) <= 80
    assert any('[/b]' in line for line in lines)
    assert any(':fire:' in line for line in lines)
    assert any('each place stands for 15 x 15 cells' in line for line in lines)


def test_sizes_beyond_counting_fit_80_columns(tmp_path, capsys):
    document = case_study(grid=case_study()['grid'] | {'rows': 8, 'cols': 8})
    document['goals'] = [
        {'name': f'g{j}', 'cell': 2 + j, 'eta': 5.0, 'delta': 2.0} for j in range(40)
    ]
    assert main([write(tmp_path / 'm.yaml', document)]) == 0
    lines = capsys.readouterr().out.splitlines()
    # 24 * 6^40 unknowns a cell, 64 cells.
    exact = next(line for line in lines if line.startswith(' exact'))
    assert exact.split()[3] == f'{64 * 24 * 6**40:.1e}'
    assert max(len(x) for x in lines if not x.startswith(('WARNING', 'not checked'))) <= 80
    assert any(line.startswith('and 10 more') for line in lines)


@pytest.mark.parametrize(
    ('seconds', 'text'),
    [
        (0.0123, '0.012 s'),
        (15.2, '15 s'),
        (119.0, '119 s'),
        (170.0, '3 min'),
        (9000.0, '2 h'),
        (2.6e5, '3 days'),
        (1e9, '32 years'),
        (1e20, '3e+12 years'),
    ],
)
def test_durations_are_short(seconds, text):
    assert duration_text(seconds) == text


def test_the_map_shows_what_is_where():
    lines = [line.plain.split() for line in map_lines(load_mission(CASE_STUDY))]
    assert lines == [['B-', 'S-', '.!', '2'], ['.', '1', '3!', '.']]


def test_a_file_that_does_not_load_ends_in_one_line(tmp_path, capsys):
    path = tmp_path / 'm.yaml'
    path.write_text('name: [')
    with pytest.raises(SystemExit) as end:
        main([str(path), '--map', str(tmp_path / 'm.html')])
    assert str(end.value).startswith('mission_check: ')
    assert '\n' not in str(end.value)
    assert not (tmp_path / 'm.html').exists()


def test_geojson_without_an_origin_is_refused_before_anything_is_written(tmp_path):
    path = write(tmp_path / 'm.yaml', case_study(1, grid=GRID))
    with pytest.raises(SystemExit, match=r'm.yaml: grid.origin: is missing'):
        main([path, '--geojson', str(tmp_path / 'o.json'), '--map', str(tmp_path / 'o.html')])
    assert [file.name for file in tmp_path.iterdir()] == ['m.yaml']


def test_what_cannot_be_written_leaves_the_old_file(tmp_path):
    (tmp_path / 'old').mkdir()
    (tmp_path / 'old' / 'keep').touch()
    with pytest.raises(SystemExit, match=r'^mission_check: '):
        main([str(SHIPPED[0]), '--map', str(tmp_path / 'old')])
    assert [path.name for path in tmp_path.rglob('*')] == ['old', 'keep']


def test_the_charge_is_unknown_where_none_is_enough():
    document = edited('energy', 'wind_penalty', value=1000.0)
    found = findings(mission_from_dict(document, 'test'))
    assert sum('out of range always' in str(f) for f in found) == 3
    assert not any(math.isnan(f.value) for f in found if isinstance(f.value, float))


@pytest.mark.parametrize('option', ['--map', '--geojson'])
def test_a_file_that_cannot_be_written_is_named(tmp_path, option):
    place = tmp_path / 'no_folder' / 'out'
    with pytest.raises(SystemExit) as ended:
        main([str(SHIPPED[0]), option, str(place)])
    assert ended.value.code == (
        f'mission_check: {place}: cannot be written: No such file or directory'
    )
