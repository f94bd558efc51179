"""The link against a scripted peer, over real UDP; only the time is made up."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Iterator

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.link import AutopilotLink, MavCommand
from uav_mission_manager.autopilot.vehicle import Arm, FlightMode, Fly, SetMode, TakeOff, commands

ARM = MavCommand(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1, 0, 0, 0, 0, 0, 0))
TAKE_OFF = MavCommand(mavlink.MAV_CMD_NAV_TAKEOFF, (0, 0, 0, 0, 0, 0, 20.0))
RATES = {33: 10.0, 1: 2.0}
STREAM = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class Peer:
    """An autopilot's end of the wire, saying and answering only what a test has it say."""

    def __init__(self, port: int, system: int = 7, component: int = 1) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(('127.0.0.1', port))
        self._socket.settimeout(0.2)
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def say(self, message, component: int | None = None) -> None:
        if component is not None:
            self._mav.srcComponent = component
        self._socket.send(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256

    def beat(
        self,
        component: int = 1,
        autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        kind: int = mavlink.MAV_TYPE_QUADROTOR,
    ) -> None:
        self.say(mavlink.MAVLink_heartbeat_message(kind, autopilot, 81, 4, 3, 3), component)

    def ack(self, command: int, result: int = 0, target: tuple[int, int] = (1, 191)) -> None:
        self.say(mavlink.MAVLink_command_ack_message(command, result, 0, 0, *target), 1)

    def raw(self, data: bytes) -> None:
        self._socket.send(data)

    def heard(self) -> list:
        """All that has arrived; a datagram on the loopback is there once it was sent."""
        messages = []
        self._socket.setblocking(False)
        try:
            while True:
                data = self._socket.recv(2048)
                assert data[0] == mavlink.PROTOCOL_MARKER_V2
                messages += self._mav.parse_buffer(data) or []
        except BlockingIOError:
            return messages

    def commands(self) -> list:
        return [m for m in self.heard() if m.get_type() in ('COMMAND_LONG', 'COMMAND_INT')]

    def close(self) -> None:
        self._socket.close()


class Wire:
    """A link, its peer and the time."""

    def __init__(self, target: int = 7, streams: dict[int, float] | None = None) -> None:
        port = free_port()
        self.link = AutopilotLink(
            f'udpin:127.0.0.1:{port}', target_system=target, streams=streams or {}
        )
        self.port, self.peers, self.now = port, [], 50.0
        self.peer = self.connect()

    def connect(self, **ids: int) -> Peer:
        self.peers.append(Peer(self.port, **ids))
        return self.peers[-1]

    def poll(self, seconds: float = 0.05) -> list:
        """Poll for some time, twice a second."""
        messages, end = [], self.now + seconds
        while True:
            self.now = min(self.now + 0.5, end)
            messages += self.link.poll(self.now)
            self.link.repeat(self.now)
            if self.now == end:
                return messages

    def until(self, condition: Callable[[], object]) -> None:
        """Poll in real time: for what the kernel has still to deliver."""
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end
            self.poll(0.0)
            time.sleep(0.001)

    def up(self) -> Wire:
        self.peer.beat()
        self.until(lambda: self.link.up)
        self.peer.heard()
        return self

    def deliver(self, condition: Callable[[], object] = lambda: True) -> list:
        """Poll once after everything said has arrived, with a heartbeat as the last of it."""
        self.peer.beat()
        messages: list = []
        end = time.monotonic() + 10.0
        while not any(m.get_type() == 'HEARTBEAT' for m in messages):
            assert time.monotonic() < end
            messages += self.poll(0.0)
            time.sleep(0.001)
        assert condition()
        return messages

    def close(self) -> None:
        self.link.close()
        for peer in self.peers:
            peer.close()


@pytest.fixture
def make() -> Iterator[Callable[..., Wire]]:
    wires: list[Wire] = []

    def build(**arguments) -> Wire:
        wires.append(Wire(**arguments))
        return wires[-1]

    yield build
    for wire in wires:
        wire.close()


def test_own_heartbeat_once_a_second_as_onboard_controller(make):
    wire = make().up()
    for _ in range(20):
        wire.peer.beat()
        wire.poll(0.25)
    beats = [m for m in wire.peer.heard() if m.get_type() == 'HEARTBEAT']
    assert len(beats) == 5
    assert (beats[0].get_srcSystem(), beats[0].get_srcComponent()) == (1, 191)
    assert beats[0].type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    assert beats[0].autopilot == mavlink.MAV_AUTOPILOT_INVALID


def test_the_autopilot_is_found_by_its_heartbeat_and_lost_without(make):
    wire = make()
    wire.peer.say(mavlink.MAVLink_sys_status_message(*[0] * 13), 1)
    wire.poll()
    assert not wire.link.up
    wire.up()
    assert (wire.link.target_system, wire.link.vehicle) == (7, 'system 7, component 1, quadrotor')
    wire.poll(2.9)
    assert wire.link.up
    wire.poll(0.2)
    assert not wire.link.up
    wire.up()


def test_messages_without_heartbeat_do_not_keep_the_link(make):
    wire = make().up()
    for _ in range(10):
        wire.peer.say(mavlink.MAVLink_sys_status_message(*[0] * 13), 1)
        wire.poll(0.4)
    assert not wire.link.up


@pytest.mark.parametrize(
    'beat',
    [
        (100, mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_TYPE_CAMERA),
        (1, mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_TYPE_QUADROTOR),
        (190, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_TYPE_GCS),
    ],
    ids=['camera', 'another autopilot', 'ground station'],
)
def test_others_are_not_taken_for_the_autopilot(make, beat):
    wire = make(target=0)
    wire.peer.beat(*beat)
    for _ in range(20):
        wire.poll()
        time.sleep(0.005)
    assert not wire.link.up
    wire.poll(3.1)
    wire.up()
    assert wire.link.vehicle == 'system 7, component 1, quadrotor'


def test_another_vehicle_is_ignored(make):
    wire = make().up()
    other = wire.connect(system=8)
    other.beat()
    other.say(mavlink.MAVLink_extended_sys_state_message(0, 2), 1)
    time.sleep(0.05)
    assert {m.get_srcSystem() for m in wire.deliver()} == {7}
    assert wire.link.target_system == 7


def test_a_second_autopilot_of_the_vehicle_is_ignored(make):
    wire = make().up()
    wire.peer.beat(2)
    assert {m.get_srcComponent() for m in wire.deliver()} == {1}


def test_target_zero_takes_the_first_and_stays_with_it(make):
    wire = make(target=0).up()
    wire.poll(10.0)
    other = wire.connect(system=8)
    other.beat()
    for _ in range(20):
        wire.poll(0.0)
        time.sleep(0.005)
    assert not wire.link.up
    assert wire.link.target_system == 7


def test_camera_is_noted_but_its_messages_are_not_the_autopilots(make):
    wire = make().up()
    assert wire.link.component_age(100, wire.now) is None
    wire.peer.beat(100, mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_TYPE_CAMERA)
    assert {m.get_srcComponent() for m in wire.deliver()} == {1}
    for _ in range(4):
        wire.poll(1.0)
        wire.deliver()
    assert wire.link.component_age(100, wire.now) == pytest.approx(4.0)


def test_without_link_the_camera_is_not_missed(make):
    wire = make().up()
    wire.peer.beat(100, mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_TYPE_CAMERA)
    wire.deliver()
    wire.poll(60.0)
    wire.up()
    assert wire.link.component_age(100, wire.now + 1.0) == pytest.approx(1.0)


def test_streams_are_asked_for_one_by_one_and_again_when_they_stop(make):
    wire = make(streams=RATES).up()
    wire.poll()
    assert wire.peer.commands() == [], 'one request at a time'
    wire.peer.ack(STREAM)
    wire.deliver()
    wire.peer.ack(STREAM)
    [second] = wire.peer.commands()
    assert (second.command, second.param1, second.param2) == (STREAM, 1, 500000)
    assert (second.target_system, second.target_component) == (7, 1)
    wire.deliver()
    for _ in range(6):  # both arrive
        wire.poll(1.0)
        wire.peer.say(mavlink.MAVLink_global_position_int_message(*[0] * 9), 1)
        wire.peer.say(mavlink.MAVLink_sys_status_message(*[0] * 13), 1)
        wire.deliver()
    assert wire.peer.commands() == []
    for _ in range(4):  # position has stopped
        wire.poll(1.0)
        wire.peer.say(mavlink.MAVLink_sys_status_message(*[0] * 13), 1)
        wire.deliver()
    [again] = wire.peer.commands()
    assert (again.param1, again.param2) == (33, 100000)


def test_a_refused_stream_is_asked_for_with_growing_pauses(make):
    wire = make(streams={193: 2.0}).up()
    asked = []
    for second in range(200):
        wire.peer.ack(STREAM, mavlink.MAV_RESULT_DENIED)
        wire.poll(1.0)
        wire.deliver()
        asked += [second] * len(wire.peer.commands())
    assert wire.link.take_answers() == []
    pauses = [later - sooner for sooner, later in zip([-1, *asked], asked, strict=False)]
    assert pauses == pytest.approx([3, 6, 12, 24, 48, 60], abs=2)
    assert wire.link.refused == {'SET_MESSAGE_INTERVAL EKF_STATUS_REPORT': 'DENIED'}
    wire.peer.say(mavlink.MAVLink_ekf_status_report_message(*[0] * 6), 1)
    wire.deliver()
    assert wire.link.refused == {}
    wire.poll(5.0)
    wire.up()
    wire.poll(1.0)
    assert [m.command for m in wire.peer.commands()] == [STREAM], 'another autopilot, perhaps'


def test_an_unanswered_command_is_repeated_and_then_given_up(make):
    wire = make().up()
    wire.link.send((ARM,), wire.now)
    confirmations = []
    for _ in range(100):
        wire.peer.beat()
        wire.poll(0.1)
        confirmations += [m.confirmation for m in wire.peer.commands()]
    assert confirmations == [0, 1, 2]
    assert wire.link.refused == {'COMPONENT_ARM_DISARM': 'no answer'}


def sent_later(wire: Wire) -> list:
    """Commands sent in the three seconds to come."""
    for _ in range(3):
        wire.poll(1.0)
        wire.deliver()
    return wire.peer.commands()


@pytest.mark.parametrize(
    ('result', 'refused'),
    [
        (mavlink.MAV_RESULT_ACCEPTED, {}),
        (mavlink.MAV_RESULT_FAILED, {'COMPONENT_ARM_DISARM': 'FAILED'}),
    ],
)
def test_an_answer_ends_a_command(make, result, refused):
    wire = make().up()
    wire.link.send((ARM,), wire.now)
    wire.peer.ack(ARM.number, result)
    wire.deliver()
    wire.peer.heard()
    assert wire.link.refused == refused
    assert sent_later(wire) == []
    wire.link.send((ARM,), wire.now)
    wire.peer.ack(ARM.number)
    wire.deliver(lambda: wire.link.refused == {})


@pytest.mark.parametrize(
    ('command', 'target'),
    [(mavlink.MAV_CMD_NAV_TAKEOFF, (1, 191)), (ARM.number, (255, 190))],
    ids=['of another command', 'for someone else'],
)
def test_an_answer_that_is_not_meant_changes_nothing(make, command, target):
    wire = make().up()
    wire.link.send((ARM,), wire.now)
    wire.peer.heard()
    wire.peer.ack(command, target=target)
    wire.deliver()
    assert [m.command for m in sent_later(wire)] == [ARM.number] * 2


@pytest.mark.parametrize('other', [(7, 1), (7, 101), (8, 100)], ids=str)
def test_a_command_to_a_component_is_answered_by_that_component(make, other):
    wire = make().up()
    picture = MavCommand(mavlink.MAV_CMD_IMAGE_START_CAPTURE, (0, 0, 1, 1, 0, 0, 0), component=100)
    wire.link.send((picture,), wire.now)
    [sent] = wire.peer.commands()
    assert (sent.target_system, sent.target_component) == (7, 100)
    ack = mavlink.MAVLink_command_ack_message(picture.number, 0, 0, 0, 1, 191)
    system, component = other
    wire.connect(system=system, component=component).say(ack)
    wire.peer.say(ack, 1)
    wire.deliver()
    assert wire.link.take_answers() == []
    wire.peer.say(ack, 100)
    wire.deliver()
    assert [(a.command, a.accepted) for a in wire.link.take_answers()] == [(picture, True)]


def test_a_camera_answers_for_no_autopilot(make):
    wire = make().up()
    wire.link.send((ARM,), wire.now)
    wire.peer.say(mavlink.MAVLink_command_ack_message(ARM.number, 0, 0, 0, 1, 191), 100)
    wire.deliver()
    assert wire.link.take_answers() == []


def test_in_progress_waits_on(make):
    wire = make().up()
    wire.link.send((ARM,), wire.now)
    wire.peer.heard()
    for _ in range(5):
        wire.peer.ack(ARM.number, mavlink.MAV_RESULT_IN_PROGRESS)
        wire.poll(0.9)
        wire.deliver()
    assert wire.peer.commands() == []
    assert wire.link.refused == {}


def test_cancelled_commands_are_not_repeated_streams_are(make):
    wire = make(streams=RATES).up()
    wire.link.send((ARM,), wire.now)
    wire.peer.heard()
    wire.link.cancel()
    assert [m.command for m in sent_later(wire)] == [STREAM] * 3


def test_what_is_heard_may_cancel_what_would_be_repeated(make):
    wire = make(streams=RATES).up()
    wire.link.send((ARM,), wire.now)
    wire.peer.heard()
    wire.peer.beat()
    wire.now += 1.0
    end = time.monotonic() + 10.0
    while not wire.link.poll(wire.now):
        assert time.monotonic() < end
    assert wire.peer.commands() == []
    wire.link.cancel()
    wire.link.repeat(wire.now)
    assert [m.command for m in wire.peer.commands()] == [STREAM]


def test_nothing_is_commanded_without_link_nor_caught_up_on_later(make):
    wire = make().up()
    wire.link.send((TAKE_OFF,), wire.now)
    wire.peer.ack(TAKE_OFF.number, mavlink.MAV_RESULT_FAILED)
    wire.deliver(lambda: wire.link.refused)
    wire.link.send((ARM,), wire.now)
    wire.poll(5.0)
    assert wire.link.refused == {}
    wire.link.send((ARM,), wire.now)
    wire.peer.heard()
    wire.up()
    assert sent_later(wire) == []


def test_requests_as_the_vehicle_gets_them(make):
    wire = make().up()
    for request in (
        SetMode(FlightMode.RTL),
        Arm(),
        TakeOff(20.0),
        Fly(-35.3633, 149.1653, 20.0, 5.0),
    ):
        wire.link.send(commands(request), wire.now)
    mode, arm, take_off, fly = wire.peer.commands()
    assert (mode.command, mode.param1, mode.param2) == (mavlink.MAV_CMD_DO_SET_MODE, 1, 6)
    assert (arm.command, arm.param1, arm.param2) == (ARM.number, 1, 0)
    assert (take_off.command, take_off.param7) == (mavlink.MAV_CMD_NAV_TAKEOFF, 20.0)
    assert (fly.get_type(), fly.command) == ('COMMAND_INT', mavlink.MAV_CMD_DO_REPOSITION)
    frame = mavlink.MAV_FRAME_GLOBAL_INT
    assert (fly.frame, fly.x, fly.y, fly.z) == (frame, -353633000, 1491653000, 20.0)
    assert fly.param2 == 0, 'a reposition must not change the mode'
    assert math.isnan(fly.param4)
    wire.peer.ack(mavlink.MAV_CMD_DO_REPOSITION)
    wire.deliver()
    [speed] = wire.peer.commands()
    assert (speed.command, speed.param1, speed.param2) == (mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 5)


def said(wire: Wire, number: int, mode: int, seconds: float = 0.05) -> list[int]:
    """Modes that the link tells of after a HEARTBEAT with a number of its own."""
    wire.peer._mav.seq = number % 256
    ids = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    wire.peer.say(mavlink.MAVLink_heartbeat_message(*ids, 81, mode, 3, 3), 1)
    return [m.custom_mode for m in wire.poll(seconds) if m.get_type() == 'HEARTBEAT']


@pytest.mark.parametrize('first', [69, 2])
def test_a_state_that_was_overtaken_is_over(make, first):
    wire = make().up()
    assert said(wire, first, mode=9) == [9]
    assert said(wire, first - 3, mode=4) == []
    assert said(wire, first + 3, mode=6) == [6]


@pytest.mark.parametrize('number', [40, 60])
def test_one_that_was_overtaken_by_another_kind_counts(make, number):
    wire = make().up()
    wire.peer._mav.seq = 50
    wire.peer.say(mavlink.MAVLink_extended_sys_state_message(0, 2), 1)
    wire.poll()
    assert said(wire, number, mode=9) == [9]


@pytest.mark.parametrize(('command', 'modes'), [(mavlink.MAV_CMD_DO_SET_MODE, []), (STREAM, [9])])
def test_a_mode_told_before_another_was_accepted_is_over(make, command, modes):
    wire = make().up()
    wire.peer._mav.seq = 20
    wire.peer.ack(command)
    wire.poll()
    assert said(wire, 19, mode=9) == modes


@pytest.mark.parametrize('order', [(20, 21), (21, 20), (20, 19), (20,)])
def test_a_mode_told_after_another_was_accepted_is_known_as_such(make, order):
    """By the autopilot's count (the answer is its 20th message), whichever comes first."""
    wire = make().up()
    wire.link.send(commands(SetMode(FlightMode.GUIDED)), wire.now)
    for number in order:
        wire.peer._mav.seq = number
        if number == 20:
            wire.peer.ack(mavlink.MAV_CMD_DO_SET_MODE)
        else:
            wire.peer.beat()
    wire.poll()
    assert [answer.accepted for answer in wire.link.take_answers()] == [True]
    assert wire.link.mode_told == (21 in order)


def test_an_answer_counts_though_a_later_one_came_first(make):
    wire = make().up()
    wire.link.send((ARM, TAKE_OFF), wire.now)
    for number, command in ((20, STREAM), (19, ARM.number)):
        wire.peer._mav.seq = number
        wire.peer.ack(command)
        wire.poll()
    assert [answer.accepted for answer in wire.link.take_answers()] == [True]


def test_a_count_that_begins_anew_is_followed_soon(make):
    wire = make().up()
    assert said(wire, 30, mode=9) == [9]
    assert said(wire, 1, mode=4) == []
    assert said(wire, 2, mode=4, seconds=0.3) == []
    assert said(wire, 3, mode=4, seconds=0.3) == [4]
    assert said(wire, 200, mode=5) == [5], 'many were lost'


def test_noise_on_the_line_is_skipped(make):
    wire = make().up()
    wire.peer.raw(b'')
    wire.peer.raw(bytes(range(256)))
    wire.peer.raw(b'\xfd\x09\x00\x00')
    for _ in range(20):
        wire.peer.beat()
    assert wire.deliver()


@pytest.mark.parametrize(
    'connection', ['udpin:127.0.0.1', '/tmp/nothing-there', 'tcp:127.0.0.1:x']
)
def test_a_bad_connection_is_named(connection):
    with pytest.raises(ValueError, match=connection):
        AutopilotLink(connection)


def test_a_rebooted_autopilot_on_another_port_is_found(make):
    wire = make().up()
    wire.peer.close()
    wire.poll(5.0)
    assert not wire.link.up
    wire.peer = wire.connect()
    wire.up()
    wire.link.send((ARM,), wire.now)
    wire.until(lambda: wire.peer.commands())
