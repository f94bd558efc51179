"""A real ArduCopter, flown by the nodes as users start them."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_autopilot import BINARY, FRAMES
from real_chain import CASE_STUDY, RealChain
from ros_helpers import Ros
from scenarios import ROUND, SCENARIOS, Chain, a_round, visits

from uav_mission_manager.autopilot.vehicle import FlightMode
from uav_mission_manager.goal_task import GoalTask, Photo, task_to_dict
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.policy import build_policy

pytestmark = pytest.mark.skipif(
    not os.access(BINARY, os.X_OK),
    reason=f'ARDUCOPTER_BIN names no ArduCopter to fly: {BINARY!r}',
)

FORCE = 21196
"""Param2 of COMPONENT_ARM_DISARM that disarms in flight (ArduPilot's number)."""

Maker = Callable[..., RealChain]


@pytest.fixture
def make(ros: Ros) -> Iterator[Maker]:
    """Return a maker of chains on their own; none has an autopilot yet."""
    made: list[RealChain] = []

    def maker(frame: str = 'quad', **parameters: object) -> RealChain:
        made.append(RealChain(ros, frame, **parameters))
        return made[-1]

    yield maker
    for chain in made:
        chain.close()


@pytest.fixture
def chain(make: Maker) -> RealChain:
    """Return a chain with a quadrotor that is ready to fly."""
    return ready(make())


def ready(chain: RealChain) -> RealChain:
    """Start the autopilot and wait until it is ready to fly."""
    chain.launch()
    chain.until_ready()
    return chain


@pytest.mark.parametrize('frame', FRAMES)
@pytest.mark.parametrize('scenario', SCENARIOS, ids=lambda scenario: scenario.__name__)
def test_scenario(make: Maker, scenario: Callable[[Chain], None], frame: str) -> None:
    scenario(ready(make(frame)))


def mission_with(folder: Path, goal: int, task: GoalTask) -> Path:
    """Write the case study with a task at a goal, counted from 0."""
    document = yaml.safe_load(CASE_STUDY.read_text())
    document['goals'][goal]['task'] = task_to_dict(task)
    path = folder / 'with_task.yaml'
    path.write_text(yaml.safe_dump(document))
    return path


def test_pictures_are_taken_by_an_autopilot_with_a_camera(make: Maker, tmp_path: Path) -> None:
    chain = ready(make(mission=mission_with(tmp_path, 0, Photo(3, 1.0))))
    chain.set('CAM1_TYPE', 1)
    boots = chain.boots
    chain.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    chain.until(lambda: chain.boots > boots, 'reboot')
    chain.until_ready()
    chain.want(1, 0, 0)
    chain.until(lambda: chain.completed, 'goal completed')
    assert [number for _, number in chain.pictures] == [1, 2, 3]


def test_an_autopilot_without_a_camera_says_so(make: Maker, tmp_path: Path) -> None:
    chain = ready(make(mission=mission_with(tmp_path, 0, Photo(3, 1.0))))
    chain.want(1, 0, 0)
    chain.until(lambda: chain.refused, 'refused')
    chain.until(lambda: any('no picture: ' in why for why in chain.reasons), 'why')
    assert (chain.pictures, chain.completed) == ([], [])


def test_a_round_of_waypoints_is_flown(make: Maker, tmp_path: Path) -> None:
    mission = mission_with(tmp_path, 1, a_round(load_mission(CASE_STUDY)))
    chain = ready(make(mission=mission, cruise_speed=10.0))
    chain.want(0, 2, 0)
    chain.until(lambda: chain.completed, 'goal completed', 240.0)
    assert visits(chain) == list(range(len(ROUND)))


def until_landing_at_three_metres(chain: RealChain) -> None:
    """Fly to goal 1 and back, and nearly land."""
    chain.want(1, 0, 0)
    chain.until(lambda: chain.completed, 'goal completed')
    chain.until(lambda: chain.mode == FlightMode.LAND and chain.height < 3.0, 'landing')


def assert_nothing_is_ordered_until_resume(chain: RealChain, orders: int) -> None:
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command', 10.0)
    chain.until(lambda: not chain.armed, 'motors stopped')
    chain.want(0, 2, 0)
    chain.spend(15.0)
    assert chain.orders[orders:] == []
    assert '~/resume' in chain.report[1]


def test_the_ground_takes_a_landing_over(chain: RealChain) -> None:
    until_landing_at_three_metres(chain)
    orders = len(chain.orders)
    chain.put_into(FlightMode.RTL)
    assert_nothing_is_ordered_until_resume(chain, orders)
    assert chain.resume()[0]
    chain.until(lambda: 'goal2' in chain.completed, 'goal2 completed', 180.0)


def test_the_ground_stops_the_motors_above_the_ground(chain: RealChain) -> None:
    until_landing_at_three_metres(chain)
    orders = len(chain.orders)
    chain.tell(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, FORCE)
    chain.until(lambda: not chain.armed, 'motors stopped', 3.0)
    assert_nothing_is_ordered_until_resume(chain, orders)


def test_a_failsafe_returns_and_resume_goes_on(chain: RealChain) -> None:
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.set('SIM_RC_FAIL', 1)
    chain.until(lambda: chain.mode == FlightMode.RTL, 'RTL', 20.0)
    orders = len(chain.orders)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command', 5.0)
    chain.spend(3.0)
    chain.set('SIM_RC_FAIL', 0)
    chain.spend(3.0)
    assert chain.orders[orders:] == []
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')


def test_the_bridge_dies_in_flight_and_is_started_anew(chain: RealChain) -> None:
    chain.want(0, 2, 0)
    chain.until_flying()
    orders = len(chain.orders)
    chain.bridge.kill()
    chain.start_bridge()
    chain.until(lambda: chain.completed, 'goal completed')
    modes = [o for o in chain.orders[orders:] if o.number == mavlink.MAV_CMD_DO_SET_MODE]
    assert (modes, chain.mode) == ([], FlightMode.GUIDED)


def test_without_allow_arming_nothing_is_ordered(make: Maker) -> None:
    chain = ready(make(allow_arming=False))
    chain.want(0, 2, 0)
    chain.until(lambda: 'allow_arming' in chain.report[1], 'a word about it')
    chain.spend(15.0)
    assert (chain.armed, chain.orders) == (False, [])


def test_refused_arming_is_told_in_the_words_of_the_autopilot(chain: RealChain) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sticks:

        def throttle(pwm: int) -> None:
            channels = struct.pack('<16H', 1500, 1500, pwm, *[1500] * 13)
            assert chain.autopilot is not None
            sticks.sendto(channels, ('127.0.0.1', chain.autopilot.remote_control))

        throttle(1600)
        chain.spend(2.0)
        chain.want(0, 2, 0)
        chain.until(lambda: 'neutral' in chain.report[1], 'the words', 30.0)
        assert chain.report[0]
        chain.spend(40.0)
        assert not chain.armed
        arming = [o.time for o in chain.orders if o.number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM]
        assert 2 <= len(arming) <= 8, arming
        throttle(1000)
        chain.until(lambda: chain.completed, 'goal completed', 180.0)


def test_five_seconds_without_gps(chain: RealChain) -> None:
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.set('SIM_GPS1_ENABLE', 0)
    chain.spend(5.0)
    chain.set('SIM_GPS1_ENABLE', 1)
    chain.until(
        lambda: 'goal2' in chain.completed or not chain.armed,
        'flown on or landed by the failsafe of the autopilot',
        180.0,
    )
    assert chain.ordered_blindly == []


def test_without_gps_the_failsafe_lands(chain: RealChain) -> None:
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.set('SIM_GPS1_ENABLE', 0)
    chain.until(lambda: chain.mode == FlightMode.LAND, 'landing', 30.0)
    orders = len(chain.orders)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command', 5.0)
    assert 'failsafe' in chain.report[1]
    chain.until(lambda: not chain.armed, 'landed')
    chain.set('SIM_GPS1_ENABLE', 1)
    chain.until(lambda: chain.fault == 'nominal', 'GPS back')
    chain.spend(10.0)
    assert (chain.orders[orders:], chain.ordered_blindly) == ([], [])


@pytest.mark.parametrize(
    ('latitude', 'longitude', 'altitude'),
    [(60.0, 10.0, 3500.0), (0.0005, 9.0, 20.0)],
    ids=['high in the north', 'at the equator'],
)
def test_elsewhere_on_earth(
    make: Maker, tmp_path: Path, latitude: float, longitude: float, altitude: float
) -> None:
    path, policy = tmp_path / 'mission.yaml', tmp_path / 'policy'
    content = yaml.safe_load(CASE_STUDY.read_text())
    content['grid']['origin'] = {
        'latitude': latitude,
        'longitude': longitude,
        'altitude': altitude,
    }
    path.write_text(yaml.safe_dump(content))
    build_policy(load_mission(path), method='exact').save(policy)
    chain = ready(make(mission=path, policy=policy))
    chain.want(1, 2, 0)
    for goal in chain.mission.goals[:2]:
        chain.until(lambda goal=goal: goal.name in chain.completed, goal.name, 180.0)
        assert chain.distance(goal.cell) < 60.0
    assert 17.0 < max(sample.height for sample in chain.track) < 23.0
    assert 4.5 < max(sample.speed for sample in chain.track) <= 5.5
    chain.until_down_at(chain.mission.grid.base)


def test_the_bridge_is_there_before_the_autopilot(make: Maker) -> None:
    chain = make(tcp=True)
    chain.until(lambda: chain.phase == 'no link', 'no link', 30.0)
    chain.spend(10.0)
    chain.launch()
    chain.want(1, 0, 0)
    chain.until(lambda: chain.completed, 'goal completed', 240.0)
    assert len(chain.bridge.lines('Connection refused')) <= 1
