"""All forms of the model say the same of random missions.

The reference is `brute_force`, which enumerates successors and shares no code with the package.
Every other form, a `FORMS` entry, is held to it in the one-epoch look-ahead

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
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import lively, missions, pick_states

from uav_mission_manager.mdp import (
    StateSpace,
    allowed_actions,
    cost,
    dynamics,
    global_actions,
    mission_from_dict,
    stage_costs,
)
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import whole_mission

SIZES = [(1, 1), (1, 3), (2, 2), (2, 3)]
seeds = st.integers(0, 2**32 - 1)
any_mission = missions(SIZES, [1, 2])


def random_w(mission, seed):
    """W over l, t, g_1.., f, r_1.."""
    k = mission.k
    shape = (mission.grid.q, 3, *(3,) * k, 8, *(2,) * k)
    return np.random.default_rng(seed).uniform(-100, 100, shape)


def sample(mission, count, seed):
    return pick_states(StateSpace(mission.k, mission.grid.q), count, seed)


# The reference


def reference_value(model, w, state):
    """V(s) of W, in plain words."""
    f, r, g, cell, c, t, m = model.split(state)
    saved = model.goals[c - 1]['eta'] * g[c - 1] * r[c - 1] if c else 0.0
    return model.document['threat']['cost'][t][m] - saved + w[(cell, t, *g, f - 1, *r)]


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


# The forms


def by_matrices(mission, w, states):
    """From `mdp` alone, with one product of matrices an action."""
    q = np.where(allowed_actions(mission, states), 0.0, np.inf)
    for i, state in enumerate(states):
        for action in global_actions(mission):
            expected = sum(
                weight * probability * value_of(mission, w, after)
                for weight, outcomes in outcomes_of(mission, state, action)
                for after, probability in outcomes.items()
            )
            j = stage_costs(mission, state, [action.number])[0]
            q[i, action.number - 1] += j + mission.discount * expected
    return q


def value_of(mission, w, state):
    s = StateSpace(mission.k, mission.grid.q).split(np.array(state))
    value = cost.threat_costs(mission)[s.t, s.m] + w[(s.l, s.t, *s.g, s.f - 1, *s.r)]
    if s.c:
        j = s.c - 1
        value -= cost.commitment_savings(mission)[j, s.g[j], s.r[j]]
    return value


def outcomes_of(mission, state, action):
    """(weight, {s': P(s')}) where the action's goal is completed, and where it is not."""
    s = StateSpace(mission.k, mission.grid.q).split(state)
    a, regime = action.number - 1, dynamics.regimes(mission)[action.number - 1, s.l]
    after = int(dynamics.landings(mission)[a, s.l])
    faults = dynamics.fault_matrices(mission)[regime, s.f - 1]
    ranges = dynamics.range_matrices(mission)[regime, s.r]
    priorities = dynamics.priority_matrices(mission)[np.arange(mission.k), s.g]
    threats = dynamics.threat_matrices(mission)[after, s.t]
    done = dynamics.may_complete(mission)[a, s.l]
    done = done * dynamics.completion_probabilities(mission)[s.f - 1]
    for weight, completed in ((done, True), (1 - done, False)):
        rows = priorities.copy()
        if completed and action.goal is not None:
            rows[action.goal] = 1.0, 0.0, 0.0
        commitment = 0 if completed else action.commitment
        outcomes = {}
        for f, *rest, t in itertools.product(
            range(8), *[range(2)] * mission.k, *[range(3)] * mission.k, range(3)
        ):
            r, g = rest[: mission.k], rest[mission.k :]
            p = faults[f] * math.prod(row[x] for row, x in zip(ranges, r))
            p *= math.prod(row[x] for row, x in zip(rows, g)) * threats[t]
            if p * weight > 0:
                next_state = (f + 1, *r, *g, after, commitment, t, int(action.agile))
                outcomes[next_state] = p
        yield weight, outcomes


def by_reduced_mission(mission, w, states):
    """From the factors of `ReducedMission`."""
    reduced = ReducedMission(whole_mission(mission))
    s, x = reduced.split(states), reduced.x(states)
    k = mission.k
    # Axes l, t, f, x_1.., with x_j = 2 g_j + r_j.
    axes = [0, 1, 2 + k, *itertools.chain(*((2 + j, 3 + k + j) for j in range(k)))]
    table = w.transpose(axes).reshape(mission.grid.q, 3, 8, *(6,) * k)
    q = np.empty((len(states), 2 * k + 4))
    for i in range(len(states)):
        cell, t, f = s.l[i], s.t[i], s.f[i] - 1
        q[i] = reduced.action_costs(cell, x[i : i + 1], np.array([f]))[:, 0, 0]
        for a, slot in enumerate(reduced.slots):
            after, regime = reduced.landings[a, cell], reduced.regimes[a, cell]
            rows = [reduced.goals[regime, j, x[i, j]] for j in range(k)]
            done = reduced.completion[f] if reduced.completes[a, cell] else 0.0
            rows[slot] = done * reduced.completed[regime, x[i, slot]] + (1 - done) * rows[slot]
            expected = np.tensordot(reduced.threat[after, t], table[after], 1)
            expected = np.tensordot(reduced.faults[regime, f], expected, 1)
            for row in rows:
                expected = np.tensordot(row, expected, 1)
            q[i, a] += reduced.price[reduced.agile[a], after, t] + mission.discount * expected
    return q + reduced.state_costs(states)[:, None]


FORMS = {'matrices': by_matrices, 'reduced mission': by_reduced_mission}
"""Q (N, 2k+4) of a mission, W and states (N, 2k+5) in each form."""


def assert_same(q, expected):
    np.testing.assert_array_equal(np.isinf(q), np.isinf(expected))
    allowed = np.isfinite(expected)
    np.testing.assert_allclose(q[allowed], expected[allowed], rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize('form', FORMS)
@settings(max_examples=25, deadline=None)
@given(any_mission, seeds)
@example(lively(), 0)
@example(lively(feasibility='paper'), 0)
def test_one_epoch_look_ahead(form, document, seed):
    mission = mission_from_dict(document, 'test')
    w, states = random_w(mission, seed), sample(mission, 4, seed)
    assert_same(FORMS[form](mission, w, states), reference_q(document, w, states))


# The model's own functions


@settings(max_examples=50, deadline=None)
@given(missions([(1, 1), (2, 4), (3, 3)], [1, 2, 4]), seeds)
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


@settings(max_examples=25, deadline=None)
@given(any_mission, seeds)
@example(lively(), 0)
@example(lively(feasibility='paper'), 0)
def test_next_states_and_their_probabilities(document, seed):
    model, mission = BruteForce(document), mission_from_dict(document, 'test')
    for state in sample(mission, 3, seed):
        for action in global_actions(mission):
            expected, found = Counter(), Counter()
            for after, p in model.successors(tuple(state.tolist()), action.number):
                expected[after] += p
            for weight, outcomes in outcomes_of(mission, state, action):
                for after, p in outcomes.items():
                    found[after] += weight * p
            for after in expected.keys() | found.keys():
                assert found[after] == pytest.approx(expected[after], rel=1e-12, abs=1e-15)


@settings(max_examples=50, deadline=None)
@given(missions([(1, 1), (2, 4), (3, 3)], [1, 3]))
def test_rows_of_every_matrix_are_distributions(document):
    mission = mission_from_dict(document, 'test')
    for matrices in (
        dynamics.fault_matrices(mission),
        dynamics.range_matrices(mission),
        dynamics.priority_matrices(mission),
        dynamics.threat_matrices(mission),
    ):
        assert (matrices >= 0).all()
        np.testing.assert_allclose(matrices.sum(axis=-1), 1.0, rtol=0, atol=1e-9)
