"""Sub-problems solved in processes and on a Dask cluster that loses a worker."""

from __future__ import annotations

import os
import signal
import sys

import numpy as np
import pytest
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy.workers import THREADS, workers


def many_goals(k):
    document = case_study()
    document['goals'] = [
        document['goals'][j % 3] | {'name': f'goal{j}', 'eta': 1.0 + j} for j in range(k)]
    return mission_from_dict(document, 'test')


def assert_same(policy, other, rtol=0.0):
    states = policy.space.draw(500, np.random.default_rng(0))
    np.testing.assert_allclose(policy.q_values(states), other.q_values(states), rtol=rtol)


@pytest.mark.parametrize(('method', 'rtol'), [('split', 0.0), ('expansion', 1e-4)])
def test_processes_find_the_same(method, rtol):
    """Linear algebra in other numbers of threads may round differently."""
    mission = mission_from_dict(case_study(), 'test')
    alone = build_policy(mission, method, order=2)
    done = []
    environment = dict(os.environ)
    together = build_policy(
        mission, method, order=2, jobs=2, on_sweep=lambda position, *_: done.append(position))
    assert_same(alone, together, rtol)
    assert done == list(range(3 if method == 'split' else 2))
    assert dict(os.environ) == environment


def test_processes_share_the_processors():
    with workers(jobs=64) as pool:
        assert not pool.here
        assert set(pool.run([_threads] * 2)) == {('1',) * len(THREADS)}


def _threads():
    return tuple(os.environ[name] for name in THREADS)


@pytest.fixture
def cluster():
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host='127.0.0.1', dashboard_address=None,
    ) as cluster:
        yield cluster


def test_a_cluster_that_loses_a_worker_finds_the_same(cluster):
    mission = many_goals(24)
    lost = []

    def kill_one(*_):
        if not lost:
            lost.append(cluster.workers[0].process.pid)
            os.kill(lost[0], signal.SIGKILL)

    policy = build_policy(
        mission, 'split', scheduler=cluster.scheduler_address, on_sweep=kill_one)
    assert lost
    assert_same(build_policy(mission, 'split'), policy)


def test_errors_of_sub_problems_arrive():
    mission = mission_from_dict(case_study(1, 2), 'test')
    with pytest.raises(ValueError, match='tolerance -1'):
        build_policy(mission, 'split', tolerance=-1, jobs=2)


def test_who_cannot_work(monkeypatch):
    mission = mission_from_dict(case_study(1, 2), 'test')
    with pytest.raises(ValueError, match='jobs 0'):
        build_policy(mission, 'split', jobs=0)
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(ValueError, match='pip install distributed'):
        build_policy(mission, 'split', scheduler='tcp://127.0.0.1:1')
