"""The solver through its service, and the way of a policy set to the manager."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from ros_helpers import ROOT, Ros
from std_msgs.msg import String

from uav_mission_manager import load_policy
from uav_mission_manager.nodes import qos


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
    decisions = ros.listen('manager/decision', DiagnosticArray, qos.LATCHED)
    ros.until(lambda: decisions, 'a decision or refusal')
    digests = {pair.key: pair.value for pair in decisions[-1].status[0].values}
    assert digests['policy'] == load_policy(path).digest

    assert ros.set_parameter('solver', 'method', 'exact').successful
    assert ros.call('solver/build').success
    ros.until(lambda: manager.lines(f'policy taken over: {path} (exact'), 'second take-over')
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
