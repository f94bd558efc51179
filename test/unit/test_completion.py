"""Goals that take different times: what is solved and simulated is what enumeration finds."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from brute_force import BruteForce, solve
from strategies import case_study, lively, pick_states, with_charge
from test_brute_force import assert_bellman, assert_simulated

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import MissionError, allowed_actions, mission_from_dict
from uav_mission_manager.mdp.dynamics import completion_probabilities
from uav_mission_manager.solver.bounds import lower_bound
from uav_mission_manager.solver.decomposition.decompose import decompose
from uav_mission_manager.solver.decomposition.measures import Measures
from uav_mission_manager.solver.evaluation import (
    evaluate,
    forecast,
    sensitivity,
    simulation,
    tabulate,
)
from uav_mission_manager.solver.evaluation.fleet_simulation import simulate_fleets
from uav_mission_manager.solver.evaluation.flights import fly
from uav_mission_manager.solver.evaluation.occupancy import start_state
from uav_mission_manager.solver.exact import AxisModel, LookAhead, look_ahead, solve_blocks
from uav_mission_manager.solver.expansion import Clusters, ExpansionLookAhead, fit_expansion
from uav_mission_manager.solver.recombination import FleetPlanner
from uav_mission_manager.solver.reduced import goal_order
from uav_mission_manager.solver.submdp import whole_mission

SLOW = [0.25, 0.2, 0.0, 0.1, 0.15, 0.0, 0.05, 0.0]
"""Completion by fault mode of what takes four epochs, and is impossible in other modes."""


def read(document):
    return mission_from_dict(document, 'test')


def different(document=None, goal=1, completion=SLOW):
    """Two goals in one cell; one takes as long as the faults say, two epochs, the other longer."""
    document = document or lively()
    document['faults']['completion'] = [0.5, 0.4, 0.3, 0.0, 0.3, 0.2, 0.1, 0.0]
    document['goals'][goal]['completion'] = completion
    return document


DOCUMENTS = {'flags': different(), 'charge': with_charge(different(), levels=3)}


@pytest.fixture(scope='module', params=DOCUMENTS)
def known(request):
    """Document, mission and the reference's solution."""
    document = DOCUMENTS[request.param]
    return document, read(document), solve(BruteForce(document))


def assert_q(q, reference, tolerance=1e-6):
    np.testing.assert_array_equal(np.isinf(q), np.isinf(reference.q))
    allowed = np.isfinite(reference.q)
    np.testing.assert_allclose(q[allowed], reference.q[allowed], rtol=0, atol=tolerance)


# The file


def of_goals(**fields):
    """Completion of the case study's goals, the first with some fields; an epoch of 10 s."""
    document = case_study()
    document['faults'].pop('completion')
    document['faults']['done_in'] = [20.0, 30.0, 40.0, 10.0, *['never'] * 4]
    document['goals'][0] |= fields
    return completion_probabilities(read(document)).tolist()


SHARED = [1 / 2, 1 / 3, 1 / 4, 1, 0, 0, 0, 0]


def test_a_goal_that_says_nothing_takes_as_long_as_the_faults_say():
    assert of_goals() == [pytest.approx(SHARED)] * 3


@pytest.mark.parametrize(
    ('fields', 'own'),
    [
        ({'completion': SLOW}, SLOW),
        (
            {'done_in': [10.0, 40.0, 'never', 80.0, *['never'] * 4]},
            [1, 1 / 4, 0, 1 / 8, 0, 0, 0, 0],
        ),
        # Three times as long with all in order, so three times as long with failed parts.
        ({'done_in': 60.0}, [1 / 6, 1 / 9, 1 / 12, 1 / 3, 0, 0, 0, 0]),
        # As long as an epoch at least, in every mode.
        ({'done_in': 10.0}, [1, 2 / 3, 1 / 2, 1, 0, 0, 0, 0]),
    ],
    ids=['probabilities', 'by fault mode', 'with all in order', 'an epoch'],
)
def test_a_goal_may_take_another_time(fields, own):
    first, *others = of_goals(**fields)
    assert first == pytest.approx(own)
    assert others == [pytest.approx(SHARED)] * 2


@pytest.mark.parametrize(
    ('fields', 'says'),
    [
        ({'done_in': 5.0}, 'done_in: 5 s is shorter than an epoch of 10 s (50 m at 5 m/s)'),
        ({'done_in': 0}, 'done_in: 0 is not above 0'),
        ({'done_in': 'never'}, "done_in: 'never' is not a number"),
        ({'done_in': [20.0] * 7}, f'done_in: {[20.0] * 7} is not a list of 8 numbers'),
        ({'done_in': [*[20.0] * 7, 'soon']}, "done_in: 'soon' is not a number, nor never"),
        ({'completion': 0.5}, 'completion: 0.5 is not a list of 8 numbers'),
        ({'completion': [1.5] * 8}, 'completion: 1.5 is outside 0..1'),
        (
            {'completion': SLOW, 'done_in': 20.0},
            'done_in: is given besides goals[0].completion: keep one of them',
        ),
    ],
)
def test_what_is_refused(fields, says):
    with pytest.raises(MissionError) as error:
        of_goals(**fields)
    assert str(error.value) == f'test: goals[0].{says}'


def test_one_time_needs_one_to_be_compared_with():
    document = case_study()
    document['faults']['completion'] = [0.0] * 8
    document['goals'][2]['done_in'] = 40.0
    with pytest.raises(MissionError) as error:
        read(document)
    assert str(error.value) == (
        'test: goals[2].done_in: needs 8 values where faults.completion (done_in) is 0 (never) of '
        'the first'
    )


def test_the_mission_is_another_one_by_it_and_else_the_same():
    plain, other = read(lively()), read(different())
    assert 'completion' not in plain.to_dict()['goals'][0]
    assert read(json.loads(json.dumps(other.to_dict()))) == other
    same = replace(other, goals=tuple(replace(goal, completion=None) for goal in other.goals))
    assert same.digest() != other.digest()
    assert other.geography() == same.geography()


# What is solved


def test_every_q_of_the_exact_solution(known):
    _, mission, reference = known
    assert_q(build_policy(mission, 'exact', tolerance=1e-8).q_values(reference.states), reference)


def test_every_q_without_tables(known, monkeypatch):
    _, mission, reference = known
    solution = build_policy(mission, 'exact', tolerance=1e-8).solution
    monkeypatch.setattr(look_ahead, 'MAX_TABLED_ENTRIES', 0)
    chosen = np.random.default_rng(0).choice(len(reference.states), 300, replace=False)
    ahead = LookAhead(AxisModel(solution.sub), solution.value)
    some = type(reference)(reference.states[chosen], reference.q[chosen])
    assert_q(ahead.q_values(some.states), some)


@pytest.mark.parametrize('kind', ['location', 'fault', 'blocks'])
def test_blocks(known, kind):
    _, mission, reference = known
    sub = whole_mission(mission)
    plan = decompose(mission, sub.states // 3, kind)
    assert len(plan.parts) > 1
    solution = solve_blocks(sub, plan.regions, 1e-8)
    values = AxisModel(sub).state_values(solution.value, reference.states)
    np.testing.assert_allclose(values, reference.v, rtol=0, atol=1e-6)


def test_a_bound_of_all_goals_is_the_optimum_and_one_of_single_goals_is_below(known):
    _, mission, reference = known
    whole = lower_bound(mission, [(0, 1)], tolerance=1e-8).values(reference.states)
    assert (whole <= reference.v + 1e-6).all()
    np.testing.assert_allclose(whole, reference.v, rtol=0, atol=1e-6 * reference.v.max())
    for steps in (0, 40):
        split = lower_bound(mission, [(0,), (1,)], iterations=steps).values(reference.states)
        assert (split <= reference.v + 1e-6).all()
        assert split.mean() > 0.5 * reference.v.mean()


def test_an_expansion_of_all_goals(known):
    _, mission, reference = known
    clusters = Clusters.up_to(mission, 2, 1 << 60)
    q = ExpansionLookAhead(fit_expansion(mission, clusters, 1e-5)).q_values(reference.states)
    scale = np.abs(reference.q[np.isfinite(reference.q)]).max()
    assert_q(q, reference, 2e-3 * scale)


def test_bellman_equation_of_three_goals():
    document = case_study()
    document['goals'][0]['completion'] = SLOW
    document['goals'][2]['completion'] = [0.1] * 8
    for changed in (document, with_charge(document)):
        policy = build_policy(read(changed), 'exact')
        assert_bellman(changed, policy, pick_states(policy.space, 15))


@pytest.mark.parametrize('method', ['split', 'highest_priority', 'best_value', 'expansion'])
def test_other_policies_cost_no_less_than_the_optimum_and_no_more_than_they_say(known, method):
    _, mission, reference = known
    policy = build_policy(mission, method, certificate=method != 'split')
    sub = whole_mission(mission)
    taken = evaluate(sub, tabulate(sub, policy.act)).state_values(reference.states)
    assert (taken >= reference.v - 1e-6).all()
    assert (policy.lower_bound(reference.states) <= reference.v + 1e-6).all()
    if method == 'expansion':
        assert (taken <= policy.upper_bound(reference.states)).all()
        assert (taken <= 1.01 * reference.v).all()


def test_a_commitment_is_allowed_where_its_own_goal_can_be_done():
    mission = read(different())
    states = [[f, 1, 1, 2, 2, 0, 0, 0, 0] for f in range(1, 9)]
    allowed = allowed_actions(mission, states)
    for first in (1, 4):
        assert allowed[:, first].tolist() == [1, 1, 1, 0, 1, 1, 1, 0]
        assert allowed[:, first + 1].tolist() == [1, 1, 0, 1, 1, 0, 1, 0]


# What is simulated


def test_simulated_costs_are_those_of_the_policy(known):
    _, mission, reference = known
    assert_simulated(mission, reference)


def waiting(document):
    """Mean epochs until each goal is done by one that stays on its cell, committed to it."""
    document['faults']['rate'] = dict.fromkeys(document['faults']['rate'], 0.0)
    document['priority_transition'] = np.eye(3).tolist()
    mission = read(document)
    found = []
    for j in range(mission.k):
        start = start_state(mission)
        start[0, -4] = mission.goals[j].cell
        states = np.repeat(start, 4000, axis=0)
        actions = np.full(len(states), 2 + j)
        rng, done = np.random.default_rng(j), np.zeros(len(states), int)
        for epoch in range(1, 200):
            completed = simulation.Simulator(mission).transition(states, actions, rng).completed
            done[(done == 0) & completed[:, j]] = epoch
        assert done.all()
        found.append(done.mean())
    return found


def test_goals_take_as_long_as_their_files_say():
    """8 s and 40 s in epochs of 4 s; 4,000 flights tell a geometric mean to 8 % (5 sigma)."""
    document = case_study(1, 2)
    document['energy']['speed'] = 12.5
    document['faults']['done_in'] = [8.0] * 8
    del document['faults']['completion']
    document['goals'][1]['done_in'] = 40.0
    assert waiting(document) == pytest.approx([2.0, 10.0], rel=0.08)


def test_a_task_drains_an_epoch_of_flight_for_each_epoch_that_it_takes():
    """Of two and ten epochs, one level each, two in agile flight; 1,000 flights, 5 sigma."""
    document = with_charge(case_study(1, 2), levels=400)
    document['range']['charge']['drain'] = {'normal': [0.0, 1.0], 'agile': [0.0, 0.0, 1.0]}
    document['goals'][0]['completion'], document['goals'][1]['completion'] = [0.5] * 8, [0.1] * 8
    mission = read(document)
    simulator, rng = simulation.Simulator(mission), np.random.default_rng(0)
    for j, (action, levels, mean) in enumerate([(2, 1, 2), (6, 2, 20)]):
        states = np.repeat(start_state(mission), 1000, axis=0)
        states[:, -4] = mission.goals[j].cell
        drained = np.zeros(len(states))
        for epoch in range(1, 150):
            transition = simulator.transition(states, np.full(len(states), action), rng)
            drained[(drained == 0) & transition.completed[:, j]] = levels * epoch
            states = transition.after
            assert (states[:, 1] == 399 - levels * epoch).all()
        assert drained.mean() == pytest.approx(mean, rel=0.16)


def test_a_forecast_counts_modes_in_which_no_goal_can_be_done():
    """The sensor's failure stops the first goal, the actuator's the second one."""
    document = different(completion=[0.5, 0.5, *[0.0] * 6])
    document['faults']['completion'] = [0.5, 0.0, 0.5, *[0.0] * 5]
    document['faults']['rate'] = {'sensor': 0.1, 'actuator': 0.0, 'camera': 0.0}
    document['faults']['repair_success'] = 0.0
    for rate, impossible in ((0.0, 0.0), (0.1, 1.0)):
        document['faults']['rate']['actuator'] = rate
        mission = read(document)
        start = np.repeat(start_state(mission), 40, axis=0)
        flights = fly(mission, lambda s: np.full(len(s), 4), start, 180, np.random.default_rng(0))
        found = forecast.forecast(flights).events['no_goal_possible'].value
        assert found == impossible


def test_fleets_of_one_cost_what_the_reference_says(known):
    """The planner's own policies, simulated with their luck, cost no less than the optimum."""
    document, mission, reference = known
    start = start_state(mission)
    planner = FleetPlanner(mission, start)
    costs = simulate_fleets(
        planner, np.repeat(start[None], 2000, axis=0), 300, np.random.default_rng(0)
    )
    optimum = reference.v[BruteForce(document).states.index(tuple(start[0].tolist()))]
    assert costs.mean() + 5 * costs.std() / np.sqrt(len(costs)) > optimum
    assert costs.mean() < 2 * optimum


# What follows from it


def test_sensitivities_are_those_of_missions_solved_anew():
    document = different()
    document['goals'] = document['goals'][1:]
    document['goals'][0] |= {'eta': 50.0, 'delta': 50.0}
    document['faults']['rate'] = dict.fromkeys(document['faults']['rate'], 0.05)
    document['range']['loss'] = {'normal': 0.05, 'agile': 0.1}
    start = np.array([[1, 1, 2, 0, 0, 0, 0]])

    def cost(**changes):
        changed = json.loads(json.dumps(document))
        changed['goals'][0] |= changes
        model = BruteForce(changed)
        return solve(model).v[model.states.index(tuple(start[0].tolist()))]

    solution = build_policy(read(document), 'exact', tolerance=1e-10).solution
    found = {each.name: each.relative for each in sensitivity.by_solving(solution, start)}
    after = cost(completion=[0.275, *SLOW[1:]])
    assert found['goals.0.completion.0'] == pytest.approx(after / cost() - 1, abs=2e-6)
    assert abs(found['goals.0.completion.0']) > 1e-3


def test_where_all_goals_have_their_own_the_faults_completion_is_no_parameter():
    document = different()
    assert 'faults.completion.0' in {p.name for p in sensitivity.parameters(read(document))}
    document['goals'][0]['completion'] = SLOW
    names = {parameter.name for parameter in sensitivity.parameters(read(document))}
    assert not [name for name in names if name.startswith('faults.completion')]
    assert {'goals.0.completion.0', 'goals.1.completion.6', 'faults.cost.1'} <= names


def test_goals_that_differ_in_nothing_else_are_told_apart():
    """In either order the same costs, and as many design points drawn for the slower one."""
    document = different()
    document['goals'][1] |= {key: document['goals'][0][key] for key in ('eta', 'delta')}
    turned = document | {'goals': document['goals'][::-1]}
    first, second = read(document), read(turned)
    assert goal_order(first) == goal_order(second)[::-1]
    states = pick_states(build_policy(first, 'exact').space, 500)
    swapped = states[:, [0, 2, 1, 4, 3, 5, 6, 7, 8]]
    swapped[:, -3] = np.array([0, 2, 1])[states[:, -3]]
    ours, theirs = (build_policy(mission, 'exact') for mission in (first, second))
    np.testing.assert_allclose(
        ours.q_values(states).min(axis=1), theirs.q_values(swapped).min(axis=1), atol=1e-6
    )
    assert (ours.q_values(states)[:, 1] != ours.q_values(swapped)[:, 2]).any()


def test_a_part_is_as_sensitive_to_faults_as_its_most_sensitive_goal():
    document = different(completion=[0.5, 0.5, 0.45, *[0.5] * 5])
    document['faults']['cost'] = [0.0] * 8
    measures = Measures(read(document))
    assert measures.fault_sensitivity((0,), (1, 3)) == pytest.approx(0.4 / 2)
    assert measures.fault_sensitivity((1,), (1, 3)) == pytest.approx(0.1 / 2)
    assert measures.fault_sensitivity((0, 1), (1, 3)) == pytest.approx(0.4 / 2)


@pytest.mark.parametrize('charged', [False, True])
def test_a_fleet_solves_anew_what_another_time_enters(charged):
    document = with_charge(different()) if charged else different()
    mission = read(document)
    agents = start_state(mission)
    planner = FleetPlanner(mission, agents)
    assert set(planner.solved) == {'goal1', 'goal2'}
    document['faults']['completion'] = [0.9] * 8
    assert planner.replan(read(document), agents).solved == ('goal1',)
    document['goals'][0]['completion'] = mission.faults.completion
    assert planner.replan(read(document), agents).solved == ()
    document['goals'][1]['completion'] = [0.6, *SLOW[1:]]
    assert planner.replan(read(document), agents).solved == ('goal2',)
