"""States, actions and the grid they live on: counts, numbering, maps."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import BruteForce
from hypothesis import given
from hypothesis import strategies as st
from strategies import case_study, missions

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import (
    Action,
    ActionKind,
    Grid,
    StateError,
    StateSpace,
    action_name,
    global_actions,
    global_to_local,
    local_actions,
    local_to_global,
    mission_from_dict,
)
from uav_mission_manager.mdp.routes import diameter, distances, epochs_of_flight, next_hops
from uav_mission_manager.solver.submdp import goal_sub_mdps, state_count, whole_mission


@pytest.mark.parametrize(('k', 'size'), [(1, 4_608), (3, 331_776), (4, 2_488_320)])
def test_number_of_states(k, size):
    document = case_study()
    document['goals'] = [document['goals'][0] | {'name': f'goal{j}'} for j in range(k)]
    mission = mission_from_dict(document, 'test')
    assert StateSpace(k, 8).size == whole_mission(mission).states == size
    assert state_count(k, 8, 8) == size
    assert {sub.states for sub in goal_sub_mdps(mission)} == {4_608}


@pytest.mark.parametrize('method', ['exact', 'best_value'])
def test_number_of_states_in_info(method):
    info = build_policy(mission_from_dict(case_study(), 'test'), method).info
    assert info['states'] == 331_776
    assert info['sub_mdp_states'] == {'exact': [331_776], 'best_value': [4_608] * 3}[method]


@pytest.mark.parametrize(('k', 'q'), [(1, 8), (2, 2), (2, 1)])
def test_states_are_all_of_them_in_order(k, q):
    document = case_study() | {'grid': {'rows': 1, 'cols': q, 'base': 0, 'service': 0}}
    document['goals'] = document['goals'][:k]
    expected = np.array(BruteForce(document).states)
    space = StateSpace(k, q)
    np.testing.assert_array_equal(space.states(), expected)
    np.testing.assert_array_equal(space.index(expected), np.arange(space.size))


@given(st.integers(1, 4), st.integers(1, 20), st.data())
def test_index_and_state_both_ways(k, q, data):
    space = StateSpace(k, q)
    indices = data.draw(st.lists(st.integers(0, space.size - 1), min_size=1, max_size=5))
    rows = space.states(indices)
    assert rows.shape == (len(indices), 2 * k + 5)
    np.testing.assert_array_equal(space.index(rows), indices)


@given(st.integers(1, 4), st.integers(1, 20))
def test_variables_by_name(k, q):
    """`split` gives views of the variables of any array of states."""
    space = StateSpace(k, q)
    states = space.draw(6, np.random.default_rng(0)).reshape(2, 3, -1)
    s = space.split(states)
    assert (s.f.shape, s.r.shape, s.m.shape) == ((2, 3), (2, 3, k), (2, 3))
    for at in np.ndindex(2, 3):
        row = [s.f[at], *s.r[at], *s.g[at], s.l[at], s.c[at], s.t[at], s.m[at]]
        assert row == states[at].tolist()
    s.t[...] = 2
    assert (states[..., -2] == 2).all()


@pytest.mark.parametrize(('k', 'q'), [(1, 2), (2, 3)])
def test_states_are_drawn_from_all(k, q):
    space = StateSpace(k, q)
    drawn = space.index(space.draw(20 * space.size, np.random.default_rng(0)))
    assert set(drawn.tolist()) == set(range(space.size))


NAMES = ['f', 'r1', 'r2', 'r3', 'g1', 'g2', 'g3', 'l', 'c', 't', 'm']
LOW = [1] + [0] * 10
HIGH = [8, 1, 1, 1, 2, 2, 2, 7, 3, 2, 1]


@pytest.mark.parametrize('at', range(11), ids=NAMES)
def test_each_variable_has_its_range(at):
    space = StateSpace(3, 8)
    for value, inside in (
        (LOW[at], True),
        (HIGH[at], True),
        (LOW[at] - 1, False),
        (HIGH[at] + 1, False),
    ):
        state = [*LOW[:at], value, *LOW[at + 1 :]]
        if inside:
            assert space.states(space.index(state)).tolist() == [state]
        else:
            with pytest.raises(StateError, match=f'^{NAMES[at]} = {value} '):
                space.index([LOW, state])


@pytest.mark.parametrize(
    ('states', 'says'),
    [
        ([1] * 10, 'not 10'),
        ([1] * 12, 'not 12'),
        ([], 'not 0'),
        ([1.0] * 11, 'float64'),
        ([[[1] * 11]], '11 variables'),
        ([True] * 11, 'bool'),
    ],
    ids=str,
)
def test_what_is_no_state(states, says):
    with pytest.raises(StateError, match=says):
        StateSpace(3, 8).check(states)


def test_actions_of_three_goals_in_the_papers_order():
    mission = mission_from_dict(case_study(), 'test')
    actions = global_actions(mission)
    none, commit, recharge, repair = ActionKind
    assert actions == (
        Action(1, none, None, False, 0),
        Action(2, commit, 0, False, 5),
        Action(3, commit, 1, False, 3),
        Action(4, commit, 2, False, 6),
        Action(5, none, None, True, 0),
        Action(6, commit, 0, True, 5),
        Action(7, commit, 1, True, 3),
        Action(8, commit, 2, True, 6),
        Action(9, recharge, None, False, 1),
        Action(10, repair, None, False, 1),
    )
    assert [action.commitment for action in actions] == [0, 1, 2, 3, 0, 1, 2, 3, 0, 0]
    assert [action_name(mission, a) for a in actions] == [
        'none normal',
        'commit goal1 normal',
        'commit goal2 normal',
        'commit goal3 normal',
        'none agile',
        'commit goal1 agile',
        'commit goal2 agile',
        'commit goal3 agile',
        'recharge',
        'repair',
    ]


@given(missions([(1, 1), (2, 4)], [1, 2, 3, 4]))
def test_actions_of_any_mission(document):
    model = BruteForce(document)
    actions = global_actions(mission_from_dict(document, 'test'))
    assert [a.number for a in actions] == list(model.actions)
    assert [(a.kind.value, a.agile, a.commitment, a.destination) for a in actions] == [
        model.effect(number) for number in model.actions
    ]
    assert all(a.goal == (a.commitment - 1 if a.commitment else None) for a in actions)


@pytest.mark.parametrize('goal', [0, 1, 2])
def test_local_actions_are_the_papers_table_4(goal):
    table = [1, 2 + goal, 5, 6 + goal, 9, 10]
    assert [local_to_global(a, goal, 3) for a in range(1, 7)] == table
    assert [global_to_local(a, goal, 3) for a in table] == [1, 2, 3, 4, 5, 6]
    assert {global_to_local(a, goal, 3) for a in set(range(1, 11)) - set(table)} == {None}
    assert local_actions(3, goal) == tuple(table)


@pytest.mark.parametrize('k', [1, 2, 4])
def test_local_actions_of_other_numbers_of_goals(k):
    for d in range(1, k + 1):
        table = [1, 1 + d, k + 2, k + 2 + d, 2 * k + 3, 2 * k + 4]
        assert [local_to_global(a, d - 1, k) for a in range(1, 7)] == table


SIZES = [(1, 1), (1, 4), (3, 1), (2, 4), (4, 5)]


@pytest.mark.parametrize(('rows', 'cols'), SIZES)
def test_routes(rows, cols):
    document = case_study(1)
    document['grid'] |= {'rows': rows, 'cols': cols}
    model = BruteForce(document)
    grid = Grid(rows, cols, 0, 0)
    longest = 0.0
    for there in range(grid.q):
        away, hops = distances(grid, there), next_hops(grid, there)
        epochs = epochs_of_flight(grid, there)
        for here in range(grid.q):
            assert hops[here] == model.next_cell(here, there)
            assert epochs[here] == model.steps(here, there)
            way = complex(*divmod(here, cols)) - complex(*divmod(there, cols))
            assert away[here] == pytest.approx(abs(way), rel=1e-15)
            longest = max(longest, abs(way))
    assert diameter(grid) == pytest.approx(longest, rel=1e-15)


def test_cells_lie_east_and_south_of_cell_0():
    grid = Grid(2, 4, 0, 1, cell_size=50.0)
    assert [grid.position(cell) for cell in (0, 3, 4, 6)] == [
        (0, 0),
        (150, 0),
        (0, -50),
        (100, -50),
    ]


@given(st.sampled_from(SIZES), st.floats(1e-2, 1e4), st.data())
def test_cell_of_a_point(size, width, data):
    grid = Grid(*size, 0, 0, cell_size=width)
    cell = data.draw(st.integers(0, grid.q - 1))
    east, north = grid.position(cell)
    off_east, off_north = data.draw(st.tuples(*[st.floats(-0.49, 0.49)] * 2))
    point = east + off_east * width, north + off_north * width
    assert (grid.cell_at(*point), grid.contains(*point)) == (cell, True)


@pytest.mark.parametrize(
    ('east', 'north', 'nearest'),
    [(-1e3, 0, 0), (1e4, 0, 3), (0, 26, 0), (60, -1e3, 5), (1e6, -1e6, 7)],
)
def test_point_off_the_grid(east, north, nearest):
    grid = Grid(2, 4, 0, 1, cell_size=50.0)
    assert (grid.cell_at(east, north), grid.contains(east, north)) == (nearest, False)
