"""The bridge and the simulated autopilot in processes of their own, over DDS and UDP."""

from __future__ import annotations

import math
import signal
import time

import pytest
import yaml
from bridge_crew import ARM, CASE_STUDY, GOAL1, GOAL2, GRID, SERVICE, Chain, Dummy, crews
from diagnostic_msgs.msg import DiagnosticStatus
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from ros_helpers import Ros
from std_msgs.msg import String

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.complaints import QUIET_TIME
from uav_mission_manager.nodes.log_limit import BURST, LINE_PERIOD


@pytest.fixture
def chain(ros: Ros):
    yield from crews(Chain, ros)


@pytest.fixture
def dummy(ros: Ros):
    yield from crews(Dummy, ros)


def test_a_goal_a_weak_motor_a_repair_and_home(chain):
    flight = chain()
    flight.command = 'commit goal1 normal'
    flight.until(lambda: flight.completed, 'goal completed')
    assert flight.distance(GOAL1) < 5.0
    assert flight.height == pytest.approx(20.0, abs=2.0)
    assert flight.faults[-1].data == 'nominal'
    assert 0.5 < flight.batteries[-1].percentage <= 1.0
    assert flight.batteries[-1].current < 0.0
    origin = GRID.origin.to_local(flight.fixes[-1].latitude, flight.fixes[-1].longitude)
    assert math.dist(origin, GOAL1) < 5.0

    flight.set('SIM_ENGINE_MUL', 0.75)
    flight.set('SIM_ENGINE_FAIL', 1)
    flight.until(lambda: flight.faults[-1].data == 'actuator', 'fault mode actuator')
    flight.command = 'repair'
    flight.until_down_at(SERVICE)
    assert flight.faults[-1].data == 'actuator'
    flight.set('SIM_ENGINE_FAIL', 0)
    flight.until(lambda: flight.faults[-1].data == 'nominal', 'repaired')

    flight.command = 'none normal'
    flight.until_down_at(GRID.position(GRID.base))
    flight.until_phase('on the ground')
    assert {message.data for message in flight.completed} == {'goal1'}


def test_a_new_command_retargets_and_agile_is_faster(chain):
    """By itself the autopilot is slow: what is flown faster was commanded, however late."""

    def fastest() -> float:
        speeds = (math.hypot(m.twist.twist.linear.x, m.twist.twist.linear.y) for m in flight.odom)
        return max(speeds, default=0.0)

    flight = chain(goal_dwell=100.0)
    flight.set('WPNAV_SPEED', 200.0)
    flight.command = 'commit goal1 normal'
    flight.until(lambda: fastest() > 4.0, 'cruising at 5 m/s')
    flight.until(lambda: flight.distance(GOAL1) < 30.0, 'nearly there')
    assert fastest() < 6.0
    flight.command = 'commit goal2 agile'
    flight.until(lambda: fastest() > 8.0, 'flying at 10 m/s')
    flight.until(lambda: flight.distance(GOAL2) < 3.0, 'goal2')
    assert fastest() < 11.0
    assert not flight.completed
    flight.command = 'recharge'
    flight.until_down_at(SERVICE)


def test_silence_holds_then_returns_to_launch(chain):
    flight = chain(cruise_speed=2.0)
    flight.command = 'commit goal2 normal'
    flight.until(lambda: flight.odom and flight.distance((0.0, 0.0)) > 30.0, 'under way')
    flight.command = None
    flight.until_phase('holding')
    assert flight.distance((0.0, 0.0)) > 30.0
    assert flight.value('mode') == 'GUIDED'
    flight.until_phase('returning to launch')
    flight.until_down_at((0.0, 0.0))
    assert flight.value('mode') == 'RTL'


def test_a_pilot_takes_over_until_resume(chain, ros):
    flight = chain(cruise_speed=1.0)
    flight.command = 'commit goal2 normal'
    flight.until_phase('en route')
    flight.say(
        mavlink.MAVLink_command_long_message(
            1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 5, 0, 0, 0, 0, 0
        )
    )
    flight.until_phase('pilot in command')
    ros.spin(3.0)
    assert (flight.value('mode'), flight.value('phase')) == ('LOITER', 'pilot in command')
    assert len(flight.bridge.lines('pilot in command: LOITER was not ordered from here')) == 1
    assert not ros.call('mavlink_bridge/hold').success
    assert ros.call('mavlink_bridge/resume').success
    flight.until_phase('en route')


def test_hold_and_resume(chain, ros):
    flight = chain(cruise_speed=1.0)
    flight.command = 'commit goal2 normal'
    flight.until_phase('en route')
    assert ros.call('mavlink_bridge/hold').success
    flight.until_phase('holding')
    assert ros.call('mavlink_bridge/resume').success
    flight.until_phase('en route')


def test_without_autopilot_the_topics_stop_and_come_back(chain, ros):
    flight = chain()
    flight.until(lambda: flight.batteries and flight.odom and flight.faults, 'telemetry')
    flight.simulator.stop(signal.SIGKILL)
    flight.until(lambda: flight.status.level == DiagnosticStatus.ERROR, 'link lost')
    counts = [len(m) for m in (flight.batteries, flight.odom, flight.fixes, flight.faults)]
    ros.spin(3.0)
    assert counts == [len(m) for m in (flight.batteries, flight.odom, flight.fixes, flight.faults)]
    flight.start_simulator()
    flight.until(lambda: len(flight.odom) > counts[1] and len(flight.faults) > counts[3], 'back')


def test_a_bad_command_is_one_line_and_the_last_good_is_kept(chain, ros):
    flight = chain(cruise_speed=1.0)
    flight.command = 'commit goal2 normal'
    flight.until_phase('en route')
    flight.command = 'commit goal9 normal'
    flight.until(lambda: flight.bridge.lines('goal9'), 'a complaint')
    ros.spin(1.0)
    assert flight.value('command') == 'commit goal2 normal'
    assert len(flight.bridge.lines('goal9')) == 1


def test_without_allow_arming_it_stays_on_the_ground(chain, ros):
    flight = chain(allow_arming=False)
    flight.command = 'commit goal1 normal'
    flight.until(lambda: 'allow_arming' in flight.status.message, 'a word about it')
    ros.spin(3.0)
    assert (flight.value('armed'), flight.value('mode')) == ('False', 'STABILIZE')


def test_a_manager_with_another_mission_is_not_obeyed(dummy, ros):
    flight = dummy()
    flight.command, flight.pose = 'commit goal1 normal', GOAL2
    flight.until(lambda: flight.value('command_refused'), 'a refusal')
    ros.spin(2.0)
    assert len(flight.bridge.lines('the manager has another mission; not flown')) == 1
    assert flight.status.level == DiagnosticStatus.WARN
    assert 'the manager has another mission; not flown' in flight.status.message
    assert flight.heard() == set()
    flight.pose = 10000.0, 10000.0
    ros.spin(1.0)
    assert flight.heard() == set()
    flight.pose = GOAL1
    flight.until(lambda: ARM in flight.heard(), 'arming')
    flight.until(lambda: flight.value('command') == flight.command, 'the command')
    flight.pose = GOAL2
    flight.until(lambda: 'the manager is silent' in flight.status.message, 'silence')


def test_a_command_with_its_pose_is_taken_at_once(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    for pose, command in ((GOAL1, 'commit goal1 normal'), (GOAL2, 'commit goal2 normal')):
        flight.pose, flight.command = pose, command
        flight._repeat()
        flight.pose = flight.command = None
        flight.until(lambda command=command: flight.value('command') == command, command)


def test_a_flood_of_texts_and_commands_is_a_few_short_lines(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    begun = time.monotonic()
    for number in range(300):
        flight.say(mavlink.MAVLink_statustext_message(4, f'\x1b[31mflood {number}'.encode()))
        flight.command = f'commit goal{number} {"x" * 100_000}'
        flight._repeat()
        ros.spin(0.01)
    flight.command = 'commit goal1 normal'
    flight.until(lambda: flight.value('command') == flight.command, 'the command')
    lines = flight.bridge.output.splitlines()
    passed = time.monotonic() - begun
    assert 5 < len([line for line in lines if 'flood' in line]) <= BURST + passed / LINE_PERIOD
    assert 0 < len([line for line in lines if 'xxx' in line]) <= 1 + passed / QUIET_TIME
    assert max(map(len, lines)) < 700
    assert '\x1b[31m' not in flight.bridge.output
    assert max(len(value.value) for m in flight.diagnostics for value in m.status[0].values) < 700


def test_far_from_the_mission_it_does_not_arm(dummy, ros):
    flight = dummy()
    flight.latitude += 0.03
    flight.command = 'commit goal1 normal'
    flight.until(lambda: 'is it the right mission file?' in flight.status.message, 'a doubt')
    assert flight.status.level == DiagnosticStatus.WARN
    assert '3.4 km away' in flight.status.message
    assert flight.heard() == set()
    flight.latitude = GRID.origin.latitude + 0.003
    flight.until(lambda: ARM in flight.heard(), 'arming')


@pytest.mark.parametrize('end', ['hold', 'silence'])
def test_what_is_over_is_not_repeated(dummy, ros, end):
    flight = dummy(manager_timeout=1.5)
    flight.command = 'commit goal1 normal'
    flight.until(lambda: ARM in flight.heard(), 'arming')
    if end == 'hold':
        assert ros.call('mavlink_bridge/hold').success
    else:
        flight.command = None
        flight.until(lambda: flight.bridge.lines('the manager is silent'), 'silence')
    flight.heard()
    ros.spin(3.0)
    assert flight.heard() == set()


def test_hold_and_resume_say_so_where_they_can_do_nothing(dummy, ros):
    flight = dummy()
    flight.mute = {'HEARTBEAT'}
    answer = ros.call('mavlink_bridge/resume')
    assert (answer.success, answer.message) == (False, 'no heartbeat of the autopilot')
    answer = ros.call('mavlink_bridge/hold')
    assert not answer.success
    assert 'no heartbeat of the autopilot' in answer.message
    flight.armed, flight.landed = True, 2
    flight.mute = {'GLOBAL_POSITION_INT'}
    flight.until(lambda: 'not heard yet: position' in flight.status.message, 'a word about it')
    assert flight.status.level == DiagnosticStatus.WARN
    answer = ros.call('mavlink_bridge/hold')
    assert not answer.success
    assert 'no position to hold' in answer.message
    assert flight.heard() == set()
    answer = ros.call('mavlink_bridge/resume')
    assert (answer.success, answer.message) == (False, 'not heard yet: position')
    flight.mute = set()
    flight.until(lambda: flight.value('phase') not in ('no link', 'waiting'), 'a position')
    assert ros.call('mavlink_bridge/resume').success


@pytest.mark.parametrize('mute', ['SYS_STATUS', 'GPS_RAW_INT', 'EKF_STATUS_REPORT'])
def test_no_fault_mode_is_made_of_old_values(dummy, ros, mute):
    flight = dummy()
    flight.until(lambda: flight.value('fault_mode') == 'nominal', 'fault mode')
    flight.mute = {mute}
    flight.until(lambda: flight.value('fault_mode') == '', 'no judgement')
    count = len(flight.faults)
    ros.spin(2.0)
    assert len(flight.faults) == count


@pytest.mark.parametrize(
    ('parameter', 'complaint'),
    [
        ('connection:=udpin:127.0.0.1:nowhere', 'udpin:127.0.0.1:nowhere'),
        ('cruise_speed:=.nan', 'cruise_speed'),
        ('cruise_speed:=-1.0', 'cruise_speed'),
        ('mission:=no_such_mission.yaml', 'no_such_mission.yaml'),
    ],
)
def test_what_cannot_start_says_so_in_one_line(ros, parameter, complaint):
    bridge = ros.start('nodes.mavlink_bridge', '--ros-args', '-p', parameter)
    assert bridge.wait() == 1
    assert len(bridge.lines(complaint)) == 1
    assert 'Traceback' not in bridge.output


def test_a_mission_without_origin_cannot_be_flown(ros, tmp_path):
    mission = yaml.safe_load(CASE_STUDY.read_text())
    del mission['grid']['origin']
    path = tmp_path / 'indoors.yaml'
    path.write_text(yaml.safe_dump(mission))
    bridge = ros.start('nodes.mavlink_bridge', '--ros-args', '-p', f'mission:={path}')
    assert bridge.wait() == 1
    [line] = bridge.lines('indoors.yaml')
    assert 'grid.origin is missing' in line


def test_a_command_left_over_by_a_silent_manager_is_ignored(ros: Ros, chain):
    leftover = ros.node.create_publisher(String, 'mission_command', qos.LATCHED)
    leftover.publish(String(data='commit goal1 normal'))
    ros.spin(2.5)
    flight = chain()
    flight.until(lambda: flight.bridge.lines("'commit goal1 normal' ignored"), 'a warning')
    flight.until_phase('on the ground')
    assert not flight.value('command')
