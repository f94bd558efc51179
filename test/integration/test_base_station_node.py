"""The base station through its parameter and its topic."""

from __future__ import annotations

import random
import signal
from pathlib import Path

import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from ros_helpers import ROOT, NodeProcess, Ros
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


# Stations that are started again


def killed(node: NodeProcess) -> None:
    assert node.stop(signal.SIGKILL) == -signal.SIGKILL


def start(ros: Ros, *parameters: str) -> NodeProcess:
    words = [word for parameter in parameters for word in ('-p', parameter)]
    return ros.start('nodes.base_station', '--ros-args', *words)


def until_heard(ros: Ros, heard: list[UInt8MultiArray], values: list[int]) -> str:
    """Wait for priorities that are published from now on; return their request's id."""
    del heard[:]
    ros.until(lambda: heard and list(heard[-1].data) == values, f'priorities {values}')
    return label(heard[-1])


def until_achieved(ros: Ros, heard: list[UInt8MultiArray], goal: str, values: list[int]) -> None:
    def done() -> bool:
        ros.publish('goal_completed', String(data=goal), qos.EVENT)
        return list(heard[-1].data) == values

    ros.until(done, f'a repetition without {goal}')


def parameter(ros: Ros) -> list[int]:
    request = GetParameters.Request(names=['priorities'])
    values = ros.call('base_station/get_parameters', request, GetParameters).values
    return list(values[0].integer_array_value)


@pytest.mark.parametrize('again', [['priorities:=[2, 0, 1]'], []], ids=['the same', 'none'])
def test_killed_it_repeats_its_request_and_revives_no_goal(ros: Ros, again: list[str]) -> None:
    node = start(ros, 'priorities:=[2, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    first = until_heard(ros, heard, [2, 0, 1])
    for goal, left in ('goal1', [0, 0, 1]), ('goal3', [0, 0, 0]):
        until_achieved(ros, heard, goal, left)
        killed(node)
        node = start(ros, *again)
        assert until_heard(ros, heard, left) == first
        assert {tuple(message.data) for message in heard} == {tuple(left)}
        assert parameter(ros) == [2, 0, 1]
    (line,) = node.lines('goes on')
    assert f'priorities [2, 0, 1], request {first} goes on; achieved: goal1, goal3' in line
    assert 'to ask anew, set the parameter priorities' in line
    assert ros.set_parameter('base_station', 'priorities', [2, 0, 1]).successful
    assert until_heard(ros, heard, [2, 0, 1]) != first


def test_killed_and_given_other_priorities_it_asks_for_these(ros: Ros) -> None:
    node = start(ros, 'priorities:=[2, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    first = until_heard(ros, heard, [2, 0, 1])
    killed(node)
    start(ros, 'priorities:=[0, 0, 1]')
    assert until_heard(ros, heard, [0, 0, 1]) != first


def test_killed_it_does_not_undo_what_was_set_since_its_start(ros: Ros) -> None:
    node = start(ros, 'priorities:=[2, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    until_heard(ros, heard, [2, 0, 1])
    for values in [0, 1, 0], [0, 0, 0]:
        assert ros.set_parameter('base_station', 'priorities', values).successful
        request = until_heard(ros, heard, values)
        killed(node)
        node = start(ros, 'priorities:=[2, 0, 1]')
        assert until_heard(ros, heard, values) == request
        assert parameter(ros) == values


def test_killed_while_it_only_listens_it_asks_for_what_was_set(ros: Ros) -> None:
    node = start(ros, 'listening_time:=60.0')
    assert ros.set_parameter('base_station', 'priorities', [0, 1, 2]).successful
    killed(node)
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    start(ros)
    until_heard(ros, heard, [0, 1, 2])


def test_killed_at_any_moment_it_asks_for_what_it_said_last(ros: Ros) -> None:
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    node = start(ros, 'priorities:=[1, 1, 1]', 'rate:=20.0')
    request = until_heard(ros, heard, [1, 1, 1])
    client = ros.node.create_client(SetParameters, 'base_station/set_parameters')
    for number in range(5):
        values = [2, number % 3, 1]
        message = Parameter('priorities', value=values).to_parameter_msg()
        ros.until(client.service_is_ready)
        answer = client.call_async(SetParameters.Request(parameters=[message]))
        ros.spin(random.uniform(0.0, 0.1))
        killed(node)
        ros.spin(0.2)  # For what is still under way.
        last = label(heard[-1])
        node = start(ros, 'priorities:=[1, 1, 1]', 'rate:=20.0')
        del heard[:]
        ros.until(lambda: heard, 'a request')
        taken = list(heard[-1].data) == values
        assert label(heard[-1]) == last or (last == request and taken)
        assert taken or not answer.done()
        request = label(heard[-1])


def journal(ros: Ros) -> Path:
    return ros.folder / 'uav_mission_manager' / 'state' / 'base_station.journal'


def only_asks_when_asked(ros: Ros, heard: list[UInt8MultiArray]) -> str:
    assert ros.set_parameter('base_station', 'priorities', [0, 1, 0]).successful
    ros.until(lambda: heard, 'the request')
    assert {tuple(message.data) for message in heard} == {(0, 1, 0)}
    return label(heard[-1])


def test_what_cannot_be_believed_asks_for_nothing(ros: Ros) -> None:
    node = start(ros, 'priorities:=[2, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    until_heard(ros, heard, [2, 0, 1])
    killed(node)
    journal(ros).write_bytes(journal(ros).read_bytes().replace(b'2', b'1'))
    del heard[:]
    node = start(ros, 'rate:=20.0')
    assert parameter(ros) == [0, 0, 0]
    (line,) = node.lines('WARN')
    assert f'{journal(ros)}: its last line is damaged; not used' in line
    request = only_asks_when_asked(ros, heard)
    killed(node)
    start(ros)
    assert until_heard(ros, heard, [0, 1, 0]) == request


def test_a_request_of_another_mission_is_not_used(ros: Ros) -> None:
    node = start(ros, 'priorities:=[2, 0, 1]')
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    until_heard(ros, heard, [2, 0, 1])
    killed(node)
    moved = ros.folder / 'moved.yaml'
    text = (ROOT / 'config' / 'case_study.yaml').read_text()
    moved.write_text(text.replace('cell_size: 50', 'cell_size: 51'))
    assert moved.read_text() != text
    del heard[:]
    node = start(ros, f'mission:={moved}', 'rate:=20.0')
    assert parameter(ros) == [0, 0, 0]
    (line,) = node.lines('WARN')
    assert f'{journal(ros)}: of a mission with other goals or another grid; not used' in line
    only_asks_when_asked(ros, heard)


def test_a_place_that_cannot_be_written_is_one_line(ros: Ros) -> None:
    node = start(ros, 'state_dir:=/proc/none')
    assert node.wait() == 1
    (line,) = node.output.splitlines()
    assert 'parameter state_dir: ' in line
    assert '/proc/none' in line
