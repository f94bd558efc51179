"""Sub-problems solved in processes and on a Dask cluster that loses a worker."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy.workers import Workers, workers


def many_goals(k):
    document = case_study()
    document['goals'] = [
        document['goals'][j % 3] | {'name': f'goal{j}', 'eta': 1.0 + j} for j in range(k)
    ]
    return mission_from_dict(document, 'test')


def contents(policy, directory):
    policy.save(directory)
    return {path.name: path.read_bytes() for path in directory.iterdir()}


@pytest.mark.parametrize('method', ['split', 'expansion'])
def test_processes_make_the_same_bytes(method, tmp_path):
    mission = mission_from_dict(case_study(), 'test')
    alone = build_policy(mission, method, order=2)
    reports = []
    together = build_policy(mission, method, order=2, jobs=2, progress=reports.append)
    assert contents(together, tmp_path / 'a') == contents(alone, tmp_path / 'b')
    tasks = {
        'split': ['sub-MDP of goal1', 'sub-MDP of goal2', 'sub-MDP of goal3'],
        'expansion': ['fit of the expansion', 'lower bound', 'upper bound'],
    }[method]
    begun = reports[: len(tasks)]
    assert sorted((report.task, report.done) for report in begun) == sorted((t, 0) for t in tasks)
    ends = [report.task for report in reports if report.done == 1]
    assert sorted(ends) == sorted(tasks)
    assert set(ends) == {report.task for report in reports}


def test_ends_are_counted_as_they_come_and_results_keep_their_order():
    ended = []
    backwards = Workers(lambda tasks: reversed([(n, task()) for n, task in enumerate(tasks)]))
    results = backwards.run([partial(pow, n, 2) for n in range(5)], ended.append)
    assert list(results) == [0, 1, 4, 9, 16]
    assert ended == [4, 3, 2, 1, 0]


def test_a_pool_keeps_the_order():
    with workers(jobs=2) as pool:
        assert list(pool.run([partial(pow, n, 2) for n in range(50)])) == [n**2 for n in range(50)]


@pytest.mark.parametrize(('k', 'certificate'), [(4, False), (3, True)])
def test_load_on_the_machine_changes_no_byte(k, certificate, tmp_path):
    """Of the fit of four goals, and of a certificate: that of four takes ten times as long."""

    def build():
        return build_policy(many_goals(k), 'expansion', order=2, certificate=certificate)

    quiet = contents(build(), tmp_path / 'a')
    busy = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
    try:
        assert contents(build(), tmp_path / 'b') == quiet
    finally:
        busy.kill()
        busy.wait()


@pytest.fixture
def cluster():
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host='127.0.0.1',
        dashboard_address=None,
    ) as cluster:
        yield cluster


def test_a_cluster_that_loses_a_worker_finds_the_same(cluster):
    mission = many_goals(24)
    lost = []

    def kill_one(report):
        if report.done == 1 and not lost:
            lost.append(cluster.workers[0].process.pid)
            os.kill(lost[0], signal.SIGKILL)

    policy = build_policy(mission, 'split', scheduler=cluster.scheduler_address, progress=kill_one)
    assert lost
    states = policy.space.draw(500, np.random.default_rng(0))
    expected = build_policy(mission, 'split').q_values(states)
    np.testing.assert_array_equal(policy.q_values(states), expected)


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
