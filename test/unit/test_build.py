"""Method auto says which method it takes and why; the plan of Algorithm 1 carries every build."""

from __future__ import annotations

from unittest.mock import Mock

import pytest
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy import build, prediction
from uav_mission_manager.solver import memory
from uav_mission_manager.solver.progress import Report


@pytest.fixture
def mission():
    return mission_from_dict(case_study(), 'test')


def test_a_mission_that_fits_is_solved_exactly(mission):
    policy = build_policy(mission)
    assert policy.method == 'exact'
    assert policy.reason == 'exact: it fits in memory and takes less than two minutes'
    assert build_policy(mission, 'exact').reason == ''


def test_auto_keeps_to_t_max(mission):
    policy = build_policy(mission, max_states=41_472, order=2, certificate=False)
    assert policy.method == 'expansion'
    assert policy.reason == ('expansion: the 331,776 states are more than T_max = 41,472')
    assert max(policy.info['sub_mdp_states']) <= 41_472


def test_auto_keeps_to_the_memory(mission, monkeypatch):
    monkeypatch.setattr(memory, 'SMALL_BYTES', 0)
    monkeypatch.setattr(memory, 'available_bytes', lambda: 12 << 20)
    policy = build_policy(mission, order=1, certificate=False)
    assert policy.method == 'expansion'
    assert policy.reason.startswith('expansion: the exact solution needs ')
    assert policy.reason.endswith(' of memory, 12 MiB are free')


def test_what_fits_neither_way_says_so_of_both(mission, monkeypatch):
    monkeypatch.setattr(memory, 'SMALL_BYTES', 0)
    monkeypatch.setattr(memory, 'available_bytes', lambda: 1 << 10)
    with pytest.raises(memory.MissionSizeError) as error:
        build_policy(mission)
    text = str(error.value)
    assert len(text.splitlines()) == 1
    assert 'use a lower order' in text
    assert '; not solved exactly because the exact solution needs ' in text


def test_auto_does_not_begin_what_cannot_end_in_time(mission, monkeypatch):
    monkeypatch.setattr(prediction, 'MAX_EXACT_SECONDS', 1e-9)
    policy = build_policy(mission, order=1, certificate=False)
    assert policy.reason.startswith('expansion: the exact solution would take more than ')


def test_auto_learns_from_the_first_sweeps(mission, monkeypatch):
    monkeypatch.setattr(prediction, 'MIN_ENTRY_SECONDS', 0.0)
    monkeypatch.setattr(prediction, 'MAX_EXACT_SECONDS', 1e-6)
    monkeypatch.setattr(build, 'CALIBRATION_SECONDS', 0.0)
    policy = build_policy(mission, order=1, certificate=False)
    assert policy.method == 'expansion'
    assert policy.reason.startswith('expansion: the exact solution would take about ')
    assert policy.reason.endswith('by its first 1 sweeps')


def test_plans(mission):
    parts = {
        method: [(part.kind, part.goals, part.states) for part in plan.parts]
        for method, plan in (
            (method, build_policy(mission, method, order=2, certificate=False).plan)
            for method in ('exact', 'split', 'highest_priority', 'expansion')
        )
    }
    assert parts['exact'] == [('location', (0, 1, 2), 331_776)]
    single = [('goal', (j,), 4_608) for j in range(3)]
    assert sorted(parts['split']) == sorted(parts['highest_priority']) == single
    clusters = {goals for _, goals, _ in parts['expansion']}
    assert clusters >= {(0, 1), (0, 2), (1, 2)}
    assert all(states <= 41_472 for _, _, states in parts['expansion'])


def test_the_exact_solution_block_by_block_is_the_same(mission):
    whole = build_policy(mission, 'exact')
    blocks = build_policy(mission, 'exact', max_states=50_000)
    assert len(blocks.plan.parts) > 1
    assert max(part.states for part in blocks.plan.parts) <= 50_000
    states = whole.space.states()
    assert abs(blocks.part_values(states) - whole.part_values(states)).max() <= 3e-7


def test_the_default_makes_the_same_bytes_twice(tmp_path):
    document = case_study()
    document['goals'].append(document['goals'][0] | {'name': 'goal4', 'cell': 7})
    for name in 'ab':
        build_policy(mission_from_dict(document, 'test')).save(tmp_path / name)
    files = [sorted((tmp_path / name).iterdir()) for name in 'ab']
    assert [file.name for file in files[0]] == [file.name for file in files[1]]
    assert [file.read_bytes() for file in files[0]] == [file.read_bytes() for file in files[1]]


def test_the_time_before_the_first_sweep_ends_does_not_count(monkeypatch):
    times = iter([1000.0, 1000.0, 1010.0, 1600.0])
    monkeypatch.setattr(build, 'time', Mock(monotonic=lambda: next(times)))
    clock = build._Clock(Mock(checkpoint=None))
    clock(Report(1, 0.01, 'a sweep, compiled first'))
    clock(Report(2, 0.50, 'soon'))
    with pytest.raises(build._TooSlowError, match='by its first 3 sweeps'):
        clock(Report(3, 0.51, 'slow after all'))
