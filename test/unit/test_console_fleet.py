"""The fleet of the console: policy sets by digest, forecasts, and what is told of both."""

from __future__ import annotations

import itertools
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from strategies import case_study

from uav_mission_manager.console import forecasting, policies
from uav_mission_manager.console.fleet import MOST_ANSWERS_KEPT, Fleet
from uav_mission_manager.console.forecasting import FORECAST_LIMITS, Forecaster, goal_chances
from uav_mission_manager.console.heard import Heard, HeardDecision, Pose
from uav_mission_manager.console.orders import (
    QUESTIONS,
    OperatorOrder,
    question,
    standing_priorities,
)
from uav_mission_manager.console.policies import PolicyShelf
from uav_mission_manager.mdp import load_mission, mission_from_dict
from uav_mission_manager.mdp.placing import place_goal
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import build_policy, load_policy
from uav_mission_manager.solver.evaluation.simulation import Simulator

SETS = share_directory() / 'policies'
STATE = (1, 1, 1, 1, 2, 2, 0, 0, 0, 0, 0)


@pytest.fixture(scope='module')
def policy():
    return load_policy(SETS / 'case_study')


def fleet_of(*names, now=0.0):
    return Fleet(PolicyShelf([str(SETS / name) for name in names]), lambda: now, 3.0)


def heard_of(digest, state=STATE):
    return Heard().with_decision(HeardDecision('why', digest, state=state, command='x'), 0.0, '')


def until(condition, limit=180.0):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_vehicle_flies_the_mission_of_the_set_that_its_manager_names(policy):
    fleet = fleet_of('case_one', 'case_study')
    one = load_policy(SETS / 'case_one')
    fleet.heard = {'/a': heard_of(policy.digest), '/b': heard_of(one.digest), '/c': Heard()}
    assert fleet.policy('/a').mission == policy.mission
    assert fleet.policy('/b').mission == one.mission
    assert fleet.policy('/c') is None


def test_a_set_that_is_written_anew_is_found(tmp_path, policy):
    shutil.copytree(SETS / 'case_one', tmp_path / 'set')
    now, shelf = 100.0, PolicyShelf([str(tmp_path / 'set')])
    assert shelf.find(policy.digest, now) is None
    shutil.rmtree(tmp_path / 'set')
    shutil.copytree(SETS / 'case_study', tmp_path / 'set')
    # Time goes on: a look that is still under way from before keeps the next one from beginning.
    times = itertools.count(now, 2 * policies.LOOK_AGAIN_PERIOD)
    until(lambda: shelf.find(policy.digest, next(times)) is not None)
    assert shelf.find(load_policy(SETS / 'case_one').digest, now) is not None


def test_a_set_that_cannot_be_read_is_told_at_the_start_and_borne_later(tmp_path, policy):
    with pytest.raises(ValueError, match='nowhere'):
        PolicyShelf([str(tmp_path / 'nowhere')])
    shutil.copytree(SETS / 'case_one', tmp_path / 'set')
    shelf = PolicyShelf([str(tmp_path / 'set')])
    (tmp_path / 'set' / 'manifest.json').write_text('{')
    assert shelf.find(policy.digest, 100.0) is None
    assert shelf.find(load_policy(SETS / 'case_one').digest, 200.0) is not None


@pytest.fixture(scope='module')
def requested(policy, tmp_path_factory):
    """Two policies: of a mission with a slot, and with a goal requested into it, on disk."""
    goals = policy.mission.goals
    slots = replace(policy.mission, goals=(*goals[:2], replace(goals[2], slot=True)))
    folder = tmp_path_factory.mktemp('sets') / 'case_study.goals1'
    placed, _ = place_goal(slots, '{"cell": 2, "name": "tree"}', [2])
    build_policy(placed, 'split').save(folder)
    return slots, load_policy(folder), str(folder)


def names(mission):
    return [goal.name for goal in mission.goals]


def test_after_a_take_over_the_goals_are_those_of_the_set_that_was_announced(policy, requested):
    _, placed, folder = requested
    times = itertools.count(100.0, 2 * policies.LOOK_AGAIN_PERIOD)
    fleet = Fleet(PolicyShelf([str(SETS / 'case_study')]), lambda: next(times), 3.0)
    fleet.heard['/a'] = heard_of(policy.digest).with_policy_set(folder, '')
    assert names(fleet.mission_of('/a')) == ['goal1', 'goal2', 'goal3']
    fleet.heard['/a'] = heard_of(placed.digest)
    assert fleet.mission_of('/a') is None, 'of a set that is not at hand nothing is shown'
    fleet.heard['/a'] = heard_of(placed.digest).with_policy_set(folder, '')
    until(lambda: fleet.mission_of('/a') is not None)
    assert names(fleet.mission_of('/a')) == ['goal1', 'goal2', 'tree']
    assert fleet.mission_of('/a').goals[2].cell == 2
    assert [bar.name for bar in fleet.view('/a').now.parts] == ['goal1', 'goal2', 'tree']
    fleet.heard['/a'] = heard_of(policy.digest).with_policy_set(folder, '')
    assert names(fleet.mission_of('/a')) == ['goal1', 'goal2', 'goal3']


def test_only_so_many_announced_sets_are_kept(policy, monkeypatch):
    one = load_policy(SETS / 'case_one')
    shelf = PolicyShelf([])
    monkeypatch.setattr(policies, 'MOST_ANNOUNCED', 1)
    times = itertools.count(100.0, 2 * policies.LOOK_AGAIN_PERIOD)
    for each, name in ((policy, 'case_study'), (one, 'case_one')):
        wanted = each.digest, str(SETS / name)
        until(lambda w=wanted: shelf.find(w[0], next(times), w[1]))
    assert shelf.find(policy.digest, next(times)) is None


def test_a_recording_shows_the_mission_with_the_goals_of_each_moment(policy, requested):
    slots, placed, _ = requested
    fleet = fleet_of()
    fleet.missions = slots, placed.mission
    assert fleet.mission_of('/a') is slots, 'before anything is heard'
    for goals, mission in (
        (('goal1', 'goal2', 'goal3'), slots),
        (('goal1', 'goal2', 'tree'), placed.mission),
        (('goal1', 'goal2', 'hut'), None),
    ):
        decision = HeardDecision('why', 'elsewhere', state=STATE, command='x', goals=goals)
        fleet.heard['/a'] = Heard().with_decision(decision, 0.0, '')
        assert fleet.mission_of('/a') is mission


def test_values_of_the_sub_mdps_are_the_policys(policy):
    fleet = fleet_of('case_study')
    fleet.heard['/a'] = heard_of(policy.digest)
    values = policy.part_values([STATE])[0]
    assert [bar.value for bar in fleet.view('/a').now.parts] == [f'{v:.4g}' for v in values]
    fleet.heard['/a'] = heard_of(policy.digest, (9, *STATE[1:]))  # No state of this mission.
    assert fleet.view('/a').now.parts == ()


def test_vehicles_are_in_the_order_that_people_count_in():
    fleet = fleet_of('case_one')
    fleet.heard = {name: Heard() for name in ('/uav10', '/uav2', '/a', '/uav1')}
    assert fleet.names == ['/a', '/uav1', '/uav2', '/uav10']


def test_only_vehicles_on_the_same_grid_are_on_a_map(policy):
    fleet = fleet_of('case_one', 'case_study', now=10.0)
    pose = Pose(1.0, 2.0, 3.0, 0.0)
    near = heard_of(policy.digest).with_pose(pose, 10.0)
    far = heard_of('of another set').with_pose(pose, 10.0)
    fleet.heard = {'/a': near, '/b': far, '/c': near.with_pose(pose, 5.0), '/d': Heard()}
    crafts = fleet.crafts(policy.mission)
    assert {name: craft.old for name, craft in crafts.items()} == {'/a': False, '/c': True}


def test_answers_are_numbered_and_the_last_ones_kept():
    fleet = fleet_of('case_one')
    for _ in range(MOST_ANSWERS_KEPT + 3):
        fleet.answer(OperatorOrder('/a', 'hold'), True, 'done')
    assert [answer.number for answer in fleet.answers] == list(range(4, MOST_ANSWERS_KEPT + 4))


def test_chances_are_those_of_flights_that_are_flown_one_by_one(policy):
    """Counted anew, epoch by epoch; an epoch lasts for cell_size / speed."""
    mission, found = policy.mission, goal_chances(policy, STATE, seed=1)
    rng, simulator = np.random.default_rng(2), Simulator(mission)
    states = np.repeat([STATE], 3000, axis=0)
    done = np.zeros((len(states), mission.k), bool)
    seconds = mission.grid.cell_size / mission.energy.speed
    for epoch in range(1, int(60 * max(FORECAST_LIMITS) / seconds) + 1):
        step = simulator.transition(states, policy.act(states), rng)
        done |= step.completed
        states = step.after
        for limit in FORECAST_LIMITS:
            if epoch == int(60 * limit / seconds):
                for j, goal in enumerate(mission.goals[:2]):
                    assert found.chances[goal.name][limit] == pytest.approx(
                        done[:, j].mean(), abs=0.1
                    )
    assert set(found.chances) == {'goal1', 'goal2'}  # goal3 is not wanted.


def test_a_forecast_without_a_speed_says_why_there_is_none():
    document = case_study()
    del document['energy']
    mission = mission_from_dict(document, 'test')
    policy = build_policy(mission, method='best_value')
    assert 'energy' in goal_chances(policy, STATE).trouble


def test_the_forecaster_answers_the_latest_question_of_each_vehicle(policy, monkeypatch):
    monkeypatch.setattr(forecasting, 'FORECAST_PERIOD', 0.0)
    forecaster, other = Forecaster(), (1, 1, 1, 1, 0, 0, 2, 5, 0, 0, 0)
    forecaster.want('/a', policy, STATE)
    forecaster.want('/b', policy, other)
    until(lambda: {'/a', '/b'} <= forecaster.found.keys())
    assert forecaster.found['/a'].state == STATE
    assert set(forecaster.found['/b'].chances) == {'goal3'}


@pytest.mark.parametrize('kind', QUESTIONS)
def test_every_order_is_asked_for_with_vehicle_and_values(kind):
    mission = load_mission(share_directory() / 'config' / 'case_study.yaml')
    values = {'priorities': (0, 1, 2), 'threat': (2,)}.get(kind, ())
    asked = question(OperatorOrder('/uav1', kind, values), mission)
    assert '/uav1' in asked
    assert ('goal1 none, goal2 low, goal3 high' in asked) == (kind == 'priorities')
    assert ('threat is high' in asked) == (kind == 'threat')


def test_an_order_begins_with_what_is_asked_for_and_with_goals_requested_in_flight(requested):
    slots, placed, _ = requested
    larger, _ = place_goal(placed.mission, '{"cell": 4}', [], 4)
    plain = replace(slots, goals=tuple(replace(goal, slot=False) for goal in slots.goals))
    state = (1, 1, 1, 1, 0, 1, 2, 0, 0, 0, 0)
    assert standing_priorities(plain, (2, 2, 1), state) == (2, 2, 1)
    assert standing_priorities(plain, (2, 2, 1), ()) == (2, 2, 1)
    assert standing_priorities(placed.mission, (2, 2, 1), state) == (2, 2, 2)
    longer = (1, 1, 1, 1, 1, 0, 1, 2, 1, 0, 0, 0, 0)
    assert standing_priorities(larger, (2, 2, 1), longer) == (2, 2, 2, 1)
    assert standing_priorities(larger, (2, 2, 1), state) == (2, 2, 0, 0)
