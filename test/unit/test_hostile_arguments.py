"""Whatever a command is given: an answer, or one short line and the exit code for it."""

from __future__ import annotations

import json
import re

import pytest
import yaml
from strategies import CASE_STUDY, case_study

from uav_mission_manager.cli import policy_build, policy_query
from uav_mission_manager.cli.demo.view import View
from uav_mission_manager.paths import share_directory

SHIPPED = str(share_directory() / 'policies' / 'case_study')
STATE = '1,1,0,1,0,2,1,1,0,2,1'
LONGEST_LINE = 620
"""Characters: the command's name, two echoes and what is said of them."""

HOSTILE = [
    'x' * 100_000,
    '/' + 'x/' * 2000,
    '\x1b[2J\x1b]0;title\x07',
    'one\ntwo\r\n',
    'a\u202eb\u2028c',
    '\udcff\udcfe',
    '9' * 5000,
    '-' + '9' * 5000,
    '1e999',
    'nan',
    '',
    ' ',
    '[/b]:fire:',
    '%s%n{0}',
]
IDS = range(len(HOSTILE))


def refusal(module, arguments, capsys):
    """Run a command that has to refuse something; return its exit code and what it says."""
    with pytest.raises(SystemExit) as ended:
        module.main(arguments)
    out, errors = capsys.readouterr()
    assert out == ''
    if isinstance(ended.value.code, str):  # The interpreter prints it.
        errors, code = ended.value.code + '\n', 1
    else:
        code = ended.value.code
    line = errors.removesuffix('\n')
    assert line.startswith(f'{module.__name__.rpartition(".")[2]}: ')
    assert line.isprintable()
    assert len(line) <= LONGEST_LINE
    return code, line


OPTIONS = ['--order', '--max-states', '--jobs', '--method', '--precision']


@pytest.mark.parametrize('value', HOSTILE, ids=IDS)
@pytest.mark.parametrize('option', [*OPTIONS, '--tolerance', '--nonsense'])
def test_options_of_policy_build(option, value, tmp_path, capsys):
    arguments = [str(CASE_STUDY), '--out', str(tmp_path / 'p'), f'{option}={value}']
    code, _ = refusal(policy_build, arguments, capsys)
    assert code in ((1, 2) if option == '--tolerance' else (2,))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('value', HOSTILE, ids=IDS)
def test_paths_of_policy_build(value, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refusal(policy_build, ['--out', 'p', '--', value], capsys)[0] == 1
    (tmp_path / 'file').touch()
    mission = tmp_path / 'm.yaml'
    mission.write_text(yaml.safe_dump(case_study(1)))
    assert refusal(policy_build, [str(mission), '--out', f'file/{value}'], capsys)[0] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ['file', 'm.yaml']


@pytest.mark.parametrize('value', HOSTILE, ids=IDS)
def test_arguments_of_policy_query(value, capsys):
    assert refusal(policy_query, [SHIPPED, f'--state={value}'], capsys)[0] == 1
    assert refusal(policy_query, [f'--state={STATE}', '--', value], capsys)[0] == 1
    assert refusal(policy_query, [SHIPPED, f'--state={STATE}', f'--json={value}'], capsys)[0] == 2


NAMES = ['site[north]', '[/b]', 'A:fire:', '[bold]x', '\\[b]', '{0}%s', 'x' * 100]


@pytest.fixture(scope='module')
def odd_names(tmp_path_factory):
    """A mission with goals of odd names."""
    document = case_study(1, 2, name='M[/i]:fire:')
    mission = tmp_path_factory.mktemp('odd') / 'm.yaml'

    def write(first, second):
        document['goals'][0]['name'], document['goals'][1]['name'] = first, second
        mission.write_text(yaml.safe_dump(document))
        return str(mission)

    return write


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('terminal', [False, True])
def test_odd_names_are_shown_as_they_are(name, terminal, odd_names, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv('COLUMNS', '250')
    if terminal:
        monkeypatch.setenv('TTY_COMPATIBLE', '1')
        monkeypatch.setenv('FORCE_COLOR', '1')
    arguments = [odd_names(name, 'plain'), '--method', 'split', '--out', str(tmp_path / 'p')]
    assert policy_build.main(arguments) == 0
    out, _ = capsys.readouterr()
    assert 'policy of mission M[/i]:fire:, method split' in out
    assert name in out
    query = [str(tmp_path / 'p'), '--state', '1,1,1,2,0,0,0,0,0']
    assert policy_query.main(query) == 0
    out, _ = capsys.readouterr()
    shown = re.sub(r'\x1b\[[\d;]*m', '', out)
    assert 'M[/i]:fire:, split' in shown
    assert shown.replace('\n', '').count(name) >= 3
    assert policy_query.main([*query, '--json']) == 0
    assert json.loads(capsys.readouterr().out)['sub_mdps'][0]['goals'] == [name]


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('terminal', [False, True])
def test_odd_names_in_the_demo(name, terminal, capsys, monkeypatch):
    monkeypatch.setenv('COLUMNS', '400')
    if terminal:
        monkeypatch.setenv('FORCE_COLOR', '1')
    view = View(f'title {name}', ['f', 'r1'])
    view.start()
    view.decision((1, 1), f'commit {name} normal', f'{name} has low priority', 'cell 1')
    view.event(f'vehicle: {name} completed')
    out, _ = capsys.readouterr()
    for text in (f'title {name}', f'commit {name} normal', f'{name} has low', f'{name} completed'):
        assert text in out
