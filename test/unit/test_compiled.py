"""The compiled sweep computes the same bits as the elementwise steps, where it is of use."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from strategies import case_study, lively, with_charge
from test_extending import extended

from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.exact import AxisModel, Sweeper, memory, sweep, value_iteration
from uav_mission_manager.solver.submdp import SubMdp, whole_mission


def whole(document):
    return whole_mission(mission_from_dict(document, 'test'))


def sweeper_of(sub, dtype=np.float64, threads=1):
    model = AxisModel(sub, dtype)
    return Sweeper(model, model.zero(), threads)


@pytest.fixture
def compiled(monkeypatch):
    """Compile whatever the size; a sweep in blocks, by threads."""
    pytest.importorskip('numba', reason="needs numba: pip install '.[fast]'")
    monkeypatch.setattr(sweep, 'MIN_COMPILED_ENTRIES', 0)
    monkeypatch.setattr(sweep, 'MIN_THREADED_ENTRIES', 0)


def assert_same_bits(sub, dtype, monkeypatch):
    fast = sweeper_of(sub, dtype, 2)
    assert fast.compiled is not None
    monkeypatch.setattr(sweep, 'MIN_COMPILED_ENTRIES', sub.entries + 1)
    slow = sweeper_of(sub, dtype)
    assert slow.compiled is None
    for further in (0.0, 0.0, 3.7, 0.0):
        assert fast.backup(further) == slow.backup(further)
        np.testing.assert_array_equal(fast.values, slow.values)
    np.testing.assert_array_equal(fast.greedy(), slow.greedy())


@pytest.mark.parametrize('dtype', [np.float32, np.float64])
@pytest.mark.parametrize('block', [1 << 6, 1 << 9, 1 << 11, 1 << 17])
@pytest.mark.parametrize(
    'document',
    [
        case_study(1),
        case_study(),
        lively(feasibility='paper'),
        with_charge(case_study()),
        with_charge(case_study(1, 2), levels=5, rate=2, noise=1.0),
        with_charge(lively(), drain={'normal': [0.2, 0.8], 'agile': [0.1, 0.3, 0.2, 0.4]}),
        with_charge(lively(), drain={'normal': [1.0], 'agile': [1.0]}),
    ],
    ids=['goal', 'flags', 'seed rules', 'charge', 'slowly charged', 'drained apart', 'never'],
)
def test_every_bit_is_the_same(compiled, monkeypatch, document, block, dtype):
    monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', block)
    assert_same_bits(whole(document), dtype, monkeypatch)


@pytest.mark.parametrize('goals', [(), (1,), (0, 2)])
def test_every_bit_of_a_sub_mdp_is_the_same(compiled, monkeypatch, goals):
    mission = mission_from_dict(with_charge(case_study()), 'test')
    sub = SubMdp(mission, goals, tuple(range(1, 11)), share=0.5)
    monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', 1 << 9)
    assert_same_bits(sub, np.float64, monkeypatch)


def test_a_solution_is_the_same(compiled, monkeypatch):
    sub = whole(with_charge(case_study(1, 2)))
    fast = value_iteration(sub, with_actions=True)
    monkeypatch.setattr(sweep, 'MIN_COMPILED_ENTRIES', sub.entries + 1)
    slow = value_iteration(sub, with_actions=True)
    assert (fast.iterations, fast.lower, fast.upper) == (slow.iterations, slow.lower, slow.upper)
    np.testing.assert_array_equal(fast.value, slow.value)
    np.testing.assert_array_equal(fast.actions, slow.actions)


def test_four_threat_levels_are_swept_as_ever(compiled):
    assert sweeper_of(whole_mission(extended(lively()))).compiled is None


def test_without_numba_nothing_is_compiled(monkeypatch):
    monkeypatch.setattr(sweep, 'MIN_COMPILED_ENTRIES', 0)
    monkeypatch.setitem(sys.modules, 'numba', None)
    for name in ('compiled', 'kernels'):
        monkeypatch.delitem(sys.modules, f'uav_mission_manager.solver.exact.{name}', raising=False)
    assert sweeper_of(whole(case_study(1))).compiled is None


def test_the_compiler_counts_in_what_memory_is_needed(compiled, monkeypatch):
    sub = whole(with_charge(case_study()))
    with_numba = memory.needed_bytes(sub, np.float64, 2)
    monkeypatch.setitem(sys.modules, 'numba', None)
    assert with_numba - memory.needed_bytes(sub, np.float64, 2) == memory.COMPILER_BYTES


USE = """
import numpy as np
from uav_mission_manager.solver.exact.kernels import mix_axes
table, matrices = np.ones((1, 3, 2)), np.full((1, 3, 3), 2.0)
mix_axes(table, table, matrices)
print(float(table.sum()), sum(mix_axes.stats.cache_hits.values()))
"""


def use(**environment):
    command = [sys.executable, '-c', USE]
    environment = {**os.environ, 'PYTHONDONTWRITEBYTECODE': '', **environment}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True)


def test_what_is_compiled_is_kept_for_the_next_process(compiled, tmp_path):
    assert use(NUMBA_CACHE_DIR=str(tmp_path)).stdout.split() == ['36.0', '0']
    assert use(NUMBA_CACHE_DIR=str(tmp_path)).stdout.split() == ['36.0', '1']


def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(compiled, tmp_path):
    (tmp_path / 'file').touch()
    only_there = {'NUMBA_CACHE_LOCATOR_CLASSES': 'UserProvidedCacheLocator'}
    done = use(NUMBA_CACHE_DIR=str(tmp_path / 'file' / 'folder'), **only_there)
    assert done.stdout.split() == ['36.0', '0']


def test_small_missions_do_not_wait_for_a_compiler():
    assert sweeper_of(whole(with_charge(case_study()))).compiled is None
