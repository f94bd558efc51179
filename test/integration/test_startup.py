"""How nodes start and end: what cannot start says why in one line, and signals end it at once."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from ros_helpers import (
    CASE_STUDY,
    LIMIT,
    NODES_HERE,
    ROOT,
    NodeProcess,
    Ros,
    free_port,
    ros_domain,
)
from std_msgs.msg import UInt8MultiArray

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.ending import ENDING_SIGNALS

ENDED_TIME = 20.0
"""Seconds that a node has to end after a signal: one, and many more on a machine that is busy."""

Start = Callable[..., NodeProcess]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    processes = []
    with ros_domain() as domain:

        def started(node: str, *arguments: str, **env: str) -> NodeProcess:
            module = f'uav_mission_manager.nodes.{node}'
            processes.append(NodeProcess(domain, tmp_path, module, *arguments, **env))
            return processes[-1]

        yield started
        for process in processes:
            process.kill()


def given(node: str, *parameters: str) -> list[str]:
    words = [word for parameter in parameters for word in ('-p', parameter)]
    return ['--ros-args', '-p', CASE_STUDY[f'nodes.{node}'], *words]


def until(condition: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.002)


# What cannot start


def the_line(process: NodeProcess) -> str:
    assert process.wait() == 1, process.output
    [line] = process.output.splitlines()
    assert len(line) < 600
    assert 'FATAL' in line
    return line


@pytest.mark.parametrize(
    ('node', 'parameter', 'words'),
    [
        ('manager', 'polcy:=x', ('polcy', 'nearest is policy')),
        ('manager', 'use_sim_tme:=true', ('use_sim_tme', 'nearest is use_sim_time')),
        ('mavlink_bridge', 'cruise_sped:=3.0', ('cruise_sped', 'nearest is cruise_speed')),
        ('mavlink_bridge', 'rate:=3.0', ('parameter rate', 'has none of this name')),
        ('base_station', 'priority:=[1, 0, 0]', ('parameter priority:', 'nearest is priorities')),
        ('solver', 'outt:=/tmp', ('outt', 'nearest is out')),
        ('manager', 'use_sim_time:=abc', ('use_sim_time', 'BOOL')),
        ('manager', 'rate:=fast', ('parameter rate', 'DOUBLE')),
        ('manager', 'rate', ("'-p rate'",)),
        ('manager', 'rate:=[1, a]', ('rate:=[1, a]',)),
        ('base_station', 'priorities:=[]', ('parameter priorities', 'empty')),
        ('mavlink_bridge', 'connection:=udpin:127.0.0.1:99999', ('port 99999',)),
        ('manager', 'qos_overrides./odom.subscription.depth:=deep', ('depth', 'INTEGER')),
        ('manager', 'qos_overrides./odom.subscription.reliability:=some', ('reliability', 'some')),
        ('manager', 'policy:=$NO_SUCH_PLACE/set', ('policy', '$NO_SUCH_PLACE is not set')),
        ('solver', 'mission:=~no_such_user/x.yaml', ('mission', '~no_such_user')),
        ('base_station', "mission:=''", ('parameter mission: not given',)),
    ],
)
def test_a_bad_parameter_ends_the_start_in_one_line(
    start: Start, node: str, parameter: str, words: tuple[str, ...]
) -> None:
    line = the_line(start(node, *given(node, parameter)))
    assert [word for word in words if word not in line] == []


def test_an_unknown_quality_of_service_is_refused(start: Start) -> None:
    process = start('manager', *given('manager', 'qos_overrides./odm.subscription.depth:=3'))
    assert process.wait() == 1
    [line] = process.lines('FATAL')
    assert 'the nearest is qos_overrides./odom.subscription.depth' in line
    assert 'Traceback' not in process.output


@pytest.mark.parametrize('node', sorted(set(NODES_HERE) - {'mission_record'}))
def test_there_is_no_silent_mission(start: Start, node: str) -> None:
    assert f'--ros-args -p {CASE_STUDY[f"nodes.{node}"]} ' in the_line(start(node))


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['polcy:=x'], 'unknown arguments: polcy:=x'),
        (['-p', 'policy:=x'], 'unknown arguments: -p policy:=x'),
        (['--ros-args', '--no-such'], '--no-such'),
        (['--ros-args', '--log-level', 'loud'], '--log-level loud'),
        (['--ros-args', '-r', '__ns:=bad ns'], '__ns:=bad ns'),
        (['--ros-args', '--params-file', '/no/such.yaml'], '/no/such.yaml'),
        (['--ros-args', '--params-file', str(ROOT)], str(ROOT)),
        (['--ros-args', '--params-file', str(ROOT / 'LICENSE')], 'LICENSE'),
    ],
)
def test_a_bad_command_line_ends_in_one_line(
    start: Start, arguments: list[str], words: str
) -> None:
    assert words in the_line(start('manager', *arguments))


@pytest.mark.parametrize(
    ('env', 'words'),
    [
        ({'HOME': '', 'ROS_HOME': '', 'ROS_LOG_DIR': ''}, 'none of HOME'),
        ({'ROS_LOG_DIR': '/proc/no_such'}, '/proc/no_such'),
        ({'ROS_DOMAIN_ID': '233'}, "'233' is not one of 0 to 232"),
        ({'ROS_DOMAIN_ID': 'two'}, "'two' is not one of 0 to 232"),
    ],
)
def test_a_bad_environment_ends_in_one_line(start: Start, env: dict[str, str], words: str) -> None:
    assert words in the_line(start('manager', *given('manager'), **env))


def run_python(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-c', code, *arguments],
        cwd=ROOT,
        env=os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )


def test_too_little_memory_is_said_in_one_line() -> None:
    run = run_python(
        'import sys\n'
        'from uav_mission_manager.nodes.runtime import run_node\n'
        'def greedy(): raise MemoryError("for\\n3 GiB")\n'
        'sys.exit(run_node(greedy, (), []))\n'
    )
    assert run.returncode == 1
    [line] = (run.stdout + run.stderr).splitlines()
    assert 'not enough memory. for 3 GiB' in line


@pytest.mark.parametrize('error', ['OSError(28, "No space\\nleft")', 'MemoryError("for 3 GiB")'])
def test_too_little_of_the_machine_in_flight_is_said_in_one_line(error: str) -> None:
    run = run_python(
        'import sys\n'
        'from rclpy.node import Node\n'
        'from uav_mission_manager.nodes.runtime import run_node\n'
        'class Poor(Node):\n'
        '    def __init__(self):\n'
        '        super().__init__("poor")\n'
        '        self.create_timer(0.01, self.fail)\n'
        f'    def fail(self): raise {error}\n'
        'sys.exit(run_node(Poor, (), []))\n'
    )
    assert run.returncode == 1
    [line] = (run.stdout + run.stderr).splitlines()
    assert 'FATAL' in line


def test_without_ros_it_says_so_in_one_line() -> None:
    run = run_python(
        'import sys\n'
        'sys.modules["rclpy"], sys.argv = None, ["/usr/bin/manager"]\n'
        'import uav_mission_manager.nodes\n'
    )
    assert run.returncode == 1
    assert run.stderr.startswith('manager: ROS 2 is not there')
    assert len((run.stdout + run.stderr).splitlines()) == 1


def test_a_params_file_serves_several_nodes(start: Start, tmp_path: Path) -> None:
    """What it gives to others by name is theirs; what it gives to all may not be for this one."""
    file = tmp_path / 'params.yaml'
    everyone = {'mission': 'x.yaml', 'a': {'b': 1}}
    others = {'mavlink_bridge': {'ros__parameters': {'polcy': 'y'}}}
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': everyone}, **others}))
    process = start('manager', *given('manager'), '--params-file', str(file))
    until(lambda: process.lines('[INFO]'), process.output)
    [line] = process.lines('WARN')
    assert 'a.b, mission' in line
    assert process.stop() == 0


@pytest.mark.parametrize('name', ['/**', '/**/manager', 'manager'])
def test_a_misspelling_in_a_params_file_is_refused(
    start: Start, tmp_path: Path, name: str
) -> None:
    file = tmp_path / 'params.yaml'
    file.write_text(yaml.safe_dump({name: {'ros__parameters': {'comand_dwell': 9.0}}}))
    line = the_line(start('manager', *given('manager'), '--params-file', str(file)))
    assert 'the nearest is command_dwell' in line


def test_paths_may_have_variables_and_a_home(ros: Ros, tmp_path: Path) -> None:
    (tmp_path / 'fields').mkdir()
    (tmp_path / 'fields' / 'north.yaml').write_bytes(
        (ROOT / 'config' / 'case_study.yaml').read_bytes()
    )
    home = {'HOME': str(tmp_path), 'PLACE': 'north'}
    ros.start('nodes.base_station', '--ros-args', '-p', 'mission:=~/fields/$PLACE.yaml', **home)
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    assert ros.set_parameter('base_station', 'priorities', [2, 0, 0]).successful
    ros.until(lambda: heard, 'a request')


# Signals


def catches(process: NodeProcess) -> bool:
    """Whether the process no longer dies by any of the signals that end it."""
    try:
        status = Path(f'/proc/{process.process.pid}/status').read_text()
    except OSError:
        return False
    line = next(line for line in status.splitlines() if line.startswith('SigCgt'))
    caught = int(line.split()[1], 16)
    return all(caught >> (number - 1) & 1 for number in ENDING_SIGNALS)


def assert_ends(process: NodeProcess, number: int) -> None:
    process.process.send_signal(number)
    assert process.process.wait(ENDED_TIME) == 0, process.output
    assert 'Traceback' not in process.output
    assert 'Error' not in process.output


SLOW_IMPORT = """
import sys, time
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name.startswith('rclpy.'):
            print('imports', flush=True)
            time.sleep(3600.0)
sys.meta_path.insert(0, Slow())
"""


@pytest.mark.parametrize('number', ENDING_SIGNALS)
def test_a_signal_during_the_imports_ends_it(start: Start, tmp_path: Path, number: int) -> None:
    (tmp_path / 'sitecustomize.py').write_text(SLOW_IMPORT)
    path = os.pathsep.join([str(tmp_path), os.environ.get('PYTHONPATH', '')])
    process = start('manager', *given('manager'), PYTHONPATH=path)
    until(lambda: process.lines('imports'), 'the imports')
    assert_ends(process, number)


@pytest.mark.parametrize('number', ENDING_SIGNALS)
def test_a_signal_at_any_moment_ends_every_node(start: Start, number: int) -> None:
    processes = []
    for place, node in enumerate(NODES_HERE * 2):  # Each alone in its namespace and on its port.
        arguments = given(node)
        if node == 'mavlink_bridge':
            arguments = given(node, f'connection:=udpin:127.0.0.1:{free_port()}')
        if node == 'console':
            arguments = given(node, 'port:=0')
        process = start(node, *arguments, '-r', f'__ns:=/n{place}')
        processes.append((process, random.uniform(0.0, 2.0)))
    began = time.monotonic()
    for process, moment in sorted(processes, key=lambda pair: pair[1]):
        time.sleep(max(0.0, began + moment - time.monotonic()))
        until(lambda process=process: catches(process), 'Python has begun with the node')
        assert_ends(process, number)


def test_what_hangs_is_ended() -> None:
    run = run_python(
        'import os, signal\n'
        'from uav_mission_manager.nodes.ending import ENDING\n'
        'ENDING.watch()\n'
        'ENDING.orderly = True\n'
        'os.kill(os.getpid(), signal.SIGHUP)\n'
        'while True: pass\n'
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, '', '')


def test_nohup_outlives_the_terminal() -> None:
    run = run_python(
        'import os, signal\n'
        'from uav_mission_manager.nodes.ending import ENDING\n'
        'signal.signal(signal.SIGHUP, signal.SIG_IGN)\n'
        'ENDING.watch()\n'
        'os.kill(os.getpid(), signal.SIGHUP)\n'
        'print("lives")\n'
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, 'lives\n', '')
