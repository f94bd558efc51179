"""The simulated multirotor, its modes and failsafes, stepped by hand."""

from __future__ import annotations

from itertools import pairwise
from statistics import mean, pstdev

import pytest

from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.frames import (
    HEXA_X,
    MOTOR_FRAMES,
    OCTA_X,
    motor_loads,
)
from uav_mission_manager.autopilot.simulator.guidance import Home
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode
from uav_mission_manager.autopilot.simulator.physics import MAX_AIRSPEED, SimulatedOrigin

DT = 0.02
ORIGIN = SimulatedOrigin(47.0, 8.0, 400.0)


def run(flight, seconds):
    for _ in range(round(seconds / DT)):
        flight.step(DT)


def run_until(flight, condition, limit):
    """Seconds it took."""
    start = flight.time
    while not condition():
        assert flight.time - start < limit
        flight.step(DT)
    return flight.time - start


def texts(flight):
    return [text for _, text in flight.texts]


def motor_means(flight, seconds=4.0):
    rows = []
    for _ in range(round(seconds / DT)):
        flight.step(DT)
        rows.append(flight.body.motors)
    return [mean(column) for column in zip(*rows)]


@pytest.fixture
def flight():
    """Ready to arm, in GUIDED."""
    flight = SimulatedFlight(ORIGIN)
    run(flight, 5.1)
    assert flight.set_mode(SimulatedMode.GUIDED)
    return flight


@pytest.fixture
def airborne(flight):
    """Hovering at 20 m."""
    assert flight.arm()
    assert flight.take_off(20.0)
    run(flight, 20.0)
    assert flight.body.altitude == pytest.approx(20.0, abs=0.1)
    return flight


@pytest.mark.parametrize(
    ('origin', 'place', 'expected'),
    [
        (SimulatedOrigin(0.0, 0.0, 0.0), (0.01, 0.0), 1105.743 + 0j),
        (SimulatedOrigin(60.0, 10.0, 0.0), (60.0, 10.02), 0.169 + 1116.0j),
        (SimulatedOrigin(78.0, 179.99, 50.0), (78.0, -179.99), 0.079 + 464.39j),
    ],
)
def test_local_frame_has_the_lengths_of_wgs84(origin, place, expected):
    assert origin.to_local(*place) == pytest.approx(expected, abs=0.02)
    assert origin.to_geodetic(origin.to_local(*place)) == pytest.approx(place, abs=1e-8)


def test_arming_waits_for_the_boot():
    flight = SimulatedFlight(ORIGIN)
    run(flight, 0.5)
    assert not flight.arm()
    assert texts(flight) == ['Arm: EKF attitude is bad', 'Arm: Gyros inconsistent']
    flight.texts.clear()
    run(flight, 2.0)
    assert not flight.arm()
    assert texts(flight) == ['Arm: Gyros inconsistent']
    run(flight, 1.0)
    assert flight.arming_faults() == []  # STABILIZE flies without a position
    assert flight.set_mode(SimulatedMode.GUIDED)
    assert not flight.arm()
    assert 'Arm: Need Position Estimate' in texts(flight)
    run(flight, 1.6)
    assert flight.arm()


def test_fix_comes_after_the_attitude_and_long_before_the_position():
    flight = SimulatedFlight(ORIGIN, boot_seconds=41.5)

    def time_of(name):
        run_until(flight, lambda: getattr(flight.estimator, name), 45.0)
        return flight.time

    times = [time_of(name) for name in ('started', 'attitude_ok', 'gps_fix', 'calm')]
    assert times == pytest.approx([2.7, 6.0, 10.0, 23.5], abs=0.1)
    assert time_of('position_ok') == pytest.approx(41.5, abs=0.1)


def test_without_gps_no_position_ever_comes():
    flight = SimulatedFlight(ORIGIN)
    flight.parameters['SIM_GPS1_ENABLE'] = 0.0
    run(flight, 20.0)
    assert not flight.position_ok
    assert not flight.estimator.gps_found
    flight.parameters['SIM_GPS1_ENABLE'] = 1.0
    run(flight, 0.1)
    assert flight.position_ok


def test_what_keeps_it_from_arming_is_told_unasked():
    flight = SimulatedFlight(ORIGIN, boot_seconds=70.0)
    run(flight, 31.0)
    assert texts(flight) == ['PreArm: Gyros inconsistent']
    run(flight, 10.0)
    flight.set_mode(SimulatedMode.GUIDED)  # which needs a position: news
    run(flight, 1.1)
    assert texts(flight)[1:] == ['PreArm: Need Position Estimate']
    run(flight, 28.0)
    assert len(texts(flight)) == 2
    run(flight, 60.0)  # ready by now
    assert len(texts(flight)) == 2
    flight.parameters['SIM_MAG1_FAIL'] = 1
    run(flight, 61.5)
    assert texts(flight)[2:] == ['PreArm: Compass not healthy'] * 3


def test_take_off_only_armed_in_guided_and_on_the_ground(flight):
    assert not flight.take_off(20.0)
    assert flight.set_mode(SimulatedMode.LOITER)
    assert flight.arm()
    assert not flight.take_off(20.0)
    assert flight.set_mode(SimulatedMode.GUIDED)
    assert not flight.take_off(-1.0)
    assert flight.take_off(20.0)
    assert run_until(flight, lambda: not flight.body.on_ground, 5.0) == pytest.approx(3.4, abs=0.1)
    run(flight, 15.0)
    assert not flight.take_off(30.0)


def test_second_take_off_while_motors_spool_up_is_accepted(flight):
    flight.arm()
    flight.take_off(20.0)
    run(flight, 2.0)
    assert flight.take_off(10.0)
    assert run_until(flight, lambda: not flight.body.on_ground, 2.0) == pytest.approx(1.4, abs=0.1)
    run(flight, 20.0)
    assert flight.body.altitude == pytest.approx(10.0, abs=0.1)


def test_take_off_long_after_arming_lifts_off_soon(flight):
    flight.arm()
    run(flight, 5.0)
    flight.take_off(20.0)
    assert run_until(flight, lambda: not flight.landed, 2.0) == pytest.approx(1.0, abs=0.1)


def test_idle_timer_does_not_interfere_with_a_take_off(flight):
    flight.parameters['DISARM_DELAY'] = 4.0
    flight.arm()
    run(flight, 3.0)
    flight.take_off(20.0)
    run(flight, 5.0)
    assert flight.armed
    assert not flight.body.on_ground


def test_target_alone_lifts_nothing(flight):
    flight.arm()
    assert flight.go_to(50 + 0j, 20.0)
    run(flight, 5.0)
    assert flight.body.on_ground
    assert flight.body.position == 0


def test_flies_to_the_target_within_its_limits(airborne):
    airborne.go_to(120 - 90j, 30.0)
    fastest = steepest = change = 0.0
    for _ in range(round(30.0 / DT)):
        before = airborne.body.velocity
        airborne.step(DT)
        body = airborne.body
        change = max(change, abs(body.velocity - before) / DT)
        fastest, steepest = max(fastest, abs(body.velocity)), max(steepest, body.climb)
    assert body.position == pytest.approx(120 - 90j, abs=0.2)
    assert body.altitude == pytest.approx(30.0, abs=0.1)
    assert fastest == pytest.approx(10.0, abs=0.01)
    assert steepest == pytest.approx(2.5, abs=0.01)
    assert change <= 2.5 + 1e-6


def ground_speed_towards(flight, target):
    flight.go_to(target, 20.0)
    run(flight, 8.0)
    return abs(flight.body.velocity)


def test_speed_set_before_the_first_target_is_lost(airborne):
    assert airborne.set_speed(1, 4.0)
    assert ground_speed_towards(airborne, 1000 + 0j) == pytest.approx(10.0)
    assert airborne.set_speed(1, 4.0)
    run(airborne, 8.0)
    assert abs(airborne.body.velocity) == pytest.approx(4.0)
    assert ground_speed_towards(airborne, 1000j) == pytest.approx(4.0)


def test_speed_is_lost_when_guided_is_entered_anew(airborne):
    ground_speed_towards(airborne, 1000 + 0j)
    airborne.set_speed(1, 4.0)
    airborne.set_mode(SimulatedMode.GUIDED)  # it is already: nothing is entered
    assert ground_speed_towards(airborne, 1000j) == pytest.approx(4.0)
    airborne.set_mode(SimulatedMode.LOITER)
    assert not airborne.set_speed(1, 6.0)
    airborne.set_mode(SimulatedMode.GUIDED)
    assert airborne.set_speed(1, 6.0)
    assert ground_speed_towards(airborne, 1000 + 0j) == pytest.approx(10.0)


def test_brake_stops_and_stays(airborne):
    airborne.go_to(1000 + 0j, 20.0)
    run(airborne, 8.0)
    airborne.set_mode(SimulatedMode.BRAKE)
    run(airborne, 10.0)
    stopped = airborne.body.position
    run(airborne, 5.0)
    assert abs(airborne.body.velocity) < 0.01
    assert airborne.body.position == pytest.approx(stopped, abs=0.05)


@pytest.mark.parametrize(
    ('effectiveness', 'pwm'), [(1.0, 1589), (0.9, 1654), (0.8, 1736), (0.7, 1842)]
)
def test_weak_motor_turns_up(airborne, effectiveness, pwm):
    airborne.parameters['SIM_ENGINE_FAIL'] = 0b0100
    airborne.parameters['SIM_ENGINE_MUL'] = effectiveness
    first, second, third, fourth = motor_means(airborne)
    assert third == pytest.approx(pwm, abs=2.0)
    assert (first, second, fourth) == pytest.approx((1589,) * 3, abs=1.0)
    assert airborne.body.altitude == pytest.approx(20.0, abs=0.1)
    assert not airborne.thrust_loss


@pytest.mark.parametrize(
    ('frame', 'opposite', 'loads'),
    [(HEXA_X, 3, (1.154, 0.923, 1.038)), (OCTA_X, 5, (1.111, 0.961, None))],
)
def test_motor_opposite_a_weak_one_unloads(frame, opposite, loads):
    flight = SimulatedFlight(ORIGIN, 0.1, frame=frame)
    run(flight, 0.2)
    flight.set_mode(SimulatedMode.GUIDED)
    flight.arm()
    flight.take_off(20.0)
    run(flight, 25.0)
    flight.parameters.update(SIM_ENGINE_FAIL=1, SIM_ENGINE_MUL=0.8)
    spans = [(pwm - 1000.0) / 589.0 for pwm in motor_means(flight)]
    weak, unloaded, others = loads
    assert spans[0] == pytest.approx(weak, abs=0.003)
    assert spans[opposite] == pytest.approx(unloaded, abs=0.003)
    if others is not None:
        rest = [span for motor, span in enumerate(spans) if motor not in (0, opposite)]
        assert rest == pytest.approx([others] * 4, abs=0.003)
    assert flight.body.altitude == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize('frame', MOTOR_FRAMES.values())
@pytest.mark.parametrize('weak', [0, 2])
def test_weakened_motors_together_hold_it_level(frame, weak):
    strength = [1.0] * len(frame.angles)
    strength[weak] = 0.7
    hover, rear = motor_loads(frame, tuple(strength))
    for loads, wanted in ((hover, [1.0] * len(hover)), (rear, frame.rearward)):
        produced = [share * load for share, load in zip(strength, loads)]
        assert produced @ frame.mixer == pytest.approx(wanted @ frame.mixer, abs=1e-9)


def test_hexacopter_bears_a_motor_that_brings_a_quadcopter_down():
    flight = SimulatedFlight(ORIGIN, 0.1, frame=HEXA_X)
    run(flight, 0.2)
    flight.set_mode(SimulatedMode.GUIDED)
    flight.arm()
    flight.take_off(20.0)
    run(flight, 25.0)
    flight.parameters.update(SIM_ENGINE_FAIL=1, SIM_ENGINE_MUL=0.6)
    run(flight, 10.0)
    assert not flight.thrust_loss
    flight.parameters['SIM_ENGINE_MUL'] = 0.1
    run_until(flight, lambda: flight.thrust_loss, 3.0)
    assert flight.body.motors[0] == 1950


def test_motor_at_60_percent_brings_it_down(airborne):
    airborne.parameters['SIM_ENGINE_FAIL'] = 1
    airborne.parameters['SIM_ENGINE_MUL'] = 0.6
    assert run_until(airborne, lambda: airborne.thrust_loss, 3.0) > 0.5
    assert 'Potential Thrust Loss (1)' in texts(airborne)
    assert airborne.body.motors[0] == 1950
    assert run_until(airborne, lambda: not airborne.armed, 15.0) > 3.0
    assert 'Crash: Disarming' in texts(airborne)


def test_forward_flight_is_no_weak_motor(airborne):
    airborne.go_to(1000 + 1000j, 20.0)
    run(airborne, 8.0)
    spans = [pwm - 1000.0 for pwm in motor_means(airborne)]
    assert 1.01 < max(spans) / min(spans) < 1.06


def power(flight, seconds=20.0):
    """Mean charge drawn in a second."""
    before = flight.body.battery.consumed
    run(flight, seconds)
    return (flight.body.battery.consumed - before) / seconds


def test_load_drains_the_battery(airborne):
    hover = power(airborne)
    assert hover * 3600 == pytest.approx(16.5, abs=0.5)
    airborne.parameters['SIM_ENGINE_FAIL'] = 1
    airborne.parameters['SIM_ENGINE_MUL'] = 0.7
    assert power(airborne) > 1.1 * hover
    airborne.parameters['SIM_ENGINE_MUL'] = 1.0
    airborne.parameters['SIM_WIND_SPD'] = 10.0
    assert power(airborne) > 1.15 * hover
    assert airborne.body.position == pytest.approx(0, abs=0.1)
    airborne.parameters['SIM_WIND_SPD'] = 0.0
    airborne.go_to(1000 + 0j, 20.0)
    assert power(airborne) > 1.1 * hover
    battery = airborne.body.battery
    assert battery.charge == pytest.approx(1.0 - battery.consumed / 5.0)
    assert 11.0 < battery.voltage < 12.5


def test_head_wind_beyond_the_airspeed_costs_ground_speed(airborne):
    airborne.parameters['SIM_WIND_DIR'] = 0.0
    airborne.parameters['SIM_WIND_SPD'] = 12.0
    airborne.go_to(1000 + 0j, 20.0)
    run(airborne, 10.0)
    assert airborne.body.velocity == pytest.approx(MAX_AIRSPEED - 12.0, abs=0.01)


def test_wind_beyond_the_airspeed_blows_it_away(airborne):
    airborne.parameters.update(SIM_WIND_DIR=0.0, SIM_WIND_SPD=MAX_AIRSPEED + 5.0)
    run(airborne, 20.0)
    assert airborne.body.velocity == pytest.approx(-5.0, abs=0.01)
    assert airborne.body.position.real < -50.0


def test_gusts_have_the_strength_asked_for_and_last_a_while():
    flight = SimulatedFlight(ORIGIN)
    flight.parameters.update(SIM_WIND_SPD=3.0, SIM_WIND_DIR=0.0, SIM_WIND_TURB=2.0)
    winds = []
    for _ in range(100_000):
        flight.step(DT)
        winds.append(flight.wind)
    assert mean(w.real for w in winds) == pytest.approx(-3.0, abs=0.4)
    assert pstdev([w.real for w in winds]) == pytest.approx(2.0, abs=0.3)
    assert pstdev([w.imag for w in winds]) == pytest.approx(2.0, abs=0.3)
    assert max(abs(b - a) for a, b in pairwise(winds)) < 2.0


def test_empty_battery_stops_the_motors(airborne):
    airborne.set_charge(0.0)
    run(airborne, 6.0)
    assert airborne.body.on_ground
    assert 'Crash: Disarming' in texts(airborne)


def test_low_voltage_returns_then_lands_if_wanted(airborne):
    airborne.parameters.update(BATT_CRT_VOLT=10.3, BATT_FS_LOW_ACT=2, BATT_FS_CRT_ACT=1)
    airborne.go_to(200 + 0j, 20.0)
    run(airborne, 10.0)
    airborne.parameters['SIM_BATT_VOLTAGE'] = 10.4
    assert run_until(airborne, lambda: airborne.mode == SimulatedMode.RTL, 11.0) >= 9.9
    assert airborne.failsafe
    assert airborne.battery.level == 1
    airborne.parameters['SIM_BATT_VOLTAGE'] = 10.2
    assert run_until(airborne, lambda: airborne.mode == SimulatedMode.LAND, 11.0) >= 9.9
    assert airborne.battery.level == 2
    assert texts(airborne).count('Battery Failsafe') == 2
    run_until(airborne, lambda: not airborne.armed, 60.0)
    airborne.parameters['SIM_BATT_VOLTAGE'] = 0.0
    airborne.set_mode(SimulatedMode.GUIDED)
    run(airborne, 20.0)
    assert airborne.failsafe  # also disarmed, and with a good voltage
    assert not airborne.arm()
    assert 'Arm: Battery failsafe' in texts(airborne)
    airborne.set_charge(100.0)
    run(airborne, 0.1)
    assert not airborne.failsafe
    assert airborne.arm()


def test_low_voltage_only_warns_by_default(airborne):
    airborne.parameters['SIM_BATT_VOLTAGE'] = 9.0
    run_until(airborne, lambda: airborne.failsafe, 11.0)
    assert airborne.battery.level == 1
    assert 'Battery Failsafe' in texts(airborne)
    run(airborne, 20.0)
    assert airborne.mode == SimulatedMode.GUIDED
    assert airborne.battery.level == 1  # there is no critical voltage by default
    assert airborne.body.battery.charge > 0.9


def test_battery_failsafe_disarms_on_the_ground(flight):
    flight.parameters.update(SIM_BATT_VOLTAGE=9.0, DISARM_DELAY=0.0)
    run(flight, 0.1)
    assert not flight.arm()
    assert 'Arm: Battery 1 low voltage failsafe' in texts(flight)
    run(flight, 20.0)
    assert not flight.failsafe  # only watched while armed
    assert flight.arm(force=True)
    run(flight, 10.1)
    assert not flight.armed
    assert 'Battery Failsafe - Disarming' in texts(flight)
    assert flight.failsafe


def test_short_dip_of_the_voltage_is_no_failsafe(airborne):
    for _ in range(3):
        airborne.parameters['SIM_BATT_VOLTAGE'] = 9.0
        run(airborne, 8.0)
        airborne.parameters['SIM_BATT_VOLTAGE'] = 0.0
        run(airborne, 1.0)
    assert airborne.mode == SimulatedMode.GUIDED


def test_lost_gps_lands_and_drifts(airborne):
    airborne.parameters['SIM_WIND_SPD'] = 5.0
    run(airborne, 5.0)
    airborne.parameters['SIM_GPS1_ENABLE'] = 0.0
    assert run_until(airborne, lambda: not airborne.estimator.gps_fix, 3.0) > 0.5
    assert airborne.position_ok
    assert run_until(airborne, lambda: airborne.mode == SimulatedMode.LAND, 8.0) > 5.0
    assert airborne.failsafe
    assert not airborne.set_mode(SimulatedMode.GUIDED)
    assert airborne.set_mode(SimulatedMode.LAND)
    run_until(airborne, lambda: not airborne.armed, 60.0)
    assert airborne.body.position.real > 20.0
    assert airborne.failsafe  # also disarmed, until there is a position
    airborne.parameters['SIM_GPS1_ENABLE'] = 1.0
    run(airborne, 0.1)
    assert not airborne.failsafe
    assert 'EKF Failsafe Cleared' in texts(airborne)


def test_return_to_launch_ends_disarmed_at_home_in_rtl(airborne):
    airborne.go_to(60 + 80j, 8.0)
    run(airborne, 25.0)
    assert airborne.set_mode(SimulatedMode.RTL)
    highest = 0.0
    while airborne.armed:
        airborne.step(DT)
        highest = max(highest, airborne.body.altitude)
        assert airborne.time < 150.0
    assert highest == pytest.approx(15.0, abs=0.6)
    assert airborne.body.position == pytest.approx(0, abs=0.3)
    assert airborne.body.on_ground
    assert airborne.mode == SimulatedMode.RTL
    assert not airborne.arm()
    assert 'Arm: RTL mode not armable' in texts(airborne)
    assert airborne.set_mode(SimulatedMode.GUIDED)
    assert airborne.arm()


def test_home_moves_to_where_it_is_armed_unless_locked(airborne):
    def land_and_arm_at(position):
        airborne.go_to(position, 20.0)
        run(airborne, 15.0)
        airborne.set_mode(SimulatedMode.LAND)
        run_until(airborne, lambda: not airborne.armed, 60.0)
        airborne.set_mode(SimulatedMode.GUIDED)
        assert airborne.arm()

    land_and_arm_at(40 + 0j)
    assert airborne.home.position == pytest.approx(40, abs=0.3)
    airborne.home = Home(5j, 0.0, locked=True)
    assert airborne.take_off(20.0)
    run(airborne, 20.0)
    land_and_arm_at(0j)
    assert airborne.home.position == 5j


def test_landing_disarms_two_seconds_after_touch_down(airborne):
    airborne.set_mode(SimulatedMode.LAND)
    run_until(airborne, lambda: airborne.body.on_ground, 60.0)
    assert run_until(airborne, lambda: airborne.landed, 5.0) == pytest.approx(1.6, abs=0.1)
    assert airborne.armed
    assert run_until(airborne, lambda: not airborne.armed, 5.0) == pytest.approx(0.5, abs=0.1)


def test_lost_remote_control_returns_and_its_return_changes_nothing(airborne):
    airborne.parameters['SIM_RC_FAIL'] = 1
    assert run_until(airborne, lambda: airborne.failsafe, 2.0) >= 0.9
    assert 'Radio Failsafe' in texts(airborne)
    assert airborne.mode == SimulatedMode.RTL
    airborne.parameters['SIM_RC_FAIL'] = 0
    run(airborne, 0.1)
    assert 'Radio Failsafe Cleared' in texts(airborne)
    assert not airborne.failsafe
    assert airborne.mode == SimulatedMode.RTL


def test_guided_goes_on_without_remote_control_if_wanted(airborne):
    airborne.parameters.update(FS_OPTIONS=4, SIM_RC3=900.0)  # as receivers without signal do
    run(airborne, 2.0)
    assert airborne.failsafe
    assert airborne.mode == SimulatedMode.GUIDED
    assert 'Radio Failsafe - Continuing Guided Mode' in texts(airborne)


def test_remote_control_is_not_watched_if_not_wanted(airborne):
    airborne.parameters.update(FS_THR_ENABLE=0, SIM_RC_FAIL=1)
    run(airborne, 5.0)
    assert not airborne.failsafe
    assert airborne.mode == SimulatedMode.GUIDED


def test_remote_control_lost_on_the_ground(flight):
    flight.parameters.update(SIM_RC_FAIL=1, FS_OPTIONS=4)
    run(flight, 2.0)
    assert texts(flight)[0] == 'Radio Failsafe - Disarming'
    assert flight.failsafe
    assert flight.arming_faults() == ['Radio failsafe on']


def test_arming_needs_a_low_throttle_but_none_below_the_failsafe(flight):
    flight.parameters['SIM_RC3'] = 1500.0
    assert flight.arming_faults() == []  # only arming itself asks for it
    assert not flight.arm()
    assert texts(flight) == ['Arm: Throttle (RC3) is not neutral']
    flight.parameters['SIM_RC3'] = 900.0
    assert flight.arming_faults() == ['Throttle below failsafe']
    flight.parameters['SIM_RC3'] = 1000.0
    assert flight.arm()


def test_lost_ground_station_returns_once_it_was_heard(airborne):
    airborne.parameters['FS_GCS_ENABLE'] = 1
    run(airborne, 20.0)
    assert not airborne.failsafe
    airborne.failsafes.hear_ground_station()
    wait = run_until(airborne, lambda: airborne.mode == SimulatedMode.RTL, 6.0)
    assert wait == pytest.approx(5.0, abs=0.1)
    assert 'GCS Failsafe' in texts(airborne)
    airborne.failsafes.hear_ground_station()
    run(airborne, 0.1)
    assert not airborne.failsafe


def test_remote_control_lost_in_a_critical_landing_changes_nothing(airborne):
    airborne.parameters.update(SIM_BATT_VOLTAGE=9.0, BATT_FS_LOW_ACT=1)
    run(airborne, 11.0)
    assert airborne.mode == SimulatedMode.LAND
    airborne.parameters['SIM_RC_FAIL'] = 1
    run(airborne, 2.0)
    assert airborne.mode == SimulatedMode.LAND
    assert 'Radio Failsafe - Continuing Landing' in texts(airborne)


def test_targets_outside_the_fence_are_refused(airborne):
    airborne.parameters.update(FENCE_ENABLE=1, FENCE_RADIUS=50.0, FENCE_ALT_MAX=30.0)
    airborne.texts.clear()
    assert not airborne.go_to(51 + 0j, 20.0)
    assert not airborne.go_to(0j, 31.0)
    assert texts(airborne) == []
    assert airborne.go_to(49 + 0j, 29.0)


@pytest.mark.parametrize(
    ('limits', 'kind'),
    [({'FENCE_RADIUS': 50.0}, 'Circle'), ({'FENCE_ALT_MAX': 10.0}, 'Max Alt')],
)
def test_breached_fence_returns(airborne, limits, kind):
    airborne.go_to(70 + 0j, 20.0)
    run(airborne, 20.0)
    airborne.parameters.update(FENCE_ENABLE=1, **limits)
    run(airborne, 0.1)
    assert airborne.mode == SimulatedMode.RTL
    assert texts(airborne)[-1] == f'{kind} fence breached'
    assert airborne.failsafes.fence
    assert not airborne.failsafe
    run_until(airborne, lambda: not airborne.armed, 90.0)
    run(airborne, 0.1)
    assert not airborne.failsafes.fence


def test_reboot_starts_anew_where_it_is(airborne):
    assert not airborne.reboot()
    airborne.go_to(30 + 0j, 20.0)
    run(airborne, 15.0)
    airborne.set_mode(SimulatedMode.LAND)
    run_until(airborne, lambda: not airborne.armed, 60.0)
    charge = airborne.body.battery.charge
    assert airborne.reboot()
    assert airborne.time < 0.0
    assert airborne.mode == SimulatedMode.STABILIZE
    assert not airborne.position_ok
    run(airborne, 6.1)
    assert airborne.position_ok
    assert airborne.body.position == pytest.approx(30.0, abs=0.3)
    assert airborne.home.position == airborne.body.position
    assert airborne.body.battery.charge == pytest.approx(charge, abs=0.01)


def test_idle_motors_stop_after_ten_seconds(flight):
    flight.arm()
    run(flight, 9.9)
    assert flight.armed
    assert min(flight.body.motors) > 1000
    run(flight, 0.2)
    assert not flight.armed
    assert flight.body.motors == (1000,) * 4


def test_disarming_in_the_air_needs_force(airborne):
    assert not airborne.disarm()
    assert airborne.disarm(force=True)
    assert airborne.landed
    run(airborne, 1.0)
    assert airborne.body.altitude > 10.0
    run(airborne, 3.0)
    assert airborne.body.on_ground
    assert airborne.body.impact > 10.0


def test_modes_that_are_refused(airborne):
    assert not airborne.set_mode(SimulatedMode.AUTO)  # there is no mission
    assert not airborne.set_mode(99)
    assert texts(airborne)[-2:] == ['Mode change to AUTO failed: init failed', 'No such mode 99']
    assert airborne.mode == SimulatedMode.GUIDED


def test_nobody_at_the_sticks_of_stabilize(airborne):
    airborne.set_mode(SimulatedMode.STABILIZE)
    run_until(airborne, lambda: not airborne.armed, 20.0)
    assert 'Crash: Disarming' in texts(airborne)


def test_same_seed_same_noise():
    def outputs(seed):
        flight = SimulatedFlight(ORIGIN, boot_seconds=0.1, seed=seed)
        flight.parameters['SIM_WIND_TURB'] = 1.0
        run(flight, 0.2)
        flight.set_mode(SimulatedMode.GUIDED)
        flight.arm()
        flight.take_off(5.0)
        run(flight, 5.0)
        return flight.body.motors, flight.wind

    assert outputs(3) == outputs(3)
    for same, other in zip(outputs(3), outputs(4)):
        assert same != other
