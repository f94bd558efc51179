"""Parameters that are set in flight, through ROS's own services."""

from __future__ import annotations

import math

import pytest
from bridge_crew import Chain, crews
from flights import Flight
from rcl_interfaces.srv import DescribeParameters
from ros_helpers import Ros

from uav_mission_manager.nodes import manager, mavlink_bridge

IN_FLIGHT = {
    'manager': (manager, {'input_timeout', 'command_dwell', 'settling_time'}),
    'mavlink_bridge': (
        mavlink_bridge,
        {
            *('cruise_speed', 'agile_speed', 'goal_dwell', 'service_time'),
            *('manager_timeout', 'rtl_delay', 'progress_timeout'),
        },
    ),
}


@pytest.fixture
def chain(ros: Ros):
    yield from crews(Chain, ros)


def test_the_bridge_flies_as_it_is_told_now(chain, ros: Ros) -> None:
    def speed() -> float:
        twist = flight.odom[-1].twist.twist.linear
        return math.hypot(twist.x, twist.y)

    flight = chain(goal_dwell=3600.0, cruise_speed=2.0)
    flight.command = 'commit goal2 normal'  # It is far away: there are seconds to set anything.
    flight.until(lambda: flight.odom and speed() > 1.8, 'cruising at 2 m/s')
    answer = ros.set_parameter('mavlink_bridge', 'cruise_speed', 1.0)
    assert answer.successful, answer.reason
    assert flight.bridge.lines('cruise_speed is 1.0 now')
    flight.until(lambda: speed() < 1.2, 'slower')
    flight.until(lambda: speed() > 0.8, 'as fast as it was told')
    assert ros.set_parameter('mavlink_bridge', 'cruise_speed', 5.0).successful
    flight.until_phase('on site')
    assert ros.set_parameter('mavlink_bridge', 'goal_dwell', 1.0).successful
    flight.until(lambda: flight.completed, 'goal completed')


def test_the_silence_of_the_manager_is_counted_by_the_new_time(chain, ros: Ros) -> None:
    flight = chain(goal_dwell=3600.0, manager_timeout=600.0)
    flight.command = 'commit goal1 normal'
    flight.until_phase('en route')
    flight.command = flight.pose = flight.wanted = None
    assert ros.set_parameter('mavlink_bridge', 'manager_timeout', 1.5).successful
    flight.until_phase('holding')


@pytest.mark.parametrize(
    ('node', 'name', 'value', 'words'),
    [
        ('mavlink_bridge', 'cruise_speed', 60.0, 'Min: 0.1, Max: 50.0'),
        ('mavlink_bridge', 'cruise_speed', math.nan, 'cruise_speed'),
        ('mavlink_bridge', 'cruise_speed', 'fast', "expected 'Type.DOUBLE'"),
        ('mavlink_bridge', 'flight_altitude', 30.0, 'read-only parameter: flight_altitude'),
        ('mavlink_bridge', 'allow_arming', True, 'read-only parameter: allow_arming'),
        ('manager', 'command_dwell', 61.0, 'Min: 0.0, Max: 60.0'),
        ('manager', 'input_timeout', 0.0, 'input_timeout out of range'),
        ('manager', 'range_hysteresis', 0.1, 'read-only parameter: range_hysteresis'),
    ],
)
def test_a_bad_value_is_refused_in_one_line_and_changes_nothing(
    ros: Ros, node: str, name: str, value: object, words: str
) -> None:
    process = ros.start(f'nodes.{node}')
    answer = ros.set_parameter(node, name, value)
    assert not answer.successful
    assert words in answer.reason
    assert '\n' not in answer.reason
    assert process.lines(f'{name} is ') == []


@pytest.mark.parametrize('node', IN_FLIGHT)
def test_what_can_be_set_in_flight_is_said(ros: Ros, node: str) -> None:
    ros.start(f'nodes.{node}')
    module, names = IN_FLIGHT[node]
    asked = [row.name for row in module.PARAMETERS]
    service = f'{node}/describe_parameters'
    answer = ros.call(service, DescribeParameters.Request(names=asked), DescribeParameters)
    assert {row.name for row in answer.descriptors if not row.read_only} == names


def test_the_manager_waits_as_long_as_it_is_told_now(ros: Ros) -> None:
    flight = Flight(ros)
    flight.cell, flight.fault = 1, 'sensor'
    process = flight.start('-p', 'command_dwell:=60.0')
    flight.until_asked([2, 0, 1], 'a')
    flight.until_command('repair')
    flight.cell = 2
    ros.until(
        lambda: (
            flight.decisions
            and flight.decisions[-1].status[0].message.startswith('keeps repair for ')
        ),
        'dwell',
    )
    assert ros.set_parameter('manager', 'command_dwell', 0.0).successful
    flight.until_command('commit goal1 normal')
    assert process.lines('command_dwell is 0.0 now')


def test_the_manager_misses_its_inputs_after_the_time_it_is_told_now(ros: Ros) -> None:
    flight = Flight(ros)
    flight.start('-p', 'input_timeout:=60.0')
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.silent = True
    ros.until(lambda: float(flight.decision().get('age odom [s]', 0.0)) > 4.0, 'old inputs')
    assert flight.decision()['command'] == 'commit goal1 normal'
    assert ros.set_parameter('manager', 'input_timeout', 3.0).successful
    ros.until(lambda: 'link lost' in flight.decisions[-1].status[0].message, 'silence')
