"""The solver agrees with the reference model: in Q of every state, and state by state for more."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import BruteForce, matrices, solve
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, charged_missions, missions, pick_states

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.evaluation import simulation

SMALL = [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]
TWO_CELLS = [(1, 1), (1, 2), (2, 1)]
LARGE = [(1, 5), (5, 1), (3, 3), (2, 4), (4, 3)]


def exact(document):
    return build_policy(mission_from_dict(document, 'test'), 'exact')


def assert_same_q(document):
    reference = solve(BruteForce(document))
    q = exact(document).q_values(reference.states)
    np.testing.assert_array_equal(np.isinf(q), np.isinf(reference.q))
    allowed = np.isfinite(q)
    np.testing.assert_allclose(q[allowed], reference.q[allowed], rtol=0, atol=1e-6)


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
@pytest.mark.parametrize('goal', [1, 2, 3])
def test_every_q_of_the_case_study_with_one_goal(goal, feasibility):
    assert_same_q(case_study(goal, feasibility=feasibility))


@settings(max_examples=20)
@given(missions(SMALL, [1]) | charged_missions(SMALL, [1]))
def test_every_q_of_any_mission_with_one_goal(document):
    assert_same_q(document)


@settings(max_examples=5)
@given(missions(TWO_CELLS, [2]))
def test_every_q_of_any_small_mission_with_two_goals(document):
    assert_same_q(document)


def assert_simulated(mission, reference):
    """Simulated costs of the exact policy are those of the reference."""
    policy = build_policy(mission, 'exact')
    starts = pick_states(policy.space, 6, seed=3)
    rng = np.random.default_rng(1)
    found = simulation.estimate(mission, policy.act, starts, 400, rng, confidence=0.999)
    optimum = reference.v[policy.space.index(starts)]
    assert (found.lower <= optimum).all()
    assert (optimum <= found.upper).all()


def assert_bellman(document, policy, states):
    """Q(s, a) = J(s, a) + discount E[min Q(s', .)], the expectation by the reference model."""
    model = BruteForce(document)
    for state, q in zip(states.tolist(), policy.q_values(states)):
        for action in model.actions:
            if not model.allowed(state, action):
                assert q[action - 1] == np.inf
                continue
            after, p = zip(*model.successors(state, action))
            value = policy.q_values(after).min(axis=1)
            expected = model.cost(state, action) + document['discount'] * np.dot(p, value)
            assert q[action - 1] == pytest.approx(expected, rel=0, abs=1e-6)


def test_bellman_equation_of_the_whole_case_study():
    document = case_study()
    policy = exact(document)
    assert_bellman(document, policy, pick_states(policy.space, 60))


@settings(max_examples=25)
@given(missions(LARGE, [2, 3]) | charged_missions(LARGE, [2, 3]), st.integers(0, 2**32 - 1))
def test_bellman_equation_of_any_larger_mission(document, seed):
    policy = exact(document)
    assert_bellman(document, policy, pick_states(policy.space, 4, seed))


@settings(max_examples=10)
@given(missions(SMALL, [1]) | charged_missions(SMALL, [1]))
def test_reference_probabilities_sum_to_one(document):
    _, rows, _ = matrices(BruteForce(document))
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, rtol=0, atol=1e-12)
