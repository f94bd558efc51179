from __future__ import annotations

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.faults import Fault, FaultEstimator
from uav_mission_manager.autopilot.telemetry import Position, Telemetry

HEALTHY = Telemetry(
    mode=4,
    armed=True,
    landed=False,
    unhealthy=0,
    fix_type=3,
    ekf_flags=831,
    position=Position(0.0, -35.0, 149.0, 604.0, 20.0),
)
GYRO = mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
NOMINAL = Fault(0)


def hover(effectiveness: float = 1.0, hovering: int = 1589) -> tuple[int, ...]:
    weak = 1000 + round((hovering - 1000) / effectiveness)
    return (min(weak, 1950), hovering, hovering, hovering, 1500, 1500, 1500, 1500)


class Watch:
    """An estimator fed at 5 Hz."""

    def __init__(self, threshold: float = 0.85) -> None:
        self.estimator = FaultEstimator(threshold)
        self.now = 100.0

    def see(self, seconds: float, telemetry: Telemetry = HEALTHY, camera_age: float | None = 0.5):
        for _ in range(round(seconds * 5)):
            self.now += 0.2
            fault = self.estimator.update(
                replace(telemetry, motors_time=self.now), camera_age, self.now
            )
        return fault


@pytest.mark.parametrize('missing', ['unhealthy', 'fix_type', 'ekf_flags'])
def test_nothing_is_said_before_telemetry_suffices(missing):
    watch = Watch()
    assert watch.see(5.0, replace(HEALTHY, **{missing: None})) is None
    assert watch.see(0.2) == NOMINAL


@pytest.mark.parametrize('missing', ['unhealthy', 'fix_type', 'ekf_flags'])
def test_nothing_is_said_once_telemetry_does_not_suffice_any_more(missing):
    watch = Watch()
    assert watch.see(1.0) == NOMINAL
    watch.see(0.8, replace(HEALTHY, unhealthy=GYRO))
    assert watch.see(9.0, replace(HEALTHY, **{missing: None})) is None
    assert watch.see(0.4, replace(HEALTHY, unhealthy=GYRO)) == NOMINAL, 'seen in one go only'


def test_nothing_is_said_before_the_first_fix():
    watch = Watch()
    assert watch.see(60.0, replace(HEALTHY, fix_type=1, ekf_flags=167)) is None
    assert watch.see(0.2) == NOMINAL


@pytest.mark.parametrize(
    'change',
    [
        {'unhealthy': GYRO},
        {'unhealthy': mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL},
        {'unhealthy': mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG},
        {'unhealthy': mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE},
        {'unhealthy': mavlink.MAV_SYS_STATUS_SENSOR_GPS},
        {'fix_type': 1},
        {'ekf_flags': 831 | mavlink.EKF_GPS_GLITCHING},
        {'ekf_flags': 831 | mavlink.EKF_CONST_POS_MODE},
        {'ekf_flags': 831 & ~mavlink.EKF_POS_HORIZ_ABS},
    ],
    ids=str,
)
def test_a_failed_sensor(change):
    watch = Watch()
    watch.see(1.0)
    assert watch.see(0.8, replace(HEALTHY, **change)) == NOMINAL
    assert watch.see(0.6, replace(HEALTHY, **change)) == Fault.SENSOR


@pytest.mark.parametrize(
    'bit',
    [
        mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER,
        mavlink.MAV_SYS_STATUS_SENSOR_BATTERY,
        mavlink.MAV_SYS_STATUS_PREARM_CHECK,
    ],
)
def test_other_health_bits_are_no_sensor_fault(bit):
    watch = Watch()
    assert watch.see(10.0, replace(HEALTHY, unhealthy=bit)) == NOMINAL


def test_a_sensor_fault_clears_after_five_seconds_of_health():
    watch = Watch()
    watch.see(1.0)
    assert watch.see(2.0, replace(HEALTHY, unhealthy=GYRO)) == Fault.SENSOR
    assert watch.see(4.8) == Fault.SENSOR
    assert watch.see(0.2, replace(HEALTHY, unhealthy=GYRO)) == Fault.SENSOR
    assert watch.see(4.8) == Fault.SENSOR, 'health has to last'
    assert watch.see(0.6) == NOMINAL


def test_a_camera_never_heard_is_no_fault_but_a_lost_one_is():
    watch = Watch()
    assert watch.see(10.0, camera_age=None) == NOMINAL
    assert watch.see(10.0, camera_age=2.9) == NOMINAL
    assert watch.see(1.4, camera_age=3.1) == Fault.CAMERA
    assert watch.see(5.4, camera_age=0.1) == NOMINAL


@pytest.mark.parametrize(
    ('effectiveness', 'expected'),
    [
        (1.0, NOMINAL),
        (0.9, NOMINAL),
        (0.8, Fault.ACTUATOR),
        (0.7, Fault.ACTUATOR),
        (0.6, Fault.ACTUATOR),
    ],
)
def test_a_weak_motor_turns_up(effectiveness, expected):
    watch = Watch()
    assert watch.see(10.0, replace(HEALTHY, motors=hover())) == NOMINAL
    assert watch.see(10.0, replace(HEALTHY, motors=hover(effectiveness))) == expected
    assert watch.estimator.effectiveness[0] == pytest.approx(effectiveness, abs=0.03)
    assert watch.estimator.effectiveness[1:] == pytest.approx((1.0,) * 3, abs=0.01)


def test_a_short_manoeuvre_is_no_weak_motor():
    watch = Watch()
    watch.see(5.0, replace(HEALTHY, motors=hover()))
    for _ in range(5):
        assert watch.see(0.6, replace(HEALTHY, motors=hover(0.7))) == NOMINAL
        assert watch.see(3.0, replace(HEALTHY, motors=hover())) == NOMINAL


def test_motors_that_stop_do_not_hide_a_weak_one():
    watch = Watch()
    watch.see(1.0, replace(HEALTHY, motors=(1000, 1589, 1589, 1589)))
    assert watch.see(6.0, replace(HEALTHY, motors=hover(0.7))) == Fault.ACTUATOR


@pytest.mark.parametrize(
    'ground',
    [{'armed': False}, {'landed': True}, {'position': replace(HEALTHY.position, height=1.0)}],
    ids=['disarmed', 'landed', 'low'],
)
def test_motors_are_judged_in_the_air_only(ground):
    watch = Watch()
    assert watch.see(20.0, replace(HEALTHY, motors=hover(0.6), **ground)) == NOMINAL


def test_as_many_motors_as_the_frame_has():
    watch = Watch()
    six = (1589,) * 5 + (1900,)
    assert watch.see(10.0, replace(HEALTHY, motors=six, motor_count=4)) == NOMINAL
    weak = (1589, 1900, 1589, 1589)
    assert watch.see(10.0, replace(HEALTHY, motors=weak, motor_count=0)) == NOMINAL
    assert watch.see(10.0, replace(HEALTHY, motors=six, motor_count=6)) == Fault.ACTUATOR


def test_an_actuator_fault_stays_until_serviced_and_is_found_again():
    watch = Watch()
    weak = replace(HEALTHY, motors=hover(0.7))
    ground = replace(HEALTHY, armed=False, motors=hover())
    assert watch.see(6.0, weak) == Fault.ACTUATOR
    assert watch.see(60.0, replace(HEALTHY, motors=hover())) == Fault.ACTUATOR
    assert watch.see(60.0, ground) == Fault.ACTUATOR
    watch.estimator.serviced()
    assert watch.see(60.0, ground) == NOMINAL
    assert watch.see(6.0, weak) == Fault.ACTUATOR


def test_service_repairs_the_actuators_only():
    watch = Watch()
    watch.see(1.0)
    assert watch.see(8.0, replace(HEALTHY, unhealthy=GYRO, motors=hover(0.7))) == 3
    watch.estimator.serviced()
    assert watch.see(0.2, replace(HEALTHY, unhealthy=GYRO, armed=False)) == Fault.SENSOR


def test_unhealthy_propulsion_is_an_actuator_fault():
    watch = Watch()
    watch.see(1.0)
    unhealthy = mavlink.MAV_SYS_STATUS_SENSOR_PROPULSION
    assert watch.see(1.4, replace(HEALTHY, unhealthy=unhealthy)) == Fault.ACTUATOR


def test_faults_add_up_to_the_fault_mode():
    watch = Watch()
    watch.see(1.0)
    broken = replace(HEALTHY, unhealthy=GYRO, motors=hover(0.6))
    assert watch.see(8.0, broken, camera_age=9.0) == 7


def test_a_lost_link_keeps_faults_but_asks_for_a_new_fix():
    watch = Watch()
    assert watch.see(6.0, replace(HEALTHY, motors=hover(0.7))) == Fault.ACTUATOR
    watch.estimator.link_lost()
    assert watch.see(5.0, replace(HEALTHY, fix_type=1)) is None
    assert watch.see(0.2) == Fault.ACTUATOR
