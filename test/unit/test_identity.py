"""Who is heard and who is not, on a port in this process."""

from __future__ import annotations

from collections import deque
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.identity import MAX_OTHERS, MULTIROTOR_TYPES
from uav_mission_manager.autopilot.link import AutopilotLink, MavCommand

ARDUPILOT, PX4 = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4
QUAD, PLANE, GCS = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_TYPE_GCS
GUIDED, RTL = 4, 6
HERE, THERE = ('10.0.0.1', 14550), ('10.0.0.2', 14550)
ARM = MavCommand(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1, 0, 0, 0, 0, 0, 0))


class AirPort:
    """A port with several senders on it; keeps what is sent, and to whom."""

    def __init__(self) -> None:
        self.last_address: Any = None
        self._waiting: deque[tuple[bytes, Any]] = deque()
        self._parser = mavlink.MAVLink(None)
        self.sent: list[tuple[Any, Any]] = []

    def recv(self, size: int) -> bytes:
        if not self._waiting:
            return b''
        data, self.last_address = self._waiting.popleft()
        return data

    def write(self, data: bytes) -> None:
        self.write_to(data, 'all')

    def write_to(self, data: bytes, address: Any) -> None:
        self.sent += [(message, address) for message in self._parser.parse_buffer(data)]

    def close(self) -> None:
        pass

    def say(self, message: Any, ids=(7, 1), address: Any = HERE, version: int = 2) -> None:
        sender = mavlink.MAVLink(None, *ids)
        data = message.pack(sender, force_mavlink1=version == 1)
        self._waiting.append((bytes(data), address))

    def commands(self) -> list[tuple[int, Any]]:
        """Return the commands sent since the last call, with where they went."""
        sent, self.sent = self.sent, []
        return [(m.command, address) for m, address in sent if m.get_type() == 'COMMAND_LONG']


class Air:
    """A link on such a port, and the time."""

    def __init__(self, target: int = 7) -> None:
        self.port, self.now = AirPort(), 100.0
        self.link = AutopilotLink(self.port, target_system=target, streams={})

    def beat(self, kind=QUAD, autopilot=ARDUPILOT, mode=GUIDED, **where) -> None:
        self.port.say(mavlink.MAVLink_heartbeat_message(kind, autopilot, 89, mode, 4, 3), **where)

    def poll(self, seconds: float = 0.05) -> list:
        messages = []
        for _ in range(round(seconds / 0.05)):
            self.now += 0.05
            messages += self.link.poll(self.now)
            self.link.repeat(self.now)
        return messages

    def modes(self) -> list[int]:
        return [m.custom_mode for m in self.poll() if m.get_type() == 'HEARTBEAT']

    def up(self, **where) -> Air:
        self.beat(**where)
        self.poll()
        assert self.link.up
        return self


@pytest.mark.parametrize('kind', MULTIROTOR_TYPES)
def test_every_multirotor_is_taken(kind):
    air = Air()
    air.beat(kind)
    air.poll()
    name = mavlink.enums['MAV_TYPE'][kind].name.removeprefix('MAV_TYPE_').lower()
    assert (air.link.up, air.link.vehicle) == (True, f'system 7, component 1, {name}')
    assert (air.link.rejected, air.link.others) == ('', ())


WRONG = [
    *(
        (kind, ARDUPILOT, f'is a MAV_TYPE_{name}, not a multirotor')
        for name, kind in (
            ('FIXED_WING', PLANE),
            ('GROUND_ROVER', mavlink.MAV_TYPE_GROUND_ROVER),
            ('ANTENNA_TRACKER', mavlink.MAV_TYPE_ANTENNA_TRACKER),
            ('HELICOPTER', mavlink.MAV_TYPE_HELICOPTER),
            ('SUBMARINE', mavlink.MAV_TYPE_SUBMARINE),
            ('VTOL_TAILSITTER_DUOROTOR', mavlink.MAV_TYPE_VTOL_TAILSITTER_DUOROTOR)
            if hasattr(mavlink, 'MAV_TYPE_VTOL_TAILSITTER_DUOROTOR')
            else ('COAXIAL', mavlink.MAV_TYPE_COAXIAL),
        )
    ),
    (200, ARDUPILOT, 'is a 200, not a multirotor'),
    (QUAD, PX4, 'runs MAV_AUTOPILOT_PX4, not ArduCopter'),
    (QUAD, mavlink.MAV_AUTOPILOT_GENERIC, 'runs MAV_AUTOPILOT_GENERIC, not ArduCopter'),
]


@pytest.mark.parametrize('target', [0, 7])
@pytest.mark.parametrize(('kind', 'autopilot', 'why'), WRONG)
def test_other_vehicles_are_refused_by_name_and_never_commanded(kind, autopilot, why, target):
    air = Air(target)
    for _ in range(5):
        air.beat(kind, autopilot)
        assert air.poll(1.0) == []
        air.link.send((ARM,), air.now)
    assert not air.link.up
    assert air.link.rejected == f'system 7 {why}: never commanded'
    assert air.link.vehicle == ''
    assert air.port.commands() == []


@pytest.mark.parametrize(('kind', 'autopilot', 'why'), WRONG)
def test_an_autopilot_that_becomes_another_vehicle_is_lost(kind, autopilot, why):
    air = Air().up()
    air.link.send((ARM,), air.now)
    air.port.commands()
    air.beat(kind, autopilot, mode=RTL)
    assert air.modes() == []
    assert not air.link.up
    assert why in air.link.rejected
    air.link.send((ARM,), air.now)
    air.poll(2.0)
    assert air.port.commands() == []


def test_what_was_wrong_and_becomes_right_is_taken():
    air = Air()
    air.beat(PLANE)
    air.poll(3.2)
    assert air.link.rejected == '', 'it is silent'
    air.up()
    assert air.link.vehicle


@pytest.mark.parametrize('timeout', [0.5, 3.0, 60.0])
def test_one_who_is_heard_as_two_vehicles_is_never_commanded(timeout):
    air = Air()
    air.link = AutopilotLink(air.port, target_system=7, timeout=timeout, streams={})
    for _ in range(10):
        air.beat(PLANE)
        air.poll(0.8)
        air.beat(QUAD)
        air.poll(0.2)
        assert not air.link.up
        assert 'FIXED_WING' in air.link.rejected
    air.poll(2.5)
    air.up()
    assert air.link.rejected == ''


@pytest.mark.parametrize(
    ('kind', 'autopilot'),
    [
        (GCS, ARDUPILOT),
        (GCS, mavlink.MAV_AUTOPILOT_INVALID),
        (QUAD, mavlink.MAV_AUTOPILOT_INVALID),
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, ARDUPILOT),
        (mavlink.MAV_TYPE_GIMBAL, ARDUPILOT),
    ],
)
@pytest.mark.parametrize('address', [HERE, THERE])
def test_what_is_no_vehicle_changes_nothing(kind, autopilot, address):
    air = Air()
    air.beat(kind, autopilot)
    assert air.modes() == []
    assert not air.link.up
    air.up()
    vehicle = air.link.vehicle
    for _ in range(5):
        air.beat(kind, autopilot, mode=RTL, address=address)
        air.beat(mode=GUIDED)
        assert air.modes() == [GUIDED]
        assert (air.link.up, air.link.vehicle, air.link.rejected) == (True, vehicle, '')
    for _ in range(7):
        air.beat(kind, autopilot, address=address)
        air.poll(0.5)
    assert not air.link.up, 'nor does it keep the link'


@pytest.mark.parametrize(
    ('component', 'kind', 'name'),
    [
        (154, mavlink.MAV_TYPE_GIMBAL, 'GIMBAL'),
        (154, QUAD, 'QUADROTOR'),
        (25, mavlink.MAV_TYPE_ANTENNA_TRACKER, 'ANTENNA_TRACKER'),
        (0, QUAD, 'QUADROTOR'),
    ],
)
@pytest.mark.parametrize('target', [0, 7])
def test_another_component_heard_first_is_not_the_autopilot(component, kind, name, target):
    air = Air(target)
    air.beat(kind, ids=(7, component))
    assert air.poll() == []
    assert not air.link.up
    assert air.link.others == (f'system 7 component {component} {name}',)
    air.up()
    air.beat(kind, ids=(7, component), mode=RTL)
    assert air.modes() == []


def test_target_zero_takes_the_first_that_qualifies():
    air = Air(0)
    air.beat(PLANE, ids=(3, 1))
    air.beat(QUAD, PX4, ids=(4, 1))
    air.beat(ids=(0, 1))
    air.poll()
    assert (air.link.target_system, air.link.up) == (0, False)
    air.up(ids=(5, 1))
    assert (air.link.target_system, air.link.rejected) == (5, '')
    for _ in range(8):
        air.beat(ids=(6, 1))
        air.poll(1.0)
    assert (air.link.target_system, air.link.up) == (5, False), 'stays with it'


def test_of_two_with_the_same_ids_the_first_is_heard_and_commanded():
    air = Air().up()
    for _ in range(8):
        air.beat(mode=GUIDED)
        air.beat(mode=RTL, address=THERE)
        air.port.say(mavlink.MAVLink_extended_sys_state_message(0, 2), address=THERE)
        assert {getattr(m, 'custom_mode', None) for m in air.poll(1.0)} == {GUIDED}
    assert air.link.others == ('system 7 component 1 QUADROTOR at 10.0.0.2:14550',)
    air.port.commands()
    air.link.send((ARM,), air.now)
    assert air.port.commands() == [(ARM.number, HERE)]
    air.port.say(mavlink.MAVLink_command_ack_message(ARM.number, 0), address=THERE)
    air.poll()
    assert air.link.take_answers() == []
    air.port.say(mavlink.MAVLink_command_ack_message(ARM.number, 0), address=HERE)
    air.poll()
    assert [answer.accepted for answer in air.link.take_answers()] == [True]


def test_the_second_is_taken_when_the_first_is_silent():
    air = Air().up()
    heard = []
    for _ in range(9):
        air.beat(mode=RTL, address=THERE)
        air.poll(0.4)
        heard.append(air.link.up)
    assert heard == [True] * 7 + [False, True], 'lost in between'
    air.link.send((ARM,), air.now)
    assert air.port.commands() == [(ARM.number, THERE)]


def test_a_plane_with_the_same_ids_elsewhere_is_no_obstacle():
    air = Air()
    for _ in range(3):
        air.beat(PLANE, address=THERE)
        air.beat()
        air.poll(1.0)
    assert (air.link.up, air.link.rejected) == (True, '')
    assert air.link.others == ('system 7 component 1 FIXED_WING at 10.0.0.2:14550',)


def test_mavlink_1_is_not_heard():
    air = Air()
    air.beat(version=1)
    assert air.poll() == []
    assert not air.link.up
    where = '10.0.0.1:14550'
    assert air.link.others == (f'system 7 component 1 QUADROTOR at {where}, MAVLink 1: ignored',)
    air.up()
    air.link.send((ARM,), air.now)
    air.beat(mode=RTL, version=1)
    air.port.say(mavlink.MAVLink_command_ack_message(ARM.number, 0), version=1)
    assert air.poll() == []
    assert air.link.take_answers() == []


def test_others_are_named_few_and_forgotten():
    air = Air().up()
    air.beat(GCS, mavlink.MAV_AUTOPILOT_INVALID, ids=(255, 190), address=THERE)
    air.port.say(mavlink.MAVLink_system_time_message(0, 0), ids=(9, 1), address=THERE)
    air.poll()
    assert air.link.others == ('system 255 component 190 GCS', 'system 9 component 1')
    for system in range(1, 250):
        air.beat(ids=(system, 100), address=('10.0.0.3', system))
    air.poll()
    assert len(air.link.others) == MAX_OTHERS
    assert max(len(other) for other in air.link.others) < 100
    air.poll(11.0)
    assert air.link.others == ()


def test_forged_addresses_do_not_drive_out_the_autopilot():
    air = Air().up()
    for number in range(90):
        air.beat(PLANE, address=('10.0.0.3', number))
        air.beat(mode=RTL, address=('10.0.0.4', number))
    air.beat()
    assert air.modes() == [GUIDED]
    assert (air.link.up, air.link.rejected) == (True, '')


def test_half_a_frame_of_a_stranger_swallows_nothing():
    air = Air().up()
    air.port._waiting.append((b'\xfd\xff\x00\x00', THERE))
    air.beat(mode=RTL)
    assert air.modes() == [RTL]


class PlainPort:
    """What a port must have at least."""

    def __init__(self, port: AirPort) -> None:
        self.recv, self.write, self.close = port.recv, port.write, port.close


def test_a_port_that_does_not_say_who_sent_will_do():
    air = Air()
    air.link = AutopilotLink(PlainPort(air.port), target_system=7, streams={})
    air.up()
    air.link.send((ARM,), air.now)
    assert air.port.commands() == [(ARM.number, 'all')]
    assert air.link.error == ''
