"""The whole chain as the demo runs it: base station, manager, bridge, simulated autopilot."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import pytest
from ros_helpers import ROOT, ros_domain

LIMIT = 600
ON_SITE = '1 1 2 5 1 0 0'
"""Case I's state in cell 5, committed to goal 1, which has high priority."""


class Demo:
    """`demo` as a process whose lines are read as they come."""

    def __init__(self, logs: Path, domain: int, *arguments: str) -> None:
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(domain),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        }
        self.logs = logs
        self.process = subprocess.Popen(
            [
                *(sys.executable, '-m', 'uav_mission_manager.cli.demo'),
                *('--logs', str(logs), *arguments),
            ],
            cwd=ROOT,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self.lines: list[str] = []

    def until(self, text: str) -> str:
        """Read on to a line with `text` and return it."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            if text in line:
                return line
        raise AssertionError(f'no {text!r} in\n' + '\n'.join(self.lines))

    def finish(self) -> int:
        """Read to the end and return the exit code."""
        assert self.process.stdout is not None
        self.lines += [line.rstrip() for line in self.process.stdout]
        return self.process.wait(LIMIT)

    def pids(self) -> dict[str, int]:
        """Process ids of the chain by name."""
        line = self.until('* pids ')
        return {name: int(pid) for name, pid in re.findall(r'(\w+) (\d+)', line.split('pids')[1])}

    @property
    def text(self) -> str:
        return '\n'.join(self.lines)


@contextmanager
def started(folder: Path, *arguments: str) -> Iterator[Demo]:
    """Start the demo, and end it where the test has not."""
    with ros_domain() as domain:
        demo = Demo(folder / 'logs', domain, *arguments)
        yield demo
        if demo.process.poll() is None:
            demo.process.terminate()
            demo.process.wait(LIMIT)


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Demo]:
    """The demo alone; its page has tests of its own."""
    with started(tmp_path, '--no-page') as demo:
        yield demo


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def assert_replays(
    logs: Path, mission: str, commands: set[str], policy_set: Path | None = None
) -> None:
    """What was recorded is decided anew bit for bit, with these commands in it."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    bag, policy = str(logs / 'bags' / mission), str(policy_set or logs / mission / 'policy')
    module = 'uav_mission_manager.cli.mission_replay'
    done = subprocess.run(
        [sys.executable, '-m', module, bag, '--policy', policy, '--json'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=True,
    )
    answer = json.loads(done.stdout)
    assert answer['decisions'] == answer['identical'] > 100
    assert (answer['gaps'], answer['not_replayed'], answer['manager_starts']) == (0, 0, 1)
    assert answer['flown_by'] == [answer['policy']['digest']]
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kind = 'diagnostic_msgs/msg/DiagnosticArray'
    with rosbag2.Reader(bag) as reader:
        [decisions] = (c for c in reader.connections if c.topic.endswith('/manager/decision'))
        told = [store.deserialize_cdr(m, kind) for _, _, m in reader.messages([decisions])]
    values = [pair for each in told for pair in each.status[0].values]
    assert commands <= {pair.value for pair in values if pair.key == 'command'}


def test_both_missions_end_with_every_goal_achieved_and_the_vehicle_home(demo):
    assert demo.finish() == 0, demo.text
    assert 'Case I: one goal: 1 of 1 goals achieved, vehicle home and disarmed' in demo.text
    assert 'Three goals: 3 of 3 goals achieved, vehicle home and disarmed' in demo.text
    for happening in (
        'no goal is wanted, threat high',  # The reason of `none agile` ..
        'goal2 has high priority, threat high',  # .. and of `commit goal2 agile`.
        'fault mode actuator; expected cost',
        'out of range: goal1',
    ):
        assert happening in demo.text, demo.text
    assert_replays(demo.logs, 'case_one', {'none normal', 'commit goal1 normal', 'none agile'})
    assert_replays(demo.logs, 'case_study', {'commit goal2 agile', 'repair', 'recharge'})


def test_without_manager_the_bridge_holds_then_returns_to_launch(demo):
    pids = demo.pids()
    demo.until(ON_SITE)
    os.kill(pids['manager'], signal.SIGKILL)
    demo.until('bridge: holding')
    demo.until('bridge: returning to launch')
    demo.until('the vehicle is home and disarmed')
    assert demo.finish() == 1
    assert 'manager (exit code -9) ended' in demo.text


def test_without_autopilot_the_manager_reports_the_lost_link_and_falls_silent(demo):
    """Without a recorder it flies on."""
    pids = demo.pids()
    if 'mission_record' in pids:
        os.kill(pids['mission_record'], signal.SIGKILL)
        demo.until('no longer recorded')
    demo.until(ON_SITE)
    os.kill(pids['sim_autopilot'], signal.SIGKILL)
    demo.until('(silent)')
    assert demo.finish() == 1
    after = demo.text.split('(silent)')[1]
    assert 'link lost' in after
    assert 'commit' not in after


def test_ctrl_c_ends_everything_that_was_started(demo):
    pids = demo.pids()
    demo.until('none normal')
    demo.process.send_signal(signal.SIGINT)
    assert demo.finish() == 130, demo.text
    assert not [name for name, pid in pids.items() if alive(pid)]


def test_each_goal_of_a_policy_sets_mission_is_flown_once(tmp_path):
    own = '--policy', 'policies/case_study', '--speedup', '16'
    with started(tmp_path, *own) as demo:
        demo.until('The flights on a page: http')
        assert demo.finish() == 0, demo.text
        assert 'Mission case_study: 3 of 3 goals achieved, vehicle home and disarmed' in demo.text
        assert demo.text.count('* base station: goal1 high, goal2 high, goal3 high') == 1
        for goal in ('goal1', 'goal2', 'goal3'):
            assert demo.text.count(f'* vehicle: {goal} completed') == 1


def test_the_page_is_served_and_ends_with_the_demo(tmp_path):
    with started(tmp_path) as demo:
        address = demo.until('The flights on a page: ').split()[-1]
        demo.until('* pids ')
        with urlopen(address, timeout=LIMIT) as page:
            assert page.status == 200
        demo.process.send_signal(signal.SIGINT)
        assert demo.finish() == 130
        with pytest.raises(URLError):
            urlopen(address, timeout=5)


def test_without_what_the_page_needs_the_demo_says_so_and_flies(tmp_path, monkeypatch):
    blocked = tmp_path / 'blocked'
    blocked.mkdir()
    (blocked / 'sitecustomize.py').write_text(
        'import sys\n'
        'class Missing:\n'
        '    def find_spec(self, name, path=None, target=None):\n'
        "        if name == 'nicegui':\n"
        '            raise ModuleNotFoundError(name)\n'
        'sys.meta_path.insert(0, Missing())\n'
    )
    monkeypatch.setenv('PYTHONPATH', f'{blocked}{os.pathsep}{ROOT}')
    with started(tmp_path) as demo:
        line = demo.until('No page: ')
        assert "pip install '.[page]'" in line
        demo.until('* pids ')
