"""Goals shared out by what was heard of each vehicle."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study

from uav_mission_manager.fleet import FleetDispatcher, FleetRole, FleetSettings
from uav_mission_manager.fleet.reports import height_conflicts
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.recombination import FleetPlanner, FleetRules

MISSION = mission_from_dict(case_study(), 'test')
PLANNER = FleetPlanner(MISSION, rules=FleetRules(threshold=1e-9))
VEHICLES = ('a', 'b', 'c')
LOST = 10.0


class Station:
    """A dispatcher with vehicles at different heights, and a time."""

    def __init__(self, planner=PLANNER, vehicles=VEHICLES, memory=None, **changes) -> None:
        changed = FleetSettings(lost_after=LOST, **changes)
        self.now = 100.0
        self.dispatcher = FleetDispatcher(planner, vehicles, changed, self.now, memory)
        self.heights = {v: 20.0 + 10.0 * n for n, v in enumerate(vehicles)}
        self.ids = map(str, itertools.count())

    def hear(self, vehicle, cell=0, f=1, ranges=(1, 1, 1), disobedience='', silence=''):
        state = () if silence else (f, *ranges, 0, 0, 0, cell, 0, 0, 0)
        report = self.dispatcher.reports[vehicle].with_decision(state, silence, self.now)
        heard = report.with_bridge(disobedience, self.heights[vehicle], self.now)
        self.dispatcher.reports[vehicle] = heard

    def ask(self, *priorities):
        self.dispatcher.wish.ask(priorities, next(self.ids))
        self.dispatcher.forget_refusals()

    def step(self):
        return self.dispatcher.step(self.now, lambda: next(self.ids))

    def given(self):
        """What each vehicle is asked for, after a step."""
        self.step()
        return {v: list(r.priorities) for v, r in self.dispatcher.requests.items()}

    def share(self, vehicle):
        return next(s for s in self.dispatcher.decision.shares if s.vehicle == vehicle)

    def goals(self):
        """Goals that are asked for, by whichever vehicle."""
        return sorted(j for values in self.given().values() for j, g in enumerate(values) if g)


def flying(**cells):
    station = Station()
    for vehicle, cell in cells.items():
        station.hear(vehicle, cell)
    return station


def test_every_vehicle_is_asked_for_no_goal_first():
    station = Station()
    assert station.step() == list(VEHICLES)
    assert all(request.request for request in station.dispatcher.requests.values())
    assert station.step() == []


def test_each_goal_goes_to_one_vehicle_with_its_priority():
    station = flying(a=0, b=3, c=6)
    station.ask(2, 1, 2)
    assert station.given() == {'a': [2, 0, 0], 'b': [0, 1, 0], 'c': [0, 0, 2]}
    assert station.step() == []
    assert dict(station.dispatcher.decision.left) == {}


def test_nothing_is_asked_anew_while_vehicles_move():
    station = flying(a=0, b=3, c=6)
    station.ask(2, 2, 2)
    station.step()
    for cells in ((1, 2, 5), (5, 3, 6), (4, 7, 2)):
        for vehicle, cell in zip(VEHICLES, cells, strict=True):
            station.hear(vehicle, cell)
        station.now += 1.0
        assert station.step() == []


def test_who_is_done_gets_the_next_goal_and_keeps_its_request_without_one():
    station = flying(a=5)
    station.ask(2, 2, 0)
    [first] = station.goals()
    request = station.dispatcher.requests['a'].request
    assert station.dispatcher.complete(MISSION.goals[first].name)
    [second] = station.goals()
    assert {first, second} == {0, 1}
    assert station.dispatcher.requests['a'].request != request
    request = station.dispatcher.requests['a'].request
    station.dispatcher.complete(MISSION.goals[second].name)
    # The same request, without the goal: for the manager it is achieved.
    assert station.given()['a'] == [0, 0, 0]
    assert station.dispatcher.requests['a'].request == request
    assert not station.dispatcher.complete(MISSION.goals[second].name)


@pytest.mark.parametrize('trouble', ['silent manager', 'no message', 'pilot'])
def test_a_vehicle_keeps_its_goal_for_a_while_and_then_others_get_it(trouble):
    station = flying(a=5, b=3)
    station.ask(2, 2, 0)
    before = station.given()
    [lost] = [j for j, g in enumerate(before['a']) if g]

    def pass_time(seconds):
        station.now += seconds
        station.hear('b', 3)
        if trouble != 'no message':
            station.hear(
                'a',
                5,
                disobedience='pilot in command' if trouble == 'pilot' else '',
                silence='link lost' if trouble == 'silent manager' else '',
            )

    for _ in range(2):
        pass_time(LOST / 2.0 - 0.1)
        assert station.given() == before
    assert station.share('a').role is FleetRole.AWAITED
    # It counts as acting for its goal: the other one has nothing to do there when it is free.
    station.dispatcher.complete(MISSION.goals[1 - lost].name)
    assert station.given()['b'] == [0, 0, 0]
    pass_time(0.5)
    assert station.given()['b'][lost] == 2
    assert station.given()['a'] == [0, 0, 0]
    assert station.share('a').role is FleetRole.OUT
    station.hear('a', 5)
    station.step()
    assert station.share('a').role is FleetRole.READY
    assert station.goals() == [lost]


def test_a_vehicle_that_comes_later_is_given_a_goal():
    station = flying(a=0)
    station.ask(2, 2, 0)
    assert len(station.goals()) == 1
    assert list(station.dispatcher.decision.left.values()) == ['waits for a vehicle that is free']
    station.hear('c', 3)
    assert station.goals() == [0, 1]


@pytest.mark.parametrize('change', [{'f': 5}, {'ranges': (0, 0, 0)}])
def test_a_fault_or_a_low_battery_gives_the_goal_to_who_can(change):
    station = flying(a=5, b=0)
    station.ask(2, 0, 0)
    assert station.given()['a'] == [2, 0, 0]
    station.hear('a', 5, **change)
    assert station.given() == {'a': [0, 0, 0], 'b': [2, 0, 0], 'c': [0, 0, 0]}


def test_a_refused_goal_goes_to_another_one_until_it_is_asked_for_anew():
    station = flying(a=5, b=0)
    station.ask(2, 0, 0)
    assert station.given()['a'] == [2, 0, 0]
    assert station.dispatcher.refuse('a', 'goal1')
    assert not station.dispatcher.refuse('a', 'goal1')
    assert not station.dispatcher.refuse('a', 'no_goal')
    assert station.given()['b'] == [2, 0, 0]
    assert station.dispatcher.refuse('b', 'goal1')
    assert station.goals() == []
    station.ask(2, 0, 0)
    assert station.given()['a'] == [2, 0, 0]


def test_who_flies_at_the_height_of_another_one_gets_nothing():
    station = Station()
    station.heights['b'] = station.heights['a'] + 4.9
    for vehicle, cell in (('a', 0), ('b', 5), ('c', 3)):
        station.hear(vehicle, cell)
    station.ask(2, 2, 2)
    assert station.given()['b'] == [0, 0, 0]
    assert station.share('b').role is FleetRole.OUT
    words = 'flight_altitude 24.9 m is within 5 m of the 20 m of a: they could meet'
    assert station.share('b').reason == words
    station.heights['b'] = math.nan
    station.hear('b', 5)
    station.step()
    assert station.share('b').reason == 'its flight height is not known'


@settings(max_examples=100)
@given(st.lists(st.integers(0, 30), max_size=6), st.integers(1, 10))
def test_the_heights_that_are_left_are_apart_and_no_other_could_join(heights, separation):
    named = {str(n): float(height) for n, height in enumerate(heights)}
    conflicts = height_conflicts(named, separation)
    left = [height for name, height in named.items() if name not in conflicts]
    for one, other in itertools.combinations(left, 2):
        assert abs(one - other) >= separation
    for name in conflicts:
        assert any(abs(named[name] - height) < separation for height in left)


def test_preconditions_and_minimal_agents():
    rules = FleetRules(preconditions={'goal3': ['goal1']}, agents={'goal1': 2}, threshold=1e-9)
    station = Station(FleetPlanner(MISSION, rules=rules))
    station.hear('a', 5)
    station.ask(2, 0, 2)
    assert station.goals() == []
    assert station.dispatcher.decision.left == {
        'goal1': 'waits for 2 vehicles that are free',
        'goal3': 'waits for goal1',
    }
    station.hear('b', 0)
    assert station.goals() == [0, 0]
    station.dispatcher.complete('goal1')
    assert station.goals() == [2]


def test_one_that_is_started_again_goes_on():
    station = flying(a=0, b=3)
    station.ask(2, 2, 2)
    station.step()
    station.dispatcher.complete('goal2')
    before = station.given()
    again = Station(memory=station.dispatcher.memory)
    assert again.dispatcher.wish.achieved == ['goal2']
    # Before it hears of them, too.
    assert again.step() == []
    assert again.given() == before
    assert again.share('a').role is FleetRole.AWAITED
    for vehicle, cell in (('a', 0), ('b', 3)):
        again.hear(vehicle, cell)
    assert again.step() == []
    assert again.dispatcher.memory == station.dispatcher.memory
    again.now += LOST + 0.1
    assert again.goals() == []


def best_sum(states, wanted, barred):
    """The largest sum of gains of any choice, each goal to one vehicle at most."""
    rows = np.array(states)
    rows[:, 4:7] = wanted
    gains = np.stack([policy.gains(rows) for policy in PLANNER.policies], axis=1)
    best = 0.0
    for choice in itertools.product(range(-1, 3), repeat=len(states)):
        goals = [j for j in choice if j >= 0]
        allowed = all((n, j) not in barred and (j < 0 or wanted[j]) for n, j in enumerate(choice))
        if allowed and len(goals) == len(set(goals)):
            best = max(best, sum(gains[n, j] for n, j in enumerate(choice) if j >= 0))
    return best, gains


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_the_optimal_assignment_is_the_best_of_all_choices(data):
    wanted = data.draw(st.tuples(*[st.integers(0, 2)] * 3))
    count = data.draw(st.integers(1, 3))
    vehicles = VEHICLES[:count]
    station = Station(vehicles=vehicles)
    barred = data.draw(st.sets(st.tuples(st.integers(0, count - 1), st.integers(0, 2))))
    states = []
    for vehicle in vehicles:
        cell, f = data.draw(st.integers(0, 7)), data.draw(st.integers(1, 8))
        ranges = data.draw(st.tuples(*[st.integers(0, 1)] * 3))
        station.hear(vehicle, cell, f, ranges)
        states.append((f, *ranges, 0, 0, 0, cell, 0, 0, 0))
    station.ask(*wanted)
    for n, j in barred:
        station.dispatcher.refuse(vehicles[n], MISSION.goals[j].name)
    station.step()
    best, gains = best_sum(states, wanted, barred)
    found = [station.dispatcher.decision.given[v] for v in vehicles]
    assert all((n, j) not in barred for n, j in enumerate(found))
    assert all(wanted[j] for j in found if j >= 0)
    gained = sum(gains[n, j] for n, j in enumerate(found) if j >= 0)
    assert gained == pytest.approx(best, abs=1e-9)


def test_it_says_why_and_what_it_would_cost_otherwise():
    station = flying(a=0, b=3)
    station.ask(2, 2, 0)
    station.step()
    states = [(1, 1, 1, 1, 0, 0, 0, cell, 0, 0, 0) for cell in (0, 3)]
    best, gains = best_sum(states, (2, 2, 0), set())
    other, _ = best_sum(states, (2, 2, 0), {(0, 0)})
    assert station.share('a').reason == (
        f'high priority, going there saves {gains[0, 0]:.4g}; '
        f'otherwise a to goal2, b to goal1, {best - other:.3g} dearer'
    )
    assert station.share('c').reason == 'manager not heard'


@pytest.mark.parametrize(
    ('assignment', 'expected'), [('queue', [2, -1, 0]), ('optimal', [2, 0, 1])]
)
def test_kept_and_barred_goals_of_a_plan(assignment, expected):
    states = np.array([[[1, 1, 1, 1, 2, 2, 2, cell, 0, 0, 0] for cell in (5, 3, 6)]])
    kept = np.array([[2, -1, -1]])
    barred = np.zeros((1, 3, 3), bool)
    barred[0, 1, 1] = True
    plan = PLANNER.plan(states, assignment=assignment, kept=kept, barred=barred)
    assert plan.pursued.tolist() == [expected]  # The queue sends the nearest one to goal1.
    barred[0, :, 1] = True
    plan = PLANNER.plan(states, assignment=assignment, kept=kept, barred=barred)
    assert sorted(plan.pursued[0]) == [-1, 0, 2]
    assert (plan.queues[0, 1] < 0).all()
    barred[:] = True
    plan = PLANNER.plan(states, assignment=assignment, barred=barred)
    assert plan.pursued.tolist() == [[-1, -1, -1]]
