"""Algorithm 1: measures, candidates, plans, and phi."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions, pick_states

from uav_mission_manager.mdp import Grid, StateSpace, mission_from_dict
from uav_mission_manager.mdp.routes import distances
from uav_mission_manager.solver.decomposition import Measures, Plan, decompose
from uav_mission_manager.solver.decomposition.decompose import DECOMPOSITION_KINDS
from uav_mission_manager.solver.decomposition.measures import summed_distances
from uav_mission_manager.solver.submdp import SubMdp

MISSION = mission_from_dict(case_study(), 'test')
MEASURES = Measures(MISSION)
kinds = st.sampled_from(list(DECOMPOSITION_KINDS))
any_mission = missions([(1, 1), (1, 3), (2, 2), (3, 4)], [1, 2, 3, 4])


def covers(part, mission, state):
    """Whether a part covers a state, by the definition."""
    wanted = [j for j in range(mission.k) if state[1 + mission.k + j] > 0]
    return (
        state[-4] in part.cells
        and state[0] in part.faults
        and (not wanted or any(j in part.goals for j in wanted))
    )


def jaccard(a, b):
    sets = [set(itertools.product(part.goals, part.cells, part.faults)) for part in (a, b)]
    return len(sets[0] & sets[1]) / len(sets[0] | sets[1])


def test_worth_is_what_waits_for_service_in_the_long_run():
    discount, matrix = MISSION.discount, np.array(MISSION.goals[0].priority_transition)
    wanted, spread = 0.0, np.full(3, 1 / 3)
    for epoch in range(1000):
        wanted += (1 - discount) * discount**epoch * spread[1:].sum()
        spread = spread @ matrix
    np.testing.assert_allclose(MEASURES.worth, np.array([15, 12, 9]) * wanted, rtol=1e-10)


def test_measures_of_the_case_study():
    assert MEASURES.reward_impact((0, 2), range(8)) == pytest.approx(24 / 36)
    assert MEASURES.reward_impact((0, 1, 2), (0, 3, 6)) == pytest.approx(21 / 36)
    assert MEASURES.spatial_coherence((0, 4, 5)) == pytest.approx(
        1 - (2 + math.sqrt(2)) / 3 / math.sqrt(10)
    )
    assert (MEASURES.spatial_coherence((6,)), MEASURES.spatial_coherence((0, 7))) == (1, 0)
    assert MEASURES.fault_sensitivity(range(3), (1,)) == 0
    assert MEASURES.fault_sensitivity(range(3), (1, 3)) == pytest.approx((0.3 + 6 / 18) / 2)
    assert MEASURES.fault_sensitivity(range(3), range(1, 9)) == 1
    # Goals 1 and 2 are sqrt(5) apart, the diameter is sqrt(10).
    assert MEASURES.coupling[0, 1] == pytest.approx(math.sqrt(12 / 15) * (1 + math.sqrt(0.5)) / 2)


@settings(max_examples=40)
@given(any_mission, st.data())
def test_measures_are_between_0_and_1(document, data):
    mission = mission_from_dict(document, 'test')
    measures = Measures(mission)
    some = [
        data.draw(st.sets(st.sampled_from(range(first, first + count)), min_size=1))
        for first, count in ((0, mission.k), (0, mission.grid.q), (1, 8))
    ]
    values = [
        measures.reward_impact(*some[:2]),
        measures.spatial_coherence(some[1]),
        measures.fault_sensitivity(some[0], some[2]),
        measures.coupling,
    ]
    for value in values:
        assert (np.asarray(value) >= 0).all()
        assert (np.asarray(value) <= 1).all()
    assert np.array_equal(measures.coupling, measures.coupling.T)
    assert not measures.coupling.diagonal().any()


def test_goal_based_plan_is_the_papers():
    plan = decompose(MISSION, 4608, 'goal')
    assert [(part.kind, part.goals, part.states, part.cost) for part in plan.parts] == [
        ('goal', (j,), 4608, 6 * 4608) for j in (0, 2, 1)
    ]
    # 2 of 4: goal 3, whose sub-MDP scores second, and one priority a row.
    states = [
        [1, 1, 1, 1, *g, 0, 0, 0, 0]
        for g in ((0, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 2), (0, 1, 2), (1, 1, 1))
    ]
    assert plan.part_of(states).tolist() == [1, 1, 3, 2, 2, 1]


@pytest.mark.parametrize(
    ('kind', 'max_states', 'types', 'sizes'),
    [
        ('location', 331_776, {'location'}, {8: 1}),
        ('location', 90_000, {'location'}, {2: 4}),
        ('location', 130_000, {'location'}, {2: 1, 3: 2}),
        ('fault', 90_000, {'fault'}, {8: 4}),
        ('fault', 50_000, {'fault'}, {8: 8}),
        ('blocks', 50_000, {'location'}, {1: 8}),
        ('blocks', 12_000, {'mixed'}, {1: 32}),
        ('blocks', 5184, {'mixed'}, {1: 64}),
    ],
)
def test_blocks_of_the_case_study(kind, max_states, types, sizes):
    plan = decompose(MISSION, max_states, kind)
    assert {part.kind for part in plan.parts} == types
    lengths = [len(part.cells) for part in plan.parts]
    assert {length: lengths.count(length) for length in lengths} == sizes
    owned = np.bincount(plan.part_of(StateSpace(3, 8).states()), minlength=len(lengths) + 1)
    assert owned.tolist() == [0, *(part.states for part in plan.parts)]
    assert plan.regions == tuple((part.cells, part.faults) for part in plan.parts)


@settings(max_examples=40)
@given(st.integers(1, 6), st.integers(1, 6), st.integers(1, 36))
def test_regions_are_contiguous_and_as_few_as_fit(rows, cols, room):
    grid = {'rows': rows, 'cols': cols, 'base': 0, 'service': 0}
    threat = case_study()['threat'] | {'zones': {}}
    document = case_study(1, grid=grid, threat=threat)
    document['goals'][0]['cell'] = 0
    mission = mission_from_dict(document, 'test')
    one = SubMdp(mission, (0,), ()).states // mission.grid.q
    plan = decompose(mission, room * one, 'location')
    assert len(plan.parts) == math.ceil(mission.grid.q / room)
    assert sorted(sum((part.cells for part in plan.parts), ())) == list(range(mission.grid.q))
    steps = np.array([distances(mission.grid, cell) == 1 for cell in range(mission.grid.q)])
    for part in plan.parts:
        assert len(part.cells) <= room
        reached = {part.cells[0]}
        for _ in part.cells:
            reached |= {cell for cell in part.cells if steps[cell, list(reached)].any()}
        assert reached == set(part.cells)


def test_clusters_of_goals_are_mixed_parts():
    plan = decompose(MISSION, 41_472, 'clusters')
    assert all(part.kind == 'mixed' and part.states == 41_472 for part in plan.parts)
    assert {part.goals for part in plan.parts} == {(0, 1), (0, 2)}
    by_goal = decompose(MISSION, 41_472, 'clusters', merge_score=3)
    assert {part.goals for part in by_goal.parts} == {(0,), (1,), (2,)}
    # Goal 2 is in no other part; that it takes goal 1 along once more is no reason to drop it.
    disjoint = decompose(MISSION, 41_472, 'clusters', overlap=1e-3)
    assert [part.goals for part in disjoint.parts] == [(0, 2), (1,)]


def test_auto_has_parts_of_all_types():
    plan = decompose(MISSION, 20_000)
    assert {part.kind for part in plan.parts} == {'goal', 'mixed'}
    assert {part.kind for part in decompose(MISSION, 50_000).parts} == {
        'location',
        'fault',
        'mixed',
    }
    assert all(part.kind != 'mixed' for part in decompose(MISSION, 50_000, merge_score=9).parts)


@pytest.mark.parametrize(
    ('weights', 'measure'),
    [
        ((2, 0, 0), 'reward_impact'),
        ((0, 0.5, 0), 'spatial_coherence'),
        ((0, 0, 1), 'fault_sensitivity'),
    ],
)
def test_weights_rank_the_parts(weights, measure):
    plan = decompose(MISSION, 50_000, weights=weights)
    scores = [part.score for part in plan.parts]
    assert scores == sorted(scores, reverse=True)
    assert scores == [max(weights) * getattr(part, measure) for part in plan.parts]
    assert scores[0] > scores[-1]


@settings(max_examples=60)
@given(any_mission, kinds, st.integers(100, 10**6), st.sampled_from([0.1, 0.4, 1.0]), st.data())
def test_plans_of_any_mission(document, kind, max_states, overlap, data):
    mission = mission_from_dict(document, 'test')
    space = StateSpace(mission.k, mission.grid.q)
    smallest = {
        'goal': 576 * mission.grid.q,
        'clusters': 576 * mission.grid.q,
        'location': space.size // mission.grid.q,
        'fault': space.size // 8,
        'blocks': space.size // mission.grid.q // 8,
    }
    if max_states < smallest.get(kind, min(smallest.values())):
        with pytest.raises(ValueError, match=f'T_max = {max_states:,} '):
            decompose(mission, max_states, kind, overlap=overlap)
        return
    plan = decompose(mission, max_states, kind, overlap=overlap)
    states = pick_states(space, 60)
    numbers = plan.part_of(states)
    for state, number in zip(states, numbers):
        assert number == 1 + [covers(part, mission, state) for part in plan.parts].index(True)
    for part in plan.parts:
        assert part.states <= max_states
        if len(part.cells) == mission.grid.q and len(part.faults) == 8:
            assert part.states == SubMdp(mission, part.goals, ()).states
    assert len(plan.parts) == len(set(plan.parts))
    for number, part in enumerate(plan.parts):
        if any(jaccard(part, better) >= overlap for better in plan.parts[:number]):
            rest = plan.parts[:number] + plan.parts[number + 1 :]
            with pytest.raises(ValueError, match='no part'):
                dataclasses.replace(plan, parts=rest)


@settings(max_examples=60)
@given(any_mission, kinds, st.integers(1000, 10**6), st.randoms(use_true_random=False))
def test_relabelled_goals_permute_the_plan(document, kind, max_states, random):
    order = list(range(len(document['goals'])))
    random.shuffle(order)
    permuted = document | {'goals': [document['goals'][j] for j in order]}
    missions_ = [mission_from_dict(each, 'test') for each in (document, permuted)]
    k, q = len(order), missions_[0].grid.q
    try:
        plan = decompose(missions_[0], max_states, kind)
    except ValueError:
        with pytest.raises(ValueError, match='T_max'):
            decompose(missions_[1], max_states, kind)
        return
    other = decompose(missions_[1], max_states, kind)
    back = [
        dataclasses.replace(part, goals=tuple(sorted(order[j] for j in part.goals)))
        for part in other.parts
    ]
    assert back == list(plan.parts)
    states = pick_states(StateSpace(k, q), 50)
    relabelled = states.copy()
    relabelled[:, 1 : 1 + k], relabelled[:, 1 + k : 1 + 2 * k] = (
        states[:, 1 : 1 + k][:, order],
        states[:, 1 + k : 1 + 2 * k][:, order],
    )
    assert np.array_equal(plan.part_of(states), other.part_of(relabelled))
    closest = [Measures(mission).closest(2) for mission in missions_]
    assert closest[0] == tuple(tuple(sorted(order[j] for j in pair)) for pair in closest[1])


@settings(max_examples=30)
@given(any_mission, st.integers(1, 3))
def test_closest_clusters_come_first(document, n):
    measures = Measures(mission_from_dict(document, 'test'))
    k = measures.mission.k
    found = measures.closest(n)
    assert sorted(found) == list(itertools.combinations(range(k), n))
    within = [
        min((measures.coupling[pair] for pair in itertools.combinations(cluster, 2)), default=0.0)
        for cluster in found
    ]
    assert within == sorted(within, reverse=True)


def test_uncovered_states_are_named():
    goals = decompose(MISSION, 4608, 'goal')
    cells = decompose(MISSION, 41_472, 'location')
    faults = decompose(MISSION, 41_472, 'fault')
    blocks = decompose(MISSION, 5184, 'blocks')

    def problem(plan, missing):
        parts = tuple(part for part in plan.parts if not missing(part))
        with pytest.raises(ValueError, match='no part of at most T_max') as error:
            Plan(MISSION, plan.max_states, parts)
        return str(error.value).partition('covers ')[2]

    assert problem(goals, lambda part: part.goals == (1,)) == (
        'goal goal2, such as [1 1 1 1 0 2 0 0 0 0 0]'
    )
    assert problem(cells, lambda part: 3 in part.cells) == (
        'location 3, such as [1 1 1 1 2 0 0 3 0 0 0]'
    )
    assert problem(cells, lambda part: {3, 5} & set(part.cells)).startswith(
        'location 3, location 5, such as'
    )
    assert problem(faults, lambda part: 8 in part.faults) == (
        'fault mode all, such as [8 1 1 1 2 0 0 0 0 0 0]'
    )
    assert problem(blocks, lambda part: part.cells == (2,) and part.faults == (5,)) == (
        'goal goal1 at location 2 in fault mode camera, such as [5 1 1 1 2 0 0 2 0 0 0]'
    )


@pytest.mark.parametrize('kind', DECOMPOSITION_KINDS)
def test_too_small_a_threshold(kind):
    with pytest.raises(ValueError, match='T_max = 300 states covers any state, such as'):
        decompose(MISSION, 300, kind)


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'max_states': 0}, 'max_states 0'),
        ({'kind': 'magic'}, "'magic' is none of goal, location"),
        ({'weights': (1, 1)}, r'weights \(1, 1\)'),
        ({'weights': (0, 0, 0)}, 'not all 0'),
        ({'weights': (1, -1, 0)}, 'not negative'),
        ({'weights': (1, math.nan, 0)}, 'finite'),
        ({'weights': (1, math.inf, 0)}, 'finite'),
        ({'overlap': 0}, 'overlap 0'),
        ({'overlap': math.nan}, 'overlap nan'),
        ({'merge_score': math.nan}, 'merge_score nan'),
    ],
)
def test_senseless_settings(settings, message):
    with pytest.raises(ValueError, match=message):
        decompose(MISSION, **({'max_states': 10_000} | settings))


def test_goal_plans_are_no_blocks():
    with pytest.raises(ValueError, match='part 1 is no block'):
        _ = decompose(MISSION, 4608, 'goal').regions


def test_plans_in_json():
    plan = decompose(MISSION, 50_000, 'fault')
    document = json.loads(json.dumps(plan.to_dict()))
    assert document['max_states'] == 50_000
    assert document['parts'][0] == {
        'kind': 'fault',
        'goals': ['goal1', 'goal2', 'goal3'],
        'cells': [[0, 7]],
        'faults': ['all'],
        'states': 41_472,
        'cost': 414_720,
        **{
            name: getattr(plan.parts[0], name)
            for name in (
                'reward_impact',
                'spatial_coherence',
                'fault_sensitivity',
                'coupling',
                'score',
            )
        },
    }


@settings(max_examples=60)
@given(any_mission, kinds, st.integers(1000, 10**6))
def test_plans_are_restored_from_json(document, kind, max_states):
    mission = mission_from_dict(document, 'test')
    try:
        plan = decompose(mission, max_states, kind)
    except ValueError:
        return
    restored = Plan.from_dict(mission, json.loads(json.dumps(plan.to_dict())))
    assert restored == plan
    states = pick_states(StateSpace(mission.k, mission.grid.q), 60)
    np.testing.assert_array_equal(restored.part_of(states), plan.part_of(states))


@pytest.mark.parametrize(
    ('change', 'error'),
    [
        ({'phi': 'the last part'}, ValueError),
        ({'parts': []}, ValueError),
        ({'parts': [{}]}, LookupError),
        ({'parts': None}, TypeError),
    ],
)
def test_what_is_no_plan_in_json(change, error):
    data = decompose(MISSION, 4608, 'goal').to_dict()
    with pytest.raises(error):
        Plan.from_dict(MISSION, data | change)


@pytest.mark.parametrize(
    'change',
    [
        {'goals': ['goal9']},
        {'faults': ['none']},
        {'cells': [[0, 8]]},
        {'cells': [[-1, 7]]},
        {'cells': []},
        {'colour': 'red'},
    ],
)
def test_what_is_no_part_in_json(change):
    data = decompose(MISSION, 4608, 'goal').to_dict()
    data['parts'][0] |= change
    with pytest.raises((ValueError, LookupError, TypeError)):
        Plan.from_dict(MISSION, data)


@pytest.mark.parametrize('shape', ['whole', 'ragged', 'two corners'])
def test_summed_distances_of_many_cells(shape):
    """Counted by offset as pair by pair."""
    grid, rng = Grid(30, 17, 0, 0), np.random.default_rng(0)
    cells = {
        'whole': np.arange(grid.q),
        'ragged': np.sort(rng.choice(grid.q, 200, replace=False)),
        'two corners': np.r_[0, np.arange(grid.q - 100, grid.q)],
    }[shape]
    row, col = np.divmod(cells, grid.cols)
    pairs = np.hypot(np.subtract.outer(row, row), np.subtract.outer(col, col))
    assert summed_distances(grid, cells) == pytest.approx(pairs.sum(), rel=1e-12)


@pytest.mark.parametrize('kind', ['goal', 'clusters'])
def test_large_grids_and_many_goals(kind):
    """No table of all pairs of cells: with 90,000 it would not fit in any memory."""
    document = case_study(grid={'rows': 300, 'cols': 300, 'base': 0, 'service': 1})
    cells = np.random.default_rng(0).choice(90_000, 40, replace=False).tolist()
    document['goals'] = [
        document['goals'][j % 3] | {'name': f'goal{j}', 'cell': cell}
        for j, cell in enumerate(cells)
    ]
    mission = mission_from_dict(document, 'test')
    plan = decompose(mission, SubMdp(mission, (0, 1, 2), ()).states, kind)
    assert {goal for part in plan.parts for goal in part.goals} == set(range(40))
    assert {len(part.goals) for part in plan.parts} <= {1, 2, 3}
    assert len(json.dumps(plan.to_dict())) < 100_000
    assert len(Measures(mission).closest(3)) == math.comb(40, 3)
