"""The bridge killed and started again, as its supervisor does, and what it then knows."""

from __future__ import annotations

import shutil
import signal

import pytest
from bridge_crew import ARM, GOAL2, SERVICE, Chain, Dummy, crews
from diagnostic_msgs.msg import DiagnosticStatus
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from ros_helpers import Ros

LAND = 9


@pytest.fixture
def chain(ros: Ros):
    yield from crews(Chain, ros)


@pytest.fixture
def dummy(ros: Ros):
    yield from crews(Dummy, ros)


@pytest.mark.parametrize('number', [signal.SIGKILL, signal.SIGTERM])
def test_held_on_the_ground_it_stays_until_resume(dummy, ros, number):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    flight.until(lambda: ros.call('mavlink_bridge/hold').success, 'hold')
    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    flight.restart_bridge(number)
    flight.until_phase('holding')
    flight.until(lambda: flight.value('command') == flight.command, 'the command')
    ros.spin(5.0)
    assert flight.heard() == set()
    assert ros.call('mavlink_bridge/resume').success
    flight.until(lambda: ARM in flight.heard(), 'arming')


def test_a_pilot_who_landed_it_has_it_until_resume(chain, ros):
    flight = chain(cruise_speed=1.0)
    flight.command = 'commit goal2 normal'
    flight.until_phase('en route')
    flight.say(
        mavlink.MAVLink_command_long_message(
            1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, LAND, 0, 0, 0, 0, 0
        )
    )
    flight.until_phase('pilot in command')
    flight.restart_bridge()
    flight.until_phase('pilot in command')
    flight.until(lambda: flight.value('armed') == 'False', 'landed')
    flight.restart_bridge()
    flight.until_phase('pilot in command')
    ros.spin(5.0)
    assert (flight.value('armed'), flight.value('mode')) == ('False', 'LAND')
    assert ros.call('mavlink_bridge/resume').success
    flight.until_phase('en route')


def test_a_broken_motor_is_broken_until_it_is_repaired(chain, ros):
    flight = chain()
    flight.command = 'commit goal1 normal'
    flight.until_phase('en route')
    flight.set('SIM_ENGINE_MUL', 0.75)
    flight.set('SIM_ENGINE_FAIL', 1)
    flight.until(lambda: flight.faults[-1].data == 'actuator', 'fault mode actuator')
    flight.command = 'repair'
    flight.until_down_at(SERVICE)
    flight.faults.clear()
    flight.command = None
    flight.restart_bridge()
    flight.until(lambda: len(flight.faults) > 3, 'a fault mode')
    assert {message.data for message in flight.faults} == {'actuator'}
    flight.command = 'repair'
    flight.until(lambda: flight.faults[-1].data == 'nominal', 'repaired')


def test_a_journal_that_cannot_be_believed_is_told_and_it_stays_on_the_ground(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    [journal] = ros.folder.rglob('mavlink_bridge.journal')
    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    flight.bridge.stop(signal.SIGKILL)
    journal.write_bytes(journal.read_bytes().replace(b'held', b'Held'))
    flight.heard()
    flight.restart_bridge()
    flight.until_phase('holding')
    assert 'damaged' in flight.status.message
    ros.spin(5.0)
    assert flight.heard() == set()
    assert len(flight.bridge.lines('what was before is not known')) >= 1
    flight.restart_bridge()
    flight.until_phase('holding')
    assert ros.call('mavlink_bridge/resume').success
    flight.until(lambda: ARM in flight.heard(), 'arming')


def test_a_journal_of_another_mission_is_still_about_this_vehicle(dummy, ros, tmp_path):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    assert ros.call('mavlink_bridge/hold').success
    flight.change_goals(tmp_path)
    flight.restart_bridge()
    flight.until_phase('holding')
    assert flight.bridge.lines('goes on from its journal of another mission')


def test_a_journal_that_is_gone_is_told(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    [journal] = ros.folder.rglob('mavlink_bridge.journal')
    shutil.rmtree(journal.parent)
    assert ros.call('mavlink_bridge/hold').success
    flight.until(lambda: 'mavlink_bridge.journal: not' in flight.status.message, 'a word about it')
    assert flight.status.level == DiagnosticStatus.WARN


def test_a_place_where_no_journal_can_be_is_refused_in_one_line(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    [journal] = ros.folder.rglob('mavlink_bridge.journal')
    flight.bridge.stop()
    journal.unlink()
    journal.mkdir()
    bridge = flight.start_bridge()
    assert bridge.wait() == 1
    assert len(bridge.lines('state_dir')) == 1
