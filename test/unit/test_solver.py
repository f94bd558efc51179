"""Value iteration keeps its promises: bounds, residual, convergence; ties; sub-MDP costs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from brute_force import BruteForce, evaluate, matrices, solve
from hypothesis import given, settings
from strategies import case_study, missions, pick_states

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import StateSpace, mission_from_dict
from uav_mission_manager.policy import ExactPolicy
from uav_mission_manager.solver.exact import AxisModel, LookAhead, value_iteration
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.submdp import goal_sub_mdps, whole_mission


@pytest.fixture(scope='module')
def one_goal():
    """Sub-MDP, all states and exact V of the case study with one goal."""
    reference = solve(BruteForce(case_study(1)))
    return whole_mission(mission_from_dict(case_study(1), 'test')), reference.states, reference.v


def state_values(solution, states):
    return AxisModel(solution.sub).state_values(solution.value, states)


@pytest.mark.parametrize('sweeps', [1, 2, 3, 10, 30, 60])
def test_bounds_hold_at_every_sweep(one_goal, sweeps):
    sub, states, exact = one_goal
    solution = value_iteration(sub, tolerance=1e-300, max_iterations=sweeps)
    assert (solution.iterations, solution.converged) == (sweeps, False)
    off = exact - state_values(solution, states)
    assert solution.lower - 1e-9 <= off.min()
    assert off.max() <= solution.upper + 1e-9
    # The bounds are not much wider than need be: the change of the last sweep decides them.
    discount = sub.mission.discount
    assert (
        solution.upper
        == -solution.lower
        == pytest.approx(discount / (1 - discount) * solution.residual, abs=1e-10)
    )


@pytest.mark.parametrize('tolerance', [1e-2, 1e-5, 1e-8])
def test_stops_once_within_the_tolerance(one_goal, tolerance):
    sub, states, exact = one_goal
    solution = value_iteration(sub, tolerance)
    assert solution.converged
    assert 0 < solution.upper - solution.lower <= 2 * tolerance
    assert np.abs(exact - state_values(solution, states)).max() <= tolerance + 1e-9
    before = value_iteration(sub, tolerance, max_iterations=solution.iterations - 1)
    assert not before.converged


@pytest.mark.parametrize('sweeps', [1, 3, 10])
def test_the_greedy_policy_loses_no_more_than_its_bound(one_goal, sweeps):
    sub, states, exact = one_goal
    model = BruteForce(case_study(1))
    solution = value_iteration(sub, 1e-300, max_iterations=sweeps)
    look_ahead = LookAhead(AxisModel(sub), solution.value)
    action = choose(look_ahead.q_values(states)) - 1
    costs, rows, row_of = matrices(model)
    everyone = np.arange(len(states))
    followed = evaluate(
        costs[everyone, action], rows, row_of[everyone, action], sub.mission.discount
    )
    loss = followed - exact
    assert loss.min() >= -1e-9
    assert loss.max() <= solution.policy_loss_bound
    assert sweeps > 1 or loss.max() > 1e-3  # After one sweep the policy is not optimal yet.


@settings(max_examples=15)
@given(missions([(1, 2), (2, 2)], [1]))
def test_bounds_of_any_mission(document):
    mission = mission_from_dict(document, 'test')
    solution = value_iteration(whole_mission(mission), max_iterations=7)
    reference = solve(BruteForce(document))
    off = reference.v - state_values(solution, reference.states)
    slack = 1e-9 * max(1.0, reference.v.max())
    assert solution.lower - slack <= off.min()
    assert off.max() <= solution.upper + slack


def test_every_sweep_is_reported(one_goal):
    reports = []
    solution = value_iteration(one_goal[0], 1e-4, progress=reports.append)
    assert [report.step for report in reports] == list(range(1, solution.iterations + 1))
    assert reports[-1].text == f'sweep {solution.iterations}, within {solution.upper:.1e} of V*'
    done = [report.done for report in reports]
    assert (done[0], done[-1]) == (0, 1)
    assert all(0 < share < 1 for share in done[1:-1])
    assert done == sorted(done)


@pytest.mark.parametrize(('tolerance', 'sweeps'), [(0, 5), (-1, 5), (math.nan, 5), (1e-3, 0)])
def test_senseless_settings(one_goal, tolerance, sweeps):
    with pytest.raises(ValueError, match='must be above 0'):
        value_iteration(one_goal[0], tolerance, sweeps)


def test_info_says_how_well_a_policy_is_solved():
    policy = build_policy(mission_from_dict(case_study(), 'test'), tolerance=1e-3)
    info, solution = policy.info, policy.solution
    assert info['iterations'] == [solution.iterations] < [60]
    assert (info['residual'], info['converged']) == (solution.residual, True)
    assert 0 < info['upper'] == -info['lower'] <= 1e-3
    unfinished = value_iteration(solution.sub, max_iterations=3)
    assert not ExactPolicy(policy.plan, unfinished).info['converged']


def test_exact_policy_of_the_case_study_needs_few_sweeps():
    """67 sweeps for 1e-6; some 300 without the stopping bounds."""
    solution = value_iteration(whole_mission(mission_from_dict(case_study(), 'test')), 1e-6)
    assert solution.converged
    assert solution.iterations <= 67


def test_lower_bound_of_a_policy_stopped_early():
    mission = mission_from_dict(case_study(1), 'test')
    exact = build_policy(mission)
    states = exact.space.states()
    v = exact.q_values(states).min(axis=1)
    for tolerance in (30.0, 1.0, 1e-3):
        bound = build_policy(mission, tolerance=tolerance).lower_bound(states)
        assert (bound <= v + 1e-6).all()
        assert (v - bound).max() <= 2 * tolerance + 1e-6
        assert (bound >= 0).all()


def test_ties_go_to_the_lowest_number():
    nearly = 100 * (1 + 0.9e-9)
    q = np.array(
        [
            [3.0, 1.0, 1.0, 2.0],
            [np.inf, nearly, 100.0, 101.0],
            [100 * (1 + 2e-9), 100, 100, 1e3],
            [0.0, 0.0, 1.0, 1.0],
            [np.inf, np.inf, 5.0, np.inf],
        ]
    )
    assert choose(q).tolist() == [2, 2, 2, 1, 3]


def test_what_a_decision_says():
    policy = build_policy(mission_from_dict(case_study(), 'test'))
    for state in pick_states(policy.space, 200).tolist():
        decision = policy.decide(state)
        q = policy.q_values(state)[0]
        ranking = np.argsort(q, kind='stable')
        assert decision.state == tuple(state)
        assert decision.values == tuple(q)
        assert decision.action.number == policy.act(state)[0] == choose(q[None])[0]
        assert q[decision.action.number - 1] == pytest.approx(q.min(), rel=1e-9)
        assert q[decision.runner_up.number - 1] == pytest.approx(q[ranking[1]], rel=1e-9)
        assert decision.margin == pytest.approx(q[ranking[1]] - q[ranking[0]], abs=1e-6)
        assert decision.lower_bound == pytest.approx(q.min(), abs=1e-5)
        assert len(decision.reason.splitlines()) == 1


def test_no_such_method():
    with pytest.raises(ValueError, match="'magic' is none of auto, exact, expansion, split"):
        build_policy(mission_from_dict(case_study(1), 'test'), 'magic')


def test_sub_mdps_of_goals():
    mission = mission_from_dict(case_study(), 'test')
    subs = goal_sub_mdps(mission)
    assert [(sub.goals, sub.numbers) for sub in subs] == [
        ((0,), (1, 2, 5, 6, 9, 10)),
        ((1,), (1, 3, 5, 7, 9, 10)),
        ((2,), (1, 4, 5, 8, 9, 10)),
    ]
    assert StateSpace(1, mission.grid.q).size == subs[0].states
