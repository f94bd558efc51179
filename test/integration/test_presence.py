"""One manager and one base station a vehicle: who comes second says so and ends."""

from __future__ import annotations

import signal

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros_helpers import NodeProcess, Ros
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.presence import TIE

ROLES = ('manager', 'base_station')


def start(ros: Ros, role: str, *arguments: str) -> NodeProcess:
    return ros.start(f'nodes.{role}', '--ros-args', *arguments)


def start_second(ros: Ros, role: str, *arguments: str) -> NodeProcess:
    """Start one that listens until it hears the first, however long that takes."""
    return start(ros, role, '-p', 'listening_time:=60.0', *arguments)


def identities(messages: list[String]) -> set[str]:
    """Who has been heard."""
    return {message.data.rpartition(' ')[0] for message in messages}


def longest(messages: list[String]) -> float:
    """For how long [s] somebody has been up who has been heard."""
    return max((float(message.data.rpartition(' ')[2]) for message in messages), default=0.0)


def until_heard_again(ros: Ros, messages: list[String], times: int = 4) -> None:
    count = len(messages)
    ros.until(lambda: len(messages) >= count + times, 'presence')


@pytest.mark.parametrize('role', ROLES)
def test_the_second_one_ends_and_the_first_goes_on(ros: Ros, role: str) -> None:
    heard = ros.listen(f'presence/{role}', String, qos.EVENT)
    first = start(ros, role)
    ros.until(lambda: longest(heard) > TIE, 'the first')
    [name] = identities(heard)

    second = start_second(ros, role)
    assert second.wait() == 1
    [line] = second.lines('FATAL')
    assert f'another {role} is in /: {name}, up for ' in line
    assert 'Traceback' not in second.output
    until_heard_again(ros, heard)
    assert first.process.poll() is None
    assert len(first.lines(f'a second {role} in /')) == 1
    assert first.stop() == 0


@pytest.mark.parametrize('role', ROLES)
def test_of_two_started_at_once_one_goes_on(ros: Ros, role: str) -> None:
    heard = ros.listen(f'presence/{role}', String, qos.EVENT)
    both = [start_second(ros, role), start_second(ros, role)]
    ros.until(lambda: any(one.process.poll() is not None for one in both), 'the end of one')
    heard.clear()
    until_heard_again(ros, heard)
    [code] = [one.process.poll() for one in both if one.process.poll() is not None]
    assert code == 1
    assert len(identities(heard)) == 1


def test_a_second_manager_commands_nothing(ros: Ros) -> None:
    """It does not know the priorities yet, and would turn the vehicle round."""
    heard = ros.listen('presence/manager', String, qos.EVENT)
    goals = ros.listen('goal_states', UInt8MultiArray, qos.LATCHED)
    decisions = ros.listen('manager/decision', DiagnosticArray, qos.LATCHED)
    wanted = UInt8MultiArray(data=[2, 0, 0])
    asking = ros.repeat('goal_priorities', lambda: wanted, qos.STATE_IN)
    start(ros, 'manager')
    ros.until(lambda: goals and list(goals[-1].data) == [2, 0, 0], 'the priorities')
    asking.cancel()
    goals.clear()
    decisions.clear()
    second = start_second(ros, 'manager')
    assert second.wait() == 1
    until_heard_again(ros, heard)
    assert {tuple(message.data) for message in goals} == {(2, 0, 0)}
    assert decisions
    assert second.lines('no command') == []


def test_a_second_base_station_asks_for_nothing(ros: Ros) -> None:
    requests = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    start(ros, 'base_station', '-p', 'priorities:=[2, 0, 0]')
    ros.until(lambda: requests, 'a request')
    second = start_second(ros, 'base_station', '-p', 'priorities:=[0, 0, 1]')
    assert second.wait() == 1
    count = len(requests)
    ros.until(lambda: len(requests) >= count + 2, 'repetition')
    assert {tuple(message.data) for message in requests} == {(2, 0, 0)}


def test_one_that_was_killed_is_nothing_to_the_next(ros: Ros) -> None:
    heard = ros.listen('presence/manager', String, qos.EVENT)
    first = start(ros, 'manager')
    ros.until(lambda: heard, 'the first')
    first.stop(signal.SIGKILL)
    second = start(ros, 'manager')
    [ghost] = identities(heard)
    ros.until(lambda: identities(heard) != {ghost}, 'the second')
    heard.clear()
    until_heard_again(ros, heard, 8)
    assert second.process.poll() is None
    assert second.lines('FATAL') == []


def test_vehicles_in_namespaces_of_their_own_live_side_by_side(ros: Ros) -> None:
    heard = [ros.listen(f'/uav{i}/presence/manager', String, qos.EVENT) for i in (1, 2)]
    both = [start(ros, 'manager', '-r', f'__ns:=/uav{i}') for i in (1, 2)]
    for messages in heard:
        ros.until(lambda messages=messages: len(messages) >= 6, 'presence')
    assert [one.process.poll() for one in both] == [None, None]
    assert [len(identities(messages)) for messages in heard] == [1, 1]


@pytest.mark.parametrize('text', ['', 'manager', 'other nan', 'other inf', 'other 1 day'])
def test_what_is_no_presence_is_said_and_ends_nothing(ros: Ros, text: str) -> None:
    heard = ros.listen('presence/base_station', String, qos.EVENT)
    station = start(ros, 'base_station')
    ros.until(lambda: heard, 'presence')

    def said() -> list[str]:
        ros.publish('presence/base_station', String(data=text), qos.EVENT)
        return station.lines('is not ID UPTIME')

    ros.until(said, 'a warning')
    until_heard_again(ros, heard)
    assert station.process.poll() is None
    assert len(station.lines('is not ID UPTIME')) == 1


def test_an_older_manager_elsewhere_is_given_way_to(ros: Ros) -> None:
    heard = ros.listen('presence/manager', String, qos.EVENT)
    manager = start(ros, 'manager')
    ros.until(lambda: longest(heard) > TIE, 'presence of one that is older than others')

    # Its own name is not another one: nothing but an older stranger ends it.
    def warned() -> list[str]:
        ros.publish('presence/manager', String(data='stranger 0.0'), qos.EVENT)
        return manager.lines('a second manager in /: stranger')

    ros.until(warned, 'a warning')
    ros.publish('presence/manager', String(data='stranger 1e6'), qos.EVENT)
    assert manager.wait() == 1
    assert 'another manager is in /: stranger, up for 1000000.0 s' in manager.output
