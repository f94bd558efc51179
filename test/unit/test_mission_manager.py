"""The manager without ROS: what it says at once, what it waits for, and what it remembers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.mdp import FAULT_MODES
from uav_mission_manager.onboard import (
    InputError,
    ManagerSettings,
    MissionManager,
    Refusal,
    format_command,
)
from uav_mission_manager.policy import Policy

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')


@pytest.fixture(scope='module')
def policy() -> Policy:
    return build_policy(MISSION)


@pytest.fixture(scope='module')
def other_policy() -> Policy:
    """One that says otherwise in some states."""
    goals = tuple(replace(g, eta=20.0 - g.eta, delta=10.0 - g.delta) for g in MISSION.goals)
    return build_policy(replace(MISSION, goals=goals))


class Flight:
    """A manager whose inputs are all there, and said again before each step."""

    def __init__(self, policy: Policy, **settings: object) -> None:
        self.manager = MissionManager(policy, ManagerSettings(**settings))
        self.now, self.charge, self.place, self.fault = 1000.0, 0.9, (0.0, 0.0), 'nominal'
        self.battery: dict[str, Any] = {}
        self.threat('none')

    def threat(self, name: str) -> None:
        self.manager.take(lambda s: s.with_threat(name, self.now))

    def ask(self, *priorities: int, name: str = '') -> None:
        self.manager.take(lambda s: s.with_priorities(priorities, name, self.now))

    def complete(self, goal: str) -> None:
        self.manager.take(lambda s: s.with_completed(goal))

    def refuse(self, goal: str) -> None:
        self.manager.take(lambda s: s.with_refused(goal))

    def at(self, cell: int) -> None:
        self.place = MISSION.grid.position(cell)

    def say(self, seconds: float = 0.1) -> str:
        """Let time pass; return the command, or why there is none."""
        self.now += seconds
        self.manager.take(lambda s: s.with_battery(self.charge, self.now, **self.battery))
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


@pytest.mark.parametrize(('unknown', 'level'), [('none', 0), ('low', 1), ('high', 2)])
def test_a_threat_never_heard_is_unknown(policy: Policy, unknown: str, level: int) -> None:
    manager = MissionManager(policy, ManagerSettings(threat_unknown=unknown))
    assert manager.situation.threat == level
    assert manager.situation.warnings == (f'threat_level: never heard, counted as {unknown}',)
    again = MissionManager(policy, ManagerSettings(threat_unknown=unknown), manager.memory)
    assert again.situation.warnings == manager.situation.warnings
    for now, heard, of in ((10.0, 'high', 2), (20.0, 'none', 0)):
        manager.take(lambda s, heard=heard, now=now: s.with_threat(heard, now))
        manager.step(now + 6.0)
        assert (manager.situation.threat, manager.situation.warnings) == (of, ())
        again = MissionManager(policy, ManagerSettings(threat_unknown=unknown), manager.memory)
        assert (again.situation.threat, again.situation.warnings) == (of, ())


def test_a_threat_level_that_is_none_is_refused(policy: Policy) -> None:
    with pytest.raises(ValueError, match="threat_unknown: 'severe' is not one of none, low, high"):
        MissionManager(policy, ManagerSettings(threat_unknown='severe'))


def test_new_warnings_are_told_once(flight: Flight) -> None:
    said = ('battery_state: reported unhealthy, counted as empty',)
    sick = {'percentage': 0.9, 'now': 1.0, 'healthy': False}
    flight.manager.news()
    for news in said, ():
        flight.manager.take(lambda s: s.with_battery(**sick))
        assert flight.manager.news() == news


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
        flight.refuse('goal2')
    else:
        flight.place = (-2500.0, 0.0)
    assert 'm off the grid' in flight.say()


def test_no_flight_begins_off_the_grid(flight: Flight) -> None:
    flight.place = (-100.0, 0.0)
    flight.ask(2, 0, 0)
    assert flight.say() == 'odom: 75 m off the grid'


# Danger at once, and its end after a while


def test_a_danger_is_answered_in_the_step_in_which_it_is_heard(policy: Policy) -> None:
    for cell, priorities in product(range(MISSION.grid.q), product((0, 1, 2), repeat=MISSION.k)):
        for danger in ('low', 'high', 'sensor', 'actuator', 'camera', 'empty', 'unhealthy'):
            flight = Flight(policy)
            flight.at(cell)
            flight.ask(*priorities)
            flight.say()
            if danger in ('low', 'high'):
                flight.threat(danger)
            elif danger == 'empty':
                flight.charge = 0.05
            elif danger == 'unhealthy':
                flight.battery = {'healthy': False}
            else:
                flight.fault = danger
            situation = flight.manager.situation
            said = flight.say()
            state = list(flight.manager.situation.state)
            state[-3], state[-1] = situation.commitment, int(situation.agile)
            assert said == format_command(MISSION, policy.decide(state).action)


@pytest.mark.parametrize('what', ['threat', 'fault'])
def test_what_to_do_in_a_danger_is_at_hand_when_it_comes(
    monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    policy = build_policy(MISSION, 'exact')
    flight = Flight(policy)
    flight.ask(1, 1, 1)
    flight.say()
    flight.manager.foresee()
    looked_up: list[Any] = []
    look_up = type(policy).look_up
    monkeypatch.setattr(
        type(policy), 'look_up', lambda self, rows: looked_up.append(rows) or look_up(self, rows)
    )
    before = flight.manager.situation.state
    if what == 'threat':
        flight.threat('high')
    else:
        flight.fault = 'actuator'
    flight.say()
    assert flight.manager.situation.state != before
    assert looked_up == []
    flight.at(7)
    flight.say()
    assert looked_up != [], 'else this test would see nothing'


def test_the_end_of_a_danger_counts_when_it_has_lasted(flight: Flight) -> None:
    flight.ask(0, 0, 0)
    flight.at(2)
    flight.threat('high')
    assert flight.say() == 'none agile'
    flight.say(100.0)
    flight.threat('none')
    assert [flight.say(0.5) for _ in range(11)] == ['none agile'] * 9 + ['none normal'] * 2
    # What comes back meanwhile begins anew.
    flight.threat('high')
    flight.say(100.0)
    for level in ('none', 'low', 'none', 'high', 'low'):
        flight.threat(level)
        flight.say(2.0)
    assert flight.manager.situation.threat == 2
    flight.say(3.0)
    assert flight.manager.situation.threat == 1


def test_each_part_is_repaired_by_itself(flight: Flight) -> None:
    flight.ask(2, 0, 0)
    for fault, seen in (('all', 8), ('actuator_camera', 8), ('camera', 8), ('nominal', 8)):
        flight.fault = fault
        flight.say(2.0)
        assert flight.manager.situation.fault == seen
        seen = flight.manager.situation.fault
    flight.say(2.0)  # The sensor is well for 6 s, the actuator for 4 s, the camera for 2 s.
    assert flight.manager.situation.fault == FAULT_MODES.index('actuator_camera') + 1


def test_without_settling_the_end_of_a_danger_counts_at_once(policy: Policy) -> None:
    flight = Flight(policy, settling_time=0.0)
    flight.ask(0, 0, 0)
    flight.threat('high')
    flight.threat('none')
    assert flight.manager.situation.threat == 0


# Priorities


def test_a_rare_change_of_priorities_counts_at_once_and_a_frequent_one_when_it_lasts(
    flight: Flight,
) -> None:
    def priorities() -> tuple[int, ...]:
        flight.say(2.0)
        return flight.manager.situation.priorities

    flight.ask(2, 0, 0, name='a')
    assert priorities() == (2, 0, 0)
    flight.ask(0, 2, 0, name='b')
    assert [priorities() for _ in range(3)] == [(2, 0, 0), (2, 0, 0), (0, 2, 0)]
    flight.ask(0, 0, 1, name='c')
    assert priorities() == (0, 0, 1)
    # Of what does not last nothing is left.
    flight.ask(2, 2, 2, name='d')
    flight.ask(0, 0, 1, name='c')
    assert [priorities() for _ in range(4)] == [(0, 0, 1)] * 4
    assert flight.manager.situation.request == 'c'


def test_a_cancellation_counts_at_once_and_what_follows_it_when_it_lasts(flight: Flight) -> None:
    flight.ask(2, 0, 0, name='a')
    flight.say()
    flight.ask(0, 0, 0, name='b')
    assert flight.say() == 'none normal'
    flight.ask(2, 0, 0, name='c')
    assert [flight.say(2.6) for _ in range(3)] == ['none normal'] + ['commit goal1 normal'] * 2


def test_the_repetition_of_a_request_that_does_not_count_yet_changes_nothing(
    flight: Flight,
) -> None:
    flight.ask(2, 0, 0, name='a')
    flight.ask(0, 2, 0, name='b')
    for _ in range(4):
        flight.say(1.0)
        flight.ask(0, 2, 0, name='b')
    assert flight.manager.situation.priorities == (2, 0, 0)
    flight.complete('goal2')  # Done already, whoever asked for it.
    flight.say(1.1)
    flight.ask(0, 2, 0, name='b')
    assert flight.manager.situation.priorities == (0, 0, 0)


# Flicker


Flicker = Callable[[Flight, int], object]


def _alternate(*changes: Callable[[Flight], object]) -> Flicker:
    return lambda flight, n: changes[n % len(changes)](flight)


def _set(name: str, *values: object) -> Flicker:
    return lambda flight, n: setattr(flight, name, values[n % len(values)])


SETTLING = {
    'threat': _alternate(*(lambda f, t=t: f.threat(t) for t in ('none', 'high', 'low'))),
    'fault': _set('fault', *FAULT_MODES),
    'one part': _set('fault', 'nominal', 'sensor'),
    'another part': _set('fault', 'nominal', 'actuator'),
    'gauge': _set('charge', 0.0, 1.0),
    'one point of the gauge': _set('charge', 0.21, 0.22),
    'noise of the gauge': lambda f, n: setattr(f, 'charge', 0.215 + 0.02 * math.sin(n * n)),
    'health': _set('battery', {'healthy': False}, {'healthy': True}),
    'voltage': _set('battery', {'voltage': 9.9}, {'voltage': 12.6}),
    'one metre': lambda f, n: f.__dict__.update(fault='sensor', place=(74.0 + 2 * (n % 2), 0.0)),
    'one metre at a corner': _set('place', (24.0, -24.0), (26.0, -26.0)),
    'metre and threat': lambda f, n: (
        setattr(f, 'place', (74.0 + 2 * (n % 2), 0.0)),
        f.threat(('none', 'high')[n % 2]),
    ),
    'requests': lambda f, n: f.ask(*((2, 0, 0), (0, 2, 1))[n % 2], name=f'{n}'),
    'two requests': lambda f, n: f.ask(*((2, 0, 0), (0, 2, 1))[n % 2], name='ab'[n % 2]),
    'requests without id': lambda f, n: f.ask(*((2, 0, 0), (0, 2, 1))[n % 2]),
    'cancellations': lambda f, n: f.ask(*((2, 1, 1), (0, 0, 0))[n % 2], name=f'{n}'),
    'completions': _alternate(lambda f: f.ask(2, 2, 2), lambda f: f.complete('goal1')),
    'refusals': lambda f, n: (
        f.refuse('goal1') if n % 2 else f.ask(2, 1 + n % 4 // 2, 0, name=f'{n}')
    ),
}
"""Inputs that flicker, and after a moment change nothing."""

DWELLING = {
    'far jumps': _set('place', (0.0, 0.0), (150.0, -50.0), (50.0, 0.0), (100.0, -50.0)),
    'off the grid': _set('place', (0.0, 0.0), (-2500.0, 0.0), (150.0, -50.0)),
    'everything': lambda f, n: [
        flicker(f, n // rate) for rate, flicker in enumerate(SETTLING.values(), 1)
    ],
}
"""Inputs that flicker, and change the command no more than once in the dwell."""

STATES = [(cell, priorities) for cell in (1, 2) for priorities in ((0, 0, 0), (2, 0, 1))]


def _changes(flight: Flight, flicker: Flicker, seconds: float = 61.0) -> list[float]:
    """When the command changes, while an input flickers at 10 Hz."""
    command, times = flight.say(), []
    for n in range(round(10 * seconds)):
        flicker(flight, n)
        said = flight.say()
        if 'off the grid' not in said and said != command:
            command = said
            times.append(flight.now)
    return times


@pytest.mark.parametrize('flicker', SETTLING.values(), ids=SETTLING.keys())
def test_what_flickers_settles(policy: Policy, flicker: Flicker) -> None:
    for cell, priorities in STATES:
        flight = Flight(policy)
        flight.at(cell)
        flight.ask(*priorities, name='at first')
        times = _changes(flight, flicker, 41.0)
        assert len(times) <= 3, (cell, priorities)
        assert all(time < 1030.0 for time in times)


@pytest.mark.parametrize('flicker', DWELLING.values(), ids=DWELLING.keys())
def test_the_command_changes_twelve_times_a_minute_at_most(
    policy: Policy, flicker: Flicker
) -> None:
    for cell, priorities in STATES:
        flight = Flight(policy)
        flight.at(cell)
        flight.ask(*priorities, name='at first')
        times = _changes(flight, flicker)
        assert all(sum(t <= time < t + 60.0 for time in times) <= 12 for t in times)


def test_policies_that_alternate_change_the_command_no_more_often(
    policy: Policy, other_policy: Policy
) -> None:
    flight = Flight(policy)
    flight.ask(1, 1, 1)
    policies = policy, other_policy
    times = _changes(flight, lambda f, n: f.manager.adopt(policies[n % 2]), 300.0)
    assert all(sum(t <= time < t + 60.0 for time in times) <= 12 for t in times)
    assert len(times) > 10


# Another policy


def test_with_another_policy_the_command_stays_for_its_time(
    flight: Flight, other_policy: Policy
) -> None:
    flight.ask(1, 0, 1)
    first = flight.say()
    flight.manager.adopt(other_policy)
    said = [flight.say(1.0) for _ in range(7)]
    assert said[:4] == [first] * 4
    assert said[-1] != first


def test_a_policy_for_another_grid_is_not_adopted(flight: Flight) -> None:
    grid = replace(MISSION.grid, cell_size=60.0)
    with pytest.raises(ValueError, match='the policy is for another grid'):
        flight.manager.adopt(build_policy(replace(MISSION, grid=grid)))


# Memory


def test_a_memory_says_the_same_again_and_only_changes_with_the_inputs(flight: Flight) -> None:
    flight.ask(2, 0, 1, name='a')
    flight.say()
    memory = flight.manager.memory
    assert json.loads(json.dumps(memory)) == memory
    for _ in range(30):
        flight.ask(2, 0, 1, name='a')
        flight.threat('none')
        flight.say()
    assert flight.manager.memory == memory
    assert MissionManager(flight.manager.policy, memory=memory).memory == memory


@pytest.mark.parametrize(
    ('path', 'value'),
    [
        (('command', 'action'), 99),
        (('situation', 'priorities'), [1, 2]),
        (('situation', 'priorities'), [1, 2, 3]),
        (('situation', 'cell'), 8),
        (('situation', 'ended'), []),
        (('situation',), None),
    ],
)
def test_a_memory_of_something_else_is_refused_in_one_line(
    flight: Flight, path: tuple[str, ...], value: object
) -> None:
    flight.ask(2, 0, 1)
    flight.say()
    memory = part = json.loads(json.dumps(flight.manager.memory))
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with pytest.raises(ValueError, match=r'^memory: .+$'):
        MissionManager(flight.manager.policy, memory=memory)


def test_of_another_boot_it_waits_no_longer_than_from_now_on(
    flight: Flight, policy: Policy
) -> None:
    """The clock of an earlier boot may be ahead: what it says of times is not known."""
    flight.ask(0, 0, 0)
    flight.at(2)
    flight.threat('high')
    assert flight.say() == 'none agile'
    flight.threat('none')
    memory = flight.manager.memory
    flight.manager, flight.now = MissionManager(policy, memory=memory), 1.0
    assert flight.say() == 'none agile'
    assert flight.say(10.0) == 'none normal'


EVENTS = st.one_of(
    st.builds(lambda t: lambda f: f.threat(t), st.sampled_from(('none', 'low', 'high'))),
    st.builds(lambda v: lambda f: setattr(f, 'fault', v), st.sampled_from(FAULT_MODES)),
    st.builds(
        lambda v: lambda f: setattr(f, 'charge', v),
        st.sampled_from((0.2, 0.21, 0.215, 0.22, 0.24, 0.26, 0.3)) | st.floats(0.0, 1.0),
    ),
    st.builds(
        lambda v: lambda f: setattr(f, 'battery', v),
        st.sampled_from(({}, {'healthy': False}, {'voltage': 10.5}, {'voltage': 14.0})),
    ),
    st.builds(
        lambda x, y: lambda f: setattr(f, 'place', (x, y)),
        st.floats(-90.0, 220.0),
        st.floats(-110.0, 60.0),
    ),
    st.builds(
        lambda v, name: lambda f: f.ask(*v, name=name),
        st.tuples(*[st.integers(0, 2)] * MISSION.k),
        st.sampled_from(('', 'a', 'b', 'c')),
    ),
    st.builds(lambda g: lambda f: f.complete(g), st.sampled_from(('goal1', 'goal2', 'goal3'))),
    st.builds(lambda g: lambda f: f.refuse(g), st.sampled_from(('goal1', 'goal2', 'goal3'))),
    st.just(lambda f: f.manager.reset_goals()),
    st.just(lambda f: None),
)


STEPS = st.tuples(EVENTS, st.sampled_from((0.1, 0.1, 1.0, 2.6, 6.0)), st.booleans())
"""What happens, for how long nothing more does, and whether the manager is killed before it."""


@settings(max_examples=100)
@given(steps=st.lists(STEPS, min_size=5, max_size=40))
def test_a_manager_made_anew_goes_on_as_if_nothing_had_happened(
    policy: Policy, steps: list[tuple[Callable[[Flight], object], float, bool]]
) -> None:
    lives_on, killed = Flight(policy), Flight(policy)
    for event, pause, dies in steps:
        if dies:
            memory = json.loads(json.dumps(killed.manager.memory))
            killed.manager = MissionManager(policy, memory=memory)
        said = []
        for flight in (lives_on, killed):
            with suppress(InputError):
                event(flight)
            said.append(flight.say(pause))
        assert said[0] == said[1]
        assert lives_on.manager.memory == killed.manager.memory
