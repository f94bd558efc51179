"""States, actions and the grid they live on: counts, numbering, maps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from brute_force import BruteForce
from hypothesis import given
from hypothesis import strategies as st
from strategies import case_study, missions

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import (
    Grid,
    Origin,
    StateError,
    StateSpace,
    action_name,
    global_actions,
    global_to_local,
    local_to_global,
    mission_from_dict,
)
from uav_mission_manager.solver import goal_sub_mdps, whole_mission


@pytest.mark.parametrize(('k', 'size'), [(1, 4_608), (3, 331_776), (4, 2_488_320)])
def test_number_of_states(k, size):
    document = case_study()
    document['goals'] = [document['goals'][0] | {'name': f'goal{j}'} for j in range(k)]
    mission = mission_from_dict(document, 'test')
    assert StateSpace(k, 8).size == whole_mission(mission).states == size
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


NAMES = ['f', 'r1', 'r2', 'r3', 'g1', 'g2', 'g3', 'l', 'c', 't', 'm']
LOW = [1] + [0] * 10
HIGH = [8, 1, 1, 1, 2, 2, 2, 7, 3, 2, 1]


@pytest.mark.parametrize('at', range(11), ids=NAMES)
def test_each_variable_has_its_range(at):
    space = StateSpace(3, 8)
    for value, inside in ((LOW[at], True), (HIGH[at], True), (LOW[at] - 1, False),
                          (HIGH[at] + 1, False)):
        state = [*LOW[:at], value, *LOW[at + 1:]]
        if inside:
            assert space.states(space.index(state)).tolist() == [state]
        else:
            with pytest.raises(StateError, match=f'^{NAMES[at]} = {value} '):
                space.index([LOW, state])


@pytest.mark.parametrize(('states', 'says'), [
    ([1] * 10, 'not 10'), ([1] * 12, 'not 12'), ([], 'not 0'), ([1.0] * 11, 'float64'),
    ([[[1] * 11]], '11 variables'), ([True] * 11, 'bool'),
], ids=str)
def test_what_is_no_state(states, says):
    with pytest.raises(StateError, match=says):
        StateSpace(3, 8).check(states)


def test_actions_of_three_goals_in_the_papers_order():
    mission = mission_from_dict(case_study(), 'test')
    actions = global_actions(mission)
    assert [(a.number, a.kind, a.goal, a.agile, a.destination) for a in actions] == [
        (1, 'none', 0, False, 0),
        (2, 'commit', 1, False, 5), (3, 'commit', 2, False, 3), (4, 'commit', 3, False, 6),
        (5, 'none', 0, True, 0),
        (6, 'commit', 1, True, 5), (7, 'commit', 2, True, 3), (8, 'commit', 3, True, 6),
        (9, 'recharge', 0, False, 1), (10, 'repair', 0, False, 1),
    ]
    assert [action_name(mission, a) for a in actions] == [
        'none normal', 'commit goal1 normal', 'commit goal2 normal', 'commit goal3 normal',
        'none agile', 'commit goal1 agile', 'commit goal2 agile', 'commit goal3 agile',
        'recharge', 'repair']


@given(missions([(1, 1), (2, 4)], [1, 2, 3, 4]))
def test_actions_of_any_mission(document):
    model = BruteForce(document)
    actions = global_actions(mission_from_dict(document, 'test'))
    assert [a.number for a in actions] == list(model.actions)
    assert [(a.kind, a.agile, a.goal, a.destination) for a in actions] == [
        model.effect(number) for number in model.actions]


@pytest.mark.parametrize('d', [1, 2, 3])
def test_local_actions_are_the_papers_table_4(d):
    table = [1, 1 + d, 5, 5 + d, 9, 10]
    assert [local_to_global(a, d, 3) for a in range(1, 7)] == table
    assert [global_to_local(a, d, 3) for a in table] == [1, 2, 3, 4, 5, 6]
    assert {global_to_local(a, d, 3) for a in set(range(1, 11)) - set(table)} == {None}


@pytest.mark.parametrize('k', [1, 2, 4])
def test_local_actions_of_other_numbers_of_goals(k):
    for d in range(1, k + 1):
        table = [1, 1 + d, k + 2, k + 2 + d, 2 * k + 3, 2 * k + 4]
        assert [local_to_global(a, d, k) for a in range(1, 7)] == table


SIZES = [(1, 1), (1, 4), (3, 1), (2, 4), (4, 5)]


@pytest.mark.parametrize(('rows', 'cols'), SIZES)
def test_next_hop_and_distance(rows, cols):
    document = case_study(1)
    document['grid'] |= {'rows': rows, 'cols': cols}
    model = BruteForce(document)
    grid = Grid(rows, cols, 0, 0)
    for here, there in itertools.product(range(grid.q), repeat=2):
        assert grid.next_hops()[here, there] == model.next_cell(here, there)
        way = complex(*divmod(here, cols)) - complex(*divmod(there, cols))
        assert grid.distances()[here, there] == pytest.approx(abs(way), rel=1e-15)


def test_cells_lie_east_and_south_of_cell_0():
    grid = Grid(2, 4, 0, 1, cell_size=50.0)
    assert [grid.position(cell) for cell in (0, 3, 4, 6)] == [
        (0, 0), (150, 0), (0, -50), (100, -50)]


@given(st.sampled_from(SIZES), st.floats(1e-2, 1e4), st.data())
def test_cell_of_a_point(size, width, data):
    grid = Grid(*size, 0, 0, cell_size=width)
    cell = data.draw(st.integers(0, grid.q - 1))
    east, north = grid.position(cell)
    off_east, off_north = data.draw(st.tuples(*[st.floats(-0.49, 0.49)] * 2))
    point = east + off_east * width, north + off_north * width
    assert (grid.cell_at(*point), grid.contains(*point)) == (cell, True)


@pytest.mark.parametrize(('east', 'north', 'nearest'), [
    (-1e3, 0, 0), (1e4, 0, 3), (0, 26, 0), (60, -1e3, 5), (1e6, -1e6, 7)])
def test_point_off_the_grid(east, north, nearest):
    grid = Grid(2, 4, 0, 1, cell_size=50.0)
    assert (grid.cell_at(east, north), grid.contains(east, north)) == (nearest, False)


def test_origin_to_geodetic():
    """A degree of latitude is 110.574 km at the equator, 111.694 km at the pole (WGS84)."""
    latitude, longitude = Origin(0.0, 10.0, 0.0).to_geodetic(111_319.5, 110_574.0)
    assert (latitude, longitude) == (pytest.approx(1.0, abs=1e-5), pytest.approx(11.0, abs=1e-5))
    latitude, longitude = Origin(60.0, 10.0, 0.0).to_geodetic(55_800.0, 0.0)
    assert (latitude, longitude) == (60.0, pytest.approx(11.0, abs=1e-4))
    assert Origin(-89.0, 0.0, 0.0).to_geodetic(0.0, 111_694.0)[0] == pytest.approx(-88.0, abs=1e-4)


@given(st.floats(-80, 80), st.floats(-179, 179), *[st.floats(-1e4, 1e4)] * 2)
def test_origin_both_ways(latitude, longitude, east, north):
    origin = Origin(latitude, longitude, 0.0)
    assert origin.to_local(*origin.to_geodetic(east, north)) == pytest.approx(
        (east, north), abs=1e-3)
