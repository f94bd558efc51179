"""The simulated autopilot as a process, and a ground station that flies it over UDP."""

from __future__ import annotations

import math
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from statistics import mean, median

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 600.0
SPEEDUP = 20.0
LATITUDE, LONGITUDE, ALTITUDE = 47.397742, 8.545594, 488.0
GUIDED, RTL = 4, 6
STREAMS = {
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 0.2,
}


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, '-m', 'uav_mission_manager.autopilot.sim_autopilot', *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def stop(process):
    """Exit code after SIGTERM."""
    if process.poll() is None:
        process.terminate()
    process.communicate(timeout=LIMIT)
    return process.returncode


class GroundStation:
    """System 255; keeps the newest message of each type and all texts."""

    def __init__(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(('127.0.0.1', 0))
            self.port = probe.getsockname()[1]
        self.link = mavutil.mavlink_connection(f'udpin:127.0.0.1:{self.port}')
        self.mav = mavlink.MAVLink(self.link, 255, 190)
        self.mav.robust_parsing = True
        self.latest, self.texts, self.components = {}, [], set()

    def poll(self):
        data = self.link.recv(4096)
        if not data:
            time.sleep(0.002)
            return []
        heard = self.mav.parse_buffer(data) or []
        self.components |= {m.get_srcComponent() for m in heard}
        messages = [m for m in heard if m.get_srcComponent() == 1]
        self.latest.update((m.get_type(), m) for m in messages)
        self.texts += [m.text for m in messages if m.get_type() == 'STATUSTEXT']
        return messages

    def until(self, condition, what):
        end = time.monotonic() + LIMIT
        while not condition():
            assert time.monotonic() < end, f'{what}; last heard {self.latest}'
            self.poll()

    def next(self, kind):
        self.latest.pop(kind, None)
        self.until(lambda: kind in self.latest, f'no {kind}')
        return self.latest[kind]

    def command(self, number, *params):
        params += (0,) * (7 - len(params))
        self.latest.pop('COMMAND_ACK', None)
        self.mav.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *params))
        return self._result(number)

    def reposition(self, latitude, longitude, height):
        self.latest.pop('COMMAND_ACK', None)
        number = mavlink.MAV_CMD_DO_REPOSITION
        self.mav.send(
            mavlink.MAVLink_command_int_message(
                1,
                1,
                mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
                number,
                0,
                0,
                -1,
                0,
                0,
                math.nan,
                round(latitude * 1e7),
                round(longitude * 1e7),
                height,
            )
        )
        return self._result(number)

    def _result(self, number):
        self.until(lambda: 'COMMAND_ACK' in self.latest, f'no ACK of {number}')
        assert self.latest['COMMAND_ACK'].command == number
        return self.latest['COMMAND_ACK'].result

    def set_parameter(self, name, value):
        self.mav.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        taken = self.next('PARAM_VALUE')
        assert (taken.param_id, taken.param_value) == (name, pytest.approx(value))

    @property
    def armed(self):
        return bool(self.latest['HEARTBEAT'].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def height(self):
        return self.latest['GLOBAL_POSITION_INT'].relative_alt / 1000.0

    def distance(self, latitude, longitude):
        position = self.latest['GLOBAL_POSITION_INT']
        north = math.radians(position.lat / 1e7 - latitude) * 6371000.0
        east = math.radians(position.lon / 1e7 - longitude) * 6371000.0
        return math.hypot(north, east * math.cos(math.radians(latitude)))

    def speed(self):
        position = self.latest['GLOBAL_POSITION_INT']
        return math.hypot(position.vx, position.vy) / 100.0

    def motors(self, seconds=3.0):
        """Mean outputs over some simulated seconds."""
        rows, end = [], self.next('SERVO_OUTPUT_RAW').time_usec + seconds * 1e6
        while not rows or rows[-1].time_usec < end:
            rows.append(self.next('SERVO_OUTPUT_RAW'))
        return [mean(getattr(row, f'servo{n}_raw') for row in rows) for n in (1, 2, 3, 4)]


@pytest.fixture
def station():
    station = GroundStation()
    yield station
    station.link.close()


@pytest.fixture
def simulator(station):
    process = start(
        '--connection',
        f'udpout:127.0.0.1:{station.port}',
        '--speedup',
        str(SPEEDUP),
        '--origin',
        f'{LATITUDE},{LONGITUDE},{ALTITUDE}',
        '--boot-seconds',
        '20',
    )
    yield process
    stop(process)


def take_off(station):
    for message, seconds in STREAMS.items():
        assert station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message, seconds * 1e6) == 0
    # Before GUIDED, which needs a position, it says that it is ready without one.
    assert station.command(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED) == 0
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    station.next('SYS_STATUS')
    station.until(
        lambda: station.next('SYS_STATUS').onboard_control_sensors_health & prearm, 'not ready'
    )
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert station.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == 0
    station.next('GLOBAL_POSITION_INT')
    station.until(lambda: station.height() > 19.7, 'no take-off')


def test_ground_station_flies_a_mission(simulator, station):
    station.next('HEARTBEAT')
    assert not station.armed
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 4
    station.until(lambda: any('Arm: ' in text for text in station.texts), 'no reason')
    take_off(station)
    assert station.motors() == pytest.approx([1589] * 4, abs=15)

    goal = LATITUDE + 0.003, LONGITUDE
    assert station.command(mavlink.MAV_CMD_DO_REPOSITION, -1, 0, 0, 0, *goal, 20) == 3
    far = LATITUDE + 0.02, LONGITUDE  # Not to be reached before the speed is changed.
    assert station.reposition(*far, 20) == 0
    station.until(lambda: station.speed() > 9.5, 'does not reach 10 m/s')
    assert station.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 5, -1) == 0
    station.until(lambda: station.speed() < 5.5, 'does not slow down')
    assert station.distance(*far) > 30.0
    assert station.reposition(*goal, 20) == 0
    station.until(lambda: station.distance(*goal) < 1.0, 'does not arrive')

    station.set_parameter('SIM_ENGINE_FAIL', 1)
    station.set_parameter('SIM_ENGINE_MUL', 0.8)
    motors = station.motors()
    assert (median(motors) - 1000) / (motors[0] - 1000) == pytest.approx(0.8, abs=0.03)

    station.set_parameter('SIM_BATT_PCT', 50)
    assert station.next('SYS_STATUS').battery_remaining == pytest.approx(49, abs=2)

    assert station.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    station.until(lambda: not station.armed, 'does not come home')
    station.next('GLOBAL_POSITION_INT')
    assert station.distance(LATITUDE, LONGITUDE) < 1.0
    assert station.latest['HEARTBEAT'].custom_mode == RTL
    assert station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 4
    assert simulator.poll() is None


def test_low_battery_brings_it_home(simulator, station):
    station.next('HEARTBEAT')
    take_off(station)
    station.set_parameter('BATT_FS_LOW_ACT', 2)
    station.set_parameter('SIM_BATT_PCT', 8)
    station.until(lambda: 'Battery Failsafe' in station.texts, 'no failsafe')
    station.until(lambda: station.latest['HEARTBEAT'].system_status == 5, 'not critical')
    station.until(lambda: not station.armed, 'does not land')


def test_reboot_is_short_and_begins_anew(simulator, station):
    station.next('HEARTBEAT')
    take_off(station)
    number = mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN
    assert station.command(number, 1) == 4
    assert station.command(mavlink.MAV_CMD_NAV_LAND) == 0
    station.until(lambda: not station.armed, 'does not land')
    before = station.next('GLOBAL_POSITION_INT').time_boot_ms
    assert station.command(number, 1) == 0
    station.until(lambda: station.next('HEARTBEAT').system_status == 1, 'does not boot')
    take_off(station)
    assert station.latest['GLOBAL_POSITION_INT'].time_boot_ms < before


def test_time_runs_at_the_speed_asked_for(simulator, station):
    station.next('HEARTBEAT')
    assert (
        station.command(
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 1e6
        )
        == 0
    )
    first, begin = station.next('SYSTEM_TIME'), time.monotonic()
    station.until(
        lambda: station.latest['SYSTEM_TIME'].time_boot_ms >= first.time_boot_ms + 60000,
        'time stands still',
    )
    # It may fall behind on a busy machine, never run ahead.
    assert time.monotonic() - begin > 0.5 * 60.0 / SPEEDUP


def test_each_link_has_its_own_streams():
    stations = [GroundStation(), GroundStation()]
    links = [f'--connection=udpout:127.0.0.1:{station.port}' for station in stations]
    process = start(*links, '--speedup', '10')
    try:
        line = process.stdout.readline()
        assert all(f'127.0.0.1:{station.port}' in line for station in stations)
        for station in stations:
            station.next('HEARTBEAT')
        stations[0].command(
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, 1e5
        )
        stations[0].next('ATTITUDE')
        for _ in range(3):
            stations[1].next('HEARTBEAT')
        assert 'ATTITUDE' not in stations[1].latest
    finally:
        stop(process)
        for station in stations:
            station.link.close()


@pytest.mark.parametrize(
    ('options', 'kind', 'components'),
    [((), 2, {1}), (('--frame', 'hexa', '--camera'), 13, {1, 100})],
)
def test_vehicles_to_choose_from(station, options, kind, components):
    process = start(f'--connection=udpout:127.0.0.1:{station.port}', '--speedup', '20', *options)
    try:
        for _ in range(5):
            assert station.next('HEARTBEAT').type == kind
        assert station.components == components
    finally:
        stop(process)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_it_without_a_peer(number):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    process = start('--connection', f'udpout:127.0.0.1:{port}', '--speedup', '50')
    try:
        assert 'speed-up 50' in process.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):  # nobody listens, and it goes on
            process.wait(0.5)
        process.send_signal(number)
        _, errors = process.communicate(timeout=LIMIT)
        assert process.returncode == 0
        assert errors == ''
    finally:
        stop(process)


@pytest.mark.parametrize(
    'arguments',
    [
        ('--origin', '47.0,8.0'),
        ('--origin', '95,8,400'),
        ('--origin', 'nan,8,400'),
        ('--speedup', '0'),
        ('--speedup', 'nan'),
        ('--connection', 'nowhere'),
        ('--connection', 'udpin:192.0.2.1:14550'),
        ('--system-id', '256'),
        ('--frame', 'penta'),
    ],
)
def test_bad_arguments_end_in_one_clear_line(arguments):
    process = start(*arguments)
    _, errors = process.communicate(timeout=LIMIT)
    assert process.returncode == 2
    assert errors.splitlines()[-1].startswith('sim_autopilot: error: ')
    assert 'Traceback' not in errors
