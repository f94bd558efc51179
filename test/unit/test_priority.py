"""Priority scores against the reference model's words, and the ranked list."""

from __future__ import annotations

import math

import numpy as np
import pytest
from brute_force import BruteForce
from hypothesis import given, settings
from strategies import case_study, missions, pick_states

from uav_mission_manager.mdp import StateSpace, mission_from_dict
from uav_mission_manager.solver.recombination import (
    PriorityScore,
    PriorityWeights,
    highest_priority,
    ranked,
)
from uav_mission_manager.solver.submdp import SubMdp, goal_sub_mdps


def undisturbed(model, f, t, cell, destination):
    """Probability of a flight in normal mode without a new failure or a high threat."""
    if cell == destination:
        return 1.0
    after = model.next_cell(cell, destination)
    sound = dict(model.fault_outcomes(f, False)).get(f, 0.0)
    return sound * sum(
        p * undisturbed(model, f, t_next, after, destination)
        for t_next, p in model.threat_outcomes(t, after)
        if t_next < 2
    )


def reference_terms(model, state):
    f, r, g, cell, _, t, _ = model.split(state)
    largest = max(goal['eta'] for goal in model.goals)

    def distance(a, b):
        return math.hypot(a // model.cols - b // model.cols, a % model.cols - b % model.cols)

    def way(a, goal):
        return distance(a, goal['cell']) + distance(goal['cell'], model.service)

    longest = max(way(a, goal) for a in range(model.rows * model.cols) for goal in model.goals)
    return [
        [
            goal['eta'] * g[j] * r[j] / (2 * largest) if largest else 0.0,
            g[j] / 2,
            1 - model.completion(f, j + 1) * undisturbed(model, f, t, cell, goal['cell']),
            (way(cell, goal) / longest if longest else 0.0) if r[j] else 1.0,
        ]
        for j, goal in enumerate(model.goals)
    ]


@settings(max_examples=30)
@given(missions([(1, 1), (1, 4), (3, 3)], [1, 2, 3]))
def test_terms_of_any_mission(document):
    model, mission = BruteForce(document), mission_from_dict(document, 'test')
    states = pick_states(StateSpace(mission.k, mission.grid.q), 20)
    terms = PriorityScore(mission).terms(states)
    assert ((terms >= 0) & (terms <= 1 + 1e-12)).all()
    expected = [reference_terms(model, state) for state in states.tolist()]
    np.testing.assert_allclose(terms, expected, atol=1e-12)


def test_score_of_weights():
    mission = mission_from_dict(case_study(), 'test')
    states = pick_states(StateSpace(3, 8), 500)
    score = PriorityScore(mission, PriorityWeights(3, 0.5, 2, 1))
    reward, urgency, risk, resources = np.moveaxis(score.terms(states), -1, 0)
    expected = (3 * reward + 0.5 * urgency + 2 * (1 - risk) + (1 - resources)) / 6.5
    np.testing.assert_allclose(
        score.of_goals(states), np.where(states[:, 4:7] > 0, expected, 0), atol=1e-12
    )
    doubled = PriorityScore(mission, PriorityWeights(6, 1, 4, 2))
    np.testing.assert_allclose(doubled.of_goals(states), score.of_goals(states), atol=1e-12)


@pytest.mark.parametrize(
    ('term', 'state', 'first'),
    [
        ('urgency', [1, 1, 1, 1, 1, 2, 1, 0, 0, 0, 0], 2),  # Goal 1 weighs more.
        ('risk', [1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0], 1),  # The ways to the others lead by cell 2.
        ('resources', [1, 1, 1, 1, 1, 1, 1, 6, 0, 0, 0], 3),
        ('resources', [1, 1, 1, 0, 1, 1, 1, 6, 0, 0, 0], 1),
    ],
)
def test_each_term_decides_alone(term, state, first):
    weights = PriorityWeights(**{'reward': 0, term: 1})
    score = PriorityScore(mission_from_dict(case_study(), 'test'), weights)
    assert score.of_goals(np.array([state])).argmax() + 1 == first


def scores_of(subs, states):
    """Rho of sub-MDPs: that of their best goal, shape (N, sub-MDPs)."""
    scores = PriorityScore(subs[0].mission).of_goals(states)
    return np.stack([scores[:, list(sub.goals)].max(axis=1) for sub in subs], axis=1)


def chosen_by_recombination(subs, states):
    """Position of the sub-MDP whose values the rule hands on."""
    tables = [
        np.full((len(states), len(sub.numbers)), position) for position, sub in enumerate(subs)
    ]
    return highest_priority(subs, states, tables).min(axis=1)


@settings(max_examples=30)
@given(missions([(2, 2)], [3]))
def test_reward_alone_is_the_rule_highest_priority(document):
    mission = mission_from_dict(document, 'test')
    states = pick_states(StateSpace(3, 4), 300)
    pairs = [SubMdp(mission, pair, tuple(range(1, 11))) for pair in ((0, 1), (0, 2), (1, 2))]
    for subs in (goal_sub_mdps(mission), pairs):
        scores = scores_of(subs, states)
        chosen = chosen_by_recombination(subs, states).astype(int)
        of_chosen = scores[np.arange(len(states)), chosen]
        np.testing.assert_allclose(of_chosen, scores.max(axis=1), rtol=1e-15)


def test_first_of_the_ranking_is_the_rule_highest_priority():
    mission = mission_from_dict(case_study(), 'test')
    states = pick_states(StateSpace(3, 8), 20_000)
    subs = goal_sub_mdps(mission)
    ranking = ranked(scores_of(subs, states))
    assert np.array_equal(ranking[:, 0], chosen_by_recombination(subs, states))


def test_ranking_is_descending_and_equals_keep_their_order():
    assert ranked(np.array([0.2, 0.7, 0.2, 0.9, 0.7])).tolist() == [3, 1, 4, 0, 2]


@pytest.mark.parametrize(
    ('weights', 'message'),
    [
        ({'risk': -0.1}, 'weight of risk: -0.1'),
        ({'urgency': math.nan}, 'weight of urgency: nan'),
        ({'resources': math.inf}, 'weight of resources: inf'),
        ({'reward': 0}, 'all priority weights are 0'),
    ],
)
def test_weights_that_cannot_be(weights, message):
    with pytest.raises(ValueError, match=message):
        PriorityWeights(**weights)
