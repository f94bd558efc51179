"""The benchmark's comparison of policies, against the reference model."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from brute_force import BruteForce, evaluate, matrices
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions

from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.evaluation import policy_evaluation as evaluation
from uav_mission_manager.solver.submdp import whole_mission

BENCHMARKS = Path(__file__).parents[2] / 'benchmarks'


@pytest.fixture(scope='module')
def agreement():
    sys.path.insert(0, str(BENCHMARKS))
    yield importlib.import_module('parts.agreement')
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope='module')
def explicit(agreement):
    return importlib.import_module('parts.explicit').explicit


@settings(max_examples=10)
@given(document=missions([(1, 1), (1, 2)], [1, 2]), seed=st.integers(0, 99))
def test_successors(agreement, document, seed):
    model, rng = BruteForce(document), np.random.default_rng(seed)
    chain = agreement.Chain(mission_from_dict(document, 'test'))
    for state in rng.permutation(model.states)[:20].tolist():
        action = int(rng.choice([a for a in model.actions if model.allowed(state, a)]))
        expected = np.zeros(len(model.states))
        for after, probability in model.successors(tuple(state), action):
            expected[chain.space.index(after)] += probability
        np.testing.assert_allclose(chain.successors(state, action), expected, rtol=0, atol=1e-12)


@settings(max_examples=5)
@given(document=missions([(1, 2), (2, 2)], [1]) | missions([(1, 1)], [2]), seed=st.integers(0, 99))
def test_cost_of_a_policy_that_looks_at_everything(agreement, document, seed):
    model, rng = BruteForce(document), np.random.default_rng(seed)
    costs, rows, row_of = matrices(model)
    draws = np.where(np.isfinite(costs), rng.random(costs.shape), -1)
    chosen = draws.argmax(axis=1)
    everyone = np.arange(len(costs))
    expected = evaluate(
        costs[everyone, chosen], rows, row_of[everyone, chosen], document['discount']
    )
    found = agreement.Chain(mission_from_dict(document, 'test')).evaluate(chosen + 1)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)


@settings(max_examples=5)
@given(document=missions([(1, 1), (1, 2)], [1, 2]), seed=st.integers(0, 99))
def test_explicit_mdp(explicit, document, seed):
    model, rng = BruteForce(document), np.random.default_rng(seed)
    mdp = explicit(mission_from_dict(document, 'test'))
    row_of = np.argsort(mdp.space.index(mdp.states))
    assert sorted(map(tuple, mdp.states.tolist())) == sorted(model.states)
    for row in rng.permutation(len(mdp.states))[:10].tolist():
        state = tuple(mdp.states[row].tolist())
        for action in model.actions:
            if not model.allowed(state, action):
                assert mdp.cost[row, action - 1] == np.inf
                continue
            assert mdp.cost[row, action - 1] == pytest.approx(model.cost(state, action))
            expected = np.zeros(len(mdp.states))
            for after, probability in model.successors(state, action):
                expected[row_of[mdp.space.index(after)]] += probability
            found = mdp.transitions[action - 1][[row]].toarray()[0]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.fixture(scope='module')
def optimum(agreement):
    return agreement.Optimum(mission_from_dict(case_study(1, 3), 'test'))


def test_the_optimum_agrees_with_itself(agreement, optimum):
    found = agreement.compare(optimum, 'exact')
    assert found.same.all()
    assert found.near.all()
    assert np.abs(found.loss).max() < 1e-8


def test_loss_is_that_of_the_solver_s_evaluation(agreement, optimum):
    found = agreement.compare(optimum, 'split')
    whole = whole_mission(optimum.mission)
    actions = evaluation.tabulate(whole, found.policy.act)
    cost = evaluation.evaluate(whole, actions).state_values(optimum.states)
    assert found.loss.max() > 0.01
    np.testing.assert_allclose(found.loss, cost / optimum.values - 1, rtol=0, atol=1e-8)


def test_best_value_takes_the_local_choice_of_least_cost(agreement, optimum):
    found = agreement.compare(optimum, 'best_value')
    tables = found.policy.local_values(optimum.states)
    least = np.argmin([table.min(axis=1) for table in tables], axis=0)
    choices = found.policy.local_choices(optimum.states)
    taken = choices[np.arange(len(least)), least]
    allowed = np.isfinite(optimum.q[np.arange(len(least)), taken - 1])
    assert allowed.mean() > 0.5
    np.testing.assert_array_equal(found.actions[allowed], taken[allowed])


def test_groups(agreement, optimum):
    found = agreement.groups(optimum.space, optimum.states)
    assert {name: list(masks) for name, masks in found.items()} == {
        'f': list(range(1, 9)),
        't': [0, 1, 2],
        'active goals': [0, 1, 2],
    }
    for masks in found.values():
        assert (sum(masks.values()) == 1).all()
    # Of two priorities of 0, 1, 2 each, four of nine pairs have one 0.
    assert found['active goals'][1].mean() == pytest.approx(4 / 9)
