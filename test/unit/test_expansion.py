"""Goal expansion: exact where it can be, near it elsewhere, the same whatever goals are called."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions, pick_states

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.mdp import ActionKind, StateSpace, mission_from_dict
from uav_mission_manager.mdp.dynamics import Regime
from uav_mission_manager.solver import memory, threads
from uav_mission_manager.solver.decomposition.measures import Measures
from uav_mission_manager.solver.evaluation.policy_evaluation import evaluate, tabulate
from uav_mission_manager.solver.exact import AxisModel, LookAhead, value_iteration
from uav_mission_manager.solver.expansion import (
    Basis,
    Clusters,
    ExpansionLookAhead,
    cluster_states,
    fit,
    fit_bytes,
    fit_expansion,
)
from uav_mission_manager.solver.expansion import design as design_module
from uav_mission_manager.solver.expansion.basis import COMPLETE
from uav_mission_manager.solver.expansion.design import design
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import whole_mission

NO_LIMIT = 1 << 60


def space_of(mission):
    return StateSpace(mission.k, mission.grid.q)


def fitted(mission, order, max_states=None):
    limit = cluster_states(mission, order) if max_states is None else max_states
    return fit_expansion(mission, Clusters.up_to(mission, order, limit))


def fitted_exactly(mission):
    return fit_expansion(mission, Clusters.up_to(mission, mission.k, NO_LIMIT), 1e-5)


def optimal_q_values(mission, states):
    solution = value_iteration(whole_mission(mission), 1e-7)
    return LookAhead(AxisModel(solution.sub), solution.value).q_values(states)


def optimum(document):
    mission = mission_from_dict(document, 'test')
    space = space_of(mission)
    states = space.states() if mission.k < 3 else pick_states(space, 20_000)
    return mission, states, optimal_q_values(mission, states)


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_of_all_goals_in_fine_it_is_exact(feasibility):
    mission, states, q = optimum(case_study(feasibility=feasibility))
    found = ExpansionLookAhead(fitted_exactly(mission)).q_values(states)
    assert np.array_equal(np.isinf(found), np.isinf(q))
    allowed = np.isfinite(q)
    scale = np.abs(q[allowed]).max()
    # To the tolerance the fit stops at, over 1 - discount, and float32.
    np.testing.assert_allclose(found[allowed], q[allowed], rtol=0, atol=2e-3 * scale)
    assert (q[np.arange(len(q)), choose(found) - 1] <= 1.001 * q.min(axis=1)).all()


@settings(max_examples=15)
@given(missions([(1, 1), (1, 3), (2, 2)], [1, 2]))
def test_of_all_goals_in_fine_it_is_exact_in_any_mission(document):
    mission, states, q = optimum(document)
    expansion = fitted_exactly(mission)
    found = ExpansionLookAhead(expansion).q_values(states)
    assert expansion.converged
    assert np.array_equal(np.isinf(found), np.isinf(q))
    allowed = np.isfinite(q)
    scale = np.abs(q[allowed]).max()
    np.testing.assert_allclose(found[allowed], q[allowed], rtol=0, atol=2e-3 * scale + 1e-6)


def test_where_no_fault_mode_completes_a_goal():
    document = case_study(1, 2)
    document['faults'] = document['faults'] | {'completion': [0.0] * 8}
    mission, states, q = optimum(document)
    found = ExpansionLookAhead(fitted_exactly(mission)).q_values(states)
    allowed = np.isfinite(q)
    assert np.array_equal(np.isfinite(found), allowed)
    np.testing.assert_allclose(found[allowed], q[allowed], rtol=2e-3)


def test_loss_of_pairs_on_the_case_study():
    """At most 0.01 % on average and 1 % anywhere, within 0.1 % of V* in 99.9 % of the states."""
    mission = mission_from_dict(case_study(), 'test')
    whole, states = whole_mission(mission), space_of(mission).states()
    expansion = fitted(mission, 2)
    assert max(expansion.clusters.states(mission)) == 41_472
    look_ahead = ExpansionLookAhead(expansion)
    q = optimal_q_values(mission, states)
    optimal = q.min(axis=1)

    def act(rows):
        return choose(look_ahead.q_values(rows))

    loss = evaluate(whole, tabulate(whole, act)).state_values(states) / optimal - 1
    assert loss.mean() < 1e-4
    assert loss.max() < 1e-2
    chosen = q[np.arange(len(q)), act(states) - 1]
    assert np.mean(chosen <= 1.001 * optimal) > 0.999


def permuted(document, order):
    return document | {'goals': [document['goals'][j] for j in order]}


@pytest.mark.parametrize('order', [[1, 2, 0], [2, 1, 0]])
def test_goals_may_stand_in_any_order(order):
    document = case_study()
    pair = (mission_from_dict(d, 'test') for d in (document, permuted(document, order)))
    first, second = (ExpansionLookAhead(fitted(mission, 2)) for mission in pair)
    states = pick_states(StateSpace(3, 8), 5000)
    other = states.copy()
    for position, j in enumerate(order):
        other[:, 1 + position], other[:, 4 + position] = states[:, 1 + j], states[:, 4 + j]
        other[states[:, -3] == j + 1, -3] = position + 1
    q, found = first.q_values(states), second.q_values(other)
    columns = [0, *(1 + j for j in order), 4, *(5 + j for j in order), 8, 9]
    finite = np.isfinite(found)
    assert np.array_equal(finite, np.isfinite(q[:, columns]))
    np.testing.assert_allclose(found[finite], q[:, columns][finite], rtol=1e-3)


def test_design_of_many_goals_follows_them_when_they_are_relabelled():
    document = case_study()
    goals = [
        g | {'name': f'{g["name"]}_{n}', 'eta': g['eta'] + n}
        for n in range(2)
        for g in document['goals']
    ]
    order = [4, 2, 0, 5, 1, 3]
    missions_ = [
        mission_from_dict(document | {'goals': g}, 'test')
        for g in (goals, [goals[j] for j in order])
    ]
    first, second = (design(mission, 600) for mission in missions_)
    assert first.shape == (600, 6)
    assert np.array_equal(first[:, order], second)


@settings(max_examples=20)
@given(missions([(2, 2)], [3]))
def test_expected_features_are_those_of_the_successors(document):
    mission = mission_from_dict(document, 'test')
    reduced = ReducedMission(whole_mission(mission))
    basis = Basis(reduced, Clusters.up_to(mission, 2, NO_LIMIT))
    rng = np.random.default_rng(0)
    x = rng.integers(0, 6, (4, 3))
    every = np.indices((6, 6, 6)).reshape(3, -1).T
    features = basis.now(every)
    for completed in (None, 1):
        found = basis.expected(x, [(regime, completed) for regime in Regime])
        for regime in Regime:
            for row in range(4):
                laws = [reduced.goals[regime, j, x[row, j]] for j in range(3)]
                if completed is not None:
                    laws[completed] = reduced.completed[regime, x[row, completed]]
                chance = np.prod([law[every[:, j]] for j, law in enumerate(laws)], axis=0)
                np.testing.assert_allclose(found[regime, :, row], features @ chance, atol=1e-9)


def reduced_mission(mission):
    return ReducedMission(whole_mission(mission))


def many_goals(k):
    document = case_study()
    document['goals'] = [
        goal | {'name': f'{goal["name"]}_{n}', 'eta': goal['eta'] + n}
        for n in range(-(-k // 3))
        for goal in document['goals']
    ][:k]
    return mission_from_dict(document, 'test')


@pytest.mark.parametrize(
    ('order', 'limit', 'groups'),
    [
        (2, 4608, [(1, 2, 3), (2, 1, 3)]),
        (2, 41_472, [(1, 2, 3), (2, 4, 3), (3, 3, 1)]),
        (3, 41_472, [(1, 2, 3), (2, 4, 3), (3, 3, 1)]),
        (3, 331_776, [(1, 2, 3), (2, 4, 3), (3, 6, 1)]),
    ],
)
def test_clusters_keep_to_the_most_states(order, limit, groups):
    """Goals, detail and number of the groups."""
    mission = mission_from_dict(case_study(), 'test')
    clusters = Clusters.up_to(mission, order, limit)
    assert [(group.n, group.detail, len(group.clusters)) for group in clusters.groups] == groups
    assert max(clusters.states(mission)) <= limit
    assert Basis(reduced_mission(mission), clusters).size == clusters.features


@settings(max_examples=30)
@given(st.integers(1, 12), st.integers(1, 3), st.integers(4608, 10**6))
def test_a_plan_of_clusters_never_exceeds_its_limits(k, order, max_states):
    mission = many_goals(k)
    clusters = Clusters.up_to(mission, order, max_states)
    assert max(clusters.states(mission)) <= max_states
    assert clusters.features <= max(COMPLETE * max(1, order - 1), 1 + 5 * k)
    assert len(Basis(reduced_mission(mission), clusters).products) == clusters.features
    found = [cluster for group in clusters.groups for cluster in group.clusters]
    assert len(set(found)) == len(found)
    assert {(j,) for j in range(k)} <= set(found)
    few = clusters.within(100)
    assert few.features <= max(100, 1 + 5 * k)
    assert few.within(100) == few


def test_more_goals_than_there_is_room_for_stand_alone():
    mission = many_goals(320)
    clusters = Clusters.up_to(mission, 2, NO_LIMIT)
    assert [(group.n, len(group.clusters)) for group in clusters.groups] == [(1, 320)]


def test_where_not_all_clusters_fit_those_that_couple_most_stay():
    mission = many_goals(10)
    clusters = Clusters.up_to(mission, 2, cluster_states(mission, 2))
    pairs = [c for group in clusters.groups if group.n == 2 for c in group.clusters]
    triples = [c for group in clusters.groups if group.n == 3 for c in group.clusters]
    measures = Measures(mission)
    assert pairs == list(measures.closest(2))
    assert 0 < len(triples) < math.comb(10, 3)
    assert triples == list(measures.closest(3)[: len(triples)])


def test_a_function_of_fewer_clusters_is_one_of_more():
    mission = mission_from_dict(case_study(), 'test')
    reduced = reduced_mission(mission)
    few, many = (Basis(reduced, Clusters.up_to(mission, n, NO_LIMIT)) for n in (1, 2))
    theta = np.random.default_rng(0).random((2, few.size))
    x = np.indices((6, 6, 6)).reshape(3, -1).T
    embedded = many.embed(theta, few)
    np.testing.assert_allclose(embedded @ many.now(x), theta @ few.now(x))


@pytest.mark.parametrize(
    ('order', 'limit', 'message'),
    [
        (0, 4608, 'order 0'),
        (1, 4607, 'T_max = 4,607'),
    ],
)
def test_clusters_that_cannot_be(order, limit, message):
    with pytest.raises(ValueError, match=message):
        Clusters.up_to(many_goals(3), order, limit)


def test_a_fit_that_runs_away_is_tried_in_more_points(monkeypatch):
    mission, tried = many_goals(6), []
    fit_once = fit._Fit.in_points

    def running_away(self, clusters, x, start):
        tried.append((clusters.features, len(x)))
        return None if len(tried) < 3 else fit_once(self, clusters, x, start)

    monkeypatch.setattr(design_module, 'COMPLETE_DESIGN', 0)
    monkeypatch.setattr(design_module, 'LEAST_POINTS', 100)
    monkeypatch.setattr(fit._Fit, 'in_points', running_away)
    clusters = Clusters.up_to(mission, 1, 4608)
    found = fit_expansion(mission, clusters)
    size = clusters.features
    assert tried == [(size, 4 * size), (size, 8 * size), (size, 16 * size)]
    assert found.points == 16 * size
    assert found.converged


def test_what_does_not_settle_gives_way_to_what_does(monkeypatch):
    mission, fit_once = many_goals(6), fit._Fit.in_points

    def large_ones_run_away(self, clusters, x, start):
        return fit_once(self, clusters, x, start) if clusters.features <= 100 else None

    monkeypatch.setattr(fit._Fit, 'in_points', large_ones_run_away)
    monkeypatch.setattr(design_module, 'COMPLETE_DESIGN', 0)
    monkeypatch.setattr(fit, 'FIRST_FEATURES', 100)
    clusters = Clusters.up_to(mission, 2, cluster_states(mission, 2))
    found = fit_expansion(mission, clusters)
    assert found.clusters == clusters.within(100) != clusters
    assert found.theta.shape[-1] == found.clusters.features
    monkeypatch.setattr(fit, 'RUNAWAY', 0.0)
    with pytest.raises(ValueError, match='mission case_study: no expansion settles'):
        fit_expansion(mission, clusters)


def test_a_fit_that_is_not_trusted_is_tried_in_more_points(monkeypatch):
    mission = many_goals(6)
    monkeypatch.setattr(design_module, 'COMPLETE_DESIGN', 0)
    monkeypatch.setattr(design_module, 'LEAST_POINTS', 100)
    monkeypatch.setattr(fit, 'FIRST_FEATURES', 50)
    clusters = Clusters.up_to(mission, 2, cluster_states(mission, 2)).within(200)
    size, tried = clusters.features, []
    fit_once = fit._Fit.in_points

    def noted(self, chosen, x, start):
        if chosen == clusters:
            tried.append(len(x))
        return fit_once(self, chosen, x, start)

    monkeypatch.setattr(fit._Fit, 'in_points', noted)
    found = fit_expansion(mission, clusters)
    assert tried == [4 * size, 8 * size]
    assert found.fresh_residual > fit.TRUSTED_RESIDUAL
    assert 'a higher order' in found.warning
    tried.clear()
    monkeypatch.setattr(fit, 'TRUSTED_RESIDUAL', 10.0)
    less = fit_expansion(mission, clusters)
    assert tried == [4 * size]
    assert found.fresh_residual < less.fresh_residual
    assert not less.warning


def test_an_expansion_that_is_far_from_its_backup_says_so():
    mission = mission_from_dict(case_study(), 'test')
    assert not fitted(mission, 2).warning
    lone = Clusters(Clusters.up_to(mission, 1, NO_LIMIT).groups[:1])
    assert 'a higher order' in fit_expansion(mission, lone).warning
    unsettled = fit_expansion(mission, lone, max_iterations=2)
    assert not unsettled.converged
    assert 'not settled after 2 sweeps' in unsettled.warning


def test_where_nothing_costs_anything_all_is_zero():
    document = case_study(distance_weight=0.0, service_cost={'recharge': 0.0, 'repair': 0.0})
    document['goals'] = [goal | {'eta': 0.0, 'delta': 0.0} for goal in document['goals']]
    document['faults'] |= {'cost': [0.0] * 8}
    document['range'] |= {'cost': 0.0}
    document['threat'] |= {'cost': [[0.0, 0.0]] * 3}
    mission = mission_from_dict(document, 'test')
    expansion = fitted(mission, 2)
    assert expansion.converged
    assert expansion.fresh_residual == 0
    q = ExpansionLookAhead(expansion).q_values(space_of(mission).states())
    assert not q[np.isfinite(q)].any()


def test_costs_over_nine_decades():
    """What the small ones decide is lost in single precision."""
    document = case_study()
    for goal, factor in zip(document['goals'], (1e6, 1.0, 1e-3)):
        goal['eta'], goal['delta'] = goal['eta'] * factor, goal['delta'] * factor
    mission = mission_from_dict(document, 'test')
    whole, states = whole_mission(mission), space_of(mission).states()
    expansion = fitted(mission, 2)
    assert expansion.theta.dtype == np.float64
    look_ahead = ExpansionLookAhead(expansion)
    optimal = optimal_q_values(mission, states).min(axis=1)
    actions = tabulate(whole, lambda rows: choose(look_ahead.q_values(rows)))
    loss = evaluate(whole, actions).state_values(states) / optimal - 1
    assert loss.mean() < 1e-3
    assert loss.max() < 0.02


def test_a_fit_too_large_for_the_memory(monkeypatch):
    mission = many_goals(10)
    clusters = Clusters.up_to(mission, 2, cluster_states(mission, 2))
    assert fit_bytes(mission, clusters) > 1e8
    assert fit_bytes(mission, clusters.within(100)) < 1e8
    monkeypatch.setattr(memory, 'available_bytes', lambda: 10**8)
    with pytest.raises(memory.MissionSizeError, match=r'1,536 features needs .* lower order'):
        fit_expansion(mission, clusters)


def test_progress_of_a_fit():
    mission, reports = many_goals(4), []
    clusters = Clusters.up_to(mission, 2, cluster_states(mission, 2))
    found = fit_expansion(mission, clusters, progress=reports.append)
    done = [report.done for report in reports]
    assert [report.step for report in reports[:-1]] == list(range(1, found.iterations + 1))
    assert done == sorted(done)
    assert done[0] < 0.1
    assert done[-2] < done[-1] == 1
    assert f'{clusters.features} features' in reports[-1].text


def test_a_fit_that_circles_ends():
    mission = mission_from_dict(case_study(), 'test')
    clusters = Clusters.up_to(mission, 2, cluster_states(mission, 2))
    found = fit_expansion(mission, clusters, 1e-18)
    assert not found.converged
    assert found.iterations < 500
    assert 'not settled' in found.warning


def test_the_same_bits_in_every_run(monkeypatch):
    mission = many_goals(4)
    first = fitted(mission, 2)
    monkeypatch.setattr(threads, 'processors', lambda: 3)
    assert np.array_equal(fitted(mission, 2).theta, first.theta)


def test_state_spaces_too_large_to_count_need_no_more_than_their_clusters():
    document = case_study()
    document['goals'] = [
        g | {'name': f'{g["name"]}_{n}'} for n in range(7) for g in document['goals']
    ][:20]
    mission = mission_from_dict(document, 'test')
    assert StateSpace(20, 8).size > 1e17
    expansion = fit_expansion(mission, Clusters.up_to(mission, 1, 4608).within(200))
    assert expansion.converged
    state = np.array([[1, *[1] * 20, *[2] * 20, 0, 0, 0, 0]])
    (chosen,) = choose(ExpansionLookAhead(expansion).q_values(state))
    assert whole_mission(mission).actions[chosen - 1].kind is ActionKind.COMMIT


def test_decision_and_round_trip(tmp_path):
    mission = mission_from_dict(case_study(), 'test')
    policy = build_policy(mission, 'expansion', order=2)
    policy.save(tmp_path / 'set')
    loaded = load_policy(tmp_path / 'set')
    assert loaded.method == 'expansion'
    assert loaded.digest == policy.digest
    assert loaded.info == policy.info
    states = pick_states(policy.space, 200)
    np.testing.assert_array_equal(loaded.q_values(states), policy.q_values(states))
    for state in states[:20]:
        decision = loaded.decide(state.tolist())
        assert decision.action.number == loaded.act(state)[0]
    bound = loaded.lower_bound(states)
    np.testing.assert_array_equal(bound, policy.lower_bound(states))
    optimal = build_policy(mission, 'exact').q_values(states).min(axis=1)
    assert (bound <= optimal).all()
    assert np.mean(optimal / bound - 1) < 0.05
    values = loaded.part_values(states)
    assert values.shape == (200, 3)
    assert not values[states[:, 4:7] == 0].any()
