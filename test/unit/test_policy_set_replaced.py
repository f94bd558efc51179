"""Policy sets altered under their reader, and their writers killed: always one whole set."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import random
import shutil
import signal
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from strategies import case_study, pick_states

from uav_mission_manager import build_policy, load_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.policy import PolicyError, private_copy, replacement
from uav_mission_manager.solver import memory
from uav_mission_manager.solver.exact import look_ahead


@pytest.fixture(scope='module')
def policies(tmp_path_factory):
    """Two policies, saved once each for their digests."""
    both = [
        build_policy(mission_from_dict(case_study(1, discount=d), 'test')) for d in (0.98, 0.5)
    ]
    for policy in both:
        policy.save(tmp_path_factory.mktemp('sets') / 'p')
    return both


@pytest.fixture(params=['in memory', 'in a private file'])
def large(request, monkeypatch):
    """A policy with actions, without tables; its arrays are kept as the parameter says."""
    monkeypatch.setattr(look_ahead, 'MAX_TABLED_ENTRIES', 0)
    policy = build_policy(mission_from_dict(case_study(1), 'test'))
    if request.param == 'in a private file':
        monkeypatch.setattr(memory, 'SMALL_BYTES', 0)
        monkeypatch.setattr(memory, 'available_bytes', lambda: 0)
    return policy


def in_child(work):
    """Return the wait status of a process that does `work`."""
    child = os.fork()
    if not child:
        status = 1
        try:
            work()
            status = 0
        finally:
            os._exit(status)
    return os.waitpid(child, 0)[1]


def truncate(directory):
    for file in directory.iterdir():
        os.truncate(file, 0)


def zero(directory):
    for file in directory.iterdir():
        with file.open('r+b') as stream:
            stream.write(bytes(file.stat().st_size))


def swap_halves(directory):
    for file in directory.iterdir():
        content = file.read_bytes()
        middle = len(content) // 2
        file.write_bytes(content[middle:] + content[:middle])


@pytest.mark.filterwarnings('ignore:.*private file:RuntimeWarning')
@pytest.mark.parametrize('harm', [truncate, zero, swap_halves, shutil.rmtree])
def test_a_loaded_policy_is_the_one_that_was_verified(tmp_path, large, harm):
    large.save(tmp_path / 'p')
    states = pick_states(large.space, 300)
    expected = large.q_values(states), large.act(states)
    loaded = load_policy(tmp_path / 'p')
    harm(tmp_path / 'p')

    def look():
        np.testing.assert_array_equal(loaded.q_values(states), expected[0])
        np.testing.assert_array_equal(loaded.act(states), expected[1])

    assert in_child(look) == 0


@pytest.mark.parametrize('moment', ['update', 'hexdigest'])
@pytest.mark.parametrize('harm', [truncate, zero, swap_halves, shutil.rmtree])
def test_what_is_verified_is_the_copy_that_is_used(tmp_path, monkeypatch, policies, harm, moment):
    """The files are altered just before, and just after, they are hashed."""

    class Hash:
        def __init__(self):
            self.real = hashlib.sha256()

        def update(self, content):
            if moment == 'update':
                harm(tmp_path / 'p')
            self.real.update(content)

        def hexdigest(self):
            if moment == 'hexdigest':
                harm(tmp_path / 'p')
            return self.real.hexdigest()

    policies[0].save(tmp_path / 'p')
    states = pick_states(policies[0].space, 300)
    with monkeypatch.context() as patch:
        patch.setattr(private_copy, 'hashlib', SimpleNamespace(sha256=Hash))
        loaded = load_policy(tmp_path / 'p')
    np.testing.assert_array_equal(loaded.q_values(states), policies[0].q_values(states))
    with pytest.raises(PolicyError):
        load_policy(tmp_path / 'p')


def test_where_memory_is_short_a_private_file_is_named(tmp_path, monkeypatch, policies):
    policies[0].save(tmp_path / 'p')
    monkeypatch.setattr(memory, 'SMALL_BYTES', 0)
    monkeypatch.setattr(memory, 'available_bytes', lambda: 1000)
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    with pytest.warns(RuntimeWarning, match=f'0_value.*private file in {tmp_path}'):
        loaded = load_policy(tmp_path / 'p')
    assert os.listdir(tmp_path) == ['p']
    assert not loaded.solution.value.flags.writeable

    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(os, 'posix_fallocate', full)
    with (
        pytest.warns(RuntimeWarning, match='private file'),
        pytest.raises(PolicyError, match=r'0_value\.npy: cannot be read: .*No space left'),
    ):
        load_policy(tmp_path / 'p')


def test_killed_at_any_step_one_set_is_there_and_the_next_save_cleans_up(tmp_path, policies):
    place, digests = tmp_path / 'p', {policy.digest for policy in policies}
    policies[0].save(place)
    steps, status = 0, None
    while status != 0:
        steps += 1
        left = [steps]

        def die_in_time(event, _, left=left):
            if event.startswith(('open', 'os.', 'shutil.', 'tempfile.', 'fcntl.')):
                left[0] -= 1
                if not left[0]:
                    os.kill(os.getpid(), signal.SIGKILL)

        def save(steps=steps, hook=die_in_time):
            sys.addaudithook(hook)
            policies[steps % 2].save(place)

        status = in_child(save)
        assert load_policy(place).digest in digests
    assert steps > 10
    policies[0].save(place)
    assert os.listdir(tmp_path) == ['p']


def test_read_while_writers_are_killed_at_random_moments(tmp_path, policies):
    place, digests = tmp_path / 'p', {policy.digest for policy in policies}
    policies[0].save(place)
    moments = random.Random(1)
    for _ in range(60):
        writer = os.fork()
        if not writer:
            while True:
                for policy in policies:
                    policy.save(place)
        end = time.monotonic() + moments.uniform(0.0, 0.05)
        try:
            while time.monotonic() < end:
                assert load_policy(place).digest in digests
        finally:
            os.kill(writer, signal.SIGKILL)
            os.waitpid(writer, 0)
        assert load_policy(place).digest in digests
    policies[0].save(place)
    assert os.listdir(tmp_path) == ['p']


def test_two_writers_of_one_place_do_not_harm_each_other(tmp_path, policies):
    place = tmp_path / 'p'
    policies[0].save(place)

    def save_often(policy):
        for _ in range(30):
            policy.save(place)

    writer = os.fork()
    if not writer:
        status = 1
        try:
            save_often(policies[1])
            status = 0
        finally:
            os._exit(status)
    try:
        save_often(policies[0])
    finally:
        assert os.waitpid(writer, 0)[1] == 0
    assert load_policy(place).digest in {policy.digest for policy in policies}
    assert os.listdir(tmp_path) == ['p']


def test_what_is_not_a_dead_writers_is_left_alone(tmp_path, policies):
    place = tmp_path / 'p'
    names = {'a writer that lives': 'set', 'of the user': 'notes', 'dead': 'set'}
    for name, content in names.items():
        (tmp_path / f'.p.new-{name}' / content).mkdir(parents=True)
    lock = os.open(tmp_path / '.p.new-a writer that lives', os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    policies[0].save(place)
    os.close(lock)
    assert set(os.listdir(tmp_path)) == {'p', '.p.new-a writer that lives', '.p.new-of the user'}


def test_where_directories_cannot_be_exchanged_both_sets_are_kept(tmp_path, monkeypatch, policies):
    def unknown(*_):
        raise OSError(errno.EINVAL, 'Invalid argument')

    place = tmp_path / 'p'
    policies[0].save(place)
    monkeypatch.setattr(replacement, 'exchange', unknown)
    with pytest.raises(PolicyError, match='not replaced') as error:
        policies[1].save(place)
    assert load_policy(place).digest == policies[0].digest
    (new,) = set(tmp_path.iterdir()) - {place}
    assert new.name.startswith('p.new-')
    assert str(new) in str(error.value)
    assert new.stat().st_mode == place.stat().st_mode
    assert load_policy(new).digest == policies[1].digest


def test_all_is_on_the_disk_before_the_old_set_goes(tmp_path, monkeypatch, policies):
    """A power cut after a build must not leave an empty set where a whole one was."""
    place, flushed, real, sync = tmp_path / 'p', [], replacement.exchange, os.fsync
    policies[0].save(place)

    def fsync(descriptor):
        flushed.append(os.fstat(descriptor).st_ino)
        sync(descriptor)

    def exchange(fresh, old):
        needed = {path.stat().st_ino for path in (fresh, *fresh.iterdir())}
        assert needed <= set(flushed)
        flushed.clear()
        real(fresh, old)

    monkeypatch.setattr(os, 'fsync', fsync)
    monkeypatch.setattr(replacement, 'exchange', exchange)
    policies[1].save(place)
    assert tmp_path.stat().st_ino in flushed


def test_a_link_to_a_set_is_replaced_and_what_it_points_to_is_kept(tmp_path, policies):
    policies[0].save(tmp_path / 'old')
    (tmp_path / 'p').symlink_to('old')
    policies[1].save(tmp_path / 'p')
    assert load_policy(tmp_path / 'p').digest == policies[1].digest
    assert load_policy(tmp_path / 'old').digest == policies[0].digest
    assert sorted(os.listdir(tmp_path)) == ['old', 'p']


@pytest.mark.parametrize('name', ['manifest.json', '0_value.npy'])
@pytest.mark.parametrize('kind', ['pipe', 'device', 'folder'])
def test_what_is_no_regular_file_is_not_waited_for(policies, tmp_path, name, kind):
    policies[0].save(tmp_path / 'set')
    place = tmp_path / 'set' / name
    place.unlink()
    if kind == 'pipe':
        os.mkfifo(place)
    elif kind == 'device':
        place.symlink_to('/dev/zero')
    else:
        place.mkdir()

    def read():
        signal.alarm(10)  # Else the one that waits would for ever.
        with pytest.raises(PolicyError, match=r'cannot be read: .*(no regular file|directory)'):
            load_policy(tmp_path / 'set')

    assert in_child(read) == 0
