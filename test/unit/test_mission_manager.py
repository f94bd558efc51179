"""The manager without ROS: what it says at once, what it waits for, and what it remembers."""

from __future__ import annotations

from pathlib import Path

import pytest

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.onboard import ManagerSettings, MissionManager, Refusal, format_command
from uav_mission_manager.policy import Policy

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')


@pytest.fixture(scope='module')
def policy() -> Policy:
    return build_policy(MISSION)


class Flight:
    """A manager whose inputs are all there, and said again before each step."""

    def __init__(self, policy: Policy, **settings: object) -> None:
        self.manager = MissionManager(policy, ManagerSettings(**settings))
        self.now, self.charge, self.place, self.fault = 1000.0, 0.9, (0.0, 0.0), 'nominal'
        self.threat('none')

    def threat(self, name: str) -> None:
        self.manager.take(lambda s: s.with_threat(name, self.now))

    def ask(self, *priorities: int, name: str = '') -> None:
        self.manager.take(lambda s: s.with_priorities(priorities, name, self.now))

    def at(self, cell: int) -> None:
        self.place = MISSION.grid.position(cell)

    def say(self, seconds: float = 0.1) -> str:
        """Let time pass; return the command, or why there is none."""
        self.now += seconds
        self.manager.take(lambda s: s.with_battery(self.charge, self.now))
        self.manager.take(lambda s: s.with_position(*self.place, self.now))
        self.manager.take(lambda s: s.with_fault(self.fault, self.now))
        outcome = self.manager.step(self.now)
        if isinstance(outcome, Refusal):
            return outcome.reason
        return format_command(MISSION, outcome.action)


@pytest.fixture
def flight(policy: Policy) -> Flight:
    return Flight(policy)


def test_nothing_is_decided_before_it_is_known_what_is_wanted(flight: Flight) -> None:
    assert flight.say() == 'no goal priorities yet'
    flight.ask(2, 0, 0)
    assert flight.say() == 'commit goal1 normal'


# Off the grid


def test_a_vehicle_that_strays_goes_on_and_is_not_taken_to_be_elsewhere(flight: Flight) -> None:
    flight.ask(0, 2, 0)
    assert flight.say() == 'commit goal2 normal'
    flight.place = (-100.0, 0.0)
    assert flight.say() == 'commit goal2 normal'
    assert flight.manager.step(flight.now).reason.startswith('odom: 75 m off the grid: ')
    flight.ask(2, 0, 0, name='b')
    assert flight.say(20.0) == 'odom: 75 m off the grid'
    flight.place = (0.0, 0.0)
    assert flight.say() == 'commit goal1 normal'


@pytest.mark.parametrize('danger', ['threat', 'fault', 'refused', 'far'])
def test_a_vehicle_that_strays_into_danger_is_left_to_the_bridge(
    flight: Flight, danger: str
) -> None:
    flight.ask(0, 2, 0)
    flight.say()
    flight.place = (-100.0, 0.0)
    if danger == 'threat':
        flight.threat('low')
    elif danger == 'fault':
        flight.fault = 'sensor'
    elif danger == 'refused':
        flight.manager.take(lambda s: s.with_refused('goal2'))
    else:
        flight.place = (-2500.0, 0.0)
    assert 'm off the grid' in flight.say()


def test_no_flight_begins_off_the_grid(flight: Flight) -> None:
    flight.place = (-100.0, 0.0)
    flight.ask(2, 0, 0)
    assert flight.say() == 'odom: 75 m off the grid'
