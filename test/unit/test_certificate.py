"""Certificates: bounds on both sides against exact optima and exact costs, and how they travel."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions, pick_states

from uav_mission_manager import build_policy, load_mission, load_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy import certify
from uav_mission_manager.solver.evaluation.policy_evaluation import evaluate, tabulate
from uav_mission_manager.solver.submdp import whole_mission


def exact_costs(policy, states):
    """V* and V^pi of states, and how far the first may be off."""
    exact, whole = build_policy(policy.mission, 'exact'), whole_mission(policy.mission)
    cost = evaluate(whole, tabulate(whole, policy.act)).state_values(states)
    return exact.q_values(states).min(axis=1), cost, exact.solution.upper


@pytest.fixture(scope='module')
def expansion():
    return build_policy(mission_from_dict(case_study(), 'test'), 'expansion', order=2)


def test_bounds_of_the_case_study_hold_everywhere(expansion):
    states = expansion.space.states()
    optimum, cost, slack = exact_costs(expansion, states)
    lower, upper = expansion.lower_bound(states), expansion.upper_bound(states)
    assert (lower <= optimum + slack).all()
    assert (cost <= upper).all()
    assert expansion.upper_bound_holds == 'everywhere'
    assert np.mean(upper / cost) < 1.015
    certificate = expansion.certificate
    assert (certificate.coverage, certificate.confidence) == (1, 1)
    gap = np.mean(cost / lower - 1)
    assert gap < 0.05
    assert abs(certificate.gap - gap) < 5 * certificate.gap_error < 0.01


@settings(max_examples=12)
@given(
    missions([(1, 2), (2, 2)], [1, 2]), st.sampled_from(['expansion', 'split', 'highest_priority'])
)
def test_bounds_of_any_mission(document, method):
    mission = mission_from_dict(document, 'test')
    policy = build_policy(mission, method, order=1, certificate=True)
    states = policy.space.states()
    optimum, cost, slack = exact_costs(policy, states)
    slack = slack + 1e-9 * max(1.0, np.abs(cost).max())
    assert (policy.lower_bound(states) <= optimum + slack).all()
    assert (optimum <= cost + slack).all()
    assert (cost <= policy.upper_bound(states) + slack).all()


def test_a_sound_expansion_comes_without_a_warning(expansion):
    assert expansion.warnings == []
    assert 0 < expansion.certificate.gap < expansion.certificate.largest_gap < 0.2


def test_an_expansion_that_loses_much_somewhere_says_so():
    """Costs far apart, and goals that are wanted for ever: 16 % are lost in the worst state."""
    mission = load_mission(Path(__file__).parents[1] / 'missions' / 'wild.yaml')
    policy = build_policy(mission, 'expansion', order=2)
    states = policy.space.states()
    optimum, cost, _ = exact_costs(policy, states)
    loss = (cost / optimum - 1).max()
    assert loss > 0.1
    assert policy.certificate.largest_gap > loss
    (warning,) = policy.warnings
    assert 'cannot show that the policy is near the optimum' in warning
    assert f'{policy.certificate.largest_gap:.0%} in the worst state' in warning
    assert (cost <= policy.upper_bound(states)).all()


def test_simulated_bounds_hold_in_as_many_states_as_they_say(expansion, monkeypatch):
    monkeypatch.setattr(certify, 'MAX_EVALUATED_ENTRIES', 0)
    policy = build_policy(expansion.mission, 'expansion', order=2)
    certificate = policy.certificate
    assert 0.9 < certificate.coverage < 1
    assert policy.upper_bound_holds == 'in 95.3% of states, confidence 98%'
    states = policy.space.states()
    _, cost, _ = exact_costs(policy, states)
    assert np.mean(cost <= policy.upper_bound(states)) >= certificate.coverage
    assert abs(certificate.gap - expansion.certificate.gap) < 4 * certificate.gap_error


def test_a_policy_that_looks_at_commitments_everywhere_is_simulated():
    policy = build_policy(
        mission_from_dict(case_study(1, 2), 'test'), 'best_value', certificate=True
    )
    assert policy.certificate.coverage < 1
    states = pick_states(policy.space, 500)
    assert (policy.lower_bound(states) < policy.upper_bound(states)).all()


def test_nothing_is_certified_unasked():
    mission = mission_from_dict(case_study(1, 2), 'test')
    for policy in (
        build_policy(mission, 'highest_priority'),
        build_policy(mission, 'expansion', order=1, certificate=False),
    ):
        assert policy.certificate is None
        assert np.isinf(policy.upper_bound(policy.space.states([0]))).all()
        assert policy.upper_bound_holds == 'nowhere'


def test_the_exact_policy_is_within_its_own_bounds():
    policy = build_policy(mission_from_dict(case_study(), 'test'), 'exact', tolerance=0.1)
    states = pick_states(policy.space, 5000)
    optimum, cost, _ = exact_costs(policy, states)
    assert (policy.lower_bound(states) <= optimum).all()
    assert (cost <= policy.upper_bound(states)).all()
    assert policy.upper_bound_holds == 'everywhere'


def test_certificates_travel_with_the_policy_set(expansion, tmp_path):
    expansion.save(tmp_path / 'set')
    loaded = load_policy(tmp_path / 'set')
    states = pick_states(expansion.space, 500)
    for look in ('lower_bound', 'upper_bound'):
        np.testing.assert_array_equal(
            getattr(loaded, look)(states), getattr(expansion, look)(states)
        )
    known = dataclasses.replace(loaded.certificate, bound=expansion.certificate.bound)
    assert known == expansion.certificate
    decision = loaded.decide(states[0].tolist())
    assert decision.lower_bound == loaded.lower_bound(states[:1])[0]
    assert decision.upper_bound == pytest.approx(loaded.upper_bound(states[:1])[0])
    assert {'gap', 'gap_error', 'offset', 'coverage', 'confidence'} <= loaded.info.keys()
