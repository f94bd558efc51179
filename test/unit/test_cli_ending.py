"""Commands end in one line at most, whoever ends them and whatever they lack."""

from __future__ import annotations

import importlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from strategies import CASE_STUDY, case_study

from uav_mission_manager.cli import policy_build, policy_query
from uav_mission_manager.paths import share_directory

LIMIT = 120
BUSY_TIME = 1.0
"""Processor time [s] by which a process that solves has imported what it needs."""

SHIPPED = share_directory() / 'policies' / 'case_study'
STATE = '--state=1,1,0,1,0,2,1,1,0,2,1'


def start(command, *arguments, **options):
    """Start a command in a session of its own, as a terminal does."""
    path = os.pathsep.join(filter(None, [str(share_directory()), os.environ.get('PYTHONPATH')]))
    environment = os.environ | {'PYTHONPATH': path} | options.pop('env', {})
    return subprocess.Popen(
        [sys.executable, '-m', f'uav_mission_manager.cli.{command}', *map(str, arguments)],
        **{'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE} | options,
        text=True,
        env=environment,
        start_new_session=True,
    )


def until(condition):
    limit = time.monotonic() + LIMIT
    while not (found := condition()):
        assert time.monotonic() < limit
        time.sleep(0.02)
    return found


def session(leader):
    """Processes that live in the session of a process."""
    found = []
    for entry in Path('/proc').iterdir():
        if entry.name.isdigit():
            try:
                stat = (entry / 'stat').read_text().rpartition(')')[2].split()
            except OSError:
                continue
            if stat[3] == str(leader) and stat[0] != 'Z':
                found.append(int(entry.name))
    return found


def solving(leader):
    """Processes of a build that have read what they are to do, and do it.

    One that is still reading when the build ends says so, in Python's words.
    """
    found = []
    for pid in session(leader):
        process = Path(f'/proc/{pid}')
        try:
            command, maps = (process / 'cmdline').read_text(), (process / 'maps').read_text()
            stat = (process / 'stat').read_text().rpartition(')')[2].split()
        except OSError:
            continue
        seconds = sum(map(int, stat[11:13])) / os.sysconf('SC_CLK_TCK')
        if 'spawn_main' in command and 'numpy' in maps and seconds > BUSY_TIME:
            found.append(pid)
    return found


@pytest.fixture
def long_build(tmp_path):
    """A build of minutes in two processes, well under way."""
    document = case_study()
    document['goals'] = [
        document['goals'][j % 3] | {'name': f'goal{j}', 'cell': j % 8} for j in range(9)
    ]
    (tmp_path / 'm.yaml').write_text(yaml.safe_dump(document))
    options = ('--method', 'expansion', '--jobs', '2', '--out', tmp_path / 'p')
    process = start('policy_build', tmp_path / 'm.yaml', *options)
    until(lambda: len(solving(process.pid)) == 2 or process.poll() is not None)
    yield process
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_build_in_processes_is_interrupted(long_build, number, tmp_path):
    if number == signal.SIGTERM:
        long_build.send_signal(number)  # As a service manager does.
    else:
        os.killpg(long_build.pid, number)  # As a terminal does.
    assert long_build.communicate(timeout=LIMIT) == ('', 'policy_build: interrupted\n')
    assert long_build.returncode == 128 + number
    until(lambda: not session(long_build.pid))
    assert [path.name for path in tmp_path.iterdir()] == ['m.yaml']


def test_processes_of_a_build_end_with_it(long_build):
    long_build.kill()
    until(lambda: not session(long_build.pid))
    assert 'Traceback' not in long_build.communicate(timeout=LIMIT)[1]


def test_a_process_of_a_build_that_dies(long_build):
    os.kill(solving(long_build.pid)[0], signal.SIGKILL)
    out, errors = long_build.communicate(timeout=LIMIT)
    assert (out, long_build.returncode) == ('', 1)
    assert errors == (
        'policy_build: a process that solves a part has died: of too little memory?\n'
    )


def run_program(program):
    """Run some Python in a process of its own."""
    return subprocess.run(
        [sys.executable, '-c', program], cwd=share_directory(), capture_output=True, text=True
    )


def test_an_interruption_that_was_lost_is_found():
    """What a signal raises in a destructor, Python drops."""
    program = """
import os, signal
from uav_mission_manager.cli.errors import look_for_interruption, one_line_errors

class Tidied:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)

with one_line_errors('x'):
    look_for_interruption()
    Tidied()
    print('lost', flush=True)
    look_for_interruption()
    print('not found')
"""
    done = run_program(program)
    assert (done.stdout, done.returncode) == ('lost\n', 128 + signal.SIGTERM)
    assert done.stderr.endswith('x: interrupted\n')


@pytest.mark.parametrize('signals', [0, 1])
def test_what_compiled_code_makes_of_an_interruption_is_one(signals):
    """Where Python that it calls is interrupted it raises an error of its own, as rclpy does."""
    program = f"""
import os, signal
from uav_mission_manager.cli.errors import one_line_errors

with one_line_errors('x'):
    try:
        for _ in range({signals}):
            os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        pass
    raise RuntimeError('Unable to convert')
"""
    done = run_program(program)
    assert done.returncode == (128 + signal.SIGINT if signals else 1)
    assert (done.stderr == 'x: interrupted\n') == bool(signals)
    assert done.stderr.endswith(
        'interrupted\n' if signals else 'RuntimeError: Unable to convert\n'
    )


@pytest.mark.parametrize('command', ['policy_build', 'policy_query'])
def test_interrupted_while_its_modules_are_imported(command):
    process = start(command, '--help')
    until(lambda: 'numpy' in Path(f'/proc/{process.pid}/maps').read_text())
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=LIMIT)
    assert 'Traceback' not in errors
    assert len(errors.splitlines()) == (process.returncode != 0)


@pytest.mark.parametrize('signals', [0, 1])
def test_a_library_that_takes_an_interruption_for_a_missing_module(signals):
    """NumPy does so where it comes while its compiled parts import others."""
    program = f"""
import os
import signal

import uav_mission_manager.cli

try:
    for _ in range({signals}):
        os.kill(os.getpid(), signal.SIGINT)
except KeyboardInterrupt:
    pass
raise ImportError('no datetime')
"""
    done = run_program(program)
    assert done.returncode == 1
    assert (done.stderr == 'interrupted\n') == bool(signals)
    assert done.stderr.endswith('interrupted\n' if signals else 'ImportError: no datetime\n')


@pytest.mark.parametrize(
    ('command', 'arguments'),
    [('policy_build', ['--help']), ('policy_query', [SHIPPED, STATE])],
)
def test_output_that_nobody_reads_any_more(command, arguments):
    reader, writer = os.pipe()
    os.close(reader)
    process = start(command, *arguments, stdout=writer)
    os.close(writer)
    assert process.communicate(timeout=LIMIT) == (None, '')
    assert process.returncode == 1


@pytest.mark.parametrize('arguments', [['--help'], [SHIPPED, STATE], [SHIPPED, STATE, '--json']])
def test_output_without_room(arguments):
    with open('/dev/full', 'w') as full:
        process = start('policy_query', *arguments, stdout=full)
        _, errors = process.communicate(timeout=LIMIT)
    assert errors == 'policy_query: No space left on device\n'
    assert process.returncode == 1


def test_output_that_is_closed():
    words = [sys.executable, '-m', 'uav_mission_manager.cli.policy_query', SHIPPED, STATE]
    closed = subprocess.run(
        ['sh', '-c', '"$@" >&-', 'sh', *map(str, words)],
        cwd=share_directory(),
        capture_output=True,
        timeout=LIMIT,
    )
    assert (closed.returncode, closed.stderr) == (0, b'')


def test_a_terminal_that_lacks_characters(tmp_path):
    document = case_study(1, name='São')
    (tmp_path / 'm.yaml').write_text(yaml.safe_dump(document))
    arguments = (tmp_path / 'm.yaml', '--out', tmp_path / 'p')
    process = start('policy_build', *arguments, env={'PYTHONIOENCODING': 'ascii'})
    out, errors = process.communicate(timeout=LIMIT)
    assert (process.returncode, errors) == (0, '')
    assert 'policy of mission S\\xe3o, method exact' in out


BAG = 'test/bags/case_study'
PATHS = [
    ('policy_build', 'NOWHERE --out p'),
    ('policy_query', f'NOWHERE {STATE}'),
    ('mission_check', 'NOWHERE'),
    ('mission_new', 'NOWHERE --out m.yaml'),
    ('mission_simulate', 'NOWHERE'),
    ('mission_simulate', 'SHIPPED --episodes 10 --compare NOWHERE'),
    ('mission_replay', 'NOWHERE --policy SHIPPED'),
    ('mission_replay', 'BAG --policy NOWHERE'),
    ('mission_replay', 'BAG --policy NOWHERE --serve --port 0'),
    ('mission_report', 'NOWHERE --out r.html'),
    ('mission_report', 'BAG --policy NOWHERE --out r.html'),
    ('mission_report', 'SHIPPED --out NOWHERE/r.html'),
    ('mission_check', 'MISSION --map NOWHERE/m.html'),
    ('mission_check', 'MISSION --geojson NOWHERE/m.json'),
    ('mission_new', 'PLAN --out NOWHERE/m.yaml'),
    ('mission_simulate', 'SHIPPED --episodes 10 --plot NOWHERE/f.svg'),
]


@pytest.mark.parametrize(('command', 'words'), PATHS)
def test_a_path_that_is_not_there_is_told_once_and_plainly(
    command, words, tmp_path, monkeypatch, capsys
):
    root = share_directory()
    places = {
        'BAG': root / BAG,
        'SHIPPED': SHIPPED,
        'MISSION': root / 'config' / 'case_one.yaml',
        'PLAN': root / 'config' / 'plans' / 'field.plan',
    }
    monkeypatch.chdir(tmp_path)
    arguments = [str(places.get(w, w)) for w in words.replace('NOWHERE', 'not/there').split()]
    module = importlib.import_module(f'uav_mission_manager.cli.{command}')
    with pytest.raises(SystemExit) as ended:
        module.main(arguments)
    line = ended.value.code
    assert capsys.readouterr() == ('', '')
    assert line.startswith(f'{command}: ')
    assert line.count('not/there') == 1
    assert line.isprintable()
    assert 'Errno' not in line
    assert re.search('there is no|No such file or directory', line)
    assert not list(tmp_path.iterdir())


COMMANDS = [
    (policy_build, [str(CASE_STUDY), '--out', '/nowhere'], '_build'),
    (policy_query, [str(SHIPPED), STATE], '_answer'),
]


@pytest.mark.parametrize(('module', 'arguments', 'step'), COMMANDS)
@pytest.mark.parametrize(
    ('error', 'says'),
    [
        (MemoryError(), 'not enough memory. '),
        (MemoryError('60 GiB'), 'not enough memory. 60 GiB'),
        (OSError(28, 'No space left on device', '/tmp/x'), r'/tmp/x: No space left on device'),
        (PermissionError(13, 'Permission denied'), 'Permission denied'),
        (IsADirectoryError(21, 'Is a directory'), 'Is a directory'),
        (ValueError('two\nlines' + 'x' * 10_000), r'two\\nlinesx+ \.\.\. \(10,009 characters\)'),
    ],
    ids=lambda value: str(value)[:20],
)
def test_errors_are_one_line(module, arguments, step, error, says, monkeypatch, capsys):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(module, step, fail)
    with pytest.raises(SystemExit, match=rf'^policy_\w+: {says}$') as ended:
        module.main(arguments)
    assert len(str(ended.value)) < 700
    assert capsys.readouterr() == ('', '')


def test_warnings_are_one_line(tmp_path):
    (tmp_path / 'm.yaml').write_text(yaml.safe_dump(case_study(1, feasibility='seed')))
    arguments = [str(tmp_path / 'm.yaml'), '--out', str(tmp_path / 'p')]
    process = start('policy_build', *arguments)
    _, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 0
    assert errors == (
        f"policy_build: warning: {tmp_path}/m.yaml: feasibility: 'seed' is the old word for "
        "'paper'; please write 'paper'\n"
    )
