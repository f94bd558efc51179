"""MAVLink front of the simulated autopilot, over links in memory."""

from __future__ import annotations

import math
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot import sim_autopilot
from uav_mission_manager.autopilot.simulator import commands
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.frames import HEXA_X, OCTA_X, QUAD_X
from uav_mission_manager.autopilot.simulator.guidance import Home
from uav_mission_manager.autopilot.simulator.link import SimulatedLink
from uav_mission_manager.autopilot.simulator.messages import MESSAGE_BUILDERS
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode
from uav_mission_manager.autopilot.simulator.parameters import SIMULATED_PARAMETERS
from uav_mission_manager.autopilot.simulator.physics import SimulatedOrigin
from uav_mission_manager.autopilot.simulator.protocol import SimulatedAutopilot

DT = 0.02
RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


class Peer:
    """A ground station at the other end of one link."""

    def __init__(self):
        self.link = SimulatedLink(self)
        self._mav = mavlink.MAVLink(self, 255, 190)
        self._messages = []
        self.autopilot = None

    def write(self, data):
        """Take what the autopilot, or in `send` this peer, writes."""
        self._messages += self._mav.parse_buffer(bytes(data)) or []

    def send(self, message):
        self.autopilot.receive(self.link, message.pack(self._mav))

    def take(self, kind=None, component=1):
        """Messages since the last call, of one type if given."""
        messages, self._messages = self._messages, []
        return [
            m
            for m in messages
            if kind in (None, m.get_type()) and m.get_srcComponent() == component
        ]

    def command(self, number, *params, system=1, component=1):
        """Send COMMAND_LONG, return the result or None without an answer."""
        self.take()
        params += (0,) * (7 - len(params))
        self.send(mavlink.MAVLink_command_long_message(system, component, number, 0, *params))
        return self._result(number)

    def command_int(self, number, latitude, longitude, z, frame=RELATIVE, flags=0):
        self.take()
        self.send(
            mavlink.MAVLink_command_int_message(
                1,
                1,
                frame,
                number,
                0,
                0,
                -1,
                flags,
                0,
                math.nan,
                round(latitude * 1e7),
                round(longitude * 1e7),
                z,
            )
        )
        return self._result(number)

    def _result(self, number):
        acks = [m for m in self._messages if m.get_type() == 'COMMAND_ACK']
        assert all(
            (m.command, m.target_system, m.target_component) == (number, 255, 190) for m in acks
        )
        return acks[-1].result if acks else None

    def get(self, message):
        """Ask for one message."""
        assert self.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message) == 0
        return next(m for m in self.take() if m.get_msgId() == message)

    def set_parameter(self, name, value):
        self.take()
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        return self.take('PARAM_VALUE')

    def unhealthy(self):
        status = self.get(mavlink.MAVLINK_MSG_ID_SYS_STATUS)
        return status.onboard_control_sensors_enabled & ~status.onboard_control_sensors_health

    def run(self, seconds):
        for _ in range(round(seconds / DT)):
            self.autopilot.step(DT)


def connect(boot_seconds=0.5, peers=1, camera=False, frame=QUAD_X):
    peers = [Peer() for _ in range(peers)]
    flight = SimulatedFlight(SimulatedOrigin(47.0, 8.0, 400.0), boot_seconds, frame=frame)
    autopilot = SimulatedAutopilot(flight, [peer.link for peer in peers], camera=camera)
    for peer in peers:
        peer.autopilot = autopilot
    return peers


@pytest.fixture
def peer():
    """Linked to an autopilot that is ready to arm."""
    (peer,) = connect()
    peer.run(1.0)
    peer.take()
    return peer


@pytest.fixture
def airborne(peer):
    assert peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED) == 0
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert peer.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == 0
    peer.run(20.0)
    return peer


def test_only_heartbeat_and_timesync_stream_unasked():
    (peer,) = connect()
    peer.run(30.01)
    kinds = [m.get_type() for m in peer.take()]
    assert kinds.count('HEARTBEAT') == 31
    assert kinds.count('TIMESYNC') == 4
    assert len(kinds) == 35


def test_intervals_are_exact_and_of_one_link():
    first, second = connect(peers=2)
    wanted = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
    assert first.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, 1e5) == 0
    assert (
        second.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 30e3)
        == 0
    )
    first.run(12.0)
    stamps = [m.time_boot_ms for m in first.take('GLOBAL_POSITION_INT')]
    assert stamps == list(range(100, 12001, 100))
    assert len(second.take('ATTITUDE')) == pytest.approx(400, abs=1)
    first.run(1.0)
    assert second.take('GLOBAL_POSITION_INT') == []
    assert first.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, -1) == 0
    first.run(1.0)
    assert first.take('GLOBAL_POSITION_INT') == []


@pytest.mark.parametrize('number', [230, 291, 331, 65000, math.nan])
def test_unknown_streams_are_refused(peer, number):
    assert peer.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e5) == 2


@pytest.mark.parametrize('number', sorted(MESSAGE_BUILDERS))
def test_every_message_can_be_asked_for(airborne, number):
    assert airborne.get(number).get_msgId() == number


def test_request_of_an_unknown_message_fails(peer):
    assert peer.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 230) == 4


def test_early_arming_fails_with_a_reason():
    (peer,) = connect()
    peer.run(0.1)
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 4
    kinds = [m.get_type() for m in peer.take()]
    assert kinds.index('COMMAND_ACK') < kinds.index('STATUSTEXT')
    assert peer.unhealthy() & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert peer.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT).lat == 0
    peer.run(0.2)
    assert peer.unhealthy() == 0
    assert peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED) == 0
    assert peer.unhealthy() == mavlink.MAV_SYS_STATUS_PREARM_CHECK
    peer.run(0.3)
    assert peer.unhealthy() == 0
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0


def test_heartbeat_of_a_flight(peer):
    def beat():
        heartbeat = peer.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        return heartbeat.base_mode, heartbeat.custom_mode, heartbeat.system_status

    assert beat() == (81, 0, 3)
    peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED)
    assert beat() == (89, 4, 3)
    peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert beat() == (217, 4, 3)
    peer.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20)
    peer.run(3.0)
    assert beat() == (217, 4, 3)
    assert peer.get(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == 1
    peer.run(2.0)
    assert beat() == (217, 4, 4)
    assert peer.get(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == 3
    peer.set_parameter('SIM_GPS1_ENABLE', 0)
    peer.run(9.0)
    assert beat() == (209, 9, 5)
    assert peer.get(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == 4


def test_results_of_commands_in_the_air(airborne):
    assert airborne.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == 4
    assert airborne.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == 4
    assert airborne.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 3) == 3
    assert airborne.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 3) == 4
    assert airborne.command(mavlink.MAV_CMD_DO_SET_MODE, 0, 4) == 2
    assert airborne.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 5, -1) == 0
    assert airborne.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, math.nan) == 2
    assert airborne.command(mavlink.MAV_CMD_DO_PARACHUTE, 1) == 3
    assert airborne.command(mavlink.MAV_CMD_NAV_LAND) == 0
    assert airborne.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    assert airborne.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == 0


def test_reposition_is_a_command_int_of_guided(airborne):
    number = mavlink.MAV_CMD_DO_REPOSITION
    assert airborne.command(number, -1, 0, 0, 0, 47.001, 8.0, 30) == 3
    assert airborne.command_int(number, 95.0, 8.0, 30) == 2
    assert airborne.command_int(number, 47.001, 8.0, math.nan) == 2
    assert (
        airborne.command_int(number, 47.001, 8.0, 30, frame=mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT)
        == 2
    )
    assert airborne.command_int(number, 47.001, 8.0, 30) == 0
    airborne.run(30.0)
    position = airborne.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert (position.lat, position.lon) == pytest.approx((470010000, 80000000), abs=30)
    assert position.relative_alt == pytest.approx(30000, abs=100)
    assert position.alt == pytest.approx(430000, abs=100)
    airborne.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.LOITER)
    assert airborne.command_int(number, 47.0, 8.0, 30) == 2
    assert airborne.command_int(number, 47.0, 8.0, 30, flags=1) == 0
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).custom_mode == SimulatedMode.GUIDED


@pytest.mark.parametrize('frame', [mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT])
def test_reposition_to_a_height_above_the_sea(airborne, frame):
    # Home is not at the origin's height: the two heights must not be mixed.
    airborne.autopilot.flight.home = Home(0j, 7.0, locked=True)
    assert airborne.command_int(mavlink.MAV_CMD_DO_REPOSITION, 47.0, 8.0, 435.0, frame=frame) == 0
    airborne.run(20.0)
    position = airborne.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert position.alt == pytest.approx(435000, abs=100)
    assert position.relative_alt == pytest.approx(28000, abs=100)


def test_speed_holds_only_if_it_is_set_after_the_first_reposition(airborne):
    def speed_after(*orders):
        for order in orders:
            assert order() == 0
        airborne.run(8.0)
        position = airborne.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
        return math.hypot(position.vx, position.vy) / 100.0

    def slow():
        return airborne.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 5, -1)

    def away():
        return airborne.command_int(mavlink.MAV_CMD_DO_REPOSITION, 47.1, 8.0, 20)

    def aside():
        return airborne.command_int(mavlink.MAV_CMD_DO_REPOSITION, 47.0, 8.1, 20)

    assert speed_after(slow, away) == pytest.approx(10.0, abs=0.1)
    assert speed_after(slow) == pytest.approx(5.0, abs=0.1)
    assert speed_after(aside) == pytest.approx(5.0, abs=0.1)


def test_position_target_moves_without_an_answer(airborne):
    airborne.take()
    airborne.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0,
            1,
            1,
            mavlink.MAV_FRAME_GLOBAL_INT,
            0b110111111000,
            470000000,
            80010000,
            415.0,
            0,
            0,
            0,
            0,
            0,
            0,
            0,
            0,
        )
    )
    assert airborne.take() == []
    airborne.run(25.0)
    local = airborne.get(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    assert (local.x, local.y, local.z) == pytest.approx((0.0, 76.1, -15.0), abs=0.3)


def test_set_home_is_where_it_returns_to(airborne):
    assert (
        airborne.command_int(
            mavlink.MAV_CMD_DO_SET_HOME, 47.0005, 8.0, 400.0, frame=mavlink.MAV_FRAME_GLOBAL
        )
        == 0
    )
    home = airborne.get(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
    assert (home.latitude, home.longitude, home.altitude) == (470005000, 80000000, 400000)
    airborne.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    airborne.run(60.0)
    assert not airborne.autopilot.flight.armed
    position = airborne.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert position.lat == pytest.approx(470005000, abs=30)
    assert position.relative_alt == 0


def test_what_is_for_others_is_left_alone(peer):
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, system=2) is None
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, component=100) is None
    assert not peer.autopilot.flight.armed
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, system=0, component=0) == 0


PICTURE = mavlink.MAV_CMD_IMAGE_START_CAPTURE


def test_a_picture_is_taken_or_refused(peer):
    assert peer.command(PICTURE, 0, 0, 1, 1) == 0
    peer.set_parameter('SIM_CAM_REFUSE', 1)
    assert peer.command(PICTURE, 0, 0, 1, 1) == 4
    assert peer.command(PICTURE, 0, 2, 5) == 3, 'a series is not simulated'


def test_a_camera_takes_its_own_pictures_while_it_works(peer):
    assert peer.command(PICTURE, 0, 0, 1, 1, component=100) is None, 'there is none'
    [peer] = connect(camera=True)
    peer.run(1.0)
    assert peer.command(PICTURE, 0, 0, 1, 1, component=100) == 0
    assert peer.take('COMMAND_ACK') == []
    assert peer.command(PICTURE, 0, 0, 1, 1, component=100) == 0
    assert len(peer.take('COMMAND_ACK', component=100)) == 1
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, component=100) is None
    peer.set_parameter('SIM_CAM_FAIL', 1)
    assert peer.command(PICTURE, 0, 0, 1, 1, component=100) is None


def test_set_mode_message_is_acknowledged_by_its_id(peer):
    peer.send(mavlink.MAVLink_set_mode_message(1, 1, SimulatedMode.GUIDED))
    (ack,) = peer.take('COMMAND_ACK')
    assert (ack.command, ack.result) == (11, 0)
    assert peer.autopilot.flight.mode == SimulatedMode.GUIDED


def test_timesync_is_answered(peer):
    peer.send(mavlink.MAVLink_timesync_message(0, 12345))
    (answer,) = peer.take('TIMESYNC')
    assert (answer.tc1, answer.ts1) == (1_000_000_000, 12345)
    peer.send(answer)
    assert peer.take('TIMESYNC') == []


def test_parameters():
    first, second = connect(peers=2)
    first.send(mavlink.MAVLink_param_request_list_message(1, 1))
    listed = first.take('PARAM_VALUE')
    assert [m.param_id for m in listed] == list(SIMULATED_PARAMETERS)
    assert [m.param_index for m in listed] == list(range(len(SIMULATED_PARAMETERS)))
    (value,) = first.set_parameter('SIM_BATT_PCT', 40.0)
    assert (value.param_id, value.param_value, value.param_count) == (
        'SIM_BATT_PCT',
        40.0,
        len(SIMULATED_PARAMETERS),
    )
    assert second.take('PARAM_VALUE')[0].param_value == 40.0
    assert first.get(mavlink.MAVLINK_MSG_ID_SYS_STATUS).battery_remaining == 40
    first.run(60.0)
    index = list(SIMULATED_PARAMETERS).index('SIM_BATT_PCT')
    for name, number in ((b'SIM_BATT_PCT', -1), (b'', index)):
        first.take()
        first.send(mavlink.MAVLink_param_request_read_message(1, 1, name, number))
        (value,) = first.take('PARAM_VALUE')
        assert value.param_index == index
        assert 39.0 < value.param_value < 40.0


def test_parameters_without_sense_are_ignored(peer):
    assert peer.set_parameter('NO_SUCH_NAME', 1.0) == []
    assert peer.set_parameter('SIM_BATT_PCT', math.nan) == []
    assert peer.set_parameter('SIM_WIND_SPD', math.inf) == []
    assert peer.set_parameter('SIM_ENGINE_MUL', 7.0)[0].param_value == 1.0
    peer.send(mavlink.MAVLink_param_request_read_message(1, 1, b'NO_SUCH_NAME', -1))
    assert peer.take('PARAM_VALUE') == []


@pytest.mark.parametrize(
    ('name', 'value', 'seconds', 'bit'),
    [
        ('SIM_MAG1_FAIL', 1, 0.1, mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG),
        ('SIM_BARO_DISABLE', 1, 0.1, mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE),
        ('SIM_BATT_VOLTAGE', 10.4, 10.1, mavlink.MAV_SYS_STATUS_SENSOR_BATTERY),
        ('SIM_GPS1_ENABLE', 0, 5.0, 0),
    ],
)
def test_health_bits_of_faults(airborne, name, value, seconds, bit):
    airborne.set_parameter(name, value)
    airborne.run(seconds)
    assert airborne.unhealthy() == bit


@pytest.mark.parametrize(
    ('frame', 'kind', 'count'), [(QUAD_X, 2, 4), (HEXA_X, 13, 6), (OCTA_X, 14, 8)]
)
def test_frame_in_messages(frame, kind, count):
    (peer,) = connect(frame=frame)
    peer.run(0.1)
    assert peer.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).type == kind
    servos = peer.get(mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)
    outputs = [getattr(servos, f'servo{number}_raw') for number in range(1, 9)]
    assert outputs == [1000] * count + [0] * (8 - count)


def test_propulsion_bit_of_a_lost_motor(airborne):
    airborne.set_parameter('SIM_ENGINE_FAIL', 2)
    airborne.set_parameter('SIM_ENGINE_MUL', 0.6)
    airborne.run(3.0)
    assert airborne.get(mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW).servo2_raw == 1950
    assert airborne.unhealthy() == mavlink.MAV_SYS_STATUS_SENSOR_PROPULSION


def test_lost_gps_in_messages(airborne):
    airborne.set_parameter('SIM_GPS1_ENABLE', 0)
    airborne.run(3.0)
    absolute = mavlink.EKF_POS_HORIZ_ABS
    assert airborne.get(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT).fix_type == 1
    assert airborne.get(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT).flags & absolute
    airborne.run(6.0)
    assert airborne.get(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT).flags == 0x25
    airborne.run(8.0)
    assert airborne.get(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT).flags == 0xA7


def test_charge_state_climbs_with_the_failsafes(airborne):
    airborne.set_parameter('BATT_CRT_VOLT', 10.2)
    states = []
    for voltage in (10.4, 10.0, 0.0):
        status = airborne.get(mavlink.MAVLINK_MSG_ID_BATTERY_STATUS)
        states.append(status.charge_state)
        airborne.set_parameter('SIM_BATT_VOLTAGE', voltage)
        airborne.run(10.1)
    assert states == [1, 2, 3]
    assert status.voltages[0] == 10000
    assert status.battery_remaining > 90


def test_battery_warning_leaves_the_mode(airborne):
    airborne.set_parameter('SIM_BATT_VOLTAGE', 10.0)
    airborne.run(10.1)
    beat = airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
    assert (beat.custom_mode, beat.system_status) == (SimulatedMode.GUIDED, 5)
    airborne.command(mavlink.MAV_CMD_NAV_LAND)
    airborne.run(60.0)
    assert not airborne.autopilot.flight.armed
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).system_status == 5
    airborne.set_parameter('SIM_BATT_VOLTAGE', 0.0)
    airborne.run(1.0)
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).system_status == 5
    assert airborne.command(mavlink.MAV_CMD_BATTERY_RESET, 1, 100) == 0
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).system_status == 3


def test_battery_reset_sets_the_charge_of_the_battery_meant(peer):
    def remaining():
        return peer.get(mavlink.MAVLINK_MSG_ID_SYS_STATUS).battery_remaining

    assert peer.command(mavlink.MAV_CMD_BATTERY_RESET, 1, 60) == 0
    assert remaining() == 60
    assert peer.command(mavlink.MAV_CMD_BATTERY_RESET, 2, 80) == 0
    assert remaining() == 60
    assert peer.command(mavlink.MAV_CMD_BATTERY_RESET, 1, 150) == 0
    assert remaining() == 100


def test_there_is_no_camera_unless_wanted(peer):
    peer.run(3.0)
    assert peer.take('HEARTBEAT', component=100) == []


def test_camera_beats_until_it_fails():
    (peer,) = connect(camera=True)
    peer.run(1.0)
    peer.take()
    peer.run(3.0)
    beats = peer.take('HEARTBEAT', component=100)
    assert [m.type for m in beats] == [mavlink.MAV_TYPE_CAMERA] * 3
    peer.set_parameter('SIM_CAM_FAIL', 1)
    peer.run(3.0)
    assert peer.take('HEARTBEAT', component=100) == []
    peer.set_parameter('SIM_CAM_FAIL', 0)
    peer.run(3.0)
    assert len(peer.take('HEARTBEAT', component=100)) == 3


def test_heartbeat_comes_at_once_when_the_mode_changes():
    first, second = connect(peers=2)
    first.run(1.5)
    second.take()
    assert first.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED) == 0
    assert [m.get_type() for m in first.take()] == ['COMMAND_ACK', 'HEARTBEAT']
    (beat,) = second.take('HEARTBEAT')
    assert (beat.base_mode, beat.custom_mode) == (89, 4)
    assert first.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED) == 0
    assert first.take('HEARTBEAT') == []
    assert first.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert first.take('HEARTBEAT') == []
    first.run(0.6)
    (beat,) = first.take('HEARTBEAT')
    assert beat.base_mode == 217


def test_heartbeat_comes_at_once_in_a_failsafe(airborne):
    airborne.run(0.5)
    airborne.set_parameter('SIM_RC_FAIL', 1)
    airborne.run(0.98)
    airborne.take()
    airborne.run(0.02)
    (beat,) = airborne.take('HEARTBEAT')
    assert (beat.custom_mode, beat.system_status) == (SimulatedMode.RTL, 5)


def test_lost_remote_control_in_messages(airborne):
    airborne.set_parameter('FS_OPTIONS', 4)
    airborne.set_parameter('SIM_RC_FAIL', 1)
    airborne.run(1.1)
    assert airborne.unhealthy() == mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    beat = airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
    assert (beat.custom_mode, beat.system_status) == (SimulatedMode.GUIDED, 5)
    airborne.set_parameter('SIM_RC_FAIL', 0)
    airborne.run(0.1)
    assert airborne.unhealthy() == 0
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).system_status == 4


def test_ground_station_is_the_system_that_a_parameter_names(airborne):
    def heartbeats_for(seconds, system):
        for _ in range(seconds):
            sender = mavlink.MAVLink(None, system, 190)
            message = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3)
            airborne.autopilot.receive(airborne.link, message.pack(sender))
            airborne.run(1.0)
        return airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).custom_mode

    airborne.set_parameter('FS_GCS_ENABLE', 1)
    assert heartbeats_for(10, 250) == SimulatedMode.GUIDED
    assert heartbeats_for(10, 255) == SimulatedMode.GUIDED
    assert heartbeats_for(10, 250) == SimulatedMode.RTL
    airborne.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED)
    airborne.set_parameter('MAV_GCS_SYSID', 250)
    assert heartbeats_for(10, 250) == SimulatedMode.GUIDED


def test_reposition_outside_the_fence_fails_without_a_word(airborne):
    number = mavlink.MAV_CMD_DO_REPOSITION
    airborne.set_parameter('FENCE_ENABLE', 1)
    airborne.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.LOITER)
    assert airborne.command_int(number, 47.003, 8.0, 30, flags=1) == 4
    assert airborne.take('STATUSTEXT') == []
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).custom_mode == SimulatedMode.LOITER
    assert airborne.command_int(number, 47.002, 8.0, 30, flags=1) == 0
    assert airborne.command_int(number, 47.002, 8.0, 101) == 4


def test_forced_disarm_in_the_air_says_on_the_ground(airborne):
    assert airborne.get(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == 2
    assert airborne.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == 0
    airborne.run(0.5)
    assert airborne.get(mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE).landed_state == 1
    assert airborne.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).system_status == 3
    assert airborne.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT).relative_alt > 10000


def test_boot_as_seen_in_messages():
    peer, witness = connect(boot_seconds=40.0, peers=2)
    seen = []
    for _ in range(45):
        peer.run(1.0)
        fix = peer.get(mavlink.MAVLINK_MSG_ID_GPS_RAW_INT)
        seen.append(
            (
                peer.get(mavlink.MAVLINK_MSG_ID_HEARTBEAT).system_status,
                peer.get(mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT).flags,
                (fix.fix_type, fix.satellites_visible),
                peer.get(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT).lat,
                bool(peer.unhealthy() & mavlink.MAV_SYS_STATUS_PREARM_CHECK),
            )
        )
        if len(seen) == 25:
            assert peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1, SimulatedMode.GUIDED) == 0
    place = 470000000
    assert list(dict.fromkeys(seen)) == [
        (1, 0x400, (0, 0), 0, True),
        (3, 0x400, (0, 0), 0, True),
        (3, 0xA7, (0, 0), 0, True),
        (3, 0xA7, (6, 10), place, True),
        (3, 0xA7, (6, 10), place, False),  # STABILIZE needs no position
        (3, 0x33F, (6, 10), place, False),
    ]
    assert [m.text for m in witness.take('STATUSTEXT')] == ['PreArm: Need Position Estimate']


def test_home_is_told_once_it_is_known():
    (peer,) = connect(boot_seconds=10.0)
    number = mavlink.MAVLINK_MSG_ID_HOME_POSITION
    assert peer.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == 0
    assert peer.take('HOME_POSITION') == []
    peer.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6)
    peer.run(4.7)
    assert peer.take('HOME_POSITION') == []
    peer.run(0.6)
    assert len(peer.take('HOME_POSITION')) == 1


def test_reboot_forgets_the_streams_and_begins_at_time_0(peer):
    wanted = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
    number = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    peer.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, wanted, 1e5)
    peer.set_parameter('RTL_ALT', 2000)
    assert peer.command(number, 2) == 3
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert peer.command(number, 1) == 4
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == 0
    peer.run(1.0)
    peer.take()
    assert peer.command(number, 1) == 0
    assert peer.command(number, 1) is None
    peer.run(0.96)
    assert peer.take() == []
    peer.run(0.04)
    first, second = peer.take()
    assert (first.get_type(), first.system_status) == ('HEARTBEAT', 1)
    assert second.get_type() == 'TIMESYNC'
    position = peer.get(wanted)
    assert (position.lat, position.time_boot_ms) == (0, 0)
    peer.run(1.0)
    assert peer.take('GLOBAL_POSITION_INT') == []
    assert peer.get(wanted).lat == 470000000
    assert peer.autopilot.flight.parameters['RTL_ALT'] == 2000
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0


@given(data=st.lists(st.binary(max_size=80), max_size=5))
@settings(max_examples=50)
def test_garbage_does_no_harm(data):
    (peer,) = connect()
    for chunk in data:
        peer.autopilot.receive(peer.link, chunk)
    peer.autopilot.receive(peer.link, bytes(300))
    peer.run(1.1)
    assert peer.take('HEARTBEAT')


FLOATS = st.floats(width=32) | st.sampled_from([0.0, 1.0, 4.0, 21196.0, -1.0, 3e38])


@given(
    number=st.sampled_from(sorted(commands._HANDLERS)),
    params=st.tuples(*[FLOATS] * 7),
    x=st.integers(-(2**31), 2**31 - 1),
    frame=st.integers(0, 12),
    mode=st.integers(0, 30),
    name=st.sampled_from(sorted(SIMULATED_PARAMETERS)),
)
@settings(max_examples=200)
def test_any_numbers_are_survived(number, params, x, frame, mode, name):
    (peer,) = connect(boot_seconds=0.1)
    peer.run(0.2)
    assert peer.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4) == 0
    assert peer.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert peer.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2) == 0
    peer.set_parameter(name, params[0])
    peer.run(1.0)
    assert peer.command(number, *params) is not None
    peer.send(
        mavlink.MAVLink_command_int_message(
            1, 1, frame, number, 0, 0, *params[:4], x, x, params[6]
        )
    )
    peer.send(mavlink.MAVLink_set_mode_message(1, 1, mode))
    peer.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, frame, 0, x, x, *params, *params[:2]
        )
    )
    peer.run(1.0)
    for message in MESSAGE_BUILDERS:
        assert peer.get(message).get_msgId() == message


class Port:
    """A port on which a message arrives at a time [s] of the vehicle."""

    def __init__(self, flight, message, time):
        self.flight, self.time = flight, time
        self.data = message.pack(mavlink.MAVLink(None, 255, 190))

    def recv(self, size):
        data = self.data if self.flight.time >= self.time else b''
        self.data = b'' if data else self.data
        return data

    def write(self, data):
        """Nobody is interested."""


def test_a_stall_is_made_up_for_with_open_ears(monkeypatch):
    """At a speed-up of 10 a quarter of a second is 2.5 s, but not after the ground slows it."""
    flight = SimulatedFlight(SimulatedOrigin(47.0, 8.0, 400.0))
    flight.parameters['SIM_SPEEDUP'] = 10.0
    slower = mavlink.MAVLink_param_set_message(1, 1, b'SIM_SPEEDUP', 1.0, 9)
    clock = SimpleNamespace(
        monotonic=Mock(side_effect=(0.0, 0.25)),
        sleep=Mock(side_effect=(None, KeyboardInterrupt)),
    )
    monkeypatch.setattr(sim_autopilot, 'time', clock)
    with pytest.raises(KeyboardInterrupt):
        sim_autopilot._run(flight, [Port(flight, slower, 1.0)], 1, False)
    assert flight.time == pytest.approx(1.0 + 0.15, abs=2 * DT)
