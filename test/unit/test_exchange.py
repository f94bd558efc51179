"""Commands and their answers, gaps and reboots, on a port in this process."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from test_identity import ARM, GUIDED, QUAD, RTL, THERE, Air

from uav_mission_manager.autopilot.link import MAX_POLL_GAP, AutopilotLink, MavCommand
from uav_mission_manager.autopilot.port import MAX_PORT_READS

FLY = MavCommand(mavlink.MAV_CMD_DO_REPOSITION, (0,) * 7)
SPEED = MavCommand(mavlink.MAV_CMD_DO_CHANGE_SPEED, (1, 5, 0, 0, 0, 0, 0))
MODE = MavCommand(mavlink.MAV_CMD_DO_SET_MODE, (1, 6, 0, 0, 0, 0, 0))
ACCEPTED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED
WARNING, INFO = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_INFO


class Dialogue(Air):
    """A link that is up and stays so."""

    def __init__(self, streams: dict[int, float] | None = None) -> None:
        super().__init__()
        self.link = AutopilotLink(self.port, target_system=7, streams=streams or {})
        self.up()
        self.port.commands()

    def send(self, *commands: MavCommand) -> None:
        self.link.send(commands, self.now)

    def sent(self) -> list[int]:
        return [number for number, _ in self.port.commands()]

    def ack(self, command: MavCommand, result: int = ACCEPTED) -> None:
        self.port.say(mavlink.MAVLink_command_ack_message(command.number, result))
        self.poll()

    def text(self, text: str, severity: int = WARNING, number: int = 0, chunk: int = 0) -> None:
        words = text.encode()
        self.port.say(mavlink.MAVLink_statustext_message(severity, words, number, chunk))
        self.poll()

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.5)):
            self.beat()
            self.poll(0.5)

    def answers(self) -> list[tuple[MavCommand, bool, str]]:
        return [(a.command, a.accepted, a.why) for a in self.link.take_answers()]


def test_each_command_waits_until_the_one_before_is_accepted():
    wire = Dialogue()
    wire.send(FLY, SPEED)
    wire.poll(0.9)
    assert wire.sent() == [FLY.number]
    wire.ack(FLY)
    assert wire.sent() == [SPEED.number]
    assert wire.answers() == [(FLY, True, '')]
    wire.ack(FLY)
    assert wire.answers() == [], 'a second answer to the first is none to the second'
    wire.wait(1.0)
    assert wire.sent() == [SPEED.number], 'repeated'
    wire.ack(SPEED)
    wire.wait(5.0)
    assert (wire.sent(), wire.answers()) == ([], [(SPEED, True, '')])


def test_what_comes_with_an_answer_may_cancel_the_next_command():
    wire = Dialogue()
    wire.send(FLY, SPEED)
    wire.sent()
    wire.port.say(mavlink.MAVLink_command_ack_message(FLY.number, ACCEPTED))
    wire.link.poll(wire.now)
    wire.link.cancel()
    wire.link.repeat(wire.now)
    wire.wait(2.0)
    assert wire.sent() == []


def test_after_a_refusal_the_others_are_not_sent():
    wire = Dialogue()
    wire.send(FLY, SPEED)
    wire.ack(FLY, FAILED)
    wire.wait(5.0)
    assert wire.sent() == [FLY.number]
    assert wire.answers() == [(FLY, False, 'FAILED')]
    assert wire.link.refused == {'DO_REPOSITION': 'FAILED'}


@pytest.mark.parametrize('accepted', [0, 1])
@pytest.mark.parametrize('first', [FLY, SPEED])
def test_a_new_sequence_replaces_the_one_that_its_first_command_is_in(accepted, first):
    wire = Dialogue()
    wire.send(FLY, SPEED)
    for _ in range(accepted):
        wire.ack(FLY)
    wire.sent()
    wire.send(first)
    assert wire.sent() == [first.number]
    wire.ack(first)
    wire.wait(5.0)
    assert wire.sent() == []


def test_sequences_of_other_commands_go_on():
    wire = Dialogue()
    wire.send(FLY, SPEED)
    wire.send(MODE)
    wire.ack(MODE)
    wire.ack(FLY)
    assert wire.sent() == [FLY.number, MODE.number, SPEED.number]
    wire.link.cancel()
    wire.wait(5.0)
    assert (wire.sent(), wire.link.refused) == ([], {})


def test_no_answer_to_three_transmissions():
    wire = Dialogue()
    wire.send(ARM)
    wire.wait(5.0)
    assert wire.sent() == [ARM.number] * 3
    assert wire.answers() == [(ARM, False, 'no answer')]


@pytest.mark.parametrize('told', [1, 30])
def test_in_progress_is_neither_repeated_nor_waited_for_without_end(told):
    wire = Dialogue()
    wire.send(ARM)
    for _ in range(told):
        wire.ack(ARM, mavlink.MAV_RESULT_IN_PROGRESS)
        wire.wait(0.5 if told > 1 else 9.0)
        if wire.link.refused:
            break
    wire.wait(1.5)
    assert wire.sent() == [ARM.number]
    assert wire.answers() == [(ARM, False, 'still in progress after 10 s')]


@pytest.mark.parametrize('in_progress', [True, False])
def test_asked_for_again_meanwhile_it_ends_as_if_asked_once(in_progress):
    wire = Dialogue()
    for _ in range(6):
        wire.send(ARM)
        if in_progress:
            wire.ack(ARM, mavlink.MAV_RESULT_IN_PROGRESS)
        wire.wait(2.0)
        if wire.link.refused:
            break
    why = 'still in progress after 10 s' if in_progress else 'no answer'
    assert wire.answers() == [(ARM, False, why)]
    assert wire.sent() == [ARM.number] * (1 if in_progress else 3)


def test_a_refusal_is_in_the_autopilots_words():
    wire = Dialogue()
    wire.text('GPS Glitch')
    wire.wait(3.0)
    wire.send(ARM)
    wire.text('Arm: Throttle (RC3) is not neutral')
    wire.text('Arm: Throttle (RC3) is not neutral')
    wire.text('EKF3 IMU0 is using GPS', INFO)
    wire.ack(ARM, FAILED)
    why = 'FAILED: Arm: Throttle (RC3) is not neutral'
    assert wire.answers() == [(ARM, False, why)]
    wire.text('Arm: Compass not calibrated', mavlink.MAV_SEVERITY_CRITICAL)
    wire.wait(1.0)
    wire.text('GPS Glitch')
    name = 'COMPONENT_ARM_DISARM'
    assert wire.link.refused == {name: f'{why}; Arm: Compass not calibrated'}
    wire.send(ARM)
    wire.ack(ARM)
    assert wire.link.refused == {}


def test_the_same_words_explain_each_refusal():
    wire = Dialogue()
    for _ in range(3):
        wire.send(ARM)
        wire.text('Arm: Throttle (RC3) is not neutral')
        wire.ack(ARM, FAILED)
        wire.wait(5.0)
    assert {why for _, _, why in wire.answers()} == {'FAILED: Arm: Throttle (RC3) is not neutral'}


def test_words_in_chunks_are_joined_and_bounded():
    wire = Dialogue()
    wire.send(ARM)
    wire.text('a' * 50, number=5)
    wire.text('b' * 50, number=5, chunk=1)
    wire.ack(ARM, mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
    [(_, _, why)] = wire.answers()
    assert why == f'TEMPORARILY REJECTED: {"a" * 50}{"b" * 50}'
    for chunk in range(2, 8):
        wire.text('c' * 50, number=5, chunk=chunk)
        wire.text(f'other {chunk}')
    [later] = wire.link.refused.values()
    assert (later[: len(why)], len(later)) == (why, 200)


def test_an_unknown_result_and_a_foreign_answer():
    wire = Dialogue()
    wire.send(ARM)
    wire.port.say(mavlink.MAVLink_command_ack_message(ARM.number, 0), address=THERE)
    wire.port.say(mavlink.MAVLink_command_ack_message(ARM.number, 0), ids=(7, 2))
    wire.port.say(mavlink.MAVLink_command_ack_message(ARM.number, 0, 0, 0, 255, 190))
    wire.poll()
    assert wire.answers() == []
    wire.ack(ARM, 77)
    assert wire.answers() == [(ARM, False, '77')]


def test_unanswered_streams_are_reported():
    wire = Dialogue({33: 10.0})
    wire.wait(5.0)
    assert wire.link.refused == {'SET_MESSAGE_INTERVAL GLOBAL_POSITION_INT': 'no answer'}
    assert wire.answers() == []
    wire.port.say(mavlink.MAVLink_global_position_int_message(*[0] * 9))
    wire.poll()
    assert wire.link.refused == {}


# After a gap, and a reboot


def test_after_a_gap_what_has_waited_is_thrown_away():
    wire = Dialogue()
    wire.send(ARM)
    wire.sent()
    for _ in range(MAX_PORT_READS + 5):
        wire.beat(mode=RTL)
    wire.now += 20.0
    assert wire.link.poll(wire.now) == []
    assert not wire.link.up
    assert wire.link.poll(wire.now + 0.05) == []
    assert not wire.link.up
    wire.now += 0.1
    wire.port.say(mavlink.MAVLink_extended_sys_state_message(0, 2))
    wire.poll()
    assert not wire.link.up, 'no HEARTBEAT yet'
    wire.send(ARM)
    wire.beat(mode=GUIDED)
    assert wire.modes() == [GUIDED]
    assert wire.link.up
    wire.wait(5.0)
    assert (wire.sent(), wire.answers(), wire.link.refused) == ([], [], {})


def test_what_a_peer_had_to_keep_back_is_thrown_away_too():
    wire = Dialogue()
    wire.port.backlog_time = 1.0  # As of a TCP connection.
    wire.now += 20.0
    for _ in range(9):
        wire.beat(mode=RTL)
        assert wire.poll(0.1) == []
        assert not wire.link.up
    wire.poll(0.2)
    wire.beat()
    assert wire.modes() == [GUIDED]


def test_a_short_pause_is_no_gap():
    wire = Dialogue()
    wire.beat(mode=RTL)
    wire.now += MAX_POLL_GAP - 0.1
    assert wire.modes() == [RTL]
    assert wire.link.up


def test_after_a_gap_the_one_who_was_heard_is_waited_for():
    wire = Dialogue()
    wire.now += 20.0
    wire.poll()
    wire.beat(mode=RTL, address=THERE)
    assert wire.modes() == []
    wire.beat()
    assert wire.modes() == [GUIDED]
    wire.now += 20.0
    wire.poll(3.1)
    wire.beat(mode=RTL, address=THERE)
    assert wire.modes() == [RTL]


def test_a_clock_that_is_set_back_keeps_nothing_alive():
    wire = Dialogue()
    camera = mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID
    wire.beat(*camera, ids=(7, 100))
    wire.poll()
    wire.sent()
    wire.now -= 1000.0
    wire.poll()
    assert not wire.link.up
    wire.beat()
    wire.poll()
    assert wire.link.up
    assert wire.link.component_age(100, wire.now + 4.0) == pytest.approx(4.0, abs=0.2)
    wire.poll(3.2)
    assert not wire.link.up
    assert sum(m.get_type() == 'HEARTBEAT' for m, _ in wire.port.sent) in (3, 4)


def heartbeat(status: int) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_heartbeat_message(QUAD, 3, 81, GUIDED, status, 3)


def position(boot_time: int) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_global_position_int_message(boot_time, *[0] * 8)


BOOT, STANDBY = mavlink.MAV_STATE_BOOT, mavlink.MAV_STATE_STANDBY


@pytest.mark.parametrize(
    ('messages', 'rebooted'),
    [
        ([heartbeat(STANDBY)], 0),
        ([heartbeat(BOOT), heartbeat(BOOT), heartbeat(mavlink.MAV_STATE_UNINIT)], 1),
        ([heartbeat(BOOT), heartbeat(STANDBY), heartbeat(mavlink.MAV_STATE_UNINIT)], 2),
        ([position(90_000), position(89_500), position(90_000)], 0),
        ([position(90_000), position(500), position(1_000)], 1),
        ([position(90_000), heartbeat(BOOT), position(500)], 1),
        ([position(90_000), position(500), heartbeat(BOOT)], 1),
    ],
)
def test_a_reboot_is_noticed_once(messages, rebooted):
    wire = Dialogue()
    seen = 0
    for message in messages:
        wire.port.say(message)
        wire.now += 0.05
        wire.link.poll(wire.now)
        seen += wire.link.rebooted
        assert wire.link.up
    assert seen == rebooted


def test_a_reboot_while_the_link_was_lost_is_noticed():
    wire = Dialogue()
    wire.port.say(position(90_000))
    wire.poll(10.0)
    assert not wire.link.up
    wire.beat()
    wire.port.say(position(9_000))
    wire.now += 0.05
    wire.link.poll(wire.now)
    assert wire.link.rebooted


def test_a_vehicle_that_is_booting_when_first_heard_has_not_rebooted():
    wire = Air()
    wire.port.say(heartbeat(BOOT))
    wire.link.poll(wire.now)
    assert (wire.link.up, wire.link.rebooted) == (True, False)


def test_after_a_reboot_nothing_is_as_before():
    wire = Dialogue({33: 10.0})
    stream = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    wire.port.say(mavlink.MAVLink_command_ack_message(stream, 0))
    for _ in range(20):
        wire.port.say(position(90_000))
        wire.beat()
        wire.poll(0.2)
    wire.sent()
    wire.send(ARM)
    wire.port.say(position(90_100))
    wire.port.say(heartbeat(BOOT))
    wire.now += 0.05
    assert [m.get_type() for m in wire.link.poll(wire.now)] == ['HEARTBEAT'], 'what came before'
    assert wire.link.rebooted
    wire.wait(0.5)
    assert wire.sent() == [ARM.number, stream]
    wire.wait(2.0)
    assert ARM.number not in wire.sent()
