"""`policy_build` and `policy_query`: exit codes, one-line errors, output.

Both are run as processes, with an error and without; where the rest of a test is about something
else, `called` does without the start of a process.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import subprocess
import sys

import pytest
import yaml
from rich.console import Console
from rich.progress import Progress
from strategies import CASE_STUDY, case_study

from uav_mission_manager import __version__, load_policy
from uav_mission_manager.cli import policy_build, policy_query
from uav_mission_manager.paths import share_directory
from uav_mission_manager.solver.progress import Report

SHIPPED = share_directory() / 'policies' / 'case_study'
STATE = '1,1,0,1,0,2,1,1,0,2,1'
ALLOWED = {1, 4, 5, 8, 9}  # Goal 1 achieved, goal 2 out of range, nothing to repair.


def run(command, *arguments):
    path = os.pathsep.join(filter(None, [str(share_directory()), os.environ.get('PYTHONPATH')]))
    return subprocess.run(
        [sys.executable, '-m', f'uav_mission_manager.cli.{command}', *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=os.environ | {'PYTHONPATH': path, 'COLUMNS': '80'},
    )


def called(command, *arguments):
    """As `run`, in this process."""
    main = {'policy_build': policy_build.main, 'policy_query': policy_query.main}[command]
    out, errors = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        patch.setenv('COLUMNS', '80')
        try:
            code = main(list(map(str, arguments)))
        except SystemExit as ended:
            code = 1
            print(ended.code, file=errors)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), errors.getvalue())


def assert_one_line(result, command, says):
    assert (result.returncode, result.stdout) == (1, '')
    assert re.fullmatch(rf'{command}: [^\n]*{re.escape(says)}[^\n]*\n', result.stderr)


def write(path, document):
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.mark.parametrize('command', ['policy_build', 'policy_query'])
def test_help_and_usage(command):
    assert run(command, '--version').stdout == f'uav_mission_manager {__version__}\n'
    assert run(command, '--help').stdout.startswith(f'usage: {command} ')
    wrong = run(command, '--nonsense')
    assert (wrong.returncode, wrong.stdout) == (2, '')


ARGPARSED = [
    'cli.policy_build',
    'cli.policy_query',
    'cli.mission_simulate',
    'cli.demo',
    'autopilot.sim_autopilot',
]


@pytest.mark.parametrize('module', ARGPARSED)
def test_a_shell_completes_an_option(module, tmp_path):
    """As bash asks it: the line, the place in it, and a file for the answer."""
    command = module.rpartition('.')[2]
    asked = {
        '_ARGCOMPLETE': '1',
        '_ARGCOMPLETE_STDOUT_FILENAME': str(tmp_path / 'answer'),
        '_ARGCOMPLETE_SHELL': 'bash',
        '_ARGCOMPLETE_IFS': '\n',
        'COMP_LINE': f'{command} --ver',
        'COMP_POINT': str(len(f'{command} --ver')),
    }
    subprocess.run(
        [sys.executable, '-m', f'uav_mission_manager.{module}'],
        env=os.environ | asked,
        cwd=share_directory(),
        timeout=120,
        check=False,
    )
    assert (tmp_path / 'answer').read_text().strip() == '--version'
    source = share_directory() / 'uav_mission_manager' / module.replace('.', '/')
    source = source / '__init__.py' if source.is_dir() else source.with_suffix('.py')
    assert source.read_text().startswith('# PYTHON_ARGCOMPLETE_OK\n')


def test_build_of_the_case_study(tmp_path):
    out = tmp_path / 'p'
    result = run('policy_build', CASE_STUDY, '--method', 'exact', '--out', out, '--json')
    assert (result.returncode, result.stderr) == (0, '')
    summary = json.loads(result.stdout)
    assert (summary['states'], summary['goals'], summary['method']) == (331_776, 3, 'exact')
    assert summary['converged']
    assert 0 < summary['upper'] == -summary['lower'] <= 1e-7
    assert summary['seconds'] < 15
    assert summary['bytes'] == sum(file.stat().st_size for file in out.iterdir())
    assert summary['digest'] == load_policy(out).digest == load_policy(SHIPPED).digest


def test_build_says_what_it_did(tmp_path):
    mission = write(tmp_path / 'm.yaml', case_study(1, 2))
    for method in ('split', 'highest_priority', 'best_value'):
        result = called('policy_build', mission, '--method', method, '--out', tmp_path / 'p')
        assert result.returncode == 0
        assert f'method {method}' in result.stdout
        assert '41,472' in result.stdout
        assert load_policy(tmp_path / 'p').method == method
    assert sorted(path.name for path in tmp_path.iterdir()) == ['m.yaml', 'p']


def test_build_says_how_good_an_expansion_is(tmp_path):
    out = tmp_path / 'p'
    result = run(
        'policy_build',
        CASE_STUDY,
        '--method',
        'expansion',
        '--order',
        '2',
        '--jobs',
        '2',
        '--out',
        out,
    )
    assert (result.returncode, result.stderr) == (0, '')
    gap = float(re.search(r'certified +on average within ([\d.]+)% ', result.stdout).group(1))
    assert 0 < gap < 5
    policy = load_policy(out)
    assert policy.info['gap'] == pytest.approx(gap / 100, abs=1e-4)
    manifest = json.loads((out / 'manifest.json').read_text())
    assert manifest['certificate']['gap'] == policy.info['gap']
    answer = json.loads(called('policy_query', out, '--state', STATE, '--json').stdout)
    decision = policy.decide([int(part) for part in STATE.split(',')])
    assert answer['lower_bound'] == decision.lower_bound
    assert answer['upper_bound'] == decision.upper_bound
    assert answer['upper_bound_holds'] == 'everywhere'
    shown = called('policy_query', out, '--state', STATE).stdout
    assert f'cost of this policy: {decision.upper_bound:.6f} (everywhere)' in shown


def test_build_without_a_certificate(tmp_path):
    mission, out = write(tmp_path / 'm.yaml', case_study(1, 2)), tmp_path / 'p'
    for flags in (
        ('--method', 'expansion', '--order', '1', '--no-certificate'),
        ('--method', 'highest_priority'),
    ):
        result = called('policy_build', mission, *flags, '--out', out)
        assert result.returncode == 0
        assert 'certified' not in result.stdout
        state = '1,1,1,2,0,0,0,0,0'
        answer = json.loads(called('policy_query', out, '--state', state, '--json').stdout)
        assert (answer['upper_bound'], answer['upper_bound_holds']) == (None, 'nowhere')


@pytest.mark.parametrize(
    ('flags', 'says'),
    [
        (('--order', '0'), 'order 0'),
        (('--max-states', '10'), 'T_max = 10'),
        (('--method', 'exact', '--max-states', '10'), 'T_max = 10'),
        (('--jobs', '0'), 'jobs 0'),
        (('--max-states', '0'), 'max_states 0'),
        (('--method', 'expansion', '--resume'), "method 'expansion' cannot be resumed"),
    ],
)
def test_build_with_options_that_cannot_be(tmp_path, flags, says):
    mission = write(tmp_path / 'm.yaml', case_study(1, 2))
    result = called('policy_build', mission, '--out', tmp_path / 'p', *flags)
    assert_one_line(result, 'policy_build', says)
    assert list(tmp_path.iterdir()) == [mission]


def test_build_with_a_scheduler_that_does_not_answer(tmp_path):
    mission, address = write(tmp_path / 'm.yaml', case_study(1, 2)), 'tcp://127.0.0.1:9'
    flags = '--method', 'expansion', '--scheduler', address
    result = run('policy_build', mission, '--out', tmp_path / 'p', *flags)
    assert_one_line(result, 'policy_build', address)
    assert list(tmp_path.iterdir()) == [mission]


def test_build_tolerance(tmp_path):
    mission = write(tmp_path / 'm.yaml', case_study(1))
    result = called(
        'policy_build', mission, '--out', tmp_path / 'p', '--tolerance', '0.5', '--json'
    )
    assert 1e-3 < json.loads(result.stdout)['upper'] <= 0.5
    for bad in ('0', '-1', 'nan'):
        result = called('policy_build', mission, '--out', tmp_path / 'q', f'--tolerance={bad}')
        assert_one_line(result, 'policy_build', 'tolerance')


def test_build_of_a_bad_mission_leaves_nothing(tmp_path):
    document = case_study()
    document['priority_transition'][0] = [0.9, 0.0, 0.0]
    mission = write(tmp_path / 'bad.yaml', document)
    for file, says in (
        (mission, 'priority_transition: row [0.9, 0.0, 0.0] sums to 0.9'),
        (tmp_path / 'nowhere.yaml', 'nowhere.yaml: cannot be read'),
    ):
        assert_one_line(
            called('policy_build', file, '--out', tmp_path / 'p'), 'policy_build', says
        )
    assert list(tmp_path.iterdir()) == [mission]


def test_build_does_not_overwrite_what_is_no_policy_set(tmp_path):
    mission = write(tmp_path / 'm.yaml', case_study(1))
    assert_one_line(
        called('policy_build', mission, '--out', tmp_path), 'policy_build', 'is no policy set'
    )
    assert list(tmp_path.iterdir()) == [mission]


def test_query_lists_every_action_and_marks_those_not_allowed():
    result = run('policy_query', SHIPPED, '--state', STATE)
    assert (result.returncode, result.stderr) == (0, '')
    rows = re.findall(
        r'^\W*(\d+)\s+\W\s+((?:none|commit|recharge|repair)[ \w]*?)\s+\W\s+'
        r'([\d.]*)\s+\W\s+([ \w-]*?)\s*\W*$',
        result.stdout,
        re.MULTILINE,
    )
    assert [int(number) for number, *_ in rows] == list(range(1, 11))
    assert {int(number) for number, _, _, mark in rows if mark != 'not allowed'} == ALLOWED
    policy = load_policy(SHIPPED)
    decision = policy.decide([int(part) for part in STATE.split(',')])
    for number, _, q, mark in rows:
        value = decision.values[int(number) - 1]
        assert (q == '') == math.isinf(value) == (mark == 'not allowed')
        assert q == '' or float(q) == pytest.approx(value, abs=1e-6)
    marked = {mark: int(number) for number, *_, mark in rows}
    assert marked['choice'] == decision.action.number
    assert marked['runner-up'] == decision.runner_up.number
    assert decision.reason in ' '.join(result.stdout.split())


def test_query_json():
    result = called('policy_query', SHIPPED, '--state', STATE.replace(',', ' '), '--json')
    answer = json.loads(result.stdout)
    decision = load_policy(SHIPPED).decide([int(part) for part in STATE.split(',')])
    assert ','.join(map(str, answer['state'].values())) == STATE
    assert [action['number'] for action in answer['actions']] == list(range(1, 11))
    assert {a['number'] for a in answer['actions'] if a['q'] is not None} == ALLOWED
    assert [math.inf if a['q'] is None else a['q'] for a in answer['actions']] == list(
        decision.values
    )
    assert answer['choice'] == decision.action.number
    assert (answer['margin'], answer['lower_bound']) == (decision.margin, decision.lower_bound)


@pytest.mark.parametrize(
    ('state', 'says'),
    [
        ('1,1,0,1', 'a state has 11 variables'),
        ('', 'a state has 11 variables'),
        ('9,1,0,1,0,2,1,1,0,2,1', 'f = 9 is outside 1..8'),
        ('1,1,0,1,0,2,1,8,0,2,1', 'l = 8 is outside 0..7'),
        ('1,1,0,1,0,2,1,1,0,2,x', "'1,1,0,1,0,2,1,1,0,2,x'"),
        ('1,1,0,1,0,2,1,1,0,2,1.0', '--state'),
        ('1,1,0,1,0,2,1,1,0,2,' + '9' * 30, 'states are integers'),
    ],
)
def test_query_of_a_bad_state(state, says):
    assert_one_line(called('policy_query', SHIPPED, f'--state={state}'), 'policy_query', says)


def test_query_of_a_broken_set(tmp_path):
    assert_one_line(
        run('policy_query', tmp_path, '--state', STATE), 'policy_query', 'manifest.json'
    )


def test_the_bars_count_the_whole_of_the_work():
    """Also what has not begun: the share of all parts, and how many are done."""
    bars = Progress(console=Console(file=io.StringIO()), disable=True)
    show = policy_build._bars(bars)
    for task in ('a', 'b', 'c', 'd'):
        show(Report(0, 0.0, 'not done yet', task))
    show(Report(1, 0.5, 'half', 'c'))
    show(Report(1, 1.0, 'done', 'a'))
    whole, *parts = bars.tasks
    assert (whole.description, whole.completed) == ('1 of 4 parts done', 37.5)
    assert [part.description for part in parts if part.visible] == ['c: half']
