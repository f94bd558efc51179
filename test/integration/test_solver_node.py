"""The solver through its service, and the way of a policy set to the manager."""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from ros_helpers import ROOT, NodeProcess, Ros
from std_msgs.msg import String
from std_srvs.srv import Trigger

from uav_mission_manager import load_policy
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.ending import ENDING_SIGNALS

ENDED_TIME = 20.0
"""Seconds that a node has to end after a signal: one, and many more on a machine that is busy."""


def test_builds_announces_and_the_manager_takes_over(ros: Ros, tmp_path: Path) -> None:
    solver = ros.start('nodes.solver', '--ros-args', '-p', 'method:=split')
    answer = ros.call('solver/build')
    assert answer.success
    path = tmp_path / 'uav_mission_manager' / 'case_study'
    assert answer.message.startswith(f'{path}: case_study, split, ')
    assert load_policy(path).method == 'split'
    late = ros.listen('policy_set', String, qos.LATCHED)
    ros.until(lambda: late, 'the announcement')
    assert late[-1].data == str(path)

    # The manager starts after the build and still hears of it.
    manager = ros.start('nodes.manager')
    ros.until(lambda: manager.lines(f'policy taken over: {path} (split'), 'take-over')
    worse = 'the mean gap over all states is certified worse, not known for 0.00%'
    ros.until(lambda: manager.lines(worse), 'a warning')
    decisions = ros.listen('manager/decision', DiagnosticArray, qos.LATCHED)
    ros.until(lambda: decisions, 'a decision or refusal')
    digests = {pair.key: pair.value for pair in decisions[-1].status[0].values}
    assert digests['policy'] == load_policy(path).digest

    assert ros.set_parameter('solver', 'method', 'exact').successful
    assert ros.call('solver/build').success
    ros.until(lambda: manager.lines(f'policy taken over: {path} (exact'), 'second take-over')
    assert len(manager.lines('certified worse')) == 1
    assert solver.stop(signal.SIGTERM) == 0
    assert manager.stop(signal.SIGINT) == 0


@pytest.mark.parametrize(
    ('field', 'words'),
    [
        ('mission', 'priority_transition'),
        ('method', 'guess'),
        ('out', 'no policy set'),
    ],
)
def test_failed_build_announces_nothing(
    ros: Ros,
    tmp_path: Path,
    field: str,
    words: str,
) -> None:
    mission = yaml.safe_load((ROOT / 'config' / 'case_study.yaml').read_text())
    mission['priority_transition'][0] = [0.8, 0.05, 0.05]
    (tmp_path / 'bad.yaml').write_text(yaml.safe_dump(mission))
    value = {'mission': str(tmp_path / 'bad.yaml'), 'method': 'guess', 'out': str(tmp_path)}[field]
    solver = ros.start('nodes.solver', '--ros-args', '-p', f'{field}:={value}')
    heard = ros.listen('policy_set', String, qos.LATCHED)
    answer = ros.call('solver/build')
    assert not answer.success
    assert words in answer.message
    assert '\n' not in answer.message
    ros.spin(1.0)
    assert not heard
    assert len(solver.lines('no policy set built')) == 1
    assert solver.stop(signal.SIGINT) == 0


@pytest.fixture
def build(ros: Ros, tmp_path: Path) -> Callable[[], NodeProcess]:
    """Start a build of a minute or more."""

    def started() -> NodeProcess:
        mission = yaml.safe_load((ROOT / 'config' / 'case_study.yaml').read_text())
        mission['goals'] += [{**mission['goals'][0], 'name': f'more{n}'} for n in range(4)]
        (tmp_path / 'large.yaml').write_text(yaml.safe_dump(mission))
        (tmp_path / 'sets').mkdir()
        given = f'mission:={tmp_path}/large.yaml', f'out:={tmp_path}/sets/set', 'method:=exact'
        words = [word for parameter in given for word in ('-p', parameter)]
        solver = ros.start('nodes.solver', '--ros-args', *words)
        client = ros.node.create_client(Trigger, 'solver/build')
        ros.until(client.service_is_ready, 'the solver')
        client.call_async(Trigger.Request())
        ros.until(lambda: solver.lines('building'), 'the build')
        ros.until(lambda: children(solver), 'its process')
        return solver

    return started


def children(node: NodeProcess) -> list[str]:
    tasks = Path(f'/proc/{node.process.pid}/task').glob('*/children')
    return [child for task in tasks for child in task.read_text().split()]


def until_gone(ros: Ros, processes: list[str]) -> None:
    ros.until(lambda: not any(Path(f'/proc/{p}/exe').exists() for p in processes), 'its end')


def test_a_build_holds_up_nothing_and_a_second_one_is_refused(ros: Ros, build) -> None:
    build()
    for _ in range(2):
        answer = ros.call('solver/build')
        assert not answer.success
        assert 'large.yaml is being built; call again when it is done' in answer.message


@pytest.mark.parametrize('number', [*ENDING_SIGNALS, signal.SIGKILL])
def test_a_build_ends_with_its_solver_and_leaves_nothing(
    ros: Ros, build, tmp_path: Path, number: int
) -> None:
    solver = build()
    processes = children(solver)
    ros.spin(random.uniform(0.0, 1.0))
    solver.process.send_signal(number)
    code = solver.process.wait(ENDED_TIME)
    assert code == (-number if number == signal.SIGKILL else 0), solver.output
    until_gone(ros, processes)
    assert list((tmp_path / 'sets').iterdir()) == []
    assert 'Traceback' not in solver.output


def test_a_build_that_is_killed_is_said_and_another_may_follow(ros: Ros, build) -> None:
    solver = build()
    for count in (1, 2):
        [child] = ros.until(lambda: children(solver), 'the build')
        os.kill(int(child), signal.SIGKILL)
        ros.until(lambda count=count: len(solver.lines('ended by SIGKILL')) == count, 'the news')
        client = ros.node.create_client(Trigger, 'solver/build')
        ros.until(client.service_is_ready, 'the solver')
        client.call_async(Trigger.Request())
