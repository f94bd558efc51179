"""`mission_simulate`: what it prints, draws and refuses."""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pytest
from strategies import case_study, lively
from test_cli_policy import SHIPPED, assert_one_line, run
from test_hostile_arguments import HOSTILE, IDS, refusal

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.cli import forecast_plot, forecast_view, mission_simulate
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.evaluation.flights import fly
from uav_mission_manager.solver.evaluation.forecast import (
    MEASURED_EVENTS,
    MEASURED_MEANS,
    forecast,
)

FEW = ('--episodes', '50')


@pytest.fixture(scope='module')
def sets(tmp_path_factory):
    """Policy sets of two goals by their names."""
    folder = tmp_path_factory.mktemp('sets')
    no_energy = lively()
    del no_energy['energy']
    weights = lively(distance_weight=3.0)
    for name, document, method in (
        ('exact', lively(), 'exact'),
        ('other', lively(), 'highest_priority'),
        ('weights', weights, 'exact'),
        ('paper', lively(feasibility='paper'), 'highest_priority'),
        ('no_energy', no_energy, 'exact'),
        ('one', case_study(1), 'exact'),
    ):
        build_policy(mission_from_dict(document, 'test'), method).save(folder / name)
    return {path.name: str(path) for path in folder.iterdir()}


def output(arguments, capsys):
    assert mission_simulate.main([str(argument) for argument in arguments]) == 0
    printed = capsys.readouterr()
    assert printed.err == ''
    return printed.out


def leaves(value):
    """All intervals in a forecast."""
    if isinstance(value, dict) and value.keys() == {'value', 'low', 'high'}:
        yield value
    elif isinstance(value, (dict, list)):
        for entry in value.values() if isinstance(value, dict) else value:
            yield from leaves(entry)


def test_help():
    result = run('mission_simulate', '--help')
    assert (result.returncode, result.stderr) == (0, '')
    assert result.stdout.startswith('usage: mission_simulate ')
    assert '%%' not in result.stdout


def test_case_study_in_a_process():
    result = run('mission_simulate', SHIPPED, *FEW)
    assert (result.returncode, result.stderr) == (0, '')
    lines = result.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    for word in ('goal1', 'median', 'recharges', 'energy [Wh]', 'Not in the model:', 'charge:'):
        assert word in result.stdout


def test_json_says_what_the_simulation_found(sets, capsys):
    state = '1,1,1,2,1,0,0,0,0'
    answer = json.loads(output([sets['exact'], *FEW, '--from', state, '--json'], capsys))
    policy = load_policy(sets['exact'])
    start = policy.space.check([int(part) for part in state.split(',')])
    rows = np.repeat(start, 50, axis=0)
    found = forecast(fly(policy.mission, policy.act, rows, 180, np.random.default_rng(0)))
    assert answer['format'] == 1
    assert list(answer['start'].values()) == start[0].tolist()
    [said] = answer['policies']
    assert said['bounds']['lower'] == policy.lower_bound(start)[0]
    assert said['bounds']['upper'] == policy.upper_bound(start)[0]
    assert (said['method'], said['digest']) == ('exact', policy.digest)
    assert said['forecast']['cost']['value'] == found.cost.value
    for goal, expected in zip(said['forecast']['goals'], found.goals, strict=True):
        values = {limit: done['value'] for limit, done in goal['done_within'].items()}
        assert values == {str(m): done.value for m, done in expected.done_within.items()}
    assert said['forecast']['means'].keys() == found.means.keys()
    for name, expected in found.events.items():
        assert said['forecast']['events'][name]['high'] == expected.high


def test_everything_that_is_measured_is_shown():
    assert forecast_view.MEAN_NAMES.keys() == MEASURED_MEANS.keys()
    assert forecast_view.EVENT_NAMES.keys() == MEASURED_EVENTS.keys()


def test_default_start_is_at_base_with_all_goals_asked_for(capsys):
    answer = json.loads(output([SHIPPED, *FEW, '--json'], capsys))
    assert list(answer['start'].values()) == [1, 1, 1, 1, 2, 2, 2, 0, 0, 0, 0]
    assert answer['difference'] is None
    assert answer['epoch_seconds'] == 10  # 50 m at 5 m/s.


def test_the_seed_decides(sets, capsys):
    runs = [output([sets['exact'], *FEW, '--seed', seed, '--json'], capsys) for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert json.loads(runs[0])['policies'] != json.loads(runs[2])['policies']


def test_comparison(sets, capsys):
    arguments = [sets['exact'], '--compare', sets['other'], *FEW]
    answer = json.loads(output([*arguments, '--json'], capsys))
    first, second = (policy['forecast'] for policy in answer['policies'])
    gained = answer['difference']
    assert gained['cost']['value'] == pytest.approx(
        second['cost']['value'] - first['cost']['value']
    )
    for name in first['means']:
        expected = second['means'][name]['value'] - first['means'][name]['value']
        assert gained['means'][name]['value'] == pytest.approx(expected)
    assert all(i['low'] <= i['value'] <= i['high'] for i in leaves(gained))
    shown = output(arguments, capsys)
    assert max(map(len, shown.splitlines())) <= 80
    cost = next(line for line in shown.splitlines() if 'discounted cost' in line)
    [low] = re.findall(r'([+-][\d.]+)\.\.', cost)
    assert float(low) == pytest.approx(gained['cost']['low'], rel=0.05)


def test_long_names_fit_too(tmp_path, capsys):
    document = lively()
    document['goals'][0]['name'] = 'x' * 100
    build_policy(mission_from_dict(document, 'test'), 'split').save(tmp_path / 'p')
    for compare in ([], ['--compare', tmp_path / 'p']):
        shown = output([tmp_path / 'p', *compare, *FEW], capsys)
        assert shown.count('x') >= 100
        tables = shown.partition('Not in the model')[0].replace(str(tmp_path), '')
        assert max(map(len, tables.splitlines())) <= 80
        assert '\u2026' not in shown


def test_a_policy_of_other_numbers_is_flown_in_the_first_mission(sets, capsys):
    arguments = [sets['exact'], '--compare', sets['weights'], *FEW]
    answer = json.loads(output([*arguments, '--json'], capsys))
    assert answer['policies'][1]['bounds'] is None
    assert 'mission with other numbers' in ' '.join(output(arguments, capsys).split())


def test_what_is_beyond_the_end_is_null_and_said(sets, capsys):
    """Nobody ever asks for a goal."""
    document = lively() | {'priority_transition': [[1, 0, 0]] * 3}
    folder = sets['exact'] + '-never'
    build_policy(mission_from_dict(document, 'test'), 'exact').save(folder)
    start = ('--from', '1,1,1,0,0,0,0,0,0')
    answer = json.loads(output([folder, *FEW, *start, '--json'], capsys))
    for goal in answer['policies'][0]['forecast']['goals']:
        assert goal['median_minutes'] == {'value': None, 'low': None, 'high': None}
        assert goal['done_within']['30']['value'] == 0
    assert '> 30' in output([folder, *FEW, *start], capsys)


@pytest.mark.parametrize('suffix', ['png', 'svg'])
def test_plot(sets, suffix, tmp_path, capsys):
    pytest.importorskip('matplotlib')
    for number, compare in enumerate(([], ['--compare', sets['other']])):
        file = tmp_path / f'{number}.{suffix}'
        output([sets['exact'], *compare, *FEW, '--plot', file], capsys)
        start = file.read_bytes()[:5]
        assert start == {'png': b'\x89PNG\r', 'svg': b'<?xml'}[suffix]
    assert sorted(path.name for path in tmp_path.iterdir()) == [f'0.{suffix}', f'1.{suffix}']


def test_curves_of_the_plot_are_the_shares_done(sets, tmp_path):
    figures = pytest.importorskip('matplotlib.figure')
    policy = load_policy(sets['exact'])
    rows = np.tile([1, 1, 1, 2, 2, 0, 0, 0, 0], (200, 1))
    flown = fly(policy.mission, policy.act, rows, 180, np.random.default_rng(0))
    axes = figures.Figure().subplots()
    forecast_plot._draw_curves(axes, [flown])
    for j, line in enumerate(axes.lines[:2]):
        minutes, share = line.get_data()
        done = (flown.done[:, j] > 0) & (flown.done[:, j] <= 30)
        assert share[np.searchsorted(minutes, 5)] == pytest.approx(100 * done.mean())
        assert (minutes[0], minutes[-1], share[0]) == (0, 30, 0)


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (('exact', '--compare', 'one'), '--compare: goals or grid of'),
        (('exact', '--compare', 'paper'), 'is paper, not strict'),
        (('no_energy',), 'no_energy: mission case_study: energy: is missing'),
        (('exact', '--from', '1,1'), '--from: a state has 9 variables'),
        (('exact', '--from', '1,1,1,3,0,0,0,0,0'), '--from: g1 = 3 is outside 0..2'),
        (('exact', '--from', 'base'), "--from: 'base' is not a list of whole numbers"),
    ],
)
def test_refusals(arguments, says, sets, capsys):
    name, *rest = arguments
    rest = [sets.get(word, word) for word in rest]
    code, line = refusal(mission_simulate, [sets[name], *FEW, *rest], capsys)
    assert code == 1
    assert says in line


def test_plots_that_cannot_be_drawn_are_refused_first(sets, tmp_path, capsys):
    pytest.importorskip('matplotlib')
    for file, says in (
        ('x.nonsense', 'ends in none of'),
        ('x', 'ends in none of'),
        ('no/x.png', 'there is no folder'),
    ):
        arguments = ['no_such_policy', '--plot', str(tmp_path / file)]
        assert says in refusal(mission_simulate, arguments, capsys)[1]
    (tmp_path / 'taken.png').mkdir()
    refusal(mission_simulate, [sets['exact'], *FEW, '--plot', str(tmp_path / 'taken.png')], capsys)
    assert [path.name for path in tmp_path.iterdir()] == ['taken.png']


def test_plot_without_matplotlib(monkeypatch, capsys):
    for name in ('matplotlib', 'matplotlib.figure'):
        monkeypatch.setitem(sys.modules, name, None)
    code, line = refusal(mission_simulate, [str(SHIPPED), '--plot', 'x.png'], capsys)
    assert code == 1
    assert 'pip install' in line


@pytest.mark.parametrize('value', HOSTILE, ids=IDS)
@pytest.mark.parametrize('option', ['--episodes', '--seed', '--from', '--compare', '--plot'])
def test_hostile_values(option, value, sets, tmp_path, monkeypatch, capsys):
    pytest.importorskip('matplotlib')
    monkeypatch.chdir(tmp_path)
    code, _ = refusal(mission_simulate, [sets['one'], f'{option}={value}'], capsys)
    assert code == (2 if option in ('--episodes', '--seed') else 1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('count', ['9', '1000001', '-5', '1.5'])
def test_numbers_of_episodes(count, sets, capsys):
    assert refusal(mission_simulate, [sets['one'], f'--episodes={count}'], capsys)[0] == 2


def test_no_policy_set(tmp_path):
    result = run('mission_simulate', tmp_path)
    assert_one_line(result, 'mission_simulate', str(tmp_path))
