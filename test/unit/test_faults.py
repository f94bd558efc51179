from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.faults import Fault, FaultEstimator, effectiveness_by_thrust
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


HOVER_SPAN = 589.0  # PWM above 1000 of a healthy motor [us]


def ring(first: float, count: int, per_arm: int = 1) -> np.ndarray:
    """Thrust, roll, pitch and yaw of each motor of a regular frame.

    The arms go clockwise from the angle `first` [deg], one or two motors each; every next motor
    turns the other way, on the next arm the upper one too. Angles and directions are
    ArduCopter's (libraries/AP_Motors/AP_MotorsMatrix.cpp).
    """
    arms = count // per_arm
    angles = np.radians(first + 360.0 / arms * np.repeat(np.arange(arms), per_arm))
    turn = [(-1.0) ** (arm + level) for arm in range(arms) for level in range(per_arm)]
    return np.column_stack([np.ones(count), -np.sin(angles), np.cos(angles), turn])


RIGHT, LEFT, REAR = (1.0, -1.0, 0.666), (1.0, 1.0, 0.666), (1.0, 0.0, -1.333)
FRAMES = {
    'quad +': ring(0.0, 4),
    'quad X': ring(45.0, 4),
    'hexa +': ring(0.0, 6),
    'hexa X': ring(30.0, 6),
    'octa +': ring(0.0, 8),
    'octa X': ring(22.5, 8),
    'deca X': ring(18.0, 10),
    'X8': ring(45.0, 8, per_arm=2),
    'Y6': np.array([(*arm, turn) for arm in (RIGHT, LEFT, REAR) for turn in (1.0, -1.0)]),
    'dodecahexa': ring(30.0, 12, per_arm=2),
}


def balanced(
    frame: np.ndarray, effectiveness: dict[int, float], moment: tuple[float, ...] = (0.0,) * 3
) -> np.ndarray:
    """Thrusts asked for that balance the vehicle with weak motors, 1 each of healthy ones.

    The controller moves its four axes until thrust and moments are what they have to be; the
    thrust goes with the square of the command.
    """
    count = len(frame)
    strength = np.diag([effectiveness.get(motor, 1.0) ** 2 for motor in range(count)])
    needed = frame.T @ np.ones(count) + count * np.array([0.0, *moment])
    axes, *_ = np.linalg.lstsq(frame.T @ strength @ frame, needed, rcond=None)
    return frame @ axes


def seen_evenly(thrusts: np.ndarray) -> tuple[float, ...]:
    return effectiveness_by_thrust(thrusts / thrusts.mean(), np.ones(len(thrusts)))


def outputs(thrusts: np.ndarray) -> tuple[int, ...]:
    pwm = [1000 + round(HOVER_SPAN * thrust**0.5) for thrust in thrusts]
    return tuple(pwm) + (0,) * (16 - len(pwm))


def hover(effectiveness: float = 1.0, hovering: int = 1589) -> tuple[int, ...]:
    weak = 1000 + round((hovering - 1000) / effectiveness)
    return (min(weak, 1950), hovering, hovering, hovering, 1500, 1500, 1500, 1500)


class Watch:
    """An estimator fed at 5 Hz."""

    def __init__(self, threshold: float = 0.85) -> None:
        self.estimator = FaultEstimator(threshold)
        self.now = 100.0

    def time_to(self, fault: Fault, telemetry: Telemetry) -> float:
        """Time [s] until `fault` is reported, 20 s at most."""
        start = self.now
        while self.see(0.2, telemetry) != fault and self.now < start + 20.0:
            pass
        return self.now - start

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


@pytest.mark.parametrize('name', FRAMES)
@pytest.mark.parametrize('effectiveness', [0.95, 0.8, 0.7, 0.5])
def test_the_thrusts_asked_for_tell_the_effectiveness_of_a_weak_motor(name, effectiveness):
    frame = FRAMES[name]
    for motor in range(len(frame)):
        thrusts = balanced(frame, {motor: effectiveness})
        seen = seen_evenly(thrusts)
        assert seen[motor] == pytest.approx(effectiveness, abs=1e-6)
        assert min(np.delete(seen, motor)) > 0.9


def test_frames_that_are_not_regular_are_read_approximately():
    sides = np.array([-1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 1.0, -1.0])
    rows = np.array([1.0, -1.0, 1 / 3, -1.0, 1.0, -1 / 3, 1 / 3, -1 / 3])
    turn = np.array([-1.0, -1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
    octa_h = np.column_stack([np.ones(8), sides, rows, turn])
    seen = []
    for motor in range(8):
        thrusts = balanced(octa_h, {motor: 0.8})
        seen.append(seen_evenly(thrusts)[motor])
    assert sorted(seen) == pytest.approx([0.74] * 4 + [0.92] * 4, abs=0.01)


@pytest.mark.parametrize('name', FRAMES)
@pytest.mark.parametrize('effectiveness', [0.8, 0.7])
def test_a_weak_motor_of_any_frame_is_reported_within_five_seconds(name, effectiveness):
    frame = FRAMES[name]
    motor_count, weakest = len(frame), len(frame) - 1
    healthy = replace(HEALTHY, motor_count=motor_count, motors=outputs(np.ones(motor_count)))
    weak = replace(healthy, motors=outputs(balanced(frame, {weakest: effectiveness})))
    watch = Watch()
    assert watch.see(10.0, healthy) == NOMINAL
    assert watch.time_to(Fault.ACTUATOR, weak) < 4.0
    watch.see(10.0, weak)
    assert watch.estimator.effectiveness[weakest] == pytest.approx(effectiveness, abs=0.03)


@pytest.mark.parametrize('name', FRAMES)
def test_turning_is_no_weak_motor(name):
    frame = FRAMES[name]
    for yaw in (-0.3, 0.3):
        motors = outputs(balanced(frame, {}, (0.0, 0.0, yaw)))
        watch = Watch()
        assert watch.see(20.0, replace(HEALTHY, motor_count=len(frame), motors=motors)) == NOMINAL
        assert min(watch.estimator.effectiveness) > 0.98


def off_centre(offset: float, direction: float) -> tuple[float, float, float]:
    """Moment of a centre of gravity that is off by `offset` [arm lengths]."""
    return -offset * np.sin(direction), offset * np.cos(direction), 0.0


@pytest.mark.parametrize(
    ('name', 'tolerated'),
    [('quad +', 0.34), ('hexa X', 0.19), ('octa X', 0.13), ('X8', 0.13), ('dodecahexa', 0.08)],
)
def test_only_a_centre_of_gravity_that_is_far_off_looks_like_a_weak_motor(name, tolerated):
    frame = FRAMES[name]
    alarms = []
    for direction in np.linspace(0.0, 2.0 * np.pi, 49):
        thrusts = balanced(frame, {}, off_centre(tolerated, direction))
        assert min(seen_evenly(thrusts)) > 0.85
        thrusts = balanced(frame, {}, off_centre(1.2 * tolerated, direction))
        alarms.append(min(seen_evenly(thrusts)) < 0.85)
    assert any(alarms)


@pytest.mark.parametrize('name', FRAMES)
def test_a_centre_of_gravity_off_a_little_hides_no_weak_motor(name):
    frame = FRAMES[name]
    for direction in np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False):
        offset = off_centre(0.05, direction)
        uneven = outputs(balanced(frame, {}, offset))
        healthy = replace(HEALTHY, motor_count=len(frame), motors=uneven)
        weak = replace(healthy, motors=outputs(balanced(frame, {0: 0.8}, offset)))
        watch = Watch()
        assert watch.see(60.0, healthy) == NOMINAL
        assert watch.time_to(Fault.ACTUATOR, weak) < 5.0


def test_a_motor_that_is_weak_from_the_start_stays_weak():
    watch = Watch(threshold=0.75)
    weak = replace(HEALTHY, motors=hover(0.8))
    assert watch.see(600.0, weak) == NOMINAL
    assert watch.estimator.effectiveness[0] == pytest.approx(0.8, abs=0.01)


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
    [
        {'armed': False},
        {'landed': True},
        {'position': replace(HEALTHY.position, height=1.0)},
        {'position': None},
    ],
    ids=['disarmed', 'landed', 'low', 'height unknown'],
)
def test_motors_are_judged_in_the_air_only(ground):
    watch = Watch()
    assert watch.see(20.0, replace(HEALTHY, motors=hover(0.6), **ground)) == NOMINAL


def test_motors_are_not_judged_while_it_is_unknown_whether_it_flies(monkeypatch):
    monkeypatch.setattr(Telemetry, 'on_ground', None)
    assert Watch().see(20.0, replace(HEALTHY, motors=hover(0.6))) == NOMINAL


def test_as_many_motors_as_the_frame_has():
    watch = Watch()
    six = (1589,) * 5 + (1900,)
    assert watch.see(10.0, replace(HEALTHY, motors=six, motor_count=4)) == NOMINAL
    weak = (1589, 1900, 1589, 1589)
    assert watch.see(10.0, replace(HEALTHY, motors=weak, motor_count=0)) == NOMINAL
    assert watch.see(10.0, replace(HEALTHY, motors=six, motor_count=6)) == Fault.ACTUATOR


@pytest.mark.parametrize('motors', [(1589,) * 4 + (1900, 0), (1589,) * 4 + (1900,)])
def test_motors_whose_outputs_are_not_sent_are_not_judged(motors):
    watch = Watch()
    assert watch.see(20.0, replace(HEALTHY, motors=motors, motor_count=6)) == NOMINAL
    assert watch.estimator.effectiveness == ()


def test_one_look_after_a_gap_is_no_weak_motor():
    watch = Watch()
    watch.see(5.0, replace(HEALTHY, motors=hover()))
    for _ in range(5):
        watch.now += 30.0
        assert watch.see(0.4, replace(HEALTHY, motors=hover(0.6))) == NOMINAL
        assert min(watch.estimator.effectiveness) > 0.9


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


BOOTING = (
    # EKF flags, fix type, unhealthy sensors: as ArduCopter boots
    (mavlink.EKF_UNINITIALIZED, 0, GYRO | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG),
    (mavlink.EKF_UNINITIALIZED, 1, 0),
    (0xA7, 1, mavlink.MAV_SYS_STATUS_SENSOR_GPS),
    (0xA7, 3, 0),
)


def boot(watch: Watch) -> None:
    for flags, fix, unhealthy in BOOTING:
        booting = replace(HEALTHY, armed=False, ekf_flags=flags, fix_type=fix, unhealthy=unhealthy)
        assert watch.see(10.0, booting, camera_age=30.0) is None


def test_a_booting_autopilot_has_no_fault():
    watch = Watch()
    boot(watch)
    assert watch.see(10.0, replace(HEALTHY, armed=False)) == NOMINAL


def test_a_reboot_forgets_all_faults_but_that_of_the_actuators():
    watch = Watch()
    broken = replace(HEALTHY, unhealthy=GYRO, motors=hover(0.7))
    assert watch.see(8.0, broken, camera_age=9.0) == 7
    watch.estimator.rebooted()
    boot(watch)
    assert watch.see(0.2, replace(HEALTHY, armed=False)) == Fault.ACTUATOR
    watch.estimator.serviced()
    assert watch.see(10.0, replace(HEALTHY, armed=False)) == NOMINAL


def test_a_fault_seen_before_a_reboot_has_to_last_anew():
    watch = Watch()
    watch.see(1.0)
    watch.see(0.8, replace(HEALTHY, unhealthy=GYRO))
    watch.estimator.rebooted()
    assert watch.see(0.8, replace(HEALTHY, unhealthy=GYRO)) == NOMINAL
    assert watch.see(0.6, replace(HEALTHY, unhealthy=GYRO)) == Fault.SENSOR


@pytest.mark.parametrize(
    'failing',
    [
        ({'unhealthy': mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG},),
        ({'fix_type': 1}, {'fix_type': 1, 'ekf_flags': 0xA7}, {'ekf_flags': 0xA7}),
    ],
    ids=['compass', 'GPS'],
)
def test_a_sensor_that_fails_and_recovers_on_a_parked_vehicle(failing):
    watch = Watch()
    parked = replace(HEALTHY, armed=False, landed=True)
    assert watch.see(5.0, parked) == NOMINAL
    for change in failing:
        assert watch.see(8.0, replace(parked, **change)) == Fault.SENSOR
    assert watch.see(8.0, parked) == NOMINAL


def test_a_lost_link_keeps_faults_but_asks_for_a_new_fix():
    watch = Watch()
    assert watch.see(6.0, replace(HEALTHY, motors=hover(0.7))) == Fault.ACTUATOR
    watch.estimator.link_lost()
    assert watch.see(5.0, replace(HEALTHY, fix_type=1)) is None
    assert watch.see(0.2) == Fault.ACTUATOR
