"""The cost of a policy against the reference model's linear system."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import BruteForce, matrices
from brute_force import evaluate as reference
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions, pick_states

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import StateSpace, allowed_actions, mission_from_dict
from uav_mission_manager.solver.evaluation import policy_evaluation
from uav_mission_manager.solver.evaluation.policy_evaluation import (
    evaluate,
    representatives,
    tabulate,
)
from uav_mission_manager.solver.exact import AxisModel, sweep
from uav_mission_manager.solver.submdp import SubMdp, whole_mission


def whole(document):
    return whole_mission(mission_from_dict(document, 'test'))


def any_action(sub, seed):
    """A policy that takes any allowed action."""
    rng = np.random.default_rng(seed)

    def act(states):
        scores = rng.random((len(states), len(sub.numbers)))
        return np.where(allowed_actions(sub.mission, states), scores, -1).argmax(axis=1) + 1

    return tabulate(sub, act)


def assert_exact(document, numbers, tolerance=1e-7):
    evaluation = evaluate(whole(document), numbers, tolerance)
    model = BruteForce(document)
    states = np.array(model.states)
    costs, rows, row_of = matrices(model)
    everyone, action = np.arange(len(states)), numbers[evaluation.model.locate(states)] - 1
    expected = reference(
        costs[everyone, action], rows, row_of[everyone, action], document['discount']
    )
    off = expected - evaluation.state_values(states)
    slack = 1e-10 * max(1.0, np.abs(expected).max())
    assert evaluation.lower - slack <= off.min()
    assert off.max() <= evaluation.upper + slack
    assert -evaluation.lower == evaluation.upper <= tolerance + slack


@settings(max_examples=20)
@given(missions([(1, 2), (2, 2)], [1]), st.integers(0, 99))
def test_any_policy_of_any_mission(document, seed):
    assert_exact(document, any_action(whole(document), seed))


@settings(max_examples=3)
@given(missions([(1, 1)], [2]), st.integers(0, 99))
def test_any_policy_of_two_goals(document, seed):
    assert_exact(document, any_action(whole(document), seed))


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_any_policy_in_mixed_precision(monkeypatch, feasibility):
    monkeypatch.setattr(policy_evaluation, 'MIN_MIXED_ENTRIES', 0)
    document = case_study(1, feasibility=feasibility)
    assert_exact(document, any_action(whole(document), 3))


def test_the_best_policy_costs_the_optimum():
    document = case_study()
    sub, policy = whole(document), build_policy(mission_from_dict(document, 'test'))
    evaluation = evaluate(sub, tabulate(sub, policy.act))
    states = pick_states(policy.space, 5000)
    optimum = policy.part_values(states)[:, 0]
    assert np.abs(evaluation.state_values(states) - optimum).max() <= 2e-7


def test_a_worse_policy_costs_what_was_measured_apart():
    """Mean loss of `split` 5.8 %, the largest 45 %."""
    mission = mission_from_dict(case_study(), 'test')
    sub = whole_mission(mission)
    exact, split = build_policy(mission), build_policy(mission, 'split')
    states = exact.space.states()
    cost = evaluate(sub, tabulate(sub, split.act), 1e-6).state_values(states)
    loss = cost / exact.part_values(states)[:, 0] - 1
    assert loss.min() >= -1e-9
    assert loss.mean() == pytest.approx(0.058, abs=5e-4)
    assert loss.max() == pytest.approx(0.45, abs=5e-3)


def test_blocks_and_threads_change_no_bit(monkeypatch):
    sub = whole(case_study(1, 2))
    numbers = any_action(sub, 1)
    straight = evaluate(sub, numbers, 0.1)
    monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', 1 << 10)
    monkeypatch.setattr(sweep, 'MIN_THREADED_ENTRIES', 0)
    blocked = evaluate(sub, numbers, 0.1, threads=3)
    assert np.array_equal(blocked.value, straight.value)
    assert (blocked.upper, blocked.iterations) == (straight.upper, straight.iterations)


@pytest.mark.parametrize('goals', [(), (1,), (0, 2), (0, 1, 2)])
def test_representatives_stand_where_their_entries_are(monkeypatch, goals):
    monkeypatch.setattr(policy_evaluation, 'MAX_ASKED_STATES', 1000)
    sub = SubMdp(whole(case_study()).mission, goals, tuple(range(1, 11)))
    model, states = AxisModel(sub), representatives(sub)
    StateSpace(3, 8).check(states)
    at = np.ravel_multi_index(model.locate(states), model.shape)
    assert np.array_equal(at, np.arange(sub.entries))
    assert tabulate(sub, lambda states: states[:, 0]).shape == model.shape


@pytest.mark.parametrize(
    ('action', 'state'),
    [
        (2, [3, 0, 1, 5, 0, 2, 0]),
        (0, [1, 1, 1, 0, 0, 0, 0]),
        (9, [1, 1, 1, 0, 0, 0, 0]),
        (257, [1, 1, 1, 0, 0, 0, 0]),
        (5, [1, 1, 1, 5, 0, 0, 0]),
    ],
)
def test_actions_that_are_not_allowed(action, state):
    sub = whole(case_study(1))
    numbers = np.ones(AxisModel(sub).shape, int)
    numbers[AxisModel(sub).locate(np.array([state]))] = action
    with pytest.raises(ValueError, match=rf'is not allowed in state \{state}'):
        evaluate(sub, numbers)


def test_senseless_settings():
    sub = whole(case_study(1))
    numbers = np.ones(AxisModel(sub).shape, np.uint8)
    for tolerance, threads in ((0.0, 1), (float('nan'), 1), (1e-3, 0)):
        with pytest.raises(ValueError, match='must be above 0'):
            evaluate(sub, numbers, tolerance, threads)
    with pytest.raises(ValueError, match=r'actions have shape \(4,\), not \(8, 9, 16\)'):
        evaluate(sub, numbers[0, 0, :4])
