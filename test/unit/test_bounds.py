"""The lower bound against exact optima; the clusters' operator against the reference model."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter

import numpy as np
import pytest
from brute_force import BruteForce, solve
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions, pick_states

from uav_mission_manager.mdp import StateSpace, mission_from_dict
from uav_mission_manager.mdp.cost import goal_costs
from uav_mission_manager.solver import memory
from uav_mission_manager.solver.bounds import bound_bytes, covering, lower_bound
from uav_mission_manager.solver.bounds.ascent import Ascent
from uav_mission_manager.solver.bounds.cluster_mdp import ClusterMdp
from uav_mission_manager.solver.exact import AxisModel, value_iteration
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import shared_sub_mdps, whole_mission

PAIRS = [(0, 1), (0, 2), (1, 2)]
SPLITS = {
    1: [[(0,)], [(0,), (0,)]],
    2: [[(0, 1)], [(1, 0)], [(0,), (1,)], [(0, 1), (1, 0)], [(0,), (1,), (1,)]],
    3: [[(0, 1, 2)], PAIRS, [(0, 2), (2, 1)], [(0,), (1,), (2,)]],
}
"""Clusters for k goals, the first of them of all goals."""


def optimum(mission, states):
    solution = value_iteration(whole_mission(mission), 1e-9)
    return AxisModel(solution.sub).state_values(solution.value, states), solution.upper


def gap(exact, bound):
    return np.mean(exact / bound - 1)


@pytest.fixture(scope='module')
def whole():
    """Mission, all states and V* of the case study."""
    mission = mission_from_dict(case_study(), 'test')
    states = StateSpace(mission.k, mission.grid.q).states()
    return mission, states, optimum(mission, states)[0]


@settings(max_examples=20)
@given(missions([(1, 1), (1, 3), (2, 2)], [1, 2, 3]), st.data())
def test_below_the_optimum_of_any_mission(document, data):
    """V* of exact arithmetic lies within `slack` of the solver's."""
    mission = mission_from_dict(document, 'test')
    states = StateSpace(mission.k, mission.grid.q).states()
    clusters = data.draw(st.sampled_from(SPLITS[mission.k]))
    exact, slack = optimum(mission, states)
    bound = lower_bound(mission, clusters, iterations=data.draw(st.sampled_from([0, 1, 5])))
    assert (bound.values(states) <= exact + slack).all()
    assert (bound.values(states) >= 0).all()


@settings(max_examples=12)
@given(missions([(1, 2), (2, 2)], [1, 2, 3]))
def test_one_cluster_of_all_goals_is_the_optimum(document):
    mission = mission_from_dict(document, 'test')
    states = StateSpace(mission.k, mission.grid.q).states()
    exact, slack = optimum(mission, states)
    bound = lower_bound(mission, SPLITS[mission.k][0], tolerance=1e-8).values(states)
    assert (bound <= exact + slack).all()
    np.testing.assert_allclose(bound, exact, rtol=0, atol=1e-6 * max(1.0, exact.max()))


@settings(max_examples=8)
@given(missions([(1, 2), (2, 1)], [1]))
def test_one_cluster_against_the_reference_model(document):
    reference = solve(BruteForce(document))
    mission = mission_from_dict(document, 'test')
    bound = lower_bound(mission, [(0,)], tolerance=1e-8).values(reference.states)
    largest = max(1.0, reference.v.max())
    assert (bound <= reference.v + 1e-9 * largest).all()
    np.testing.assert_allclose(bound, reference.v, rtol=0, atol=1e-6 * largest)


@pytest.mark.parametrize('feasibility', ['strict', 'paper'])
def test_pairs_of_the_case_study(whole, feasibility):
    mission, states, exact = whole
    if feasibility == 'paper':
        mission = dataclasses.replace(mission, feasibility='paper')
        exact, _ = optimum(mission, states)
    even = lower_bound(mission, PAIRS, iterations=0).values(states)
    tight = lower_bound(mission, PAIRS).values(states)
    assert (even <= exact).all()
    assert (tight <= exact).all()
    assert gap(exact, even) > 0.15
    assert gap(exact, tight) < 0.03


def test_single_goals_of_the_case_study(whole):
    mission, states, exact = whole
    clusters = [(0,), (1,), (2,)]
    even = lower_bound(mission, clusters, iterations=0).values(states)
    tight = lower_bound(mission, clusters).values(states)
    assert (tight <= exact).all()
    assert gap(exact, tight) < gap(exact, even) / 2


def test_never_worse_than_the_even_split(whole):
    """Even where the ascent has hardly begun."""
    mission = whole[0]
    even = lower_bound(mission, PAIRS, iterations=0)
    for iterations in (1, 2):
        bound = lower_bound(mission, PAIRS, iterations=iterations)
        assert bound.tables.sum(dtype=float) >= even.tables.sum(dtype=float) * (1 - 1e-3)


def test_tables(whole):
    bound = lower_bound(whole[0], PAIRS, iterations=0)
    assert bound.tables.shape == (3, 8, 3, 8, 6, 6)
    assert bound.tables.dtype == np.float32
    assert bound.clusters.tolist() == [list(pair) for pair in PAIRS]


def cluster(mission, goals):
    return ClusterMdp(shared_sub_mdps(mission, np.array([goals]))[0], np.float64)


@pytest.mark.parametrize('goals', [(1,), (0, 2), (0, 1, 2)])
def test_expectations_and_masses_are_adjoint(whole, goals):
    mdp = cluster(whole[0], goals)
    rng = np.random.default_rng(0)
    values = rng.random(mdp.shape)
    ahead = mdp.ahead(values)
    arrived, total = np.zeros_like(ahead), 0.0
    for cell in range(len(values)):
        expected = mdp.q_values(cell, ahead, [])
        mass = rng.random(expected.shape)
        total += (mass * expected).sum()
        mdp.leave(cell, mass, arrived)
    assert total == pytest.approx((mdp.settle(arrived) * values).sum())


def test_expectation_of_one_is_the_discount(whole):
    mdp = cluster(whole[0], (0, 2))
    np.testing.assert_allclose(mdp.ahead(np.ones(mdp.shape)), whole[0].discount)


@pytest.mark.parametrize('clusters', SPLITS[3])
def test_shares_of_the_costs_add_up_to_those_of_the_whole(whole, clusters):
    """The costs of any actions, but for where a cluster forbids one."""
    mission, reduced = whole[0], ReducedMission(whole_mission(whole[0]))
    x = np.indices((6, 6, 6)).reshape(3, -1)
    total = 0.0
    for sub in shared_sub_mdps(mission, np.array(clusters)):
        mdp = ClusterMdp(sub, np.float64)
        costs = sum(mdp.costs({})) + mdp.state_costs.reshape(mdp.axes[1:])
        column = np.ravel_multi_index(x[list(sub.goals)], (6,) * sub.n)
        total += costs.reshape(*costs.shape[:2], -1, 3, 8)[:, :, column]
    price = reduced.price[reduced.agile[:, None], reduced.landings]
    state = reduced.fault_costs + own_goal_costs(mission, x.T)
    expected = reduced.action_costs(np.arange(mission.grid.q), x.T).transpose(1, 0, 3, 2)
    expected = expected[:, :, :, None] + price.swapaxes(0, 1)[:, :, None, :, None]
    expected += state[:, None]
    allowed = np.isfinite(total) & np.isfinite(expected)
    assert (allowed >= np.isfinite(expected)).all()
    np.testing.assert_allclose(total[allowed], expected[allowed])


def own_goal_costs(mission, x):
    """Of x (N, 3), as if uncommitted, shape (N, 1)."""
    return goal_costs(mission)[np.arange(3), x // 2, x % 2].sum(axis=1)[:, None]


@pytest.mark.parametrize('clusters', [PAIRS, [(0,), (1,), (2,)], [(0, 2), (1, 2)]])
def test_shifted_costs_sum_to_exactly_zero(whole, clusters):
    subs = shared_sub_mdps(whole[0], np.array(clusters))
    ascent = Ascent(subs, 32.0, 1)
    for done in (0.0, 0.5):
        ascent.climb(done)
    total = 0.0
    for number, sub in enumerate(subs):
        for slots, psi in ascent.psi(number).items():
            axes = [6 if any(sub.goals[slot] == j for slot in slots) else 1 for j in range(3)]
            total = total + psi.reshape(*psi.shape[:2], *axes, 24)
    assert (np.asarray(total) == 0).all()
    assert any(np.abs(psi).max() > 0 for psi in ascent.psi(0).values())


def test_climbing_says_how_far_it_is(whole):
    reports = []
    lower_bound(whole[0], PAIRS, iterations=3, progress=reports.append)
    assert [report.step for report in reports] == [1, 2, 3, 3]
    assert [report.done for report in reports] == pytest.approx([0.8 / 3, 1.6 / 3, 0.8, 1.0])


def test_same_bytes_whatever_the_threads(whole):
    one, three = (lower_bound(whole[0], PAIRS, iterations=5, threads=n) for n in (1, 3))
    assert one.tables.tobytes() == three.tables.tobytes()


def free_of_charge(document):
    """The mission without any cost."""
    for goal in document['goals']:
        goal |= {'eta': 0.0, 'delta': 0.0}
    document['faults']['cost'] = [0.0] * 8
    document['range']['cost'] = 0.0
    document['threat']['cost'] = [[0.0, 0.0]] * 3
    return document | {'distance_weight': 0.0, 'service_cost': {'recharge': 0.0, 'repair': 0.0}}


def test_mission_without_costs():
    mission = mission_from_dict(free_of_charge(case_study()), 'test')
    bound = lower_bound(mission, PAIRS, iterations=3)
    assert (bound.tables <= 0).all()
    states = pick_states(StateSpace(3, mission.grid.q), 100)
    assert (bound.values(states) == 0).all()
    assert (bound.sums(states) > -1e-300).all()


@pytest.mark.parametrize('unit', [1e-200, 1e-30, 1e200])
def test_unit_of_the_costs_does_not_matter(unit):
    """But for how the logarithms round."""
    document = case_study()
    usual = lower_bound(mission_from_dict(document, 'test'), PAIRS, iterations=20)
    for goal in document['goals']:
        goal |= {'eta': goal['eta'] * unit, 'delta': goal['delta'] * unit}
    document['faults']['cost'] = [cost * unit for cost in document['faults']['cost']]
    document['range']['cost'] *= unit
    document['threat']['cost'] = [[p * unit for p in row] for row in document['threat']['cost']]
    document |= {
        'distance_weight': unit,
        'service_cost': {'recharge': 2 * unit, 'repair': 4 * unit},
    }
    scaled = lower_bound(mission_from_dict(document, 'test'), PAIRS, iterations=20)
    assert scaled.tables.sum(dtype=float) == pytest.approx(
        unit * usual.tables.sum(dtype=float), rel=1e-4
    )


def test_costs_over_nine_decades():
    """Below V*, and in the mean state not far below, in whatever precision that takes."""
    document = case_study()
    document['goals'][0] |= {'eta': 1e9, 'delta': 1e9}
    document['goals'][1] |= {'eta': 1e-3, 'delta': 1e-3}
    mission = mission_from_dict(document, 'test')
    states = StateSpace(mission.k, mission.grid.q).states()
    exact, slack = optimum(mission, states)
    bound = lower_bound(mission, PAIRS)
    assert (bound.values(states) <= exact + slack).all()
    assert gap(exact, bound.values(states)) < 0.2


def test_estimate_of_memory(monkeypatch):
    """More cells, goals or clusters need more; what does not fit is refused in one line."""
    mission = goals_of_many(6)
    triples, pairs = (list(itertools.combinations(range(6), n)) for n in (3, 2))
    assert bound_bytes(mission, pairs) < bound_bytes(mission, triples)
    assert bound_bytes(mission, triples[:10]) < bound_bytes(mission, triples)
    monkeypatch.setattr(memory, 'SMALL_BYTES', 0)
    monkeypatch.setattr(memory, 'available_bytes', lambda: 1 << 20)
    with pytest.raises(memory.MissionSizeError, match='build without a certificate') as error:
        lower_bound(mission, triples)
    assert '\n' not in str(error.value)


def test_large_grids_get_small_clusters():
    document = case_study()
    document['grid'] |= {'rows': 100, 'cols': 100}
    mission = mission_from_dict(document, 'test')
    assert {len(cluster) for cluster in covering(mission, 10**12)} == {1}


def goals_of_many(k):
    document = case_study()
    goals = [
        dict(goal, name=f'{goal["name"]}_{n}', eta=goal['eta'] + n)
        for n in range(-(-k // 3))
        for goal in document['goals']
    ]
    return mission_from_dict(document | {'goals': goals[:k]}, 'test')


@pytest.mark.parametrize(
    ('k', 'max_states', 'size', 'count', 'pairs'),
    [
        (1, 4608, 1, 1, 0),
        (2, 4608, 1, 2, 0),
        (2, 41_472, 2, 1, 1),
        (3, 41_472, 2, 3, 3),
        (3, 331_776, 3, 1, 3),
        (4, 331_776, 3, 4, 6),
        (10, 331_776, 3, 120, 45),
        (10, 41_472, 2, 45, 45),
        (20, 331_776, 3, 68, 170),
        (40, 10**9, 2, 215, 215),
    ],
)
def test_clusters_of_a_certificate(k, max_states, size, count, pairs):
    """Different ones that hold each goal about equally often and at least so many pairs."""
    found = covering(goals_of_many(k), max_states)
    assert {len(cluster) for cluster in found} == {size}
    assert len(set(found)) == len(found) == count
    held = Counter(j for cluster in found for j in cluster)
    assert len(held) == k
    assert max(held.values()) <= 20 * min(held.values())
    pair = {frozenset(pair) for cluster in found for pair in itertools.combinations(cluster, 2)}
    assert len(pair) >= pairs


def test_clusters_of_a_certificate_follow_relabelled_goals():
    mission, order = goals_of_many(7), [3, 0, 6, 2, 5, 1, 4]
    other = dataclasses.replace(mission, goals=tuple(mission.goals[j] for j in order))
    for max_states in (41_472, 331_776):
        back = [tuple(order[j] for j in cluster) for cluster in covering(other, max_states)]
        assert list(map(sorted, back)) == list(map(list, covering(mission, max_states)))


def test_too_few_states_for_one_goal():
    with pytest.raises(ValueError, match='T_max = 4,607'):
        covering(goals_of_many(3), 4607)


def test_more_goals_than_can_be_solved_exactly():
    """Overlapping pairs of six goals beat single ones, both tightened."""
    document = case_study()
    document['goals'] = [
        dict(goal, name=f'{goal["name"]}_{copy}') for copy in 'ab' for goal in document['goals']
    ]
    mission = mission_from_dict(document, 'test')
    states = pick_states(StateSpace(6, mission.grid.q), 1000)
    singles = lower_bound(mission, [(j,) for j in range(6)], iterations=30).values(states)
    chain = lower_bound(mission, [(j, j + 1) for j in range(5)], iterations=30).values(states)
    assert chain.mean() > 1.1 * singles.mean()


@pytest.mark.parametrize(
    ('clusters', 'options', 'message'),
    [
        ([(0, 1), (2,)], {}, 'one size'),
        ([], {}, 'one size'),
        ([(0, 0), (1, 2)], {}, 'a goal twice'),
        ([(0, 1)], {}, 'each at least once'),
        ([(0, 1), (2, 3)], {}, r'the goals 0\.\.2'),
        (PAIRS, {'iterations': -1}, 'iterations -1'),
        (PAIRS, {'tolerance': 0.0}, r'tolerance 0\.0'),
    ],
)
def test_bad_input(whole, clusters, options, message):
    with pytest.raises(ValueError, match=message):
        lower_bound(whole[0], clusters, **options)
