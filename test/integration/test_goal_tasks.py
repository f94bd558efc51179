"""Tasks at goals with real processes: pictures, and the node of docs/tasks.md as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from bridge_crew import CASE_STUDY, GOAL1, GOAL2, Chain, crews
from ros_helpers import ROOT, NodeProcess, Ros
from std_msgs.msg import String

from uav_mission_manager.nodes import qos


@pytest.fixture
def chain(ros: Ros):
    yield from crews(Chain, ros)


def mission_with(folder: Path, *tasks: dict[str, object]) -> Path:
    """Write the case study with tasks at its first goals."""
    document = yaml.safe_load(CASE_STUDY.read_text())
    for goal, task in zip(document['goals'], tasks, strict=False):
        goal['task'] = task
    path = folder / 'with_tasks.yaml'
    path.write_text(yaml.safe_dump(document))
    return path


def sampler(ros: Ros, folder: Path, jars: int) -> NodeProcess:
    """Start the node of the documentation."""
    page = (ROOT / 'docs' / 'tasks.md').read_text()
    [code] = re.findall(r'```python\n(.*?)```', page, re.DOTALL)
    assert len(code.splitlines()) < 45
    (folder / 'sampler.py').write_text(code)
    arguments = '--ros-args', '-p', f'jars:={jars}'
    process = NodeProcess(ros.domain, folder, 'sampler', *arguments, PYTHONPATH=str(folder))
    ros.processes.append(process)
    return process


def test_another_node_does_the_work_or_says_why_it_cannot(chain, ros, tmp_path):
    active = ros.listen('goal_active', String, qos.LATCHED)
    external = {'external': {'timeout': 600.0}}
    flight = chain(mission=mission_with(tmp_path, external, external))
    flight.command, flight.pose = 'commit goal1 normal', GOAL1
    flight.until(lambda: active and active[-1].data == 'goal1', 'goal1 active')
    flight.until(lambda: flight.distance(GOAL1) < 5.0, 'over it')
    for key in ('goal_active', 'goal_at_work'):
        flight.until(lambda key=key: flight.value(key) == 'goal1', 'the diagnostics say so')
    node = sampler(ros, tmp_path, jars=1)
    flight.until(lambda: flight.completed, 'goal1 completed')
    flight.until(lambda: active[-1].data == '', 'nobody works any more')
    ros.spin(2.0)
    assert [message.data for message in flight.completed] == ['goal1'], 'said once, by the node'

    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    flight.until(lambda: flight.refused, 'goal2 refused')
    assert {message.data for message in flight.refused} == {'goal2'}
    flight.until(lambda: 'no jar left' in flight.status.message, 'why')
    assert flight.value('goal_refused').endswith('commit goal2 normal: no jar left')
    assert len(flight.bridge.lines('refused: goal2: commit goal2 normal: no jar left')) == 1
    assert active[-1].data == ''
    assert node.process.poll() is None


def test_held_nobody_works_and_what_nobody_waits_for_is_ignored(chain, ros, tmp_path):
    active = ros.listen('goal_active', String, qos.LATCHED)
    flight = chain(mission=mission_with(tmp_path, {'external': {'timeout': 600.0}}))
    flight.command, flight.pose = 'commit goal1 normal', GOAL1
    flight.until(lambda: active and active[-1].data == 'goal1', 'goal1 active')
    assert ros.call('mavlink_bridge/hold').success
    flight.until(lambda: active[-1].data == '', 'held')
    ros.publish('goal_failed', String(data='goal1: too late'), qos.EVENT)
    flight.until(lambda: flight.bridge.lines("nothing waits for 'goal1: too late'"), 'a word')
    assert ros.call('mavlink_bridge/resume').success
    flight.until(lambda: active[-1].data == 'goal1', 'goal1 active again')
    flight.restart_bridge()
    active.clear()
    flight.until(lambda: active and active[-1].data == 'goal1', 'and after a restart')
    assert len(flight.refused) == 0


def test_pictures_are_taken_before_the_goal_is_completed(chain, ros, tmp_path):
    flight = chain(mission=mission_with(tmp_path, {'photo': {'count': 3, 'interval': 0.5}}))
    flight.command, flight.pose = 'commit goal1 normal', GOAL1
    flight.until(lambda: flight.completed, 'goal completed')
    assert [len(flight.bridge.lines(f'; {n} of 3 pictures')) for n in (1, 2)] == [1, 1]
    flight.set('SIM_CAM_REFUSE', 1)
    flight.command, flight.pose = 'none agile', None
    flight.until(lambda: flight.value('command') == 'none agile', 'another command')
    flight.command = 'commit goal1 normal'
    flight.until(lambda: flight.refused, 'goal refused')
    flight.until(lambda: 'no picture: FAILED' in flight.value('goal_refused'), 'why')
    assert len(flight.completed) == 1
