"""Simulated episodes against the reference model and against exact evaluation."""

from __future__ import annotations

import numpy as np
import pytest
from strategies import case_study, pick_states
from test_recombination import recombination

from uav_mission_manager.mdp import StateError, StateSpace, cost, mission_from_dict
from uav_mission_manager.solver.evaluation.policy_evaluation import evaluate, tabulate
from uav_mission_manager.solver.evaluation.simulation import (
    ControlVariate,
    estimate,
    simulate,
)
from uav_mission_manager.solver.exact import AxisModel, LookAhead, value_iteration
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.submdp import whole_mission


@pytest.fixture(scope='module')
def split():
    """Mission, policy, start states and the exact cost of `split` in the case study."""
    mission = mission_from_dict(case_study(), 'test')
    q_values, sub = recombination(mission, 'split'), whole_mission(mission)

    def act(states):
        return choose(q_values(states))

    start = pick_states(StateSpace(3, 8), 12, seed=5)
    return mission, act, start, evaluate(sub, tabulate(sub, act)).state_values(start)


def control_by(mission, values):
    """Control variate of a W, of the optimal one where it is None."""
    model = AxisModel(whole_mission(mission))
    if values is None:
        values = value_iteration(model.sub).value
    return ControlVariate(
        lambda states: model.state_values(values, states), LookAhead(model, values).q_values
    )


def test_estimates_and_their_variance(split):
    mission, act, start, value = split
    plain, controlled = (
        estimate(mission, act, start, 200, np.random.default_rng(1), control)
        for control in (None, control_by(mission, None))
    )
    for found in (plain, controlled):
        assert ((found.lower <= value) & (value <= found.upper)).all()
        score = (found.mean - value) / found.error
        assert np.abs(score).max() < 4
    assert controlled.error.mean() < plain.error.mean() / 3
    assert (controlled.upper - controlled.lower).mean() < (plain.upper - plain.lower).mean() / 3


def test_any_value_function_leaves_the_mean_as_it_is(split):
    mission, act, start, value = split
    shape = AxisModel(whole_mission(mission)).shape
    control = control_by(mission, np.random.default_rng(2).uniform(0, 300, shape))
    found = estimate(mission, act, start, 200, np.random.default_rng(3), control)
    assert np.abs((found.mean - value) / found.error).max() < 4


def test_without_a_policy_the_least_q_decides(split):
    mission, _, start, _ = split
    control = control_by(mission, None)
    runs = [
        simulate(mission, act, start, 30, np.random.default_rng(1), control)
        for act in (lambda states: choose(control.q_values(states)), None)
    ]
    assert np.array_equal(runs[0][0], runs[1][0])
    assert np.array_equal(runs[0][1], runs[1][1])


@pytest.mark.parametrize('truncation', [0.3, 0.9])
def test_bounds_hold_of_episodes_cut_short(split, truncation):
    mission, act, start, value = split
    for control in (None, control_by(mission, None)):
        found = estimate(
            mission, act, start, 50, np.random.default_rng(4), control, truncation=truncation
        )
        assert mission.discount**found.horizon <= truncation
        assert mission.discount ** (found.horizon - 1) > truncation
        assert ((found.lower <= value) & (value <= found.upper)).all()


def test_confidence_is_that_of_student():
    """Of many intervals from three episodes that many hold the cost."""
    mission = mission_from_dict(case_study(1), 'test')
    control, start = control_by(mission, None), pick_states(StateSpace(1, 8), 1)
    value = control.values(start)[0]
    found = estimate(
        mission,
        lambda states: choose(control.q_values(states)),
        np.repeat(start, 2000, axis=0),
        3,
        np.random.default_rng(5),
        confidence=0.8,
        truncation=1e-4,
    )
    tail = mission.discount**found.horizon * cost.largest_stage_cost(mission)
    inside = (found.lower <= value) & (value <= found.upper - tail / (1 - mission.discount))
    assert inside.mean() == pytest.approx(0.8, abs=0.05)


def test_the_same_seed_the_same_episodes(split):
    mission, act, start, _ = split
    runs = [simulate(mission, act, start, 30, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0][0], runs[1][0])
    assert np.array_equal(runs[0][1], runs[1][1])
    assert not np.array_equal(runs[0][0], runs[2][0])


def test_what_cannot_be_simulated(split):
    mission, act, start, _ = split
    rng = np.random.default_rng(0)
    out_of_range = [1, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0]
    for action in (0, 11, 3):
        with pytest.raises(ValueError, match=rf'action {action} is not allowed in state \[1, 0'):
            simulate(
                mission, lambda states, a=action: np.full(len(states), a), out_of_range, 1, rng
            )
    with pytest.raises(StateError, match='l = 8'):
        simulate(mission, act, [1, 0, 0, 0, 2, 0, 0, 8, 0, 0, 0], 1, rng)
    with pytest.raises(ValueError, match='neither act nor control'):
        simulate(mission, None, start, 1, rng)
    for settings_ in ({'episodes': 1}, {'truncation': 0.0}, {'confidence': 1.0}):
        with pytest.raises(ValueError, match=next(iter(settings_))):
            estimate(mission, act, start, **{'episodes': 5, 'rng': rng, **settings_})
