"""All forms of the model say the same of random missions.

The reference is `brute_force`, which enumerates successors and shares no code with the package.
Every other form, an entry of `forms.FORMS`, is held to it in the one-epoch look-ahead

    Q(s, a) = J(s, a) + discount E[p(t', m') - [c' > 0] eta_c' g_c' r_c' + W(l', t', g', f', r')]

of a random W: costs, feasibility and dynamics enter it, each in all its terms.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter

import numpy as np
import pytest
from brute_force import BruteForce
from chance import DRAWS, assert_drawn_from
from forms import DOUBLE, FORMS, backed_up, outcomes_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import charged_missions, lively, missions, pick_states, with_charge

from uav_mission_manager.mdp import (
    StateSpace,
    allowed_actions,
    cost,
    dynamics,
    global_actions,
    mission_from_dict,
    stage_costs,
)
from uav_mission_manager.solver.evaluation.simulation import Simulator
from uav_mission_manager.solver.exact import AxisModel, LookAhead, sweep
from uav_mission_manager.solver.submdp import shared_sub_mdps

SIZES = [(1, 1), (1, 3), (2, 2), (2, 3)]
LARGE = [(1, 1), (2, 4), (3, 3)]
seeds = st.integers(0, 2**32 - 1)
any_mission = missions(SIZES, [1, 2]) | charged_missions(SIZES, [1, 2])


def random_w(mission, seed):
    """W over l, t, g_1.., f, r_1.., or b in place of these."""
    k = mission.k
    shape = (mission.grid.q, 3, *(3,) * k, 8, *StateSpace.of(mission).ranges)
    return np.random.default_rng(seed).uniform(-100, 100, shape)


def sample(mission, count, seed):
    return pick_states(StateSpace.of(mission), count, seed)


# The reference


def reference_value(model, w, state):
    """V(s) of W, in plain words."""
    f, r, g, cell, c, t, m = model.split(state)
    saved = model.goals[c - 1]['eta'] * g[c - 1] * r[c - 1] if c else 0.0
    ranges = state[1:2] if model.charge else r
    return model.document['threat']['cost'][t][m] - saved + w[(cell, t, *g, f - 1, *ranges)]


def reference_q(document, w, states):
    model = BruteForce(document)
    q = np.full((len(states), len(model.actions)), np.inf)
    for i, state in enumerate(map(tuple, states.tolist())):
        for action in model.actions:
            if model.allowed(state, action):
                expected = math.fsum(
                    p * reference_value(model, w, after)
                    for after, p in model.successors(state, action)
                )
                q[i, action - 1] = model.cost(state, action) + document['discount'] * expected
    return q


def assert_same(q, expected, tolerance):
    np.testing.assert_array_equal(np.isinf(q), np.isinf(expected))
    allowed = np.isfinite(expected)
    np.testing.assert_allclose(q[allowed], expected[allowed], **tolerance)


@pytest.mark.parametrize('form', FORMS)
@settings(max_examples=25)
@given(any_mission, seeds)
@example(lively(), 0)
@example(lively(feasibility='paper'), 0)
@example(with_charge(lively(), rate=2), 0)
def test_one_epoch_look_ahead(form, document, seed):
    mission = mission_from_dict(document, 'test')
    w, states = random_w(mission, seed), sample(mission, 4, seed)
    look_ahead, tolerance = FORMS[form]
    assert_same(look_ahead(mission, w, states), reference_q(document, w, states), tolerance)


@pytest.mark.parametrize('entries', [sweep.MAX_BLOCK_ENTRIES, 40])
@settings(max_examples=25)
@given(any_mission, seeds)
@example(lively(), 0)
@example(with_charge(lively()), 0)
def test_a_sweep_takes_the_least_of_the_look_ahead(entries, document, seed):
    """In one block of rows and in many."""
    mission = mission_from_dict(document, 'test')
    w, states = random_w(mission, seed), sample(mission, 4, seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep, 'MAX_BLOCK_ENTRIES', entries)
        after = backed_up(mission, w)
    model = BruteForce(document)
    values = [reference_value(model, after, state) for state in map(tuple, states.tolist())]
    expected = reference_q(document, w, states).min(axis=1)
    np.testing.assert_allclose(values, expected, **DOUBLE)


@settings(max_examples=25)
@given(missions(SIZES, [2, 3]) | charged_missions(SIZES, [2, 3]), st.integers(1, 2), seeds)
@example(lively(), 1, 0)
@example(with_charge(lively()), 1, 0)
def test_sub_mdps_with_shares_add_up_to_the_mission(document, n, seed):
    """Q of the sum of their W is the sum of their Q, wherever the mission allows the action."""
    mission = mission_from_dict(document, 'test')
    k, states, rng = mission.k, sample(mission, 3, seed), np.random.default_rng(seed)
    w, q = np.zeros_like(random_w(mission, 0)), np.zeros((len(states), 2 * k + 4))
    for sub in shared_sub_mdps(mission, np.array(list(itertools.combinations(range(k), n)))):
        model = AxisModel(sub)
        values = rng.uniform(-100, 100, model.shape)
        q += LookAhead(model, values).q_values(states)
        tracked = np.isin(range(k), sub.goals)
        ranges = sub.ranges if mission.range.charge else np.where(tracked, 2, 1)
        axes = *np.where(tracked, 3, 1), 8, *ranges
        w += values.reshape(mission.grid.q, 3, *axes)
    expected = reference_q(document, w, states)
    allowed = np.isfinite(expected)
    np.testing.assert_allclose(q[allowed], expected[allowed], **DOUBLE)


@settings(max_examples=20)
@given(any_mission, seeds)
@example(lively(), 0)
@example(lively(feasibility='paper'), 0)
@example(with_charge(lively(), rate=2), 0)
def test_simulated_steps(document, seed):
    """Next states as often as they should be, and no others."""
    model, simulator = BruteForce(document), Simulator(mission_from_dict(document, 'test'))
    space, rng = simulator.space, np.random.default_rng(seed)
    for state in map(tuple, space.draw(6, rng).tolist()):
        action = rng.choice([a for a in model.actions if model.allowed(state, a)])
        expected = Counter()
        for after, p in model.successors(state, action):
            expected[after] += p
        drawn = simulator.step(np.tile(state, (DRAWS, 1)), np.full(DRAWS, action), rng)
        indices, counts = np.unique(space.index(drawn), return_counts=True)
        after = map(tuple, space.states(indices).tolist())
        assert_drawn_from(dict(zip(after, counts.tolist())), expected)


@settings(max_examples=20)
@given(any_mission, seeds)
def test_simulated_costs_and_what_may_be_simulated(document, seed):
    model, simulator = BruteForce(document), Simulator(mission_from_dict(document, 'test'))
    states = sample(simulator.mission, 30, seed)
    for action in model.actions:
        actions = np.full(len(states), action)
        expected = [model.cost(tuple(state), action) for state in states.tolist()]
        np.testing.assert_allclose(simulator.costs(states, actions), expected, atol=1e-9)
        for i, state in enumerate(map(tuple, states.tolist())):
            if model.allowed(state, action):
                simulator.check(states[i : i + 1], actions[:1])
            else:
                with pytest.raises(ValueError, match='is not allowed'):
                    simulator.check(states[i : i + 1], actions[:1])


# The model's own functions


@settings(max_examples=50)
@given(missions(LARGE, [1, 2, 4]) | charged_missions(LARGE, [1, 2, 4]), seeds)
def test_stage_costs_and_feasibility(document, seed):
    model, mission = BruteForce(document), mission_from_dict(document, 'test')
    states = sample(mission, 30, seed)
    largest = cost.largest_stage_cost(mission)
    for action in model.actions:
        costs = stage_costs(mission, states, np.full(len(states), action))
        expected = [model.cost(state, action) for state in map(tuple, states.tolist())]
        np.testing.assert_allclose(costs, expected, rtol=1e-13, atol=1e-12)
        assert (costs >= 0).all()
        assert (costs <= largest * (1 + 1e-12)).all()
    expected = [[model.allowed(tuple(s), a) for a in model.actions] for s in states.tolist()]
    np.testing.assert_array_equal(allowed_actions(mission, states), expected)


@settings(max_examples=25)
@given(any_mission, seeds)
@example(lively(), 0)
@example(lively(feasibility='paper'), 0)
@example(with_charge(lively(), rate=2), 0)
def test_next_states_and_their_probabilities(document, seed):
    model, mission = BruteForce(document), mission_from_dict(document, 'test')
    may_complete = dynamics.may_complete(mission)
    for state in sample(mission, 3, seed):
        for action in global_actions(mission):
            completable = model.goal_on_site(tuple(state.tolist()), action.number)
            assert may_complete[action.number - 1, state[-4]] == bool(completable)
            expected, found = Counter(), Counter()
            for after, p in model.successors(tuple(state.tolist()), action.number):
                expected[after] += p
            for weight, outcomes in outcomes_of(mission, state, action):
                for after, p in outcomes.items():
                    found[after] += weight * p
            for after in expected.keys() | found.keys():
                assert found[after] == pytest.approx(expected[after], rel=1e-12, abs=1e-15)


@settings(max_examples=50)
@given(missions(LARGE, [1, 3]) | charged_missions(LARGE, [1, 3]))
def test_rows_of_every_matrix_are_distributions(document):
    mission = mission_from_dict(document, 'test')
    for matrices in (
        dynamics.fault_matrices(mission),
        dynamics.range_matrices(mission),
        dynamics.charge_matrices(mission),
        dynamics.priority_matrices(mission),
        dynamics.threat_matrices(mission),
    ):
        assert (matrices >= 0).all()
        np.testing.assert_allclose(matrices.sum(axis=-1), 1.0, rtol=0, atol=1e-9)
