"""A manager that was killed, and the one started after it."""

from __future__ import annotations

import random
import shutil
import signal
from pathlib import Path

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from flights import CASE_STUDY, Flight
from ros_helpers import NodeProcess, Ros
from std_msgs.msg import String

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.nodes import qos


@pytest.fixture
def flight(ros: Ros) -> Flight:
    return Flight(ros)


def killed(process: NodeProcess) -> None:
    assert process.stop(signal.SIGKILL) == -signal.SIGKILL


def journal(folder: Path) -> Path:
    return folder / 'uav_mission_manager' / 'state' / 'manager.journal'


def split_policy(place: Path, discount: float = 0.98) -> str:
    mission = yaml.safe_load(CASE_STUDY.read_text())
    mission['discount'] = discount
    (place.parent / 'mission.yaml').write_text(yaml.safe_dump(mission))
    policy = build_policy(load_mission(place.parent / 'mission.yaml'), method='split')
    policy.save(place)
    return policy.digest


def take_over(flight: Flight, process: NodeProcess, path: Path) -> None:
    flight.ros.publish('policy_set', String(data=str(path)), qos.LATCHED)
    flight.ros.until(lambda: process.lines(f'policy taken over: {path}'), 'take-over')


def test_the_next_one_goes_on_as_before(ros: Ros, flight: Flight) -> None:
    first = flight.start()
    flight.until_asked([2, 1, 0], 'a')
    flight.until_threat('high')
    flight.refuse('goal3')
    ros.until(lambda: flight.decision().get('refused_goals') == 'goal3', 'the refusal')
    settled = 8  # Repetitions at 1 Hz: longer than a command is kept against the policy.
    flight.commands.clear()
    ros.until(
        lambda: (
            len(flight.commands) > settled
            and len({message.data for message in flight.commands[-settled:]}) == 1
        ),
        'a command that stays',
    )
    for _ in range(3):
        command, state = flight.commands[-1].data, flight.decision()['state']
        killed(first)
        flight.commands.clear()
        flight.decisions.clear()
        first = flight.start()
        ros.until(lambda: flight.commands, 'a command')
        assert flight.commands[0].data == command
        ros.until(lambda: 'state' in flight.decision(), 'a decision')
        assert flight.decision()['state'] == state
        assert flight.decision()['refused_goals'] == 'goal3'
        assert list(flight.goals[-1].data) == [2, 1, 0]


def test_what_was_achieved_is_not_asked_for_by_a_repetition(ros: Ros, flight: Flight) -> None:
    first = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.complete('goal1')
    flight.until_goals([0, 0, 0])
    killed(first)
    flight.goals.clear()
    flight.start()
    for _ in range(5):
        flight.ask([2, 0, 0], 'a')
        ros.spin(0.5)
    ros.until(lambda: flight.goals, 'what is wanted')
    assert {tuple(message.data) for message in flight.goals} == {(0, 0, 0)}


def test_killed_at_any_moment_nothing_else_is_commanded(ros: Ros, flight: Flight) -> None:
    flight.cell = 1  # Beside goal 1, where the start of another flight would be another command.
    process = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    flight.commands.clear()
    for _ in range(5):
        ros.spin(random.uniform(0.0, 2.0))
        killed(process)
        count = len(flight.commands)
        process = flight.start()
        ros.until(lambda count=count: len(flight.commands) > count, 'a command')
    assert {message.data for message in flight.commands} == {'commit goal1 normal'}


def test_a_cancellation_while_it_was_dead_is_waited_for(ros: Ros, flight: Flight) -> None:
    first = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    killed(first)
    flight.commands.clear()
    flight.goals.clear()
    flight.start('-p', 'listening_time:=3.0')  # For longer than it takes to be found.
    flight.until_asked([0, 0, 0], 'b')
    flight.until_command('none normal')
    assert {tuple(message.data) for message in flight.goals} == {(0, 0, 0)}
    assert {message.data for message in flight.commands} == {'none normal'}


def test_it_flies_on_by_the_policy_that_was_taken_over(
    ros: Ros, flight: Flight, tmp_path: Path
) -> None:
    first = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    digest = split_policy(tmp_path / 'set')
    take_over(flight, first, tmp_path / 'set')
    ros.until(lambda: flight.decision().get('policy') == digest, 'a decision by it')
    killed(first)
    flight.decisions.clear()
    second = flight.start()
    ros.until(lambda: second.lines(f'policy {tmp_path}/set (split, {digest[:12]})'), 'its start')
    ros.until(lambda: 'policy' in flight.decision(), 'a decision')
    assert flight.decision()['policy'] == digest
    killed(second)

    # Who asks for another one by the parameter gets it.
    shutil.copytree(tmp_path / 'set', tmp_path / 'same')
    third = flight.start('-p', f'policy:={tmp_path}/same')
    ros.until(lambda: third.lines(f'policy {tmp_path}/same'), 'its start')
    assert third.lines('WARN') == []


@pytest.mark.parametrize('fate', ['gone', 'replaced'])
def test_a_policy_that_is_not_there_any_more_is_said(
    ros: Ros, flight: Flight, tmp_path: Path, fate: str
) -> None:
    first = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    digest = split_policy(tmp_path / 'set')
    take_over(flight, first, tmp_path / 'set')
    ros.until(lambda: flight.decision().get('policy') == digest, 'a decision by it')
    killed(first)
    if fate == 'gone':
        shutil.rmtree(tmp_path / 'set')
    else:
        split_policy(tmp_path / 'set', 0.9)
    flight.decisions.clear()
    second = flight.start()
    ros.until(lambda: second.lines('policy set flown by before not found'), 'the news')
    ros.until(lambda: 'state' in flight.decision(), 'a decision')
    assert flight.decision()['policy'] != digest
    assert flight.decision()['command'] == 'commit goal1 normal'


@pytest.mark.parametrize('damage', ['flipped', 'other words', 'other mission'])
def test_a_journal_that_cannot_be_used_is_said_and_nothing_decided_until_asked(
    ros: Ros, flight: Flight, tmp_path: Path, damage: str
) -> None:
    first = flight.start()
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    killed(first)
    words, arguments = 'journal not believed', []
    if damage == 'flipped':
        content = bytearray(journal(tmp_path).read_bytes())
        content[-5] ^= 1
        journal(tmp_path).write_bytes(content)
    elif damage == 'other words':
        journal(tmp_path).write_text('commit goal1\n')
    else:
        mission = yaml.safe_load(CASE_STUDY.read_text())
        mission['goals'][0]['cell'] = 6
        (tmp_path / 'mission.yaml').write_text(yaml.safe_dump(mission))
        build_policy(load_mission(tmp_path / 'mission.yaml'), method='split').save(tmp_path / 's')
        words, arguments = 'journal is of another mission', ['-p', f'policy:={tmp_path}/s']
    before = journal(tmp_path).read_bytes()
    flight.commands.clear()
    second = flight.start(*arguments)
    ros.until(lambda: second.lines(words), 'the news')
    flight.diagnostics.clear()
    flight.until_diagnosis('memory', DiagnosticStatus.WARN, words)
    ros.spin(3.0)
    assert flight.commands == []
    assert journal(tmp_path).read_bytes() == before
    flight.until_asked([2, 0, 0], 'a')
    ros.until(lambda: flight.commands, 'a command')
    flight.until_diagnosis('memory', DiagnosticStatus.OK, '')


def test_nothing_is_written_while_another_one_may_be_there(
    ros: Ros, flight: Flight, tmp_path: Path
) -> None:
    flight.start('-p', 'listening_time:=60.0')
    ros.until(lambda: flight.diagnostics, 'the start')
    for _ in range(10):
        flight.ask([2, 0, 0], 'a')
        ros.spin(0.2)
    assert not journal(tmp_path).exists()


def test_a_journal_that_cannot_be_kept_is_said(ros: Ros, flight: Flight, tmp_path: Path) -> None:
    flight.start('-p', f'state_dir:={tmp_path}/states')
    flight.until_asked([2, 0, 0], 'a')
    flight.until_diagnosis('memory', DiagnosticStatus.OK, '')
    shutil.rmtree(tmp_path / 'states')
    flight.until_asked([0, 0, 0], 'b')
    flight.until_diagnosis('memory', DiagnosticStatus.WARN, 'states')
    flight.until_command('none normal')


def test_a_place_that_takes_no_files_ends_the_start_in_one_line(ros: Ros, tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    process = ros.start('nodes.manager', '--ros-args', '-p', f'state_dir:={tmp_path}/file')
    assert process.wait() == 1
    [line] = process.output.splitlines()
    assert 'parameter state_dir' in line
