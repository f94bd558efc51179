"""An executor that rests between two looks at what has arrived."""

from __future__ import annotations

import time

import pytest
from ros_helpers import Ros
from std_msgs.msg import Empty

from uav_mission_manager.nodes import qos, runtime

FLOOD = 50


@pytest.fixture
def rests(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The rests that were taken; none of them takes time."""
    taken: list[float] = []
    monkeypatch.setattr(runtime.time, 'sleep', taken.append)
    return taken


@pytest.fixture
def resting(ros: Ros) -> runtime.RestingExecutor:
    """An executor of the test's own node."""
    executor = runtime.RestingExecutor(30.0, ros.context)
    ros.executor.remove_node(ros.node)
    executor.add_node(ros.node)
    return executor


def spin_until_heard(executor: runtime.RestingExecutor, heard: list[Empty], count: int) -> None:
    end = time.monotonic() + 60.0
    while len(heard) < count:
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=1.0)


def test_rests_before_it_looks(
    ros: Ros, resting: runtime.RestingExecutor, rests: list[float]
) -> None:
    heard = {name: ros.listen(name, Empty, qos.TRACE) for name in ('one', 'other')}
    for name in ('one', 'other', 'one'):
        before = len(rests)
        ros.publish(name, Empty(), qos.TRACE)
        spin_until_heard(resting, heard[name], len(heard[name]) + 1)
        assert len(rests) > before
    assert set(rests) == {30.0}


def test_takes_a_flood_without_rest(
    ros: Ros, resting: runtime.RestingExecutor, rests: list[float]
) -> None:
    heard = ros.listen('flood', Empty, qos.TRACE)
    for _ in range(FLOOD):
        ros.publish('flood', Empty(), qos.TRACE)
    spin_until_heard(resting, heard, FLOOD)
    assert len(rests) < FLOOD / 2
