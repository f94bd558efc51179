"""The manager in a process of its own, spoken to through its topics and services only."""

from __future__ import annotations

import math
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from flights import CASE_STUDY, SHIPPED, Flight, request
from ros_helpers import ROOT, NodeProcess, Ros
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String, UInt8MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.nodes import qos


@pytest.fixture
def flight(ros: Ros) -> Flight:
    return Flight(ros)


@pytest.fixture
def manager(ros: Ros, flight: Flight) -> NodeProcess:
    process = flight.start()
    flight.until_asked([0, 0, 0])
    flight.until_threat('none')
    flight.until_command('none normal')
    ros.until(lambda: flight.goals and flight.decisions and flight.markers, 'every topic')
    ros.until(lambda: 'command' in flight.decision(), 'a decision')
    # Else the last diagnosis may be one from before the first inputs.
    flight.until_diagnosis('link', DiagnosticStatus.OK, 'all inputs fresh')
    return process


def test_case_one_through_topics(ros: Ros, flight: Flight, manager: NodeProcess) -> None:
    flight.ask([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.until_goals([2, 0, 0])
    flight.until_target(50.0, -50.0)
    assert flight.poses[-1].header.frame_id == 'map'

    flight.cell = 5
    ros.until(lambda: flight.decision()['state'] == '1 1 1 1 2 0 0 5 1 0 0', 'arrival')
    assert flight.commands[-1].data == 'commit goal1 normal'
    flight.complete('goal1')
    flight.until_command('none normal')
    flight.threat('high')
    flight.until_command('none agile')
    flight.cell = 0
    flight.threat('none')
    flight.until_command('none normal')

    # A repetition of the same request does not send it out again; a new one does.
    flight.ask([2, 0, 0], 'a')
    ros.spin(1.5)
    assert flight.commands[-1].data == 'none normal'
    assert list(flight.goals[-1].data) == [0, 0, 0]
    flight.ask([2, 0, 0], 'b')
    flight.until_command('commit goal1 normal')
    said = 'commit goal1 normal: goal1 has high priority'
    ros.until(lambda: len(manager.lines(said)) == 2, 'both decisions in the log')


def test_a_goal_is_stayed_at_until_it_is_completed(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    """A sensor fault makes completion uncertain; the policy stays, only the mode may change."""
    flight.fault = 'sensor'
    ros.until(lambda: flight.decision()['state'].startswith('2 '), 'the fault')
    flight.ask([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.cell = 5
    ros.until(lambda: flight.decision()['state'] == '2 1 1 1 2 0 0 5 1 0 0', 'arrival')
    arrived = len(flight.commands)
    ros.until(lambda: len(flight.commands) >= arrived + 4, 'repetitions at 1 Hz')
    flight.threat('high')
    flight.until_command('commit goal1 agile')
    changed = len(flight.commands)
    ros.until(lambda: len(flight.commands) >= changed + 2, 'repetitions')
    flight.threat('none')
    flight.until_command('commit goal1 normal')
    on_site = [message.data for message in flight.commands[arrived:]]
    assert {command.rsplit(' ', 1)[0] for command in on_site} == {'commit goal1'}
    flight.complete('goal1')
    ros.until(lambda: not flight.commands[-1].data.startswith('commit'), 'departure')
    flight.until_goals([0, 0, 0])


def test_decision_says_why(ros: Ros, flight: Flight, manager: NodeProcess) -> None:
    flight.ask([0, 1, 2])
    flight.until_goals([0, 1, 2])
    ros.until(lambda: flight.decision()['command'].startswith('commit'), 'a commitment')
    decision = flight.decision()
    values = [float(value) for value in decision['values'].split()]
    assert len(values) == 10
    assert values[int(decision['action']) - 1] == min(values)
    assert float(decision['margin']) >= 0.0
    assert 0.0 < float(decision['lower_bound']) <= min(values) + 1e-3
    assert min(values) - 1e-3 <= float(decision['upper_bound']) <= min(values) + 1e-3
    assert len(decision['policy']) == 64
    assert decision['refused_goals'] == 'none'
    assert 0.0 <= float(decision['age odom [s]']) < 3.0
    assert flight.decisions[-1].status[0].message
    assert flight.decisions[-1].status[0].hardware_id == 'vehicle'
    assert decision['goal3 priority'] == 'high'
    assert float(decision[f'cost of {decision["command"]}']) == pytest.approx(min(values))


def test_markers_show_where_it_is_and_what_it_does(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    flight.ask([2, 0, 0], 'a')
    flight.cell = 5
    flight.until_command('commit goal1 normal')

    def drawn() -> list[Marker]:
        return [marker for array in flight.markers[-1:] for marker in array.markers]

    def shown(space: str) -> Marker:
        return next((marker for marker in drawn() if marker.ns == space), Marker())

    said = 'commit goal1 normal\ngoal1 has high priority'
    ros.until(lambda: shown('command').text.startswith(said), 'the reason')
    ros.until(lambda: shown('vehicle').pose.position.x == 50.0, 'the vehicle in its cell')
    assert shown('vehicle').pose.position.y == -50.0
    ros.until(lambda: {marker.action for marker in drawn()} == {Marker.ADD}, 'nothing deleted')


def test_a_vehicle_in_a_namespace_is_called_by_it_everywhere(ros: Ros) -> None:
    ros.start('nodes.manager', '--ros-args', '-r', '__ns:=/fleet/uav1')
    markers = ros.listen('fleet/uav1/manager/markers', MarkerArray, qos.LATCHED)
    diagnostics = ros.listen('/diagnostics', DiagnosticArray, qos.RELIABLE)
    ros.until(lambda: markers and diagnostics, 'what it says')
    drawn = [marker for marker in markers[-1].markers if marker.action != Marker.DELETEALL]
    assert {marker.ns.rpartition('/')[0] for marker in drawn} == {'fleet/uav1'}
    assert {status.hardware_id for status in diagnostics[-1].status} == {'fleet/uav1'}


def test_fault_and_low_battery_send_it_to_service(flight: Flight, manager: NodeProcess) -> None:
    flight.fault = 'actuator'
    flight.until_command('repair')
    flight.until_target(50.0, 0.0)
    flight.fault, flight.charge = 'nominal', 0.05
    flight.until_command('recharge')
    flight.charge = 1.0
    flight.until_command('none normal')


@pytest.mark.parametrize(
    ('health', 'command'),
    [
        (BatteryState.POWER_SUPPLY_HEALTH_DEAD, 'recharge'),
        (BatteryState.POWER_SUPPLY_HEALTH_UNSPEC_FAILURE, 'recharge'),
        (BatteryState.POWER_SUPPLY_HEALTH_GOOD, 'commit goal1 normal'),
    ],
)
def test_a_battery_that_is_reported_unhealthy_counts_as_empty(
    ros: Ros, flight: Flight, manager: NodeProcess, health: int, command: str
) -> None:
    flight.health = health
    flight.ask([2, 0, 0], 'a')
    flight.until_command(command)
    if command == 'recharge':
        said = 'battery_state: reported unhealthy, counted as empty'
        flight.until_diagnosis('inputs', DiagnosticStatus.WARN, said)
        assert len(manager.lines(said)) == 1
        flight.health = BatteryState.POWER_SUPPLY_HEALTH_GOOD
        flight.until_command('commit goal1 normal')
    ros.until(lambda: 'battery' not in flight.diagnosis('inputs').message, 'no complaint')


def test_a_refused_goal_is_left_until_priorities_are_asked_for_anew(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    flight.ask([2, 1, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.refuse('goal1')
    flight.until_command('commit goal2 normal')
    flight.refuse('goal1')  # The bridge repeats it.
    said = 'goal_refused: goal1, counted as out of range until priorities are asked for anew'
    flight.until_diagnosis('inputs', DiagnosticStatus.WARN, said)
    ros.until(lambda: flight.decision()['refused_goals'] == 'goal1', 'the decision says so')
    assert flight.decision()['state'].split()[1] == '0'
    assert list(flight.goals[-1].data) == [2, 1, 0]
    assert len(manager.lines(said)) == 1
    flight.ask([2, 1, 0], 'a')
    flight.refuse('goal7')
    ros.until(lambda: manager.lines("goal_refused: 'goal7' is not one of"), 'a complaint')
    assert flight.commands[-1].data == 'commit goal2 normal'
    flight.ask([2, 1, 0], 'b')
    flight.until_command('commit goal1 normal')
    ros.until(lambda: flight.decision()['refused_goals'] == 'none', 'no refusal any more')


def test_reset_goals_forgets_refusals(ros: Ros, flight: Flight, manager: NodeProcess) -> None:
    flight.refuse('goal3')
    ros.until(lambda: flight.decision()['state'].split()[3] == '0', 'the refusal')
    assert ros.call('manager/reset_goals').success
    ros.until(lambda: flight.decision()['state'].split()[3] == '1', 'no refusal any more')


def test_a_change_of_mind_waits_and_says_so(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    """A sensor fails in the service cell, just before the vehicle leaves it."""
    flight.ask([2, 0, 1], 'a')
    flight.cell = 1
    ros.until(lambda: flight.decision()['state'] == '1 1 1 1 2 0 1 1 1 0 0', 'arrival')
    flight.fault = 'sensor'
    flight.until_command('repair')
    first = len(flight.commands)
    flight.cell = 2
    ros.until(
        lambda: flight.decisions[-1].status[0].message.startswith('keeps repair for '), 'dwell'
    )
    said = flight.decisions[-1].status[0].message
    assert ' s more; the policy now says commit goal1 normal: goal1 has high priority' in said
    assert flight.decision()['runner_up'] == 'commit goal1 normal'
    flight.until_command('commit goal1 normal')
    kept = [message.data for message in flight.commands[first:-1]]
    assert set(kept) == {'repair'}  # Repeated meanwhile.


def test_a_taken_over_policy_keeps_the_command_that_stands(ros: Ros, flight: Flight) -> None:
    flight.cell, flight.fault = 1, 'sensor'
    process = flight.start('-p', 'command_dwell:=60.0')
    flight.until_asked([2, 0, 1], 'a')
    flight.until_command('repair')
    flight.cell = 2

    def kept() -> bool:
        said = [message.status[0].message for message in flight.decisions]
        return bool(said) and said[-1].startswith('keeps repair for ')

    ros.until(kept, 'dwell')
    ros.publish('policy_set', String(data=str(SHIPPED)), qos.LATCHED)
    ros.until(lambda: process.lines('policy taken over'), 'take-over')
    flight.decisions.clear()
    ros.until(lambda: flight.decisions, 'a decision')
    assert kept()
    assert {message.data for message in flight.commands} == {'repair'}


def test_goal_states_are_repeated_though_nothing_is_decided(ros: Ros, flight: Flight) -> None:
    flight.silent = True
    flight.ros.repeat('goal_priorities', lambda: request([2, 0, 1], 'a'), qos.STATE_IN)
    process = ros.start('nodes.manager')
    ros.until(lambda: flight.goals, 'goal_states')
    ros.until(lambda: process.lines('no command yet: waiting for data'), 'a refusal')
    ros.until(lambda: list(flight.goals[-1].data) == [2, 0, 1], 'what is wanted')
    count = len(flight.goals)
    ros.until(lambda: len(flight.goals) >= count + 3, 'repetition')
    assert flight.commands == []
    assert process.lines('ERROR') == [], 'what was never heard is not lost'


def test_goal_states_come_before_the_command_that_follows_from_them(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    """Else the bridge might start motors for a goal that is not wanted any more."""
    sent: dict[str, int] = {}

    def goals(message: UInt8MultiArray, info: dict[str, int]) -> None:
        sent.setdefault(str(list(message.data)), info['source_timestamp'])

    def command(message: String, info: dict[str, int]) -> None:
        sent.setdefault(message.data, info['source_timestamp'])

    flight.ask([0, 2, 0])
    flight.until_command('commit goal2 normal')
    ros.node.create_subscription(UInt8MultiArray, 'goal_states', goals, qos.LATCHED)
    ros.node.create_subscription(String, 'mission_command', command, qos.LATCHED)
    ros.until(lambda: len(sent) == 2, 'what is latched')
    flight.ask([0, 0, 0])
    ros.until(lambda: len(sent) == 4, 'both anew')
    first, second = sorted(sent, key=sent.__getitem__)[2:]
    assert first == '[0, 0, 0]', second


def test_off_the_grid_nothing_is_commanded_and_it_is_said_once(
    ros: Ros, flight: Flight, manager: NodeProcess
) -> None:
    flight.cell = 400  # Far to the south.
    flight.until_diagnosis('inputs', DiagnosticStatus.WARN, 'm off the grid')
    flight.until_diagnosis('link', DiagnosticStatus.ERROR, 'm off the grid')
    said = len(flight.commands)
    ros.spin(2.0)
    assert len(flight.commands) == said
    # Another kind of silence, before the first inputs, may have been told just before.
    told = 'm off the grid: no command until it is back'
    ros.until(lambda: manager.lines(told), told)
    ros.spin(2.0)
    assert len(manager.lines(told)) == 1
    flight.cell = 0
    flight.until_diagnosis('link', DiagnosticStatus.OK, 'all inputs fresh')


def test_bad_inputs_are_one_line_each_and_change_nothing(
    ros: Ros,
    flight: Flight,
    manager: NodeProcess,
) -> None:
    flight.ask([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    nan, engine = BatteryState(percentage=math.nan), String(data='engine')
    # Repeated until heard: these topics keep the last message only, and lose the first ones.
    for send, complaint in (
        (lambda: ros.publish('battery_state', nan, qos.SENSOR), 'percentage nan is unknown'),
        (lambda: flight.ask([2, 0], 'b'), 'goal_priorities: data has 2 values, not 3'),
        (lambda: ros.publish('fault_mode', engine, qos.STATE_IN), "fault_mode: 'engine' is not"),
        (lambda: flight.threat('extreme'), "threat_level: 'extreme' is not one of"),
        (lambda: flight.complete('goal7'), "goal_completed: 'goal7' is not one of"),
        (lambda: flight.ask([0, 0, 3], 'c'), 'goal_priorities: goal3 is 3, not 0, 1 or 2'),
    ):

        def heard(send: Callable[[], None] = send, complaint: str = complaint) -> list[str]:
            send()
            return manager.lines(complaint)

        ros.until(heard, complaint)
        # Good battery and fault messages come in between, so those two may be news again.
        if complaint[:4] in ('goal', 'thre'):
            assert len(manager.lines(complaint)) == 1
    flight.until_diagnosis('inputs', DiagnosticStatus.WARN, 'threat_level')
    ros.spin(1.0)
    assert flight.commands[-1].data == 'commit goal1 normal'
    assert list(flight.goals[-1].data) == [2, 0, 0]
    assert flight.decision()['state'].startswith('1 1 1 1 2 0 0')
    assert 'Traceback' not in manager.output


def test_unknown_battery_falls_silent_and_recovers(
    ros: Ros,
    flight: Flight,
    manager: NodeProcess,
) -> None:
    flight.charge = math.nan
    flight.until_diagnosis('link', DiagnosticStatus.ERROR, 'link lost: battery_state ')
    assert len(manager.lines('battery_state: percentage nan')) == 1
    flight.charge = 0.9
    flight.until_diagnosis('link', DiagnosticStatus.OK, 'all inputs fresh')


def test_lost_link_means_silence_until_it_is_back(
    ros: Ros,
    flight: Flight,
    manager: NodeProcess,
) -> None:
    before = len(manager.lines('link lost'))  # A slow start may have said so already.
    flight.silent = True
    flight.until_diagnosis('link', DiagnosticStatus.ERROR, 'link lost: battery_state')
    assert 's old, odom ' in flight.diagnosis('link').message
    ros.until(lambda: flight.decisions[-1].status[0].level == DiagnosticStatus.ERROR, 'a refusal')
    said = len(flight.commands), len(flight.poses)
    flight.ask([2, 0, 0], 'a')
    flight.until_goals([2, 0, 0])
    ros.spin(2.5)
    assert (len(flight.commands), len(flight.poses)) == said
    assert len(manager.lines('link lost')) == before + 1
    flight.silent = False
    flight.until_command('commit goal1 normal')
    flight.until_diagnosis('link', DiagnosticStatus.OK, 'all inputs fresh')


def test_command_is_repeated_and_latched(ros: Ros, flight: Flight, manager: NodeProcess) -> None:
    said = len(flight.commands)
    ros.until(lambda: len(flight.commands) >= said + 2, 'repetition')
    late = ros.listen('mission_command', String, qos.LATCHED)
    ros.until(lambda: late, 'the latched command')


def test_reset_goals(ros: Ros, flight: Flight, manager: NodeProcess) -> None:
    flight.ask([2, 1, 0], 'a')
    flight.until_command('commit goal1 normal')
    assert ros.call('manager/reset_goals').success
    flight.until_command('none normal')
    flight.until_goals([0, 0, 0])


def test_policies_are_taken_over_or_refused_in_flight(
    ros: Ros,
    flight: Flight,
    manager: NodeProcess,
    tmp_path: Path,
) -> None:
    before = flight.decision()['policy']
    good, broken, other = tmp_path / 'good', tmp_path / 'broken', tmp_path / 'other'
    build_policy(load_mission(CASE_STUDY), method='split').save(good)
    shutil.copytree(good, broken)
    array = next(broken.glob('*.npy'))
    data = bytearray(array.read_bytes())
    data[-1] ^= 1
    array.write_bytes(data)
    mission = yaml.safe_load(CASE_STUDY.read_text())
    mission['goals'] = mission['goals'][:2]
    (tmp_path / 'other.yaml').write_text(yaml.safe_dump(mission))
    build_policy(load_mission(tmp_path / 'other.yaml')).save(other)

    def announce(path: Path) -> None:
        ros.publish('policy_set', String(data=str(path)), qos.LATCHED)

    for path in broken, other, tmp_path / 'nowhere':
        announce(path)
        ros.until(lambda path=path: manager.lines(f'the old one kept: {path}'), f'{path} refused')
    flight.until_diagnosis('policy', DiagnosticStatus.WARN, 'policy set refused')
    assert flight.decision()['policy'] == before
    announce(good)
    ros.until(lambda: flight.decision()['policy'] != before, 'take-over')
    flight.until_diagnosis('policy', DiagnosticStatus.OK, str(good))
    flight.until_command('none normal')

    shutil.rmtree(good)
    answer = ros.call('manager/reload_policy')
    assert not answer.success
    assert str(good) in answer.message
    build_policy(load_mission(CASE_STUDY)).save(good)
    assert ros.call('manager/reload_policy').success
    ros.until(lambda: flight.decision()['policy'] == before, 'the reloaded policy')
    assert 'Traceback' not in manager.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_stops_cleanly(manager: NodeProcess, number: int) -> None:
    assert manager.stop(number) == 0
    assert 'Traceback' not in manager.output


def test_parameter_file_and_namespace(ros: Ros) -> None:
    process = ros.start(
        'nodes.manager',
        '--ros-args',
        '-r',
        '__ns:=/uav1',
        '--params-file',
        str(ROOT / 'config' / 'nodes.yaml'),
    )
    heard = ros.listen('/uav1/manager/decision', DiagnosticArray, qos.LATCHED)
    ros.until(lambda: heard, 'a decision in the namespace')
    assert process.process.poll() is None


def _without_energy(tmp_path: Path) -> str:
    mission = yaml.safe_load(CASE_STUDY.read_text())
    del mission['energy']
    (tmp_path / 'mission.yaml').write_text(yaml.safe_dump(mission))
    build_policy(load_mission(tmp_path / 'mission.yaml')).save(tmp_path / 'set')
    return f'policy:={tmp_path / "set"}'


@pytest.mark.parametrize(
    ('argument', 'words'),
    [
        ('policy:=/nonexistent', '/nonexistent'),
        ('input_timeout:=.nan', 'parameter input_timeout'),
        ('rate:=1000.0', 'parameter rate'),
        ('command_dwell:=61.0', 'parameter command_dwell'),
        (_without_energy, 'mission case_study: no energy section'),
    ],
)
def test_refuses_to_start_with_one_line(
    ros: Ros,
    tmp_path: Path,
    argument: Any,
    words: str,
) -> None:
    if callable(argument):
        argument = argument(tmp_path)
    process = ros.start('nodes.manager', '--ros-args', '-p', argument)
    assert process.wait() == 1
    assert len(process.output.splitlines()) == 1
    assert words in process.output
