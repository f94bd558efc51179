"""The exact solution on a card: the bits of NumPy, one line where that cannot be.

It runs with a strict stand-in for CuPy, and once more with CuPy itself where there is a card.
"""

from __future__ import annotations

import gc
import re
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import strict_cupy
from strategies import CASE_STUDY, case_study, lively, with_charge
from test_extending import extended

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.cli import policy_build
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy import Checkpoint
from uav_mission_manager.solver.exact import (
    AxisModel,
    Sweeper,
    find_device,
    look_ahead,
    memory,
    sweep,
    value_iteration,
)
from uav_mission_manager.solver.memory import MissionSizeError
from uav_mission_manager.solver.submdp import SubMdp, whole_mission


@pytest.fixture
def stand_in(monkeypatch):
    """CuPy's name leads to the stand-in."""
    if shutil.which('c++') is None:
        pytest.skip('no C++ compiler')
    monkeypatch.setitem(sys.modules, 'cupy', strict_cupy)
    return strict_cupy


@pytest.fixture(params=['stand-in', 'card'])
def gpu(request):
    """Devices: the stand-in, and a card where there is one."""
    if request.param == 'stand-in':
        request.getfixturevalue('stand_in')
    try:
        return find_device('gpu')
    except ValueError as error:
        pytest.skip(str(error))


def whole(document):
    return whole_mission(mission_from_dict(document, 'test'))


def many_goals(count, **charge):
    document = with_charge(case_study(), **charge)
    goals = document['goals']
    document['goals'] = [goals[j % 3] | {'name': f'g{j}', 'cell': j % 8} for j in range(count)]
    return document


def assert_same_bits(sub, dtype, gpu):
    models = AxisModel(sub, dtype), AxisModel(sub, dtype, gpu)
    here, there = (Sweeper(model, model.zero()) for model in models)
    for further in (0.0, 0.0, 3.7, 0.0):
        assert there.backup(further) == here.backup(further)
        np.testing.assert_array_equal(gpu.take_back(there.values), here.values)
    np.testing.assert_array_equal(there.greedy(), here.greedy())


@pytest.mark.parametrize('dtype', [np.float32, np.float64])
@pytest.mark.parametrize('block', [1 << 8, 1 << 11, 1 << 25])
@pytest.mark.parametrize(
    'document',
    [
        case_study(1),
        case_study(),
        lively(feasibility='paper'),
        with_charge(case_study(1, 2), levels=5, rate=2, noise=1.0),
        with_charge(lively(), drain={'normal': [0.2, 0.8], 'agile': [0.1, 0.3, 0.2, 0.4]}),
    ],
    ids=['goal', 'flags', 'seed rules', 'slowly charged', 'drained apart'],
)
def test_every_bit_is_the_same(gpu, monkeypatch, document, block, dtype):
    monkeypatch.setattr(sweep, 'MAX_GPU_BLOCK_ENTRIES', block)
    assert_same_bits(whole(document), dtype, gpu)


@pytest.mark.parametrize('goals', [(), (0, 2)])
def test_every_bit_of_a_sub_mdp_is_the_same(gpu, goals):
    mission = mission_from_dict(with_charge(case_study()), 'test')
    assert_same_bits(SubMdp(mission, goals, tuple(range(1, 11)), share=0.5), np.float64, gpu)


def test_every_bit_of_four_threat_levels_is_the_same(gpu):
    assert_same_bits(whole_mission(extended(lively())), np.float64, gpu)


def test_a_mission_too_large_for_one_piece_here_is_the_same_in_one_there(gpu):
    sub = whole(many_goals(5))
    assert sweep.MAX_BLOCK_ENTRIES < sub.entries < sweep.MAX_GPU_BLOCK_ENTRIES
    assert_same_bits(sub, np.float64, gpu)


@pytest.mark.parametrize('precision', ['mixed', 'double', 'single'])
def test_a_solution_is_the_same_and_here(gpu, precision):
    sub, found = whole(case_study(1, 2)), []
    for device in ('cpu', 'gpu'):
        kept = {}
        solution = value_iteration(
            sub,
            1e-3,
            precision=precision,
            on_values=lambda sweeps, values, kept=kept: kept.update({sweeps: values().copy()}),
            with_actions=True,
            device=device,
        )
        found.append((solution, kept))
    (here, kept_here), (there, kept_there) = found
    assert (there.lower, there.upper, there.residual) == (here.lower, here.upper, here.residual)
    assert there.iterations == here.iterations == len(kept_there) == len(kept_here)
    assert type(there.value) is type(there.actions) is np.ndarray
    np.testing.assert_array_equal(there.value, here.value)
    np.testing.assert_array_equal(there.actions, here.actions)
    for sweeps in (1, 20, here.iterations):
        np.testing.assert_array_equal(kept_there[sweeps], kept_here[sweeps])


def test_begun_here_and_ended_there_is_the_same_file(gpu, monkeypatch, tmp_path):
    monkeypatch.setattr(look_ahead, 'MAX_TABLED_ENTRIES', 0)
    mission = mission_from_dict(case_study(1, 2), 'test')
    build_policy(mission, 'exact').save(tmp_path / 'here')

    def stop(report):
        if report.step == 40:
            raise InterruptedError

    place = tmp_path / 'there'
    checkpoint = Checkpoint(place, mission, 'exact', 'mixed', interval=0)
    with pytest.raises(InterruptedError):
        build_policy(mission, 'exact', progress=stop, checkpoint=checkpoint)
    checkpoint = Checkpoint(place, mission, 'exact', 'mixed')
    assert checkpoint.load()[0] == 39
    build_policy(mission, 'exact', checkpoint=checkpoint, device='gpu').save(place)
    for file in (tmp_path / 'here').iterdir():
        assert (place / file.name).read_bytes() == file.read_bytes()


def build(tmp_path, *arguments):
    return policy_build.main([str(CASE_STUDY), '--out', str(tmp_path / 'p'), *arguments])


def test_the_command_makes_the_shipped_policy_set(stand_in, tmp_path):
    stand_in.memory.most = 0
    assert build(tmp_path, '--device', 'gpu') == 0
    assert stand_in.memory.most > 0
    shipped = CASE_STUDY.parents[1] / 'policies' / 'case_study'
    assert load_policy(tmp_path / 'p').digest == load_policy(shipped).digest


@pytest.mark.parametrize('block', [1 << 13, 1 << 16, 1 << 25])
@pytest.mark.parametrize('document', [case_study(), many_goals(4)], ids=['flags', 'charge'])
def test_a_card_holds_no_more_than_was_counted_and_nothing_afterwards(
    stand_in, monkeypatch, document, block
):
    monkeypatch.setattr(sweep, 'MAX_GPU_BLOCK_ENTRIES', block)
    monkeypatch.setattr(sweep, 'MAX_BLOCK_ENTRIES', 0)  # As if none were small.
    sub, device = whole(document), find_device('gpu')
    gc.collect()
    gc.disable()  # What is freed late would be missing meanwhile.
    try:
        before = stand_in.memory.most = stand_in.memory.used
        value_iteration(sub, 1e-3, with_actions=True, device='gpu')
        assert stand_in.memory.used == before
    finally:
        gc.enable()
    held = stand_in.memory.most - before
    assert held <= memory.needed_bytes(sub, np.float64, 1, device) < 1.5 * held


MEMORY = re.compile(r'\| (\d+), (.*) \| ([\d,]+) \| ([\d.]+) GiB \| ([\d.]+) GiB \|')


def test_the_page_says_what_is_counted(stand_in):
    page = (CASE_STUDY.parents[1] / 'docs' / 'model.md').read_text()
    rows = MEMORY.findall(page.partition('## On a card')[2].partition('\n## ')[0])
    assert len(rows) == 8
    for goals, what, *figures in rows:
        document = many_goals(int(goals), levels=16)
        if what == 'range flags':
            document['range'] = case_study()['range']
        sub = whole(document)
        needed = memory.needed_bytes(sub, np.float64, 1, find_device('gpu'))
        sizes = [f'{size / 2**30:.1f}' for size in (needed, memory.kept_bytes(sub, np.float64))]
        assert figures == [f'{sub.entries:,}', *sizes]


def test_a_mission_too_large_for_the_card_is_refused(stand_in, monkeypatch):
    sub = whole(many_goals(4))
    needed = memory.needed_bytes(sub, np.float64, 1, find_device('gpu'))
    monkeypatch.setattr(memory.memory, 'SMALL_BYTES', 0)
    monkeypatch.setattr(stand_in.memory, 'total', stand_in.memory.used + needed - 1)
    with pytest.raises(MissionSizeError) as error:
        value_iteration(sub, device='gpu')
    text = str(error.value)
    assert len(text.splitlines()) == 1
    assert ' of memory of the card, ' in text
    assert "use precision 'single' (" in text
    policy = build_policy(sub.mission, order=1, certificate=False, device='gpu')
    assert policy.reason.startswith('expansion: the exact solution needs ')
    assert ' of memory of the card, ' in policy.reason


def test_the_solution_has_to_fit_here_too(stand_in, monkeypatch):
    sub = whole(many_goals(4))
    kept = memory.kept_bytes(sub, np.float64)
    monkeypatch.setattr(memory.memory, 'SMALL_BYTES', 0)
    for free in (kept, kept - 1):
        monkeypatch.setattr(memory.memory, 'available_bytes', lambda free=free: free)
        lacking = memory.shortage(sub, np.float64, 1, find_device('gpu'))
        assert lacking.endswith(' MiB are free') == (free < kept)
        assert 'card' not in lacking


def test_auto_lets_a_card_show_how_long_it_takes(stand_in, monkeypatch):
    mission = mission_from_dict(case_study(1, 2), 'test')
    monkeypatch.setattr('uav_mission_manager.policy.prediction.MAX_EXACT_SECONDS', 1e-9)
    assert build_policy(mission, order=1, certificate=False).method == 'expansion'
    assert build_policy(mission, device='gpu').method == 'exact'


def framed(*_):
    raise RuntimeError('\n=====\nFailed: no driver.\n\nSee the manual.\n')


@pytest.mark.parametrize(
    ('module', 'says'),
    [
        (None, "device 'gpu' needs the Python package cupy: pip install '.[gpu]' ("),
        (SimpleNamespace(zeros=framed), "device 'gpu' cannot be used: Failed: no driver."),
    ],
    ids=['no CuPy', 'no card'],
)
def test_without_a_card_that_is_said_in_one_line(monkeypatch, tmp_path, module, says):
    monkeypatch.setitem(sys.modules, 'cupy', module)
    with pytest.raises(SystemExit) as end:
        build(tmp_path, '--device', 'gpu')
    assert len(end.value.code.splitlines()) == 1
    assert end.value.code.startswith(f'policy_build: {says}')
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('how', 'says'),
    [
        ({'device': 'tpu'}, "device 'tpu' is none of cpu, gpu"),
        ({'method': 'split', 'device': 'gpu'}, "device 'gpu' is of no use to method 'split'"),
        ({'max_states': 9, 'device': 'gpu'}, "device 'gpu' solves in one piece: leave max_states"),
    ],
)
def test_senseless_settings(stand_in, how, says):
    with pytest.raises(ValueError, match=says):
        build_policy(mission_from_dict(case_study(1), 'test'), **how)


@pytest.mark.parametrize(
    'refused',
    [
        lambda table: np.asarray(table),
        lambda table: np.add(table, np.ones(4)),
        lambda table: np.add(np.ones(4), table, table),
        lambda table: np.add(table, table, np.ones(4)),
        lambda table: np.add(table, 1.0, out=table, where=np.ones(4, bool)),
        lambda table: table.take(np.zeros(1, int), 0, np.ones(1), 'clip'),
        lambda table: np.copyto(np.ones(4), table),
        lambda table: np.copyto(table, np.ones(4)),
        lambda table: np.sort(table).nothing,
    ],
)
def test_what_mixes_arrays_of_card_and_machine_is_refused(gpu, refused):
    table = gpu.put(np.arange(4.0))
    with pytest.raises((TypeError, ValueError, AttributeError)):
        refused(table)


@pytest.mark.parametrize(
    'copies',
    [
        lambda table: np.add(table[1:], 1.0, table[:-1]),
        lambda table: np.copyto(table[:2], table[1:3]),
        lambda table: table.reshape(2, 2).transpose().reshape(4),
    ],
)
def test_the_stand_in_refuses_what_would_be_copied(stand_in, copies):
    table = stand_in.array(np.arange(4.0))
    with pytest.raises(AssertionError, match='copies'):
        copies(table)
