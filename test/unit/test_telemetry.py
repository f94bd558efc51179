from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.telemetry import Position, Telemetry, forget, update
from uav_mission_manager.autopilot.vehicle import mode_name

UNKNOWN_BATTERY = pytest.approx(math.nan, nan_ok=True)
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
BATTERY = mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
GYRO = mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO


def decode(*messages) -> Telemetry:
    telemetry = Telemetry()
    for message in messages:
        telemetry = update(telemetry, message, 7.0)
    return telemetry


def sys_status(
    remaining=80, millivolts=15200, centiamperes=1650, present=0, enabled=None, health=0
):
    return mavlink.MAVLink_sys_status_message(
        present,
        present if enabled is None else enabled,
        health,
        0,
        millivolts,
        centiamperes,
        remaining,
        0,
        0,
        0,
        0,
        0,
        0,
    )


def heartbeat(base_mode=81, mode=4, state=3, kind=mavlink.MAV_TYPE_QUADROTOR):
    return mavlink.MAVLink_heartbeat_message(
        kind, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, mode, state, 3
    )


def global_position(lat=-353632620, lon=1491652370, heading=9000, time=0, height=20.5):
    return mavlink.MAVLink_global_position_int_message(
        time, lat, lon, 604500, round(1000 * height), 300, 400, -100, heading
    )


def servos(port=0, first=1842):
    return mavlink.MAVLink_servo_output_raw_message(
        0, port, first, 1589, 1590, 1591, 1500, 1500, 1500, 1500
    )


@pytest.mark.parametrize(
    ('base_mode', 'armed'), [(81, False), (89, False), (217, True), (209, True)]
)
def test_armed_and_mode_come_from_heartbeat(base_mode, armed):
    telemetry = decode(heartbeat(base_mode, mode=6))
    assert (telemetry.armed, telemetry.mode) == (armed, 6)


@pytest.mark.parametrize(('state', 'failsafe'), [(3, False), (4, False), (5, True), (6, True)])
def test_failsafe(state, failsafe):
    assert decode(heartbeat(state=state)).failsafe is failsafe


@pytest.mark.parametrize(
    ('kind', 'motors'),
    [
        (mavlink.MAV_TYPE_QUADROTOR, 4),
        (mavlink.MAV_TYPE_HEXAROTOR, 6),
        (mavlink.MAV_TYPE_OCTOROTOR, 8),
        (mavlink.MAV_TYPE_DECAROTOR, 10),
        (mavlink.MAV_TYPE_DODECAROTOR, 12),
        (mavlink.MAV_TYPE_TRICOPTER, 0),
    ],
)
def test_number_of_motors(kind, motors):
    assert decode(heartbeat(kind=kind)).motor_count == motors


@pytest.mark.parametrize(
    ('remaining', 'charge'),
    [(0, 0.0), (55, 0.55), (100, 1.0), (-1, UNKNOWN_BATTERY), (101, UNKNOWN_BATTERY)],
)
def test_charge(remaining, charge):
    assert decode(sys_status(remaining)).battery.charge == charge


@pytest.mark.parametrize(
    ('millivolts', 'voltage'),
    [(15200, 15.2), (0, UNKNOWN_BATTERY), (64900, UNKNOWN_BATTERY), (65535, UNKNOWN_BATTERY)],
)
def test_voltage_that_cannot_be_is_unknown(millivolts, voltage):
    assert decode(sys_status(millivolts=millivolts)).battery.voltage == voltage


def test_current():
    assert decode(sys_status(centiamperes=1650)).battery.current == 16.5
    assert math.isnan(decode(sys_status(centiamperes=-1)).battery.current)


@pytest.mark.parametrize(
    ('present', 'enabled', 'health', 'unhealthy'),
    [(GYRO, GYRO, GYRO, 0), (GYRO, GYRO, 0, GYRO), (GYRO, 0, 0, 0), (0, GYRO, 0, 0)],
)
def test_health_counts_where_present_and_enabled(present, enabled, health, unhealthy):
    telemetry = decode(sys_status(present=present, enabled=enabled, health=health))
    assert telemetry.unhealthy == unhealthy


@pytest.mark.parametrize(
    ('present', 'health', 'ready'), [(PREARM, PREARM, True), (PREARM, 0, False), (0, 0, None)]
)
def test_ready_to_arm(present, health, ready):
    assert decode(sys_status(present=present, health=health)).ready is ready


def test_battery_health():
    assert decode(sys_status(present=BATTERY, health=BATTERY)).battery.healthy
    assert not decode(sys_status(present=BATTERY)).battery.healthy


def test_position_in_si_units_and_east_north_up():
    position = decode(global_position()).position
    assert (position.latitude, position.longitude) == (-35.363262, 149.165237)
    assert (position.altitude, position.height) == (604.5, 20.5)
    assert position.velocity == (4.0, 3.0, 1.0)
    assert position.heading == pytest.approx(math.pi / 2)
    assert math.isnan(decode(global_position(heading=65535)).position.heading)


def test_position_zero_is_none():
    assert decode(global_position(), global_position(0, 0)).position is None


def ekf(flags):
    return mavlink.MAVLink_ekf_status_report_message(flags, 0, 0, 0, 0, 0)


def test_a_position_to_fly_by_is_recent_and_absolute():
    telemetry = decode(global_position())
    assert telemetry.fix(8.9) is telemetry.position
    assert telemetry.fix(9.1) is None
    assert decode(global_position(), ekf(831)).fix(8.0) is not None
    assert decode(global_position(), ekf(167)).fix(8.0) is None


def track(*places, start=7.0, telemetry=None):
    """Positions at 10 Hz, each so many degrees north; the vehicle's clock agrees."""
    telemetry = telemetry or Telemetry()
    for step, north in enumerate(places):
        now = start + 0.1 * step
        message = global_position(lat=-353632620 + round(north * 1e7), time=round(now * 1e3))
        telemetry = update(telemetry, message, now)
    return telemetry


def test_a_position_is_flown_by_when_it_has_settled_for_a_second():
    telemetry = track(*[0.0] * 10)
    assert telemetry.fix(7.95) is None
    telemetry = track(0.0, 0.0, start=8.0, telemetry=telemetry)
    assert telemetry.fix(8.1) is telemetry.position


@pytest.mark.parametrize('jump', [0.02, 0.0005], ids=['2.2 km', '55 m'])
def test_a_jump_is_not_flown_by_nor_is_what_follows_it_for_a_second(jump):
    telemetry = track(*[0.0] * 20)
    assert telemetry.fix(8.9) is not None
    assert track(jump, start=9.0, telemetry=telemetry).fix(9.0) is None
    telemetry = track(jump, *[0.0] * 10, start=9.0, telemetry=telemetry)
    assert telemetry.fix(10.0) is None
    assert track(0.0, 0.0, start=10.1, telemetry=telemetry).fix(10.2) is not None


def test_a_position_that_was_overtaken_is_dropped():
    """On a link that delays, positions come in another order than they were measured in."""
    telemetry = track(*[0.0] * 20)
    late = update(telemetry, global_position(time=8500), 9.0)
    assert late.fix(9.0) == telemetry.fix(9.0) is not None


def test_a_wrong_position_from_the_future_is_not_flown_by_later():
    telemetry = track(*[0.0] * 20)
    forged = update(telemetry, global_position(lat=-353432620, time=10500), 9.0)
    for step in range(15):
        now = 9.05 + 0.1 * step
        forged = update(forged, global_position(time=round(1000 * now)), now)
        fix = forged.fix(now)
        assert fix is None or fix.latitude == pytest.approx(-35.363262)


def test_fast_flight_is_no_jump_at_any_speed_up():
    places = [4e-5 * step for step in range(30)]  # 44 m/s
    telemetry = Telemetry()
    for step, north in enumerate(places):
        message = global_position(lat=round(north * 1e7) + 1, time=100 * step)
        telemetry = update(telemetry, message, 7.0 + 0.01 * step)
    assert telemetry.settled_at == 8.0


def test_nothing_heard_is_not_on_the_ground():
    assert Telemetry().on_ground is None
    assert Telemetry().unheard == 'mode, position, landed state'
    telemetry = decode(heartbeat(217))
    assert telemetry.on_ground is None
    assert telemetry.unheard == 'position, landed state'
    landed = mavlink.MAVLink_extended_sys_state_message(0, 2)
    telemetry = decode(heartbeat(217), global_position(), landed)
    assert (telemetry.on_ground, telemetry.unheard) == (False, '')


def battery_status(number, percent, state=mavlink.MAV_BATTERY_CHARGE_STATE_OK):
    return mavlink.MAVLink_battery_status_message(
        number, 0, 0, 32767, [12000] + [65535] * 9, -1, -1, -1, percent, 0, state
    )


def test_every_battery_is_told_by_its_id():
    def batteries(*messages, percent=80):
        return decode(sys_status(percent), *messages).all_batteries

    def charges(*messages, percent=80):
        return {n: b.charge for n, b in batteries(*messages, percent=percent).items()}

    assert charges(battery_status(0, 80)) == {0: 0.8}
    assert charges(battery_status(0, 60)) == {0: 0.6}
    assert charges(battery_status(0, 80), battery_status(1, 4)) == {0: 0.8, 1: 0.04}
    assert charges(battery_status(1, -1)) == {0: 0.8}
    assert charges(battery_status(1, 90), percent=-1) == {1: 0.9}
    assert list(charges(percent=-1)) == [0]
    assert batteries(battery_status(1, 90))[1].healthy
    assert math.isnan(batteries(battery_status(1, 90))[1].voltage)
    low = mavlink.MAV_BATTERY_CHARGE_STATE_LOW
    assert not batteries(battery_status(1, 90, low))[1].healthy
    assert not batteries(battery_status(1, -1, low))[1].healthy
    assert not batteries(battery_status(0, 90, low))[0].healthy
    assert batteries(battery_status(1, 90, low))[0].healthy
    assert decode(battery_status(0, 80)).all_batteries == {}
    assert forget(decode(sys_status(80), battery_status(1, 4)), 12.1).batteries == {}


def test_what_is_not_said_again_is_forgotten():
    gps = mavlink.MAVLink_gps_raw_int_message(0, 3, *[0] * 8)
    landed = mavlink.MAVLink_extended_sys_state_message(0, 1)
    telemetry = decode(heartbeat(), sys_status(), gps, ekf(831), landed)
    assert forget(telemetry, 11.9) == telemetry
    old = forget(telemetry, 12.1)
    assert (old.unhealthy, old.ready, old.battery, old.landed) == (None,) * 4
    assert (old.fix_type, old.ekf_flags) == (None, None)
    assert old.mode == 4, 'the link is lost before'
    assert forget(update(telemetry, ekf(167), 12.0), 12.1).ekf_flags == 167


def test_distance():
    position = Position(0.0, -35.363262, 149.165237, 584.0, 0.0)
    assert position.distance_to(-35.363262 + 1e-3, 149.165237) == pytest.approx(110.95, abs=0.01)
    assert position.distance_to(-35.363262, 149.165237 + 1e-3) == pytest.approx(90.88, abs=0.01)


def test_motors_of_the_main_outputs():
    telemetry = decode(servos(), servos(port=1, first=1000))
    assert telemetry.motors == (1842, 1589, 1590, 1591, 1500, 1500, 1500, 1500) + (0,) * 8
    assert telemetry.motors_time == 7.0


def test_motors_of_a_frame_that_has_more_than_eight():
    message = servos()
    for output in range(9, 17):
        setattr(message, f'servo{output}_raw', 1600 + output)
    assert decode(message).motors[8:] == tuple(range(1609, 1617))


@pytest.mark.parametrize(
    ('state', 'height', 'on_ground'),
    [
        *((1, 20.5, True), (2, 0.0, False), (3, 0.0, False), (4, 0.0, False)),
        *((0, 20.5, False), (0, 0.0, None), (0, -12.0, None)),
    ],
)
def test_on_the_ground(state, height, on_ground):
    landed = mavlink.MAVLink_extended_sys_state_message(0, state)
    telemetry = decode(heartbeat(217), global_position(height=height), landed)
    assert telemetry.on_ground is on_ground
    assert decode(heartbeat(81), global_position(), landed).on_ground


def test_other_messages_change_nothing():
    assert decode(mavlink.MAVLink_vibration_message(0, 0, 0, 0, 0, 0, 0)) == Telemetry()


def test_mode_names():
    assert (mode_name(4), mode_name(27), mode_name(None)) == ('GUIDED', 'mode 27', 'mode None')
