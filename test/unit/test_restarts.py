"""A bridge that dies, and the one after it: what was true before is true again."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scenarios import NEEDED_BEFORE_AN_ORDER, ROUND, a_round, visits
from simulated_chain import SETTINGS, SimulatedChain

from uav_mission_manager.autopilot.bridge import VehicleBridge
from uav_mission_manager.autopilot.faults import FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.vehicle import FlightMode
from uav_mission_manager.goal_task import Dwell, External, Photo
from uav_mission_manager.policy import load_policy

POLICY = load_policy(Path(__file__).parents[2] / 'policies' / 'case_study')
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
TO_FLY = (ARM, mavlink.MAV_CMD_NAV_TAKEOFF)


class Mortal(SimulatedChain):
    """The chain with a bridge that can be killed, and comes back with its memory."""

    def __init__(self, settings=SETTINGS, **options: Any) -> None:
        super().__init__(POLICY, settings=settings, **options)
        self.settings = settings
        self.memory, self.written_at = '', 0.0
        self._adopt(self.bridge)

    def _adopt(self, bridge: VehicleBridge) -> None:
        self.bridge = bridge
        bridge.remember = self._remember

    def _remember(self, memory: dict[str, Any]) -> None:
        text = json.dumps(memory)
        if text != self.memory:
            self.memory, self.written_at = text, self.now

    def kill_bridge(self, seconds: float = 3.0) -> None:
        """End the bridge; another one starts after some seconds."""
        self.end_bridge(seconds)
        if self.memory:
            self.bridge.restore(json.loads(self.memory), self.written_at)

    def end_bridge(self, seconds: float = 3.0) -> None:
        self.stall(seconds)
        self.port.arrived.clear()
        self.heard.clear()
        link = AutopilotLink(self.port, source_system=245)
        self._adopt(VehicleBridge(link, Pilot(self.settings, self._plan.ground), FaultEstimator()))

    def until_ready(self) -> None:
        self.until(lambda: self.ready and self.fault == 'nominal', 'ready')

    def orders_to_fly(self) -> list[Any]:
        return [order for order in self.orders if order.number in TO_FLY]

    def beat_as_camera(self) -> None:
        """Let the bridge hear a camera."""
        camera = mavlink.MAVLink(None, srcSystem=1, srcComponent=100)
        ids = mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID
        self.port.arrived.append(mavlink.MAVLink_heartbeat_message(*ids, 0, 0, 4, 3).pack(camera))


def flying() -> Mortal:
    chain = Mortal()
    chain.want(0, 2, 0)
    chain.until_flying()
    return chain


# Held, taken over, returning


def test_held_on_the_ground_it_stays():
    chain = Mortal()
    chain.until_ready()
    assert chain.hold()[0]
    chain.want(0, 2, 0)
    for _ in range(3):
        chain.kill_bridge()
        chain.spend(15.0)
    assert (chain.armed, chain.orders_to_fly(), chain.phase) == (False, [], 'holding')
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')


def test_held_in_flight_it_holds_there():
    chain = flying()
    assert chain.hold()[0]
    chain.spend(5.0)
    place = chain.track[-1]
    chain.kill_bridge()
    chain.until(lambda: chain.phase == 'holding', 'holding')
    chain.spend(10.0)
    assert abs(chain.track[-1].east - place.east) + abs(chain.track[-1].north - place.north) < 5.0
    assert chain.report == (True, 'holding: until ~/resume')
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')


def test_resumed_it_is_not_held():
    chain = Mortal()
    chain.until_ready()
    chain.hold()
    chain.resume()
    chain.want(0, 2, 0)
    chain.kill_bridge()
    chain.until(lambda: chain.completed, 'goal completed')


class HardOfHearing(Mortal):
    """The chain whose bridge may not hear one kind of message."""

    unheard: int | None = None

    def _step_bridge(self) -> None:
        if self.unheard is not None:
            unheard = self.unheard.to_bytes(3, 'little')
            heard = [data for data in self.port.arrived if data[7:10] != unheard]
            self.port.arrived.clear()
            self.port.arrived.extend(heard)
        super()._step_bridge()


def test_a_resume_before_the_vehicle_is_known_takes_nothing_from_a_pilot():
    chain = HardOfHearing()
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.cut()
    chain.until(lambda: chain.phase == 'no link', 'no link')
    chain.unheard = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
    chain.mend()
    chain.until(lambda: chain.phase == 'waiting', 'waiting')
    resumed, why = chain.resume()
    assert not resumed
    assert 'landed state' in why
    chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, FlightMode.RTL)
    chain.spend(3.0)
    chain.unheard, orders = None, len(chain.orders)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command')
    chain.spend(10.0)
    assert chain.orders[orders:] == []


def test_a_landing_that_was_broken_off_goes_on_if_a_pilot_wants_it():
    """Before GUIDED is heard of, LAND may be the bridge's own; once it is accepted, it is not."""
    chain = HardOfHearing()
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.want(0, 0, 0)
    chain.until(lambda: chain.phase == 'landing', 'landing')
    chain.spend(3.0)
    chain.want(0, 2, 0)
    chain.until(lambda: 'commit' in chain.command, 'another command')
    chain.unheard = mavlink.MAVLINK_MSG_ID_HEARTBEAT
    chain.until(lambda: chain.flight.mode == FlightMode.GUIDED, 'broken off')
    chain.spend(0.2)
    chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, FlightMode.LAND)
    chain.spend(0.2)
    chain.unheard, orders = None, len(chain.orders)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command', 5.0)
    chain.spend(10.0)
    assert chain.orders[orders:] == []


@pytest.mark.parametrize('seen', [True, False])
@pytest.mark.parametrize('mode', [FlightMode.LOITER, FlightMode.RTL, FlightMode.LAND])
def test_whoever_took_over_has_it_until_resume(mode, seen):
    """Whether the bridge saw it, or was dead when the mode was changed and all the way down."""
    chain = flying()
    chain.put_into(mode) if seen else chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)
    chain.spend(2.0) if seen else chain.kill_bridge(5.0)
    orders = len(chain.orders)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command')
    chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, FlightMode.LAND)
    chain.kill_bridge(60.0)
    chain.until(lambda: not chain.armed, 'landed')
    chain.kill_bridge()
    chain.spend(20.0)
    assert chain.orders[orders:] == []
    assert chain.phase == 'pilot in command'
    assert chain.report[0]
    assert chain.resume()[0]
    chain.until(lambda: 'goal2' in chain.completed, 'goal completed', 180.0)


def landed() -> Mortal:
    """Down after a mission, in LAND, with nothing wanted."""
    chain = Mortal()
    chain.want(1, 0, 0)
    chain.until(lambda: chain.completed, 'goal completed')
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    chain.spend(10.0)
    return chain


def test_a_mode_set_by_hand_on_the_ground_is_taken_over_unseen_too():
    chain = landed()
    chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, FlightMode.STABILIZE)
    chain.kill_bridge()
    orders = len(chain.orders)
    chain.want(0, 2, 0)
    chain.spend(20.0)
    assert (chain.phase, chain.orders[orders:]) == ('pilot in command', [])


def test_a_vehicle_that_was_switched_off_and_on_is_nobodys():
    chain = landed()
    chain.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    chain.kill_bridge(10.0)
    chain.want(0, 2, 0)
    chain.until(lambda: 'goal2' in chain.completed, 'goal2 completed', 180.0)
    assert chain.boots == 1


def test_held_or_taken_over_it_is_so_after_that_too():
    chain = landed()
    assert chain.hold()[0]
    chain.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    chain.kill_bridge(10.0)
    chain.want(0, 2, 0)
    chain.spend(60.0)
    assert chain.boots == 1
    assert (chain.armed, chain.phase) == (False, 'holding')


def test_motors_that_stopped_unseen_are_not_started_again():
    chain = flying()
    chain.tell(ARM, 0, 21196)
    chain.kill_bridge(20.0)
    chain.spend(20.0)
    assert chain.phase == 'pilot in command'
    assert not chain.armed


def test_a_landing_that_was_ordered_is_nobodys_taking_over():
    chain = Mortal()
    chain.want(1, 0, 0)
    chain.until(lambda: chain.phase == 'landing' and chain.height < 15.0, 'landing')
    chain.kill_bridge(60.0)
    assert not chain.armed
    chain.spend(5.0)
    assert chain.phase == 'on the ground'
    chain.want(0, 2, 0)
    chain.kill_bridge()
    chain.until(lambda: 'goal2' in chain.completed, 'goal2 completed', 180.0)


def test_an_order_under_way_is_nobodys_taking_over():
    """Killed at each step of the first seconds of a flight: what had just been asked for."""
    for steps in range(0, 60, 8):
        chain = Mortal()
        chain.until_ready()
        chain.want(0, 2, 0)
        chain.until(lambda chain=chain: chain.orders, 'an order')
        chain.spend(0.05 * steps)
        chain.kill_bridge(0.5)
        chain.until(lambda chain=chain: chain.completed, f'goal completed, {steps}')


@pytest.mark.parametrize('again', [True, False])
def test_a_landing_that_was_being_broken_off_when_it_died_goes_on(again):
    """Whether a pilot gave LAND again, or the order to leave it was lost: nobody can tell."""
    chain = flying()
    chain.want(0, 0, 0)
    chain.until(lambda: chain.phase == 'landing', 'landing')
    chain.spend(3.0)
    chain.want(0, 2, 0)
    while 'commit' not in chain.command:
        chain.spend(0.05)
    if not again:
        chain.cut()
    chain.spend(0.05)
    chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, FlightMode.LAND)
    under_way = json.loads(chain.memory)['pilot']['authority']['ordered']
    assert under_way == FlightMode.GUIDED
    chain.kill_bridge()
    chain.mend()
    orders = len(chain.orders)
    chain.until(lambda: not chain.armed, 'landed')
    chain.spend(10.0)
    assert (chain.phase, chain.orders[orders:]) == ('pilot in command', [])
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed', 180.0)


def test_on_its_way_back_it_goes_on_and_stays():
    chain = flying()
    chain.kill_manager()
    chain.until(lambda: chain.mode == FlightMode.RTL, 'RTL')
    chain.kill_bridge()
    chain.start_manager()
    chain.until(lambda: chain.phase == 'returning to launch', 'returning')
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    chain.kill_bridge()
    orders = len(chain.orders)
    chain.spend(20.0)
    assert (chain.armed, chain.orders[orders:]) == (False, [])
    assert 'returned to launch: the manager is silent' in chain.report[1]


def test_a_vehicle_flown_by_hand_from_the_start_is_not_taken():
    chain = Mortal(replace(SETTINGS, allow_arming=False))
    chain.until_ready()
    chain.put_into(FlightMode.LOITER)
    chain.kill_bridge()
    chain.want(0, 2, 0)
    chain.tell(ARM, 1, 21196)
    chain.until(lambda: chain.armed, 'armed')
    chain.kill_bridge()
    chain.spend(5.0)
    assert chain.phase == 'pilot in command'
    assert 'GUIDED gives command here' in chain.report[1]
    assert chain.orders == []


# Tasks at goals


def at_work(task) -> Mortal:
    goals = list(POLICY.mission.goals)
    goals[1] = replace(goals[1], task=task)
    chain = Mortal(mission=replace(POLICY.mission, goals=tuple(goals)))
    chain.want(0, 2, 0)
    return chain


def test_a_stay_is_as_long_as_it_was_to_be():
    chain, stay = at_work(Dwell(20.0)), 0.0
    while not chain.completed:
        chain.until(lambda: chain.phase == 'on site', 'on site')
        begin = chain.now
        chain.until(lambda begin=begin: chain.completed or chain.now > begin + 6.5, 'a while')
        stay += chain.now - begin
        if not chain.completed:
            chain.kill_bridge()
    assert 20.0 <= stay < 24.5, 'each of three restarts forgets less than a second'


def test_a_picture_is_taken_again_only_if_nobody_heard_of_it():
    chain, kills = at_work(Photo(8, 1.0)), 0
    while not chain.completed:
        have = len(chain.pictures)
        chain.until(lambda have=have: len(chain.pictures) > have or chain.completed, 'a picture')
        if kills < 4:
            chain.spend(0.25 * kills)
            chain.kill_bridge()
            kills += 1
    numbers = [number for _, number in chain.pictures]
    assert (numbers, set(numbers)) == (sorted(numbers), set(range(1, 9)))
    assert len(numbers) <= 8 + kills


def test_a_round_goes_on_where_it_was():
    chain = at_work(a_round(POLICY.mission))
    chain.until(lambda: len(visits(chain)) == 2, 'two waypoints')
    chain.spend(1.0)
    chain.kill_bridge()
    begin = len(chain.track)
    chain.until(lambda: chain.completed, 'goal completed')
    assert visits(chain, begin) == list(range(2, len(ROUND)))


def test_another_program_is_told_again():
    chain = at_work(External(10.0))
    chain.until(lambda: chain.active == 'goal2', 'active')
    chain.spend(6.0)
    chain.active = ''
    chain.kill_bridge()
    chain.until(lambda: chain.active == 'goal2', 'active again')
    begin = chain.now
    chain.until(lambda: 'goal2' in chain.refused, 'timeout')
    assert 3.0 < chain.now - begin < 6.0


# Faults


def test_a_broken_motor_is_broken_until_its_service_is_done_anew():
    chain = flying()
    chain.set('SIM_ENGINE_MUL', 0.75)
    chain.set('SIM_ENGINE_FAIL', 1)
    chain.until(lambda: chain.fault == 'actuator', 'actuator fault')
    chain.kill_bridge()
    chain.until_down_at(chain.mission.grid.service, 300.0)
    for _ in range(3):
        chain.spend(SETTINGS.service_time - 1.0)
        chain.kill_bridge(1.0)
        assert chain.fault == 'actuator'
        assert not chain.armed
    chain.set('SIM_ENGINE_FAIL', 0)
    start = chain.now
    chain.until(lambda: chain.fault == 'nominal', 'repaired')
    assert chain.now - start > SETTINGS.service_time
    chain.kill_bridge()
    chain.until(lambda: chain.completed, 'goal completed', 300.0)


def test_a_dead_camera_is_missed():
    chain = Mortal()
    chain.until_ready()
    chain.beat_as_camera()
    chain.until(lambda: chain.fault == 'camera', 'camera fault')
    chain.kill_bridge()
    faults = set()
    for _ in range(20):
        chain.spend(1.0)
        faults.add(chain.fault)
    assert faults == {'camera'}
    for _ in range(10):
        chain.beat_as_camera()
        chain.spend(1.0)
    assert chain.fault == 'nominal'
    chain.kill_bridge()
    chain.until(lambda: chain.fault == 'camera', 'camera fault')


def test_a_vehicle_without_gps_has_a_sensor_fault_at_once():
    chain = Mortal()
    chain.until_ready()
    chain.set('SIM_GPS1_ENABLE', 0)
    chain.until(lambda: chain.fault == 'sensor', 'sensor fault')
    chain.kill_bridge()
    chain._fault = ''
    chain.until(lambda: chain.fault, 'a fault mode', 10.0)
    assert chain.fault == 'sensor'


# A memory that cannot be believed


def test_on_the_ground_it_is_not_believed_and_held():
    chain = Mortal()
    chain.until_ready()
    chain.want(0, 2, 0)
    chain.end_bridge()
    chain.bridge.distrust('its last line is damaged')
    chain.spend(20.0)
    assert chain.orders_to_fly() == []
    assert chain.report == (
        True,
        'holding: on the ground until ~/resume; its last line is damaged',
    )
    chain.kill_bridge()
    chain.spend(20.0)
    assert chain.orders_to_fly() == []
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')


def test_in_flight_it_holds_then_returns_and_stays():
    chain = flying()
    chain.end_bridge()
    begin, orders = chain.now, len(chain.orders)
    chain.bridge.distrust('its last line is damaged')
    chain.until(lambda: chain.phase == 'holding', 'holding')
    chain.until(lambda: chain.mode == FlightMode.RTL, 'RTL', 60.0)
    assert chain.now - begin > SETTINGS.rtl_delay
    chain.kill_bridge()
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    chain.spend(20.0)
    assert not chain.armed
    assert chain.completed == []
    assert not set(TO_FLY) & {order.number for order in chain.orders[orders:]}
    assert 'its last line is damaged' in chain.report[1]


def test_a_pilot_is_left_alone_by_one_that_knows_nothing():
    chain = flying()
    chain.put_into(FlightMode.LOITER)
    chain.spend(2.0)
    chain.end_bridge()
    orders = len(chain.orders)
    chain.bridge.distrust('its last line is damaged')
    chain.spend(30.0)
    chain.put_into(FlightMode.LAND)
    chain.until(lambda: not chain.armed, 'landed')
    chain.spend(20.0)
    assert chain.orders[orders:] == []
    assert chain.phase == 'holding'


@pytest.mark.parametrize('memory', [{}, {'pilot': {}}, {'pilot': None, 'faults': 1}])
def test_what_is_no_memory_is_refused(memory):
    with pytest.raises(ValueError, match='no memory of a bridge'):
        Mortal().bridge.restore(memory)


# Before, not after


def test_it_is_remembered_before_it_is_asked_for():
    chain = Mortal()
    chain.until_ready()
    chain.want(0, 2, 0)
    sent: list[dict[str, Any]] = []
    send = chain.bridge.link.send

    def noted(commands, now) -> None:
        sent.append(json.loads(chain.memory))
        send(commands, now)

    chain.bridge.link.send = noted
    chain.until_flying()
    assert [memory['pilot']['authority']['ordered'] for memory in sent][:1] == [FlightMode.GUIDED]
    assert sent[1]['pilot']['authority']['arming']
    assert sent[2]['pilot']['authority']['motors_started_here']
    chain.hold()
    assert json.loads(chain.memory)['pilot']['held']


def test_it_changes_when_something_happens_and_not_all_the_time():
    chain = Mortal()
    chain.until_ready()
    memories = []
    chain.bridge.remember = memories.append
    chain.want(0, 2, 0)
    chain.until(lambda: chain.completed, 'goal completed')
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    texts = [json.dumps(memory) for memory in memories]
    changes = sum(new != old for old, new in pairwise(texts))
    assert 4 < changes < 30


# At any moment


class Unlucky(Mortal):
    """Checks each order to fly when it is given."""

    forbidden = ''

    def watch_bridge(self, message) -> None:
        before = len(self.orders)
        super().watch_bridge(message)
        for order in self.orders[before:]:
            assert order.heard >= NEEDED_BEFORE_AN_ORDER, f'{order} after a start'
            if order.number in TO_FLY:
                assert not self.forbidden, f'{order}: {self.forbidden}'


@pytest.mark.parametrize('seed', range(4))
def test_killed_at_random_it_takes_off_for_a_reason_and_comes_home(seed):
    rng = random.Random(seed)
    chain = Unlucky(seed=seed)
    chain.until_ready()

    def kills(seconds: float) -> None:
        end = chain.now + seconds
        while chain.now < end:
            chain.spend(rng.choice((0.05, 0.3, 1.0, 4.0, 12.0)))
            chain.kill_bridge(rng.choice((0.0, 0.2, 1.0, 3.5, 8.0)))

    def crew_on_the_ground() -> None:
        """Nobody flies while a person is beside the vehicle."""
        chain.forbidden = rng.choice(('held', 'no goal is wanted'))
        if chain.forbidden == 'held':
            while chain.phase == 'no link' or not chain.hold()[0]:
                chain.spend(0.5)
        elif chain.forbidden == 'no goal is wanted':
            chain.want(0, 0, 0)
            chain.spend(0.2)

    for _ in range(3):
        chain.want(*(rng.randint(0, 2) for _ in range(3)))
        kills(rng.uniform(5.0, 40.0))
        if chain.armed and rng.random() < 0.6:
            mode = rng.choice((FlightMode.LOITER, FlightMode.RTL, FlightMode.LAND))
            chain.until(lambda: chain.phase not in ('no link', 'waiting'), 'heard')
            chain.put_into(mode)
            chain.forbidden = 'a pilot has it'
            kills(rng.uniform(2.0, 20.0))
            chain.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, FlightMode.LAND)
            chain.until(lambda: not chain.armed, 'landed')
        elif not chain.armed:
            crew_on_the_ground()
        kills(rng.uniform(5.0, 30.0))
        if chain.forbidden:
            chain.until(lambda: chain.phase not in ('no link', 'waiting'), 'heard')
            chain.forbidden = ''
            chain.resume()
    chain.want(0, 0, 0)
    chain.until(lambda: chain.phase not in ('no link', 'waiting'), 'heard')
    chain.resume()
    kills(30.0)
    home = min(chain.distance(chain.mission.grid.base), chain.distance(chain.mission.grid.service))
    chain.until(lambda: not chain.armed, f'landed, {home:.0f} m from home', 300.0)
    assert not any('Crash' in text for text in chain.texts)
