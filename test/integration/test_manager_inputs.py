"""What the manager hears: latched, stamped, hostile, of several batteries, under wrong clocks."""

from __future__ import annotations

import itertools
import os
import re
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from flights import Flight
from rcl_interfaces.srv import GetParameters
from ros_helpers import NodeProcess, Ros
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.complaints import QUIET_TIME
from uav_mission_manager.nodes.vehicle_inputs import TakenOnce

HUGE = 'x' * 10_000_000
LONGEST_LINE = 600
"""Characters of a log line: 200 of the value, the rest says what is wrong with it."""

MOST_MEMORY = 500
"""MiB: what waits to be taken is in memory, ten messages a topic at most."""


@pytest.fixture
def flight(ros: Ros) -> Flight:
    return Flight(ros)


@pytest.fixture
def manager(flight: Flight) -> NodeProcess:
    process = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    return process


def resident(process: NodeProcess) -> int:
    """Return the resident memory in MiB."""
    pages = Path(f'/proc/{process.process.pid}/statm').read_text().split()[1]
    return int(pages) * os.sysconf('SC_PAGE_SIZE') >> 20


@pytest.mark.parametrize(
    ('stamps', 'again'),
    [
        ([1, 1], [False, True]),
        ([1, 2, 1, 2], [False, False, True, True]),
        # One way is late, and the other one has lost the first.
        ([2, 1, 2, 1], [False, False, False, True]),
        ([1, 2, 2, 3, 3], [False, False, True, False, True]),
    ],
)
def test_a_message_that_comes_twice_is_known_again(stamps, again):
    once = TakenOnce()
    assert [once.again(stamp) for stamp in stamps] == again


def test_a_threat_latched_before_the_start_is_heard(ros: Ros, flight: Flight) -> None:
    detector = ros.node.create_publisher(String, 'threat_level', qos.LATCHED)
    detector.publish(String(data='high'))
    manager = flight.start()
    flight.until_asked([0, 0, 0])
    flight.until_threat_counts(2)
    detector.publish(String(data='none'))
    flight.until_threat_counts(0)
    assert manager.lines('incompatible QoS') == []


def test_priorities_latched_before_the_start_are_heard_once(ros: Ros, flight: Flight) -> None:
    """Taken twice, a request without id would revive a goal achieved in between."""
    station = ros.node.create_publisher(UInt8MultiArray, 'goal_priorities', qos.LATCHED)
    station.publish(UInt8MultiArray(data=[2, 0, 0]))
    flight.start()
    flight.until_command('commit goal1 normal')
    flight.complete('goal1')
    flight.until_goals([0, 0, 0])
    flight.goals.clear()
    ros.spin(3.0)
    assert {tuple(message.data) for message in flight.goals} == {(0, 0, 0)}


def test_a_threat_never_heard_is_said(flight: Flight, manager: NodeProcess) -> None:
    flight.until_diagnosis('inputs', DiagnosticStatus.WARN, 'threat_level: never heard')


def test_a_threat_never_heard_counts_as_the_parameter_says(flight: Flight) -> None:
    flight.start('-p', 'threat_unknown:=high')
    flight.until_asked([0, 0, 0])
    flight.until_threat_counts(2)
    flight.until_threat('none')
    flight.until_threat_counts(0)


def test_an_unknown_threat_level_ends_the_start_in_one_line(flight: Flight) -> None:
    process = flight.start('-p', 'threat_unknown:=medium')
    assert process.wait() == 1
    [line] = process.output.splitlines()
    assert 'threat_unknown' in line


@pytest.mark.parametrize('seconds', [3600, -3600])
@pytest.mark.parametrize('topic', ['odom', 'battery_state'])
def test_a_stamp_counts_on_both_sides(
    ros: Ros, flight: Flight, manager: NodeProcess, topic: str, seconds: int
) -> None:
    flight.stamp_offsets[topic] = 0.0
    flight.until_diagnosis('link', DiagnosticStatus.OK, 'fresh')
    begun = time.monotonic()
    flight.stamp_offsets[topic] = seconds
    flight.until_diagnosis('inputs', DiagnosticStatus.WARN, f'{topic}: stamped')
    flight.until_diagnosis('link', DiagnosticStatus.ERROR, f'link lost: {topic}')
    count = len(flight.commands)
    ros.spin(1.5)
    assert len(flight.commands) == count
    said = len(manager.lines(f'{topic}: stamped'))
    assert said <= 1 + (time.monotonic() - begun) / QUIET_TIME
    flight.commands.clear()
    flight.stamp_offsets[topic] = 0.0
    flight.until_command('commit goal1 normal')


def test_the_worst_of_several_batteries_counts(flight: Flight, manager: NodeProcess) -> None:
    flight.ros.repeat(
        'battery_state', lambda: BatteryState(percentage=0.04, location='tail'), qos.SENSOR
    )
    flight.until_command('recharge')


def test_huge_strings_are_cut_wherever_they_come(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    ros.until(lambda: resident(manager) > 50, 'its memory')
    before = resident(manager)
    sends = {
        'threat_level': lambda: flight.threat(HUGE),
        'fault_mode': lambda: ros.publish('fault_mode', String(data=HUGE), qos.STATE_IN),
        'goal_completed': lambda: flight.complete(HUGE),
        'goal_refused': lambda: flight.refuse(HUGE),
        'policy_set': lambda: ros.publish('policy_set', String(data=HUGE), qos.LATCHED),
        'goal_priorities': lambda: flight.ask([2, 0, 0], HUGE),
    }
    for topic, send in sends.items():

        def heard(topic: str = topic, send=send) -> bool:
            send()
            return any(topic.partition('_')[0] in line for line in manager.lines('WARN'))

        ros.until(heard, topic)
    flight.diagnostics.clear()
    ros.until(lambda: flight.diagnostics, 'diagnostics')
    assert max(map(len, manager.output.splitlines())) < LONGEST_LINE
    statuses = flight.diagnostics[-1].status
    assert sum(len(status.message) for status in statuses) < 3000
    assert resident(manager) < before + MOST_MEMORY
    flight.until_command('commit goal1 normal')


def test_a_flood_of_ever_new_bad_words_is_a_few_lines(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    """As many as the time allows that the flood takes, on whatever machine."""
    before, begun, numbers = len(manager.output.splitlines()), time.monotonic(), itertools.count()

    def left_out() -> int:
        counts = re.findall(r'\(([\d,]+) more like this left out\)', manager.output)
        return sum(int(count.replace(',', '')) for count in counts)

    ros.repeat('fault_mode', lambda: String(data=f'bad {next(numbers)}'), qos.STATE_IN, 0.001)
    ros.until(lambda: left_out() > 1000, 'a flood')
    lines = manager.output.splitlines()[before:]
    said = [line for line in lines if 'bad ' in line]
    assert len(said) <= 1 + (time.monotonic() - begun) / QUIET_TIME
    assert len(lines) < 100


def test_a_policy_set_that_is_a_pipe_holds_up_nothing(
    ros: Ros, flight: Flight, manager: NodeProcess, tmp_path: Path
) -> None:
    (tmp_path / 'set').mkdir()
    os.mkfifo(tmp_path / 'set' / 'manifest.json')
    ros.publish('policy_set', String(data=str(tmp_path / 'set')), qos.LATCHED)
    ros.until(lambda: manager.lines('no regular file'), 'the refusal')
    assert ros.call('manager/reload_policy').success
    flight.until_command('commit goal1 normal')


def test_the_quality_of_service_of_one_topic_is_not_another_one_s(
    ros: Ros, flight: Flight
) -> None:
    """rclpy writes what overrides a topic's profile into the profile that it is given."""
    name = 'qos_overrides./{}.subscription.depth'
    flight.start('-p', f'{name.format("battery_state")}:=7')
    ros.until(lambda: flight.diagnostics, 'the start')
    topics = 'battery_state', 'odom'
    answer = ros.call(
        'manager/get_parameters',
        GetParameters.Request(names=[name.format(topic) for topic in topics]),
        GetParameters,
    )
    assert [value.integer_value for value in answer.values] == [7, 5]


def test_simulated_time_that_jumps_or_stands_is_said(ros: Ros, flight: Flight) -> None:
    """A silent battery counts as lost all the same: time-outs do not run on that clock."""
    clock = Clock()
    clock.clock.sec = 5000

    def tick() -> Clock:
        clock.clock.nanosec += 100_000_000
        clock.clock.sec += clock.clock.nanosec // 10**9
        clock.clock.nanosec %= 10**9
        return clock

    timer = ros.repeat('/clock', tick, qos.RELIABLE, 0.1)
    flight.start('-p', 'use_sim_time:=true')
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.until_diagnosis('clock', DiagnosticStatus.OK, '')

    def go_back() -> None:
        clock.clock.sec -= 5

    # Again and again: the first jump may be over when the manager looks at its clock first.
    jumps = ros.node.create_timer(1.0, go_back)
    flight.until_diagnosis('clock', DiagnosticStatus.WARN, 'the clock jumped by -')
    jumps.cancel()
    flight.until_command('commit goal1 normal')
    timer.cancel()
    flight.until_diagnosis('clock', DiagnosticStatus.WARN, 'the clock stands')
    flight.silent = True
    flight.until_diagnosis('link', DiagnosticStatus.ERROR, 'link lost: battery_state')


def test_without_any_simulated_time_stamps_are_not_believed(ros: Ros, flight: Flight) -> None:
    flight.stamp_offsets['battery_state'] = 0.0
    flight.start('-p', 'use_sim_time:=true')
    flight.until_diagnosis('clock', DiagnosticStatus.WARN, 'the clock stands')
    flight.until_diagnosis('link', DiagnosticStatus.ERROR, 'battery_state never received')
    assert flight.commands == []
