"""Policy sets of large missions: actions on disk; checkpoints; Ctrl-C."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys

import numpy as np
import pytest
from strategies import CASE_STUDY, case_study, pick_states

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.cli import policy_build
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy import Checkpoint, PolicyError
from uav_mission_manager.solver.exact import look_ahead


@pytest.fixture
def large(monkeypatch):
    """Treats every mission as one too large for tables."""
    monkeypatch.setattr(look_ahead, 'MAX_TABLED_ENTRIES', 0)


@pytest.fixture
def mission():
    return mission_from_dict(case_study(1, 2), 'test')


def test_actions_come_from_disk_without_tables(tmp_path, monkeypatch, mission):
    reference = build_policy(mission, 'exact')
    states = pick_states(reference.space, 2000)
    assert reference.solution.actions is None
    monkeypatch.setattr(look_ahead, 'MAX_TABLED_ENTRIES', 0)
    build_policy(mission, 'exact').save(tmp_path / 'p')
    policy = load_policy(tmp_path / 'p')
    solution = policy.solution
    assert solution.actions.dtype == np.uint8
    # One byte a state of the reduced space: cells, t, f, r, g.
    assert solution.actions.size == 8 * 3 * 8 * 4 * 9
    assert np.array_equal(policy.act(states), reference.act(states))
    for state in states[:50]:
        decision, expected = policy.decide(state), reference.decide(state)
        assert decision.action == expected.action
        assert decision.values == pytest.approx(expected.values, rel=1e-12)
        assert decision.lower_bound == pytest.approx(expected.lower_bound, rel=1e-12)
        assert decision.margin >= 0


@pytest.mark.usefixtures('large')
def test_a_large_set_has_the_same_bytes_each_time(tmp_path, mission):
    for name in 'ab':
        build_policy(mission, 'exact', jobs=2).save(tmp_path / name)
    files = sorted(path.name for path in (tmp_path / 'a').iterdir())
    assert files == ['0_actions.npy', '0_value.npy', 'manifest.json']
    for name in files:
        assert (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes()
    file = tmp_path / 'a' / '0_actions.npy'
    file.write_bytes(file.read_bytes()[:-1] + b'\1')
    with pytest.raises(PolicyError, match=r'0_actions\.npy: sha256'):
        load_policy(tmp_path / 'a')


def test_single_precision_halves_the_file(tmp_path, mission):
    sizes = {}
    for precision in ('single', 'double'):
        policy = build_policy(mission, 'exact', tolerance=1e-2, precision=precision)
        policy.save(tmp_path / precision)
        sizes[precision] = (tmp_path / precision / '0_value.npy').stat().st_size - 128
        assert load_policy(tmp_path / precision).solution.value.dtype.itemsize == (
            4 if precision == 'single' else 8
        )
    assert 2 * sizes['single'] == sizes['double']


class StoppedError(Exception):
    """Stands for a power cut."""


def build(mission, place, checkpoint, stop_after=None):
    def progress(report):
        if report.step == stop_after:
            raise StoppedError

    policy = build_policy(mission, 'exact', progress=progress, checkpoint=checkpoint)
    policy.save(place)
    checkpoint.remove()
    return policy


def test_resumed_from_a_checkpoint_to_the_same_bytes(tmp_path, mission):
    straight = build_policy(mission, 'exact')
    straight.save(tmp_path / 'straight')
    place = tmp_path / 'sets' / 'p'
    with pytest.raises(StoppedError):
        build(mission, place, Checkpoint(place, mission, 'exact', 'mixed', interval=0), 30)
    (left,) = (tmp_path / 'sets').iterdir()
    assert left.name == '.p.checkpoint.npz'
    checkpoint = Checkpoint(place, mission, 'exact', 'mixed', interval=0)
    assert checkpoint.load()[0] == 29
    sweeps = []
    policy = build_policy(
        mission, 'exact', checkpoint=checkpoint, progress=lambda report: sweeps.append(report.step)
    )
    policy.save(place)
    checkpoint.remove()
    assert sweeps[0] == 30
    assert policy.digest == straight.digest
    assert [path.name for path in place.parent.iterdir()] == ['p']


def test_a_checkpoint_of_something_else_or_broken_is_refused(tmp_path, mission):
    place = tmp_path / 'p'
    with pytest.raises(StoppedError):
        build(mission, place, Checkpoint(place, mission, 'exact', 'mixed', interval=0), 5)
    other = mission_from_dict(case_study(1), 'test')
    for key in [
        (other, 'exact', 'mixed'),
        (mission, 'split', 'mixed'),
        (mission, 'exact', 'single'),
    ]:
        with pytest.raises(PolicyError, match='is of another mission, method or precision'):
            Checkpoint(place, *key).load()
    checkpoint = Checkpoint(place, mission, 'exact', 'mixed')
    for bad in (checkpoint.file.read_bytes()[:-30], b'', b'PK'):
        checkpoint.file.write_bytes(bad)
        with pytest.raises(PolicyError, match='cannot be read'):
            checkpoint.load()


def test_short_solves_write_no_checkpoint(tmp_path, mission):
    place = tmp_path / 'p'
    checkpoint = Checkpoint(place, mission, 'exact', 'mixed')
    with pytest.raises(StoppedError):
        build(mission, place, checkpoint, 20)
    assert list(tmp_path.iterdir()) == []


def test_command_takes_precision_jobs_and_resume(tmp_path, capsys):
    out = tmp_path / 'p'
    arguments = [str(CASE_STUDY), '--out', str(out), '--json', '--tolerance', '0.1']
    policy_build.main([*arguments, '--precision', 'single', '--jobs', '1', '--resume'])
    summary = json.loads(capsys.readouterr().out)
    assert summary['converged']
    assert load_policy(out).solution.value.dtype == np.float32
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize('resume', [False, True])
def test_ctrl_c_leaves_nothing_behind(tmp_path, monkeypatch, resume):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(np, 'save', interrupted)
    out = tmp_path / 'sets' / 'p'
    with pytest.raises(SystemExit) as error:
        policy_build.main([str(CASE_STUDY), '--out', str(out)] + ['--resume'] * resume)
    assert error.value.code == 130
    assert list((tmp_path / 'sets').iterdir()) == []


def test_progress_says_sweeps_bound_and_time_left(tmp_path):
    master, slave = pty.openpty()
    command = [sys.executable, '-m', 'uav_mission_manager.cli.policy_build', str(CASE_STUDY)]
    done = subprocess.run(
        [*command, '--out', str(tmp_path / 'p'), '--precision', 'double'],
        stderr=slave,
        stdout=subprocess.PIPE,
        check=True,
        env={**os.environ, 'TERM': 'xterm', 'COLUMNS': '120'},
    )
    os.close(slave)
    shown = b''
    while True:
        try:
            part = os.read(master, 1 << 16)
        except OSError:  # The terminal is closed and read to its end.
            break
        if not part:
            break
        shown += part
    os.close(master)
    text = shown.decode()
    assert 'exact solution: sweep ' in text
    assert 'of V*' in text
    assert '0:00:00' in text
    assert b'sweeps' in done.stdout
