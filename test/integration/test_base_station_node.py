"""The base station through its parameter and its topic."""

from __future__ import annotations

import signal

import pytest
from ros_helpers import Ros
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.nodes import qos


def label(message: UInt8MultiArray) -> str:
    return message.layout.dim[0].label


def test_priorities_live(ros: Ros) -> None:
    node = ros.start('nodes.base_station', '--ros-args', '-p', 'priorities:=[0, 2, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    ros.until(lambda: len(heard) >= 3, 'repetition')
    assert {tuple(message.data) for message in heard} == {(0, 2, 1)}
    assert len({label(message) for message in heard}) == 1
    first = label(heard[-1])

    assert ros.set_parameter('base_station', 'priorities', [2, 0, 0]).successful
    ros.until(lambda: list(heard[-1].data) == [2, 0, 0], 'the new priorities')
    second = label(heard[-1])
    assert second not in ('', first)
    # Asking for the same again is a new request: the goal recurs.
    assert ros.set_parameter('base_station', 'priorities', [2, 0, 0]).successful
    ros.until(lambda: label(heard[-1]) not in (first, second), 'a new request id')
    assert node.stop(signal.SIGINT) == 0


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ([2, 0], '2 values, the mission has 3 goals'),
        ([2, 0, 3], 'goal3 is 3, not 0, 1 or 2'),
        ([-1, 0, 0], 'goal1 is -1'),
        ([1.0, 0.0, 0.0], 'INTEGER_ARRAY'),
        ([], 'INTEGER_ARRAY'),
        (None, 'cannot be undeclared'),
    ],
)
def test_bad_priorities_are_refused(ros: Ros, values: list[float] | None, words: str) -> None:
    node = ros.start('nodes.base_station', '--ros-args', '-p', 'priorities:=[0, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    result = ros.set_parameter('base_station', 'priorities', values)
    assert not result.successful
    assert words in result.reason
    count = len(heard)
    ros.until(lambda: len(heard) > count + 1, 'repetition')
    assert list(heard[-1].data) == [0, 0, 1]
    assert len({label(message) for message in heard}) == 1
    assert node.stop() == 0


def test_refuses_to_start_with_one_line(ros: Ros) -> None:
    node = ros.start('nodes.base_station', '--ros-args', '-p', 'priorities:=[1, 2]')
    assert node.wait() == 1
    assert len(node.output.splitlines()) == 1
    assert '2 values, the mission has 3 goals' in node.output


def test_an_achieved_goal_leaves_the_repetition_but_not_the_request(ros: Ros) -> None:
    ros.start('nodes.base_station', '--ros-args', '-p', 'priorities:=[2, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    ros.until(lambda: heard, 'the request')

    def achieved() -> bool:
        ros.publish('goal_completed', String(data='goal1'), qos.EVENT)
        return list(heard[-1].data) == [0, 0, 1]

    ros.until(achieved, 'a repetition without goal1')
    assert len({label(message) for message in heard}) == 1


def test_a_station_without_priorities_asks_for_nothing(ros: Ros) -> None:
    ros.start('nodes.base_station')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    assert ros.set_parameter('base_station', 'priorities', [0, 1, 0]).successful
    ros.until(lambda: heard, 'the request')
    assert {tuple(message.data) for message in heard} == {(0, 1, 0)}


def test_help_names_the_parameters(ros: Ros) -> None:
    node = ros.start('nodes.base_station', '--help')
    assert node.wait() == 0
    assert 'mission' in node.output
    assert 'Repetition rate [Hz]' in node.output
