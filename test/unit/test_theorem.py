"""The policy equivalence theorem: true under its conditions, false without them.

Nothing here is about UAVs but the last tests, which say what one UAV has to do with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, pick_states

from uav_mission_manager.mdp import StateSpace, mission_from_dict
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import goal_sub_mdps, whole_mission

DISCOUNT = 0.9
EPOCHS = 1 / (1 - DISCOUNT)
"""Discounted number of epochs: what a cost of 1 an epoch comes to."""


@dataclass(frozen=True)
class Mdp:
    """Costs J (S, A), transitions P (S, A, S) and a discount."""

    cost: np.ndarray
    transitions: np.ndarray
    discount: float = DISCOUNT

    def evaluate(self, policies):
        """Cost of policies (..., S), by their linear equations."""
        rows = np.arange(len(self.cost))
        system = np.eye(len(rows)) - self.discount * self.transitions[rows, policies]
        return np.linalg.solve(system, self.cost[rows, policies][..., None])[..., 0]

    def restricted(self, actions):
        return Mdp(self.cost[:, actions], self.transitions[:, actions], self.discount)


def enumerated(mdp):
    """Best of all policies, every one evaluated, and its cost."""
    states, actions = mdp.cost.shape
    policies = np.indices((actions,) * states).reshape(states, -1).T
    values = mdp.evaluate(policies)
    best = values.sum(axis=1).argmin()
    return policies[best], values[best]


def policy_iteration(mdp):
    """Optimal policy and its cost, for MDPs with too many policies to enumerate."""
    rows = np.arange(len(mdp.cost))
    policy = np.zeros_like(rows)
    while True:
        values = mdp.evaluate(policy)
        q = mdp.cost + mdp.discount * mdp.transitions @ values
        better = q.min(axis=1) < q[rows, policy] - 1e-12 * (1 + np.abs(values).max())
        if not better.any():
            return policy, values
        policy = np.where(better, q.argmin(axis=1), policy)


def product(one, other):
    """Two MDPs side by side: summed costs, transitions multiplied, a pair of actions."""
    states, actions = np.multiply(one.cost.shape, other.cost.shape)
    cost = one.cost[:, None, :, None] + other.cost[None, :, None, :]
    transitions = np.einsum('iaj,kbl->ikabjl', one.transitions, other.transitions)
    return Mdp(
        cost.reshape(states, actions), transitions.reshape(states, actions, states), one.discount
    )


def joint(mdps, policies):
    """The policy (pi_1, .., pi_n) on the product."""
    combined = policies[0]
    for mdp, policy in zip(mdps[1:], policies[1:]):
        combined = np.add.outer(combined * mdp.cost.shape[1], policy).ravel()
    return combined


def summed(values):
    """V_1(s_1) + .. + V_n(s_n) on the product."""
    return reduce(np.add.outer, values).ravel()


weights = st.sampled_from([0.0, 1.0]) | st.floats(0.0, 100.0)


@st.composite
def sub_mdps(draw):
    """Two or three MDPs of up to three states and actions under one discount."""
    discount = draw(st.sampled_from([0.0, 0.95]) | st.floats(0.0, 0.99))

    def array(*shape):
        size = math.prod(shape)
        return np.array(draw(st.lists(weights, min_size=size, max_size=size))).reshape(shape)

    mdps = []
    for _ in range(draw(st.integers(2, 3))):
        states, actions = draw(st.integers(1, 3)), draw(st.integers(1, 3))
        masses = array(states, actions, states)
        masses[masses.sum(axis=-1) == 0] = 1
        transitions = masses / masses.sum(axis=-1, keepdims=True)
        mdps.append(Mdp(array(states, actions), transitions, discount))
    return mdps


@settings(max_examples=200)
@given(sub_mdps())
def test_under_its_conditions_the_theorem_holds(mdps):
    policies, values = zip(*map(enumerated, mdps))
    whole = reduce(product, mdps)
    _, optimum = policy_iteration(whole)
    near = 1e-9 * (1 + optimum.max())
    np.testing.assert_allclose(summed(values), optimum, rtol=0, atol=near)
    np.testing.assert_allclose(whole.evaluate(joint(mdps, policies)), optimum, rtol=0, atol=near)


def under_threat(mdp, threat, prices):
    """The MDP on states (s, t): t changes by itself and multiplies the costs."""
    states, actions = mdp.cost.shape
    cost = mdp.cost[:, None] * np.array(prices)[:, None]
    transitions = np.einsum('iaj,tu->itaju', mdp.transitions, threat)
    size = states * len(threat)
    return Mdp(cost.reshape(size, actions), transitions.reshape(size, actions, size), mdp.discount)


@settings(max_examples=100)
@given(sub_mdps(), st.floats(0.0, 1.0), st.tuples(weights, weights))
def test_a_shared_state_that_no_action_moves_does_no_harm(mdps, share, prices):
    """It breaks conditions 1, 3 and 5: the theorem asks for more than it needs."""
    threat = np.array([[1 - share, share], [1.0, 0.0]])
    one, other = (under_threat(mdp, threat, prices) for mdp in mdps[:2])
    _, optimum = policy_iteration(under_threat(product(*mdps[:2]), threat, prices))
    (_, first), (_, second) = enumerated(one), enumerated(other)
    total = first.reshape(-1, 1, 2) + second.reshape(1, -1, 2)
    np.testing.assert_allclose(total.ravel(), optimum, rtol=0, atol=1e-9 * (1 + optimum.max()))


def choice(*costs):
    """MDP of one state whose actions cost as given."""
    return Mdp(np.array([costs], dtype=float), np.ones((1, len(costs), 1)))


def chain(costs, targets):
    """MDP with costs (S, A) and certain transitions (S, A) to states."""
    return Mdp(np.array(costs, dtype=float), np.eye(len(targets))[np.array(targets)])


BREACHES = {
    # Condition 2: 5 more where both take their first action.
    'cost of a pair': (chain([[5, 1, 1, 2]], [[0] * 4]), [choice(0, 1), choice(0, 1)], 1, 0, 5),
    # Conditions 2 and 4: one cost of 1, counted by both.
    'cost counted twice': (choice(1), [choice(1), choice(1)], 1, 2, 1),
    # Condition 4: 2 to leave the goal, weighed double, or 3 to fly there.
    'other weights': (choice(2, 3), [choice(4, 3), choice(0)], 2, 3, 3),
    # Condition 5: the other sub-MDP's second action moves the first to where it pays 1.
    'transition of a pair': (
        chain([[0.5, 0], [1.5, 1]], [[0, 1], [0, 1]]),
        [chain([[0], [1]], [[0], [1]]), choice(0.5, 0)],
        0.5,
        0,
        DISCOUNT,
    ),
}
"""Global MDP, sub-MDPs, and from the first state V*, sum of V_i* and the joint policy's cost, all
per discounted epoch."""


@pytest.mark.parametrize('name', BREACHES)
def test_without_a_condition_it_fails(name):
    whole, subs, *expected = BREACHES[name]
    policies, values = zip(*map(enumerated, subs))
    found = [enumerated(whole)[1], summed(values), whole.evaluate(joint(subs, policies))]
    assert [value[0] / EPOCHS for value in found] == pytest.approx(expected)
    assert not expected[0] == expected[1] == expected[2]


def test_one_action_for_all():
    """Only pairs (a, a): one choice is not best for both, and the better-off chooses worst."""
    subs = [choice(0, 1), choice(10, 1)]
    whole = product(*subs).restricted([0, 3])
    policies, values = zip(*map(enumerated, subs))
    assert [int(policy[0]) for policy in policies] == [0, 1]
    assert summed(values) == pytest.approx(1 * EPOCHS)
    assert enumerated(whole)[1] == pytest.approx(2 * EPOCHS)
    assert values[0] < values[1]
    assert whole.evaluate(policies[0]) == pytest.approx(10 * EPOCHS)


def errand(goals):
    """One UAV on cells 0, 1, 2 in a row; each goal costs 1 until the UAV was in its cell.

    States (l, g of each goal), actions left and right.
    """
    shape = (3,) + (2,) * len(goals)
    costs, targets = [], []
    for cell, *open_ in np.ndindex(shape):
        left = [flag and cell != goal for flag, goal in zip(open_, goals)]
        ahead = [max(cell - 1, 0), min(cell + 1, 2)]
        costs.append([sum(open_)] * 2)
        targets.append([np.ravel_multi_index((to, *left), shape) for to in ahead])
    return chain(costs, targets)


def test_one_location_for_all():
    """Two goals on either side of one UAV: fewer states than the product, and no way to both."""
    whole, subs = errand([0, 2]), [errand([0]), errand([2])]
    assert len(whole.cost) == 12 < math.prod(len(sub.cost) for sub in subs) == 36
    policies, values = zip(*map(enumerated, subs))
    middle, open_ = 1 * 4 + 3, 1 * 2 + 1
    assert [int(policy[open_]) for policy in policies] == [0, 1]
    total = sum(value[open_] for value in values)
    assert total == pytest.approx(2 + 2 * DISCOUNT)
    late = DISCOUNT**2 + DISCOUNT**3
    assert enumerated(whole)[1][middle] == pytest.approx(total + late)


@pytest.fixture(scope='module')
def mission():
    return mission_from_dict(case_study(), 'test')


def test_the_mission_is_no_product_of_its_sub_mdps(mission):
    subs = goal_sub_mdps(mission)
    assert [sub.states for sub in subs] == [4608] * 3
    assert whole_mission(mission).states == 331_776 < 4608**3
    assert len(whole_mission(mission).actions) == 10 < math.prod(len(s.actions) for s in subs)


def test_sub_mdps_count_the_shared_costs_once_each(mission):
    """Sum of J_i - J = (k-1) (phi(f) + p(t, m)), but for h."""
    space = StateSpace(mission.k, mission.grid.q)
    states = pick_states(space, 1000)
    whole, *parts = (
        ReducedMission(sub).state_costs(states)
        for sub in (whole_mission(mission), *goal_sub_mdps(mission))
    )
    s = space.split(states)
    phi, p = np.array(mission.faults.cost)[s.f - 1], np.array(mission.threat.cost)[s.t, s.m]
    np.testing.assert_allclose(sum(parts) - whole, 2 * (phi + p), rtol=0, atol=1e-12)
    assert not any(sub.travel_costs.any() for sub in goal_sub_mdps(mission))
