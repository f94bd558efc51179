"""What may happen to a vehicle in flight, told once for a simulated and for a real autopilot.

A scenario is a function of a `Chain`: base station, manager, bridge and autopilot, with a crew
that can do to them what crews and bad days do. What the vehicle did is read on the wire, not asked
of the bridge.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.vehicle import FlightMode
from uav_mission_manager.goal_task import Dwell, External, GoalTask, Photo, Waypoint, Waypoints
from uav_mission_manager.mdp import Mission

FLIGHT_ALTITUDE = 20.0
ORDERS = {
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_DO_REPOSITION,
    mavlink.MAV_CMD_DO_CHANGE_SPEED,
}
PICTURE = mavlink.MAV_CMD_IMAGE_START_CAPTURE
NEEDED_BEFORE_AN_ORDER = {'HEARTBEAT', 'GLOBAL_POSITION_INT', 'EXTENDED_SYS_STATE'}


@dataclass(frozen=True)
class Sample:
    """A position of the vehicle: [s], from the mission's origin [m], [m/s]."""

    time: float
    east: float
    north: float
    height: float
    speed: float


@dataclass(frozen=True)
class Order:
    """A command of the bridge, and the messages of the vehicle that it had heard."""

    time: float
    number: int
    params: tuple[float, ...]
    heard: frozenset[str]


class Chain(ABC):
    """The chain of nodes with a vehicle, and all that went over the wire between the two."""

    real = False

    def __init__(self, mission: Mission) -> None:
        assert mission.grid.origin is not None
        self.mission, self.origin = mission, mission.grid.origin
        self.armed, self.mode, self.state, self.ready = False, -1, 0, False
        self.located = False
        self.landed = 0
        self.track: list[Sample] = []
        self.orders: list[Order] = []
        self.texts: list[str] = []
        self.commands: list[tuple[float, str]] = []
        self.completed: list[str] = []
        self.refused: list[str] = []
        self.reasons: list[str] = []  # of refusals
        self.active = ''
        self.pictures: list[tuple[float, int]] = []  # when taken, and their numbers
        self.heard: set[str] = set()
        self.boots = 0
        self._boot_time = self._asked_for = 0

    # What a crew can do

    @abstractmethod
    def want(self, *priorities: int) -> None:
        """Ask the base station for these priorities."""

    @abstractmethod
    def spend(self, seconds: float) -> None:
        """Let time pass."""

    @abstractmethod
    def set(self, name: str, value: float) -> None:
        """Set a parameter of the autopilot."""

    @abstractmethod
    def say(self, message: Any) -> None:
        """Send a message to the autopilot from a ground station."""

    @abstractmethod
    def forge(self, message: Any, v1: bool = False) -> None:
        """Send a message to the bridge with the vehicle's ids and address."""

    @abstractmethod
    def cut(self) -> None:
        """Cut the link between bridge and vehicle."""

    @abstractmethod
    def mend(self) -> None:
        """Mend it."""

    @abstractmethod
    def stall(self, seconds: float) -> None:
        """Let the bridge stand still for a while."""

    @abstractmethod
    def kill_manager(self) -> None:
        """End the manager."""

    @abstractmethod
    def start_manager(self) -> None:
        """Start it anew."""

    @abstractmethod
    def answer(self, goal: str, why: str = '') -> None:
        """Say that a goal is done, or why it has failed, as the program that works there."""

    @abstractmethod
    def hold(self) -> tuple[bool, str]:
        """Call the bridge's ~/hold."""

    @abstractmethod
    def resume(self) -> tuple[bool, str]:
        """Call its ~/resume."""

    # What the nodes say

    @property
    @abstractmethod
    def now(self) -> float:
        """Time [s]."""

    @property
    @abstractmethod
    def phase(self) -> str:
        """What the bridge is doing."""

    @property
    @abstractmethod
    def report(self) -> tuple[bool, str]:
        """The bridge's diagnostics: whether they are at WARN or worse, and their message."""

    @property
    @abstractmethod
    def fault(self) -> str:
        """The fault mode."""

    @property
    def command(self) -> str:
        """What the manager commands."""
        return self.commands[-1][1] if self.commands else ''

    # What is made of these

    def until(self, condition: Callable[[], Any], what: str, limit: float = 120.0) -> None:
        """Let time pass until something is true."""
        end = self.now + limit
        while not condition():
            assert self.now < end, (
                f'{what}: not within {limit:.0f} s; {self.report}, {self.command!r}, '
                f'mode {self.mode}, {self.texts[-5:]}'
            )
            self.spend(0.1)

    def tell(self, number: int, *params: float) -> None:
        """Give the autopilot a command from the ground."""
        params += (0.0,) * (7 - len(params))
        self.say(mavlink.MAVLink_command_long_message(1, 1, number, 0, *params))

    def put_into(self, mode: FlightMode) -> None:
        """Change the flight mode, as a pilot does."""
        self.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)
        self.until(lambda: self.mode == mode, f'{mode.name}')

    @property
    def height(self) -> float:
        """Height [m] above the mission's origin."""
        return self.track[-1].height if self.track else 0.0

    def distance(self, cell: int) -> float:
        """Distance [m] from a cell's centre."""
        if not self.track:
            return math.inf
        here = self.track[-1].east, self.track[-1].north
        return math.dist(here, self.mission.grid.position(cell))

    def until_flying(self) -> None:
        """Wait until the vehicle is on its way at its height."""
        self.until(
            lambda: self.phase == 'en route' and self.height > FLIGHT_ALTITUDE - 3.0,
            'en route at height',
        )

    def until_down_at(self, cell: int, limit: float = 180.0) -> None:
        """Wait until the vehicle has landed in a cell."""
        self.until(
            lambda: not self.armed and self.distance(cell) < 25.0 and abs(self.height) < 1.5,
            f'landed in cell {cell}',
            limit,
        )

    def forge_position(self, north: float) -> None:
        """Tell the bridge that the vehicle is so far [m] north of where it is."""
        here = self.track[-1]
        latitude, longitude = self.origin.to_geodetic(here.east, here.north + north)
        altitude = round(1000.0 * (here.height + self.origin.altitude))
        self.forge(
            mavlink.MAVLink_global_position_int_message(
                *(self._boot_time, round(latitude * 1e7), round(longitude * 1e7)),
                *(altitude, round(1000.0 * here.height), 0, 0, 0, 0),
            )
        )

    def watch_vehicle(self, message: Any, to_the_bridge: bool) -> None:
        """Take note of what the vehicle says; `to_the_bridge`, whether the bridge hears it."""
        kind = message.get_type()
        if message.get_srcComponent() != 1:
            return
        if to_the_bridge:
            self.heard.add(kind)
        if kind == 'HEARTBEAT' and message.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
            self.mode, self.state = message.custom_mode, message.system_status
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif kind == 'SYS_STATUS':
            self.ready = bool(
                message.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
            )
        elif kind == 'EXTENDED_SYS_STATE':
            self.landed = message.landed_state
        elif kind == 'EKF_STATUS_REPORT':
            self.located = message.flags & 0x418 == 0x18
        elif kind == 'STATUSTEXT':
            self.texts.append(message.text)
        elif kind == 'GLOBAL_POSITION_INT':
            self._place(message)
        elif kind == 'COMMAND_ACK' and message.command == PICTURE and message.result == 0:
            self.pictures.append((self.now, self._asked_for))

    def _place(self, message: Any) -> None:
        if message.time_boot_ms < self._boot_time - 1000:
            self.boots += 1
            self.ready = self.located = False
        self._boot_time = message.time_boot_ms
        if message.lat or message.lon:
            east, north = self.origin.to_local(message.lat / 1e7, message.lon / 1e7)
            height = message.alt / 1000.0 - self.origin.altitude
            speed = math.hypot(message.vx, message.vy) / 100.0
            self.track.append(Sample(self.now, east, north, height, speed))

    def watch_bridge(self, message: Any) -> None:
        """Take note of what the bridge sends."""
        if message.get_type() not in ('COMMAND_LONG', 'COMMAND_INT'):
            return
        if message.command == PICTURE:
            self._asked_for = int(message.param4)
        if message.command in ORDERS:
            params = tuple(getattr(message, f'param{n}') for n in range(1, 5))
            self.orders.append(Order(self.now, message.command, params, frozenset(self.heard)))


# Never flies without a reason


def sensors_fail_on_a_parked_vehicle(chain: Chain) -> None:
    """Nothing is wanted: a fault, found and gone, does not make it fly."""
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    for name, good, bad in (
        ('SIM_GPS1_ENABLE', 1, 0),
        ('SIM_MAG1_FAIL', 0, 1),
        ('SIM_BARO_DISABLE', 0, 1),
    ):
        chain.set(name, bad)
        chain.spend(8.0)
        if name == 'SIM_GPS1_ENABLE':
            assert chain.fault == 'sensor'
        chain.set(name, good)
        chain.until(lambda: chain.fault == 'nominal', f'{name} well again')
        chain.spend(15.0)
    assert (chain.armed, chain.orders) == (False, [])


def the_autopilot_reboots_on_the_ground(chain: Chain) -> None:
    """However short the gap, the estimator that boots is no fault, and nothing flies."""
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    boots, faults = chain.boots, []
    chain.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    chain.until(lambda: chain.boots > boots, 'reboot')

    def booted() -> bool:
        faults.append(chain.fault)
        return chain.ready and chain.located

    chain.until(booted, 'booted')
    chain.spend(15.0)
    assert set(faults) <= {'nominal', ''}
    assert (chain.armed, chain.orders) == (False, [])


def a_service_is_no_reason_to_fly(chain: Chain) -> None:
    """Repaired at the service cell with nothing wanted, it stays there."""
    chain.want(1, 0, 0)
    chain.until_flying()
    chain.set('SIM_ENGINE_MUL', 0.75)
    chain.set('SIM_ENGINE_FAIL', 1)
    chain.until(lambda: chain.command == 'repair', 'repair')
    chain.until_down_at(chain.mission.grid.service)
    chain.want(0, 0, 0)
    chain.set('SIM_ENGINE_FAIL', 0)
    chain.until(lambda: chain.fault == 'nominal', 'repaired')
    orders = len(chain.orders)
    chain.spend(20.0)
    assert not chain.armed
    assert chain.orders[orders:] == []


def a_goal_is_wanted_of_a_vehicle_without_position(chain: Chain) -> None:
    """It stays, and says why; with a position it flies."""
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    chain.set('SIM_GPS1_ENABLE', 0)
    chain.until(lambda: chain.fault == 'sensor', 'sensor fault')
    chain.want(0, 2, 0)
    chain.spend(20.0)
    assert not chain.armed
    assert 'no position yet' in chain.report[1]
    chain.set('SIM_GPS1_ENABLE', 1)
    chain.until(lambda: 'goal2' in chain.completed, 'goal2 completed', 180.0)


# Authority is what the mode says


def a_battery_warning_is_no_takeover(chain: Chain) -> None:
    """A warning that leaves GUIDED: the mission goes on, and goes to recharge."""
    chain.set('BATT_FS_LOW_ACT', 0)
    chain.set('BATT_LOW_VOLT', 10.5)
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.set('SIM_BATT_VOLTAGE', 10.3)
    phases = []

    def warned() -> bool:
        phases.append(chain.phase)
        return chain.command == 'recharge'

    chain.until(warned, 'recharge')
    chain.until_down_at(chain.mission.grid.service)
    assert 'pilot in command' not in phases
    assert 'failsafe' in chain.report[1]


def radio_control_is_lost_and_guided_goes_on(chain: Chain) -> None:
    """With FS_OPTIONS 4 the vehicle flies on, and says so."""
    chain.set('FS_OPTIONS', 4)
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.set('SIM_RC_FAIL', 1)
    chain.until(lambda: chain.state == mavlink.MAV_STATE_CRITICAL, 'failsafe')
    chain.until(lambda: 'failsafe' in chain.report[1], 'a word about it')
    assert chain.report[0]
    chain.spend(5.0)
    assert chain.mode == FlightMode.GUIDED
    assert chain.phase in ('en route', 'on site')
    chain.set('SIM_RC_FAIL', 0)
    chain.until(lambda: chain.completed, 'goal completed')


def the_battery_turns_critical_in_a_landing(chain: Chain) -> None:
    """In a failsafe already, and in LAND: nothing but the landing going on shows the new one."""
    chain.set('FS_OPTIONS', 4)
    chain.want(1, 0, 0)
    chain.until_flying()
    chain.set('SIM_RC_FAIL', 1)
    chain.until(lambda: chain.phase == 'landing' and chain.height < 12.0, 'landing')
    chain.set('BATT_FS_CRT_ACT', 1)
    chain.set('BATT_CRT_VOLT', 10.4)
    chain.set('SIM_BATT_VOLTAGE', 10.0)
    begin = len(chain.track)
    chain.until(lambda: not chain.armed, 'landed', 60.0)
    assert max(sample.height for sample in chain.track[begin:]) < 13.0
    assert chain.distance(chain.mission.grid.base) < 10.0


def a_pilot_takes_over_and_gives_back(chain: Chain) -> None:
    """Any mode that was not ordered ends the commanding until ~/resume."""
    chain.want(0, 2, 0)
    for mode in (FlightMode.LOITER, FlightMode.BRAKE, FlightMode.RTL):
        chain.until_flying()
        chain.put_into(mode)
        chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command')
        orders = len(chain.orders)
        chain.spend(4.0)
        assert chain.orders[orders:] == []
        assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')


def the_manager_dies(chain: Chain) -> None:
    """It holds, returns, lands, and stays down until ~/resume."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.kill_manager()
    chain.until(lambda: chain.phase == 'holding', 'holding', 10.0)
    assert chain.mode == FlightMode.GUIDED
    chain.until(lambda: chain.mode == FlightMode.RTL, 'return', 20.0)
    chain.start_manager()
    chain.until_down_at(chain.mission.grid.base)
    orders = len(chain.orders)
    chain.spend(10.0)
    assert chain.orders[orders:] == []
    assert 'until ~/resume' in chain.report[1]
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')


# After a gap nothing is known


def assert_heard_before_ordered(chain: Chain, orders: int) -> None:
    """The first order came after all that a decision needs, and none was to land."""
    for order in chain.orders[orders:]:
        assert order.heard >= NEEDED_BEFORE_AN_ORDER, order
        assert (order.number, order.params[1]) not in (
            (mavlink.MAV_CMD_DO_SET_MODE, FlightMode.LAND),
            (mavlink.MAV_CMD_DO_SET_MODE, FlightMode.RTL),
        )


def the_link_is_cut_in_flight(chain: Chain) -> None:
    """For 4, 5 and 20 s; the flight goes on where it was."""
    chain.want(0, 2, 0)
    for seconds in (4.0, 5.0, 20.0):
        chain.until_flying()
        orders = len(chain.orders)
        chain.cut()
        chain.spend(seconds)
        chain.heard.clear()
        chain.mend()
        chain.until(lambda: chain.phase in ('en route', 'on site'), 'on its way', 20.0)
        assert_heard_before_ordered(chain, orders)
        if seconds < 20.0:
            chain.want(0, 2, 0)
    chain.until(lambda: chain.completed, 'goal completed')


def the_link_is_cut_and_the_manager_is_dead(chain: Chain) -> None:
    """It holds, then returns; it does not land where it is."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.kill_manager()
    orders = len(chain.orders)
    chain.cut()
    chain.spend(5.0)
    chain.heard.clear()
    chain.mend()
    chain.until(lambda: chain.phase == 'holding', 'holding', 20.0)
    assert_heard_before_ordered(chain, orders)
    chain.until(lambda: chain.mode == FlightMode.RTL, 'return', 30.0)
    chain.until_down_at(chain.mission.grid.base)


def the_manager_is_dead_and_the_link_has_gaps(chain: Chain) -> None:
    """However often the link is lost, it does not hold for ever."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.kill_manager()
    end = chain.now + 60.0
    while chain.mode != FlightMode.RTL:
        assert chain.now < end, chain.report
        chain.spend(6.0)
        chain.cut()
        chain.spend(5.0)
        chain.mend()
    chain.until_down_at(chain.mission.grid.base)


def the_bridge_stands_still(chain: Chain) -> None:
    """For 20 s: what waits for it is old; it hears anew, then goes on."""
    chain.want(0, 2, 0)
    chain.until_flying()
    orders = len(chain.orders)
    chain.heard.clear()
    chain.stall(20.0)
    chain.heard.clear()
    chain.until(lambda: chain.phase in ('en route', 'on site'), 'on its way', 20.0)
    assert_heard_before_ordered(chain, orders)
    chain.until(lambda: chain.completed, 'goal completed')


def a_hold_begins_on_a_wrong_position(chain: Chain) -> None:
    """One position, 2.2 km off, is no place to hold, whenever it comes."""
    chain.want(0, 2, 0)
    chain.until_flying()
    for pause in (0.2, 0.25, 0.3):
        chain.spend(3.0)
        place = chain.track[-1]
        chain.forge_position(2200.0)
        chain.hold()
        chain.spend(pause)
        chain.forge_position(2200.0)
        chain.until(lambda: chain.phase == 'holding' and chain.track[-1].speed < 0.5, 'holding')
        chain.spend(5.0)
        here = chain.track[-1]
        assert math.dist((here.east, here.north), (place.east, place.north)) < 15.0
        assert chain.resume()[0]
        chain.until_flying()
    chain.until(lambda: chain.completed, 'goal completed')


# Flight as a pilot expects


def the_first_leg_is_not_too_fast(chain: Chain) -> None:
    """Nor is the leg after a pilot gave the vehicle back."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.spend(5.0)
    chain.put_into(FlightMode.LOITER)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command')
    chain.resume()
    chain.until(lambda: chain.completed, 'goal completed')
    assert 4.5 < max(sample.speed for sample in chain.track) <= 5.5


def a_landing_is_broken_off(chain: Chain) -> None:
    """Near the ground it climbs before it moves sideways."""
    chain.want(1, 0, 0)
    chain.until(lambda: chain.completed, 'goal completed')
    chain.until(lambda: chain.phase == 'landing' and chain.height < 3.0, 'landing')
    begin = len(chain.track)
    place = chain.track[-1]
    chain.want(0, 2, 0)
    chain.until(lambda: 'goal2' in chain.completed, 'goal2 completed', 180.0)
    low = [s for s in chain.track[begin:] if s.height < FLIGHT_ALTITUDE - 3.0]
    if chain.armed:
        away = [math.dist((s.east, s.north), (place.east, place.north)) for s in low]
        assert max(away, default=0.0) < 5.0


def handed_over_too_high(chain: Chain) -> None:
    """A goal is completed at its height."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.put_into(FlightMode.LOITER)
    chain.until(lambda: chain.phase == 'pilot in command', 'pilot in command')
    chain.put_into(FlightMode.GUIDED)
    latitude, longitude = chain.origin.to_geodetic(*chain.mission.grid.position(3))
    chain.say(
        mavlink.MAVLink_command_int_message(
            *(1, 1, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT),
            *(mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 0, 0, math.nan),
            *(round(latitude * 1e7), round(longitude * 1e7), 39.0),
        )
    )
    chain.until(lambda: chain.height > 38.0 and chain.distance(3) < 2.0, 'high over the goal')
    assert chain.resume()[0]
    chain.until(lambda: chain.completed, 'goal completed')
    assert abs(chain.height - FLIGHT_ALTITUDE) < 2.5


# What is refused


def a_goal_lies_outside_the_fence(chain: Chain) -> None:
    """It is said at once, the goal is out of range, and something else is done."""
    chain.set('FENCE_TYPE', 2)
    chain.set('FENCE_RADIUS', 120)
    chain.set('FENCE_ENABLE', 1)
    chain.want(1, 2, 0)
    chain.until(lambda: chain.height > FLIGHT_ALTITUDE - 2.0, 'at height')
    chain.until(lambda: chain.report[0] and 'FAILED' in chain.report[1], 'WARN', 10.0)
    chain.until(lambda: 'goal2' in chain.refused, 'goal2 refused', 10.0)
    chain.until(lambda: 'goal2' not in chain.command, 'another command', 10.0)
    chain.until(lambda: 'goal1' in chain.completed, 'goal1 completed')
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    assert 'goal2' not in chain.completed


def the_wind_is_too_strong(chain: Chain) -> None:
    """No progress is noticed: the goals are out of range, and it goes home."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.set('SIM_WIND_DIR', 90)
    chain.set('SIM_WIND_TURB', 10)
    chain.set('SIM_WIND_SPD', 15 if chain.real else 25)
    chain.until(lambda: chain.refused or chain.completed or not chain.armed, 'noticed', 90.0)
    chain.until(
        lambda: not chain.command.startswith('commit') or chain.mode == FlightMode.RTL, 'home'
    )
    chain.set('SIM_WIND_SPD', 2)
    chain.set('SIM_WIND_TURB', 0)
    chain.until(lambda: not chain.armed and abs(chain.height) < 3.0, 'landed', 300.0)
    assert min(chain.distance(chain.mission.grid.base), chain.distance(1)) < 30.0


# Motors


def a_motor_weakens(chain: Chain) -> None:
    """At 80 % it is reported within five seconds; the vehicle is repaired and flies on."""
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.spend(2.0)
    assert chain.fault == 'nominal'
    chain.set('SIM_ENGINE_MUL', 0.8)
    chain.set('SIM_ENGINE_FAIL', 2)
    chain.until(lambda: chain.fault == 'actuator', 'actuator fault', 6.0)
    found = chain.now
    chain.until_down_at(chain.mission.grid.service, 300.0)
    chain.set('SIM_ENGINE_FAIL', 0)
    times = [time for time, _ in chain.commands if time > found + 1.0]
    pauses = [later - sooner for sooner, later in pairwise(times)]
    assert all(pause > 4.0 for pause in pauses), chain.commands
    chain.until(lambda: 'goal2' in chain.completed, 'goal2 completed', 300.0)


# Who is who


def others_speak_with_the_vehicles_ids(chain: Chain) -> None:
    """Neither a ground station with its ids nor MAVLink 1 is the vehicle."""
    ids = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
    station = mavlink.MAVLink_heartbeat_message(*ids, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)
    ids = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    old = mavlink.MAVLink_heartbeat_message(*ids, 81, FlightMode.LOITER, 4, 3)
    chain.want(0, 2, 0)
    chain.until_flying()
    end = chain.now + 120.0
    while not chain.completed:
        chain.forge(station)
        chain.forge(old, v1=True)
        chain.spend(0.3)
        assert chain.phase in ('en route', 'on site', 'landing')
        assert chain.now < end


def a_plane_has_the_vehicles_ids(chain: Chain) -> None:
    """What may be a plane is not commanded, and it is said why; then it flies."""
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    ids = mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    plane = mavlink.MAVLink_heartbeat_message(*ids, 81, 10, mavlink.MAV_STATE_ACTIVE, 3)
    chain.forge(plane)
    chain.want(0, 2, 0)
    for _ in range(10):
        chain.forge(plane)
        chain.spend(1.0)
    assert (chain.armed, chain.orders) == (False, [])
    assert chain.report[0]
    assert 'not a multirotor' in chain.report[1]
    chain.until(lambda: chain.completed, 'goal completed')


# Ground stations


def the_bridge_dies_beside_a_ground_station(chain: Chain) -> None:
    """The failsafe counts the bridge's heartbeats, and not those of the ground station."""
    chain.set('MAV_GCS_SYSID', 245)
    chain.set('FS_GCS_ENABLE', 1)
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.cut()
    chain.until(lambda: chain.mode == FlightMode.RTL, 'RTL', 15.0)


SCENARIOS = (
    sensors_fail_on_a_parked_vehicle,
    the_autopilot_reboots_on_the_ground,
    a_service_is_no_reason_to_fly,
    a_goal_is_wanted_of_a_vehicle_without_position,
    a_battery_warning_is_no_takeover,
    radio_control_is_lost_and_guided_goes_on,
    the_battery_turns_critical_in_a_landing,
    a_pilot_takes_over_and_gives_back,
    the_manager_dies,
    the_link_is_cut_in_flight,
    the_link_is_cut_and_the_manager_is_dead,
    the_manager_is_dead_and_the_link_has_gaps,
    the_bridge_stands_still,
    a_hold_begins_on_a_wrong_position,
    the_first_leg_is_not_too_fast,
    a_landing_is_broken_off,
    handed_over_too_high,
    a_goal_lies_outside_the_fence,
    the_wind_is_too_strong,
    a_motor_weakens,
    others_speak_with_the_vehicles_ids,
    a_plane_has_the_vehicles_ids,
    the_bridge_dies_beside_a_ground_station,
)
"""All scenarios; the bridge has `source_system` 245 in each."""


# What is done at a goal


def call_away(chain: Chain) -> None:
    """A low battery calls the vehicle away; when it is recharged, it is sent back."""
    chain.set('BATT_FS_LOW_ACT', 0)
    chain.set('BATT_LOW_TIMER', 1)
    chain.set('SIM_BATT_VOLTAGE', 10.3)
    chain.until(lambda: chain.command == 'recharge', 'recharge', 30.0)
    chain.until_down_at(chain.mission.grid.service)
    chain.set('SIM_BATT_VOLTAGE', 0)
    chain.set('SIM_BATT_PCT', 100)


def on_site(chain: Chain) -> bool:
    return chain.phase == 'on site' and 'goal2' in chain.command


def a_stay_is_taken_up(chain: Chain) -> None:
    """Time on site counts, whatever is in between."""
    chain.want(0, 2, 0)
    chain.until(lambda: on_site(chain), 'on site')
    begin, stays = chain.now, []
    chain.spend(8.0)
    call_away(chain)
    stays.append(next(time for time, text in chain.commands if text == 'recharge') - begin)
    chain.until(lambda: on_site(chain), 'on site again', 180.0)
    begin = chain.now
    chain.until(lambda: chain.completed, 'goal completed')
    stays.append(chain.now - begin)
    assert 8.0 < stays[0] < 20.0, stays
    assert abs(sum(stays) - 20.0) < 1.0, stays


def pictures_are_not_taken_again(chain: Chain) -> None:
    """Ten, two seconds apart, some before and some after a recharge."""
    chain.want(0, 2, 0)
    chain.until(lambda: len(chain.pictures) == 3, 'three pictures')
    call_away(chain)
    before = len(chain.pictures)
    chain.until(lambda: chain.completed, 'goal completed', 180.0)
    assert 3 <= before < 10
    assert [number for _, number in chain.pictures] == list(range(1, 11))
    assert all(later - sooner > 1.9 for (sooner, _), (later, _) in pairwise(chain.pictures))


def a_camera_refuses(chain: Chain) -> None:
    """The goal is refused, and it is said why; another one is flown to."""
    chain.set('SIM_CAM_REFUSE', 1)
    chain.want(1, 2, 0)
    chain.until(lambda: 'goal2' in chain.refused, 'goal2 refused')
    chain.until(lambda: chain.reasons, 'the reason', 5.0)
    assert chain.reasons[-1].endswith('commit goal2 normal: no picture: FAILED')
    chain.until(lambda: 'goal1' in chain.completed, 'goal1 completed', 180.0)
    assert chain.pictures == []
    assert 'goal2' not in chain.completed


ROUND = (
    *((20.0, 20.0, None), (-20.0, 20.0, None), (-40.0, 0.0, 32.0)),
    *((-20.0, -20.0, None), (20.0, -20.0, 12.0), (20.0, 0.0, None)),
)
"""Waypoints east and north of goal 2 [m], and their heights [m]."""


def visits(chain: Chain, begin: int = 0) -> list[int]:
    """Waypoints in the order in which they were reached, from a sample on."""
    east, north = chain.mission.grid.position(3)
    found: list[int] = []
    for sample in chain.track[begin:]:
        for number, (x, y, height) in enumerate(ROUND):
            near = math.dist((sample.east, sample.north), (east + x, north + y)) < 3.0
            level = abs(sample.height - (height or FLIGHT_ALTITUDE)) < 2.2
            if near and level and found[-1:] != [number]:
                found.append(number)
    return found


def a_round_is_taken_up(chain: Chain) -> None:
    """Waypoints are flown in order, those passed before a recharge not again."""
    chain.want(0, 2, 0)
    chain.until(lambda: visits(chain), 'first waypoint')
    call_away(chain)
    before, begin = visits(chain), len(chain.track)
    chain.until(lambda: chain.completed, 'goal completed', 240.0)
    assert before == list(range(len(before)))
    assert 0 < len(before) < len(ROUND)
    assert before + visits(chain, begin) == list(range(len(ROUND)))


def another_program_works(chain: Chain) -> None:
    """It is told when to work, and its word is enough."""
    chain.want(0, 2, 0)
    chain.until(lambda: chain.active == 'goal2', 'goal2 active')
    assert chain.distance(3) < 3.0
    call_away(chain)
    assert chain.active == ''
    chain.until(lambda: chain.active == 'goal2', 'goal2 active again', 180.0)
    chain.spend(5.0)
    assert chain.completed == []
    chain.answer('goal2')
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    assert (chain.completed, chain.refused, chain.active) == (['goal2'], [], '')


def another_program_fails(chain: Chain) -> None:
    """The goal is refused, with its word for it."""
    chain.want(0, 2, 0)
    chain.until(lambda: chain.active == 'goal2', 'goal2 active')
    chain.answer('goal2', 'the jar is full')
    chain.until(lambda: chain.refused, 'goal2 refused', 5.0)
    chain.until(lambda: not chain.armed, 'landed', 180.0)
    assert chain.reasons[-1].endswith('commit goal2 normal: the jar is full')
    assert (chain.completed, set(chain.refused), chain.active) == ([], {'goal2'}, '')


def another_program_is_silent(chain: Chain) -> None:
    """Its time over, the goal is refused; asked for anew, it is begun anew."""
    for _ in range(2):
        chain.refused.clear()
        chain.want(0, 2, 0)
        chain.until(lambda: chain.active == 'goal2', 'goal2 active')
        begin = chain.now
        chain.until(lambda: chain.refused, 'goal2 refused')
        assert abs(chain.now - begin - 60.0) < 1.0
        chain.until(lambda: not chain.armed, 'landed', 180.0)
    assert chain.completed == []


def a_round(mission: Mission) -> GoalTask:
    """The task of flying `ROUND`."""
    assert mission.grid.origin is not None
    east, north = mission.grid.position(3)
    places = ((mission.grid.origin.to_geodetic(east + x, north + y), h) for x, y, h in ROUND)
    return Waypoints(tuple(Waypoint(*place, height) for place, height in places))


TASK_SCENARIOS: tuple[tuple[Callable[[Chain], None], Callable[[Mission], GoalTask]], ...] = (
    (a_stay_is_taken_up, lambda mission: Dwell(20.0)),
    (pictures_are_not_taken_again, lambda mission: Photo(10, 2.0)),
    (a_camera_refuses, lambda mission: Photo(1, 0.0)),
    (a_round_is_taken_up, a_round),
    (another_program_works, lambda mission: External(60.0)),
    (another_program_fails, lambda mission: External(60.0)),
    (another_program_is_silent, lambda mission: External(60.0)),
)
"""Scenarios with a task at goal 2; only the simulated autopilot's battery can be charged again."""
