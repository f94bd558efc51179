"""The out-of-core solver, block by block, against value iteration on the whole."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from brute_force import BruteForce, solve
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions

from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.decomposition.decompose import decompose
from uav_mission_manager.solver.exact import AxisModel, value_iteration
from uav_mission_manager.solver.exact.blocks import solve_blocks
from uav_mission_manager.solver.submdp import SubMdp, whole_mission

CELLS, MODES = range(8), range(1, 9)
HALVES = (0, 1, 4, 5), (2, 3, 6, 7)
BLOCKS = {
    'whole': [(CELLS, MODES)],
    'location': [((cell,), MODES) for cell in CELLS],
    'fault': [(CELLS, (mode,)) for mode in MODES],
    'location x fault': [(half, range(f, f + 2)) for half in HALVES for f in (1, 3, 5, 7)],
    'scattered': [((0, 3, 6), (1, 4, 8)), ((0, 3, 6), (2, 3, 5, 6, 7)), ((7, 1, 2, 4, 5), MODES)],
    'overlapping': [(HALVES[0], MODES), (range(1, 8), range(3, 9)), (CELLS, (1, 2))],
}


def whole(*goals, **changes):
    return whole_mission(mission_from_dict(case_study(*goals, **changes), 'test'))


@pytest.fixture(scope='module')
def two_goals():
    return value_iteration(whole(1, 2), 1e-9)


def assert_exact(solution, exact, tolerance):
    """Within the tolerance of the exact solution, and between the bounds."""
    assert solution.converged
    off = exact.value - solution.value
    assert np.abs(off).max() <= tolerance + exact.upper
    assert solution.lower + exact.lower <= off.min()
    assert off.max() <= solution.upper + exact.upper
    assert solution.upper <= 1.01 * tolerance


@pytest.mark.parametrize('blocks', BLOCKS.values(), ids=BLOCKS)
def test_any_blocks_give_the_exact_solution(two_goals, blocks):
    solution = solve_blocks(two_goals.sub, blocks, 1e-3)
    assert_exact(solution, two_goals, 1e-3)
    # A round of one sweep is worth a sweep of value iteration.
    assert solution.iterations <= value_iteration(two_goals.sub, 1e-3).iterations + 1


def test_base_and_service_on_goals():
    sub = whole(2, 3, grid={'rows': 1, 'cols': 8, 'base': 6, 'service': 3})
    solution = solve_blocks(sub, BLOCKS['scattered'], 1e-3)
    assert_exact(solution, value_iteration(sub, 1e-9), 1e-3)


@pytest.mark.parametrize(
    ('goals', 'numbers', 'share'), [((), range(1, 11), 1.0), ((2,), (1, 4, 5, 8, 9, 10), 0.4)]
)
def test_any_sub_mdp(goals, numbers, share):
    sub = SubMdp(whole().mission, goals, tuple(numbers), share)
    solution = solve_blocks(sub, BLOCKS['overlapping'], 1e-6)
    assert_exact(solution, value_iteration(sub, 1e-9), 1e-6)


def test_three_goals_by_plans():
    sub = whole()
    exact = value_iteration(sub, 1e-9)
    for kind, most in (('location', 100_000), ('fault', 200_000), ('blocks', 30_000)):
        plan = decompose(sub.mission, most, kind)
        assert len(plan.parts) > 1
        assert_exact(solve_blocks(sub, plan.regions), exact, 1e-7)


@st.composite
def cuts(draw, cells):
    """Blocks that part the grid, and the fault modes of each region anew; perhaps one more."""

    def classes(count):
        labels = draw(st.lists(st.integers(0, 2), min_size=count, max_size=count))
        return [[i for i in range(count) if labels[i] == label] for label in set(labels)]

    blocks = [
        (region, [fault + 1 for fault in faults])
        for region in classes(cells)
        for faults in classes(8)
    ]
    return blocks + draw(st.lists(st.sampled_from(blocks), max_size=1))


@settings(max_examples=10)
@given(missions([(1, 2), (2, 2)], [1]), st.data())
def test_small_missions_against_policy_iteration(document, data):
    mission, reference = mission_from_dict(document, 'test'), solve(BruteForce(document))
    blocks = data.draw(cuts(mission.grid.q))
    rounds = data.draw(st.sampled_from([3, 1000]))
    solution = solve_blocks(whole_mission(mission), blocks, 1e-6, max_rounds=rounds)
    model = AxisModel(solution.sub)
    off = reference.v - model.state_values(solution.value, reference.states)
    slack = 1e-9 * max(1.0, reference.v.max())
    assert solution.lower - slack <= off.min()
    assert off.max() <= solution.upper + slack
    assert rounds == 3 or solution.upper <= 2e-6 + slack


@settings(max_examples=20)
@given(missions([(1, 3), (2, 2)], [2]), st.data())
def test_a_round_is_a_whole_backup_of_any_mission(document, data):
    sub = whole_mission(mission_from_dict(document, 'test'))
    blocks = data.draw(cuts(sub.mission.grid.q))
    for rounds in range(1, 5):
        solution = solve_blocks(sub, blocks, 1e-9, max_rounds=rounds)
        reference = value_iteration(sub, 1e-9, rounds, precision='double')
        assert solution.iterations == reference.iterations
        scale = max(1.0, float(np.abs(reference.value).max()))
        np.testing.assert_allclose(solution.value, reference.value, rtol=0, atol=1e-9 * scale)
        assert solution.upper == pytest.approx(reference.upper, rel=1e-6, abs=1e-8 * scale)


def test_the_memory_is_that_of_a_block(tmp_path):
    document = case_study()
    document['goals'].append(document['goals'][0] | {'name': 'goal4', 'cell': 7})
    sub = whole_mission(mission_from_dict(document, 'test'))
    peaks = []
    for blocks in (
        BLOCKS['whole'],
        BLOCKS['location x fault'],
        [((cell,), (mode,)) for cell in CELLS for mode in MODES],
    ):
        tracemalloc.start()
        solution = solve_blocks(sub, blocks, max_rounds=2, directory=tmp_path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert isinstance(solution.value, np.memmap)
    assert peaks[0] > 2 * solution.value.nbytes
    assert peaks[0] > 2.5 * peaks[1] > 3.75 * peaks[2]


def test_an_unreachable_tolerance_ends_where_rounding_does():
    solution = solve_blocks(whole(1), BLOCKS['location'], 1e-300)
    assert not solution.converged
    assert 0 < solution.upper < 1e-8


@pytest.mark.parametrize(
    'settings', [{'tolerance': 0}, {'tolerance': math.nan}, {'max_rounds': 0}]
)
def test_senseless_settings(settings):
    with pytest.raises(ValueError, match='must be above 0'):
        solve_blocks(whole(1), BLOCKS['whole'], **settings)


@pytest.mark.parametrize(
    ('blocks', 'message'),
    [
        ([], 'none holds cell 0 in fault mode 1'),
        ([(CELLS, range(1, 6)), (range(3), MODES)], 'none holds cell 3 in fault mode 6'),
        ([(range(9), MODES)], 'cell 8 in fault mode 1 does not exist'),
        ([(CELLS, range(8))], 'cell 0 in fault mode 0 does not exist'),
    ],
)
def test_blocks_that_do_not_fit_the_mission(blocks, message):
    with pytest.raises(ValueError, match=message):
        solve_blocks(whole(1), blocks)
