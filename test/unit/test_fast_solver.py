"""The fast solver: blocks, threads and precisions change the time a solve takes, nothing else."""

from __future__ import annotations

import copy
import tracemalloc

import numpy as np
import pytest
from brute_force import BruteForce, solve
from hypothesis import given, settings
from strategies import case_study, missions, pick_states, with_charge

from uav_mission_manager.mdp import StateSpace, mission_from_dict
from uav_mission_manager.solver.exact import (
    AxisModel,
    LookAhead,
    Sweeper,
    look_ahead,
    memory,
    sweep,
    value_iteration,
)
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.memory import MissionSizeError
from uav_mission_manager.solver.submdp import SubMdp, whole_mission


def whole(document):
    return whole_mission(mission_from_dict(document, 'test'))


def backups(sub, count, dtype=np.float64, threads=1):
    """W after some backups of W = 0, and the changes on the way."""
    model = AxisModel(sub, dtype)
    sweeper = Sweeper(model, model.zero(), threads)
    changes = [sweeper.backup() for _ in range(count)]
    return sweeper, changes


@pytest.mark.parametrize('dtype', [np.float32, np.float64])
@pytest.mark.parametrize('block', [1 << 7, 1 << 10, 1 << 12])
@pytest.mark.parametrize(
    'document',
    [
        case_study(1, 2),
        case_study(feasibility='paper'),
        case_study(2, 3, grid={'rows': 1, 'cols': 8, 'base': 6, 'service': 3}),
    ],
    ids=['two goals', 'seed rules', 'base and service on goals'],
)
def test_blocks_and_threads_change_no_bit(monkeypatch, document, block, dtype):
    sub = whole(document)
    reference, changes = backups(sub, 4, dtype)
    assert len(reference.row_blocks) == 1
    monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', block)
    monkeypatch.setattr(sweep, 'MIN_THREADED_ENTRIES', 0)
    blocked, blocked_changes = backups(sub, 4, dtype, threads=3)
    assert len(blocked.row_blocks) > 1
    assert blocked_changes == changes
    assert np.array_equal(blocked.values, reference.values)
    assert np.array_equal(blocked.greedy(), reference.greedy())


@settings(max_examples=25)
@given(missions([(1, 2), (2, 2)], [1]))
def test_greedy_actions_and_one_state_backups_of_any_mission(document):
    sub = whole(document)
    space = StateSpace(sub.mission.k, sub.mission.grid.q)
    solution = value_iteration(sub, 1e-3, with_actions=True)
    model, states = AxisModel(sub), space.states()
    q = LookAhead(model, solution.value).q_values(states)
    best = q.min(axis=1)
    chosen = solution.actions[model.locate(states)].astype(int)
    slack = 1e-9 * np.abs(best).max() + 1e-9
    assert (q[np.arange(len(q)), chosen - 1] <= best + slack).all()
    sums = LookAhead(model, solution.value)
    sums.table = None
    some = pick_states(space, 60)
    np.testing.assert_allclose(sums.q_values(some), q[space.index(some)], rtol=1e-10, atol=1e-10)
    sums.expected = expected_tables(model, solution.value)
    np.testing.assert_allclose(sums.q_values(some), q[space.index(some)], rtol=1e-10, atol=1e-10)


@settings(max_examples=5)
@given(missions([(1, 2)], [2]))
def test_small_missions_of_two_goals(document):
    reference = solve(BruteForce(document))
    solution = value_iteration(whole(document), 1e-6, precision='mixed')
    value = AxisModel(solution.sub).state_values(solution.value, reference.states)
    slack = 1e-9 * max(1.0, np.abs(reference.v).max())
    assert np.abs(value - reference.v).max() <= solution.upper + slack


@pytest.mark.parametrize('goals', [(1,), (1, 2), (1, 2, 3)])
def test_greedy_actions_are_those_of_least_q(goals):
    sub = whole(case_study(*goals))
    solution = value_iteration(sub, with_actions=True)
    model = AxisModel(sub)
    states = pick_states(StateSpace(sub.n, sub.mission.grid.q), 4000)
    q = LookAhead(model, solution.value).q_values(states)
    assert np.array_equal(solution.actions[model.locate(states)], choose(q))


@pytest.mark.parametrize('numbers', [(1, 4, 9, 10), tuple(range(1, 11))])
@pytest.mark.parametrize('goals', [(), (1,), (0, 2)])
def test_one_state_backups_of_any_sub_mdp(goals, numbers):
    sub = SubMdp(whole(case_study()).mission, goals, numbers, share=0.5)
    solution = value_iteration(sub, 1e-4)
    tables = LookAhead(AxisModel(sub), solution.value)
    sums = LookAhead(AxisModel(sub), solution.value)
    sums.table = None
    states = pick_states(StateSpace(3, 8), 300)
    np.testing.assert_allclose(sums.q_values(states), tables.q_values(states), rtol=1e-12)
    sums.expected = expected_tables(AxisModel(sub), solution.value)
    np.testing.assert_allclose(sums.q_values(states), tables.q_values(states), rtol=1e-12)


def expected_tables(model, values):
    sweeper = Sweeper(model, values)
    sweeper.expect()
    return sweeper.expected


def test_precisions_agree_within_their_bounds():
    sub = whole(case_study())
    double, mixed, single = (
        value_iteration(sub, 1e-8, precision=precision)
        for precision in ('double', 'mixed', 'single')
    )
    assert double.converged
    assert mixed.converged
    assert np.abs(mixed.value - double.value).max() <= mixed.upper + double.upper
    assert (single.value.dtype, single.converged) == (np.float32, False)
    error = double.value - single.value
    assert single.lower - double.upper <= error.min()
    assert error.max() <= single.upper - double.lower
    # The bound counts every rounding at its worst; the error is far below it.
    assert np.abs(error).max() < single.upper / 20 < 0.01


def test_single_precision_meets_a_tolerance_it_can_meet():
    solution = value_iteration(whole(case_study(1)), 0.01, precision='single')
    assert solution.converged
    assert solution.residual * 19 <= 0.01 < solution.upper


def test_an_unreachable_tolerance_ends_where_rounding_does():
    solution = value_iteration(whole(case_study(1)), 1e-300)
    assert not solution.converged
    assert solution.upper < 1e-8
    assert solution.iterations < 100


@pytest.mark.parametrize('precision', ['mixed', 'double'])
def test_a_solve_resumed_anywhere_ends_in_the_same_bits(precision):
    sub = whole(case_study(1, 2, 3))
    kept = {}
    straight = value_iteration(
        sub,
        precision=precision,
        on_values=lambda sweeps, values: kept.update({sweeps: values().copy()}),
    )
    assert sorted(kept) == list(range(1, straight.iterations + 1))
    for sweeps in (1, 20, straight.iterations - 2):
        resumed = value_iteration(sub, precision=precision, start=(sweeps, kept[sweeps]))
        assert resumed.iterations == straight.iterations
        assert np.array_equal(resumed.value, straight.value)


def test_sweeps_end_at_the_most_allowed():
    sub = whole(case_study())
    for precision in ('mixed', 'double', 'single'):
        for most in (1, 5, 50):
            solution = value_iteration(sub, 1e-12, most, precision=precision)
            assert solution.iterations == min(most, solution.iterations)
            assert not solution.converged


def many_goals(count):
    document = case_study()
    document['goals'] = [
        {**copy.deepcopy(document['goals'][0]), 'name': f'g{j}', 'cell': j % 8}
        for j in range(count)
    ]
    return document


def test_a_mission_too_large_is_refused_before_anything_is_allocated(monkeypatch):
    def forbidden(*_):
        raise AssertionError

    monkeypatch.setattr(AxisModel, '__init__', forbidden)
    with pytest.raises(MissionSizeError) as error:
        value_iteration(whole(many_goals(14)))
    text = str(error.value)
    assert len(text.splitlines()) == 1
    assert f'{8 * 6**14 * 8 * 15 * 6:,} states' in text
    assert 'GiB' in text
    assert text.endswith("use method 'expansion'")


def test_single_precision_is_named_where_it_would_fit(monkeypatch):
    sub = whole(many_goals(6))
    needed = memory.needed_bytes(sub, np.float64, 2)
    assert 1 << 27 < needed < 1 << 29
    monkeypatch.setattr(memory.memory, 'available_bytes', lambda: needed - 1)
    with pytest.raises(MissionSizeError, match=r"use precision 'single' \(\d+ MiB\) or method"):
        value_iteration(sub, threads=2)


def test_memory_is_counted():
    assert 1 << 20 < memory.memory.available_bytes() < 1 << 50
    sub = whole(case_study())
    model = AxisModel(sub)
    sweeper = Sweeper(model, model.zero())
    tables = [model.base_cost, sweeper.values, sweeper.expected.open, *sweeper.expected.completed]
    counted = memory.needed_bytes(sub, np.float64, 0)
    assert sum(table.nbytes for table in tables) <= counted
    assert counted < 1.3 * sum(table.nbytes for table in tables)


def test_hardly_more_memory_is_taken_than_is_counted(monkeypatch):
    """Also for the bound on rounding: b, with a charge, is a third as large as W."""
    # In large blocks scratch, which is counted amply, would hide it.
    monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', 1 << 14)
    sub = whole(with_charge(many_goals(6)))
    tracemalloc.start()
    try:
        value_iteration(sub, precision='double', threads=1, max_iterations=1)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= 1.1 * memory.needed_bytes(sub, np.float64, 1)


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'precision': 'half'}, "'half' is none of mixed, double, single"),
        ({'threads': 0}, 'threads 0 must be above 0'),
    ],
)
def test_senseless_settings(settings, message):
    with pytest.raises(ValueError, match=message):
        value_iteration(whole(case_study(1)), **settings)


def test_tables_are_kept_for_small_missions_only():
    assert [LookAhead.tabulates(whole(many_goals(k))) for k in range(1, 7)] == [True] * 4 + [
        False
    ] * 2
    assert look_ahead.MAX_TABLED_ENTRIES * 8 * 8 < 1 << 26
