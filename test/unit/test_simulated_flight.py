"""The simulated multirotor, its modes and failsafes, stepped by hand."""

from __future__ import annotations

from statistics import mean

import pytest

from uav_mission_manager.autopilot.simulator.flight import Home, SimulatedFlight
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
        (SimulatedOrigin(0.0, 0.0, 0.0), (1.0, 0.0), 110574.3 + 0j),
        (SimulatedOrigin(60.0, 10.0, 0.0), (60.0, 11.0), 55800j),
    ],
)
def test_local_frame_has_the_lengths_of_wgs84(origin, place, expected):
    assert origin.to_local(*place) == pytest.approx(expected, rel=1e-4)
    assert origin.to_geodetic(origin.to_local(*place)) == pytest.approx(place, abs=1e-9)


def test_arming_waits_for_the_boot():
    flight = SimulatedFlight(ORIGIN)
    run(flight, 4.9)
    assert not flight.arm()
    assert not flight.set_mode(SimulatedMode.GUIDED)
    assert 'PreArm: EKF3 still initialising' in texts(flight)
    run(flight, 0.2)
    assert flight.arm()


def test_take_off_only_armed_in_guided_and_on_the_ground(flight):
    assert not flight.take_off(20.0)
    assert flight.set_mode(SimulatedMode.LOITER)
    assert flight.arm()
    assert not flight.take_off(20.0)
    assert flight.set_mode(SimulatedMode.GUIDED)
    assert not flight.take_off(-1.0)
    assert flight.take_off(20.0)
    run(flight, 15.0)
    assert not flight.take_off(30.0)


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


def test_speed_lasts_until_the_mode_changes(airborne):
    assert airborne.set_speed(1, 4.0)
    airborne.go_to(1000 + 0j, 20.0)
    run(airborne, 8.0)
    assert abs(airborne.body.velocity) == pytest.approx(4.0)
    airborne.set_mode(SimulatedMode.LOITER)
    assert not airborne.set_speed(1, 6.0)
    airborne.set_mode(SimulatedMode.GUIDED)
    airborne.go_to(1000 + 0j, 20.0)
    run(airborne, 8.0)
    assert abs(airborne.body.velocity) == pytest.approx(10.0)


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


def test_empty_battery_stops_the_motors(airborne):
    airborne.set_charge(0.0)
    run(airborne, 6.0)
    assert airborne.body.on_ground
    assert 'Crash: Disarming' in texts(airborne)


def test_low_charge_returns_then_lands(airborne):
    airborne.parameters['BATT_CRT_VOLT'] = 10.3
    airborne.go_to(200 + 0j, 20.0)
    run(airborne, 10.0)
    airborne.set_charge(9.0)
    assert run_until(airborne, lambda: airborne.mode == SimulatedMode.RTL, 11.0) >= 10.0
    assert airborne.failsafe
    assert airborne.battery.level == 1
    assert run_until(airborne, lambda: airborne.mode == SimulatedMode.LAND, 11.0) >= 10.0
    assert airborne.battery.level == 2
    assert texts(airborne).count('Battery Failsafe') == 2
    run_until(airborne, lambda: not airborne.armed, 60.0)
    airborne.set_mode(SimulatedMode.GUIDED)
    assert not airborne.arm()
    airborne.set_charge(100.0)
    run(airborne, 0.1)
    assert airborne.battery.level == 0
    assert airborne.arm()


def test_low_voltage_leaves_the_charge(airborne):
    airborne.parameters['SIM_BATT_VOLTAGE'] = 9.0
    run_until(airborne, lambda: airborne.mode == SimulatedMode.RTL, 11.0)
    assert airborne.body.battery.charge > 0.95


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
    assert run_until(airborne, lambda: not airborne.gps_fix, 3.0) > 0.5
    assert airborne.position_ok
    assert run_until(airborne, lambda: airborne.mode == SimulatedMode.LAND, 8.0) > 5.0
    assert airborne.failsafe
    assert not airborne.set_mode(SimulatedMode.GUIDED)
    assert airborne.set_mode(SimulatedMode.LAND)
    run_until(airborne, lambda: not airborne.armed, 60.0)
    assert airborne.body.position.real > 20.0
    assert not airborne.failsafe
    airborne.parameters['SIM_GPS1_ENABLE'] = 1.0
    run(airborne, 0.1)
    assert airborne.set_mode(SimulatedMode.GUIDED)


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
    run(airborne, 4.0)
    assert airborne.body.on_ground
    assert airborne.body.impact > 10.0


def test_modes_that_are_refused(airborne):
    assert not airborne.set_mode(SimulatedMode.AUTO)  # there is no mission
    assert not airborne.set_mode(99)
    assert airborne.mode == SimulatedMode.GUIDED


def test_nobody_at_the_sticks_of_stabilize(airborne):
    airborne.set_mode(SimulatedMode.STABILIZE)
    run_until(airborne, lambda: not airborne.armed, 20.0)
    assert 'Crash: Disarming' in texts(airborne)


def test_same_seed_same_noise():
    def outputs(seed):
        flight = SimulatedFlight(ORIGIN, boot_seconds=0.1, seed=seed)
        run(flight, 0.2)
        flight.set_mode(SimulatedMode.GUIDED)
        flight.arm()
        flight.take_off(5.0)
        run(flight, 1.0)
        return flight.body.motors

    assert outputs(3) == outputs(3) != outputs(4)
