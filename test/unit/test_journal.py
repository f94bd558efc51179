"""Journals: what is read is what was written last, whatever happened to their writers."""

from __future__ import annotations

import errno
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from strategies import case_study

from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.onboard import journal as module
from uav_mission_manager.onboard.journal import Journal, JournalError, goals_hash

LIMIT = 180.0
"""Seconds before a condition that never comes true fails the test."""


@pytest.fixture
def journals(tmp_path):
    """Makes journals of one file, as one process after another does; closes them at the end."""
    made = []

    def make(kind='manager', mission='abc', path=tmp_path / 'uav1' / 'manager.journal'):
        made.append(Journal(path, kind, mission))
        return made[-1]

    yield make
    for journal in made:
        journal.close()


@pytest.fixture
def path(tmp_path):
    return tmp_path / 'uav1' / 'manager.journal'


def state_in(journal):
    record = journal.read()
    return record and record.state


def written(journals, *states):
    """Leave a file that a process wrote before it ended."""
    journal = journals()
    for state in states:
        journal.write(state)
        assert journal.error == ''
    journal.close()


def until(condition):
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def in_child(work):
    """Start a process that does `work`; return its id."""
    child = os.fork()
    if not child:
        try:
            work()
        finally:
            os._exit(1)
    return child


# What was written is read


def test_nothing_is_there_at_a_first_start(journals, path):
    assert journals().read() is None
    assert not path.exists()


def test_a_process_finds_what_the_one_before_it_wrote(journals):
    states = {'priorities': [2, 0, 1], 'request': 'ä\n', 'why': None}, {'priorities': [0, 0, 1]}
    for state in states:
        written(journals, state)
        assert journals(mission='of another').read() == module.Record('abc', state)


def test_an_unchanged_state_writes_nothing(journals, path):
    written(journals, {'a': 1, 'b': 2}, {'b': 2, 'a': 1})
    size = path.stat().st_size
    assert path.read_bytes().count(b'\n') == 1
    written(journals, {'a': 1, 'b': 2})
    assert path.stat().st_size == size
    written(journals, {'a': 1})
    assert path.stat().st_size > size


def test_another_mission_is_told_not_hidden(journals):
    written(journals, {'a': 1})
    journal = journals(mission='xyz')
    assert journal.read().mission == 'abc'
    journal.write({'a': 1})
    assert journals().read() == module.Record('xyz', {'a': 1})


def test_goals_and_grid_make_the_hash_and_weights_do_not():
    mission = mission_from_dict(case_study(1, 2), 'test')
    other = replace(
        mission,
        name='x',
        discount=0.5,
        goals=(replace(mission.goals[0], eta=99.0), mission.goals[1]),
    )
    assert goals_hash(other) == goals_hash(mission)
    a, b = mission.goals
    for goals in ((b, a), (a,), (a, replace(b, name='x')), (a, replace(b, cell=b.cell + 1))):
        assert goals_hash(replace(mission, goals=goals)) != goals_hash(mission)
    grid = replace(mission.grid, cell_size=49.0)
    assert goals_hash(replace(mission, grid=grid)) != goals_hash(mission)


# Damage


def test_a_line_torn_anywhere_counts_for_nothing(journals, path):
    written(journals, {'n': 1}, {'n': 2}, {'n': 3})
    content = path.read_bytes()
    start = content.rfind(b'\n', 0, -1) + 1
    for end in range(start, len(content)):
        path.write_bytes(content[:end])
        assert state_in(journals()) == {'n': 2}
    written(journals, {'n': 4})
    assert state_in(journals()) == {'n': 4}
    assert len(path.read_bytes()) == len(content)


def test_a_flipped_bit_in_the_last_line_is_damage_and_not_a_torn_line(journals, path):
    written(journals, {'n': 1}, {'n': 2})
    content = path.read_bytes()
    journal = journals()
    for bit in range(8 * (content.rfind(b'\n', 0, -1) + 1), 8 * len(content)):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        with pytest.raises(JournalError, match=f'{path}: its last line is damaged'):
            journal.read()


@pytest.mark.parametrize('content', [b'', b'\n', b'\0' * 100, b'x', b'torn, and nothing before'])
def test_what_holds_no_line_is_damage(journals, path, content):
    journal = journals()
    path.write_bytes(content)
    with pytest.raises(JournalError, match=str(path)):
        journal.read()
    journal.write({'n': 1})
    assert journal.error == ''
    assert state_in(journals()) == {'n': 1}


def test_a_damaged_journal_is_made_anew_by_the_first_write(journals, path):
    written(journals, {'n': 1})
    path.write_bytes(path.read_bytes().replace(b'1', b'2'))
    written(journals, {'n': 3})
    assert state_in(journals()) == {'n': 3}


def test_another_kind_is_refused(journals):
    written(journals, {'n': 1})
    with pytest.raises(JournalError, match="kind is 'manager', not 'base_station'"):
        journals('base_station').read()


def test_another_version_is_refused(journals, monkeypatch):
    written(journals, {'n': 1})
    monkeypatch.setattr(module, 'JOURNAL_VERSION', module.JOURNAL_VERSION + 1)
    with pytest.raises(JournalError, match='version is 1, not 2'):
        journals().read()


# Places that cannot be written


def test_a_folder_or_a_pipe_in_its_place_is_refused(tmp_path, journals):
    with pytest.raises(IsADirectoryError):
        journals(path=tmp_path)
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(OSError, match='no regular file'):
        journals(path=tmp_path / 'pipe')


def test_a_place_below_a_file_is_refused(tmp_path, journals):
    (tmp_path / 'file').touch()
    with pytest.raises(NotADirectoryError):
        journals(path=tmp_path / 'file' / 'x' / 'manager.journal')


@pytest.mark.parametrize('folder', ['/proc', '/proc/state'])
def test_a_place_that_takes_no_files_is_refused(journals, folder):
    with pytest.raises(OSError, match='/proc'):
        journals(path=Path(folder) / 'manager.journal')


def test_a_full_disk_is_an_error_until_there_is_room(journals, monkeypatch):
    journal = journals()
    journal.write({'n': 1})
    taken = 0

    def write(descriptor, line):
        return real(descriptor, line[:taken])

    real = os.write
    for taken in (0, 1, 40):
        monkeypatch.setattr(os, 'write', write)
        journal.write({'n': 2})
        assert 'No space left' in journal.error
        assert state_in(journals()) == {'n': 1}
        monkeypatch.undo()
        journal.write({'n': 2 + taken})
        assert journal.error == ''
        assert state_in(journals()) == {'n': 2 + taken}
        journal.write({'n': 1})


def test_a_full_disk_is_an_error_at_the_first_write(journals, path):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    journal = journals()
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, limit[1]))
        journal.write({'n': 1})
        assert journal.error.startswith(f'{path}: not written: ')
        assert journal.read() is None
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, before)
    journal.write({'n': 1})
    assert journal.error == ''
    assert state_in(journal) == {'n': 1}


def test_what_is_no_json_is_an_error(journals):
    journal = journals()
    journal.write({'n': object()})
    assert 'not JSON serializable' in journal.error
    journal.write({'n': 1})
    assert journal.error == ''


# The disk


def test_a_write_does_not_wait_for_the_disk(journals, monkeypatch):
    disk = threading.Event()
    monkeypatch.setattr(module, 'flush', lambda _: disk.wait(LIMIT))
    journal = journals()
    for n in range(100):
        journal.write({'n': n})
    assert state_in(journals()) == {'n': 99}
    assert not disk.is_set()
    disk.set()


def test_every_state_comes_to_the_disk(journals, path, monkeypatch):
    flushed = []
    monkeypatch.setattr(module, 'flush', lambda place: flushed.append((place, place.stat())))
    journal = journals()
    for n in range(3):
        journal.write({'n': n})
        size = path.stat().st_size
        until(lambda size=size: any(p == path and s.st_size == size for p, s in flushed))
    assert any(place == path.parent for place, _ in flushed)


def test_a_disk_that_fails_is_an_error_and_is_written_anew(journals, path, monkeypatch):
    journal = journals()
    journal.write({'n': 1})
    monkeypatch.setattr(module, 'RETRY_PERIOD', 0.01)

    def failing(_):
        raise OSError(errno.EIO, 'disk on fire')

    monkeypatch.setattr(module, 'flush', failing)
    journal.write({'n': 2})
    until(lambda: 'not safe on the disk: [Errno 5] disk on fire' in journal.error)
    monkeypatch.undo()
    until(lambda: journal.error == '')
    assert state_in(journals()) == {'n': 2}
    assert path.read_bytes().count(b'\n') == 1


def test_the_file_stays_small_and_the_last_state_counts(journals, path, monkeypatch):
    monkeypatch.setattr(module, 'LARGEST_JOURNAL', 500)
    journal = journals()
    for n in range(2000):
        journal.write({'n': n})
        assert journal.error == ''
    until(lambda: path.stat().st_size <= 500)
    assert state_in(journals()) == {'n': 1999}
    journal.write({'n': 2000})
    assert state_in(journals()) == {'n': 2000}


def test_a_journal_that_is_left_while_it_is_replaced_is_no_hindrance(journals, path, monkeypatch):
    monkeypatch.setattr(module, 'LARGEST_JOURNAL', 0)
    reached, disk = threading.Event(), threading.Event()

    def fsync(_):
        reached.set()
        disk.wait(LIMIT)

    monkeypatch.setattr(os, 'fsync', fsync)
    first, second = journals(), journals()
    first.write({'n': 1})
    assert reached.wait(LIMIT)
    first.close()
    flushed = threading.Event()
    monkeypatch.setattr(module, 'flush', lambda _: flushed.set())
    second.write({'n': 2})
    assert flushed.wait(LIMIT)
    assert second.error == ''
    disk.set()
    assert state_in(journals()) == {'n': 2}


def test_what_a_writer_that_died_replacing_left_is_no_matter(journals, path):
    written(journals, {'n': 1})
    left = path.with_name(f'{path.name}.new')
    for left_content in (b'', path.read_bytes()[:20], b'longer than a line' * 100):
        left.write_bytes(left_content)
        assert state_in(journals()) == {'n': 1}
        path.unlink()
        written(journals, {'n': 1})
        assert not left.exists()


def test_a_file_that_was_deleted_comes_back(journals, path):
    journal = journals()
    journal.write({'n': 1})
    path.unlink()
    journal.write({'n': 2})
    until(lambda: state_in(journal) == {'n': 2})


# One file, many processes


def test_a_second_writer_writes_nothing(journals):
    first, second = journals(), journals()
    first.write({'n': 1})
    second.write({'n': 2})
    assert 'another process has it' in second.error
    assert state_in(second) == {'n': 1}
    first.close()
    second.write({'n': 2})
    assert second.error == ''
    assert state_in(first) == {'n': 2}
    first.write({'n': 3})
    assert 'closed' in first.error


def test_journals_of_several_kinds_keep_apart(journals, path):
    kinds = {kind: journals(kind, path=path.with_name(kind)) for kind in ('a', 'b', 'c')}
    for n in range(100):
        for kind, journal in kinds.items():
            journal.write({kind: n})
    assert [state_in(j) for j in kinds.values()] == [{'a': 99}, {'b': 99}, {'c': 99}]


def test_threads_write_whole_lines(journals):
    journal = journals()
    threads = [
        threading.Thread(target=lambda: [journal.write({'n': n}) for n in range(200)])
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert journal.error == ''
    assert state_in(journal) == {'n': 199}


WRITE_AND_END = """
import sys, threading
from pathlib import Path
from uav_mission_manager.onboard import journal
disk = threading.Event()
journal.flush = lambda _: disk.set() or threading.Event().wait()
journal.Journal(Path(sys.argv[1]), 'manager', 'abc').write({'n': 1})
disk.wait()
"""


def test_the_end_of_a_process_waits_for_no_disk(journals, path):
    command = [sys.executable, '-c', WRITE_AND_END, path]
    subprocess.run(command, check=True, timeout=LIMIT, cwd=Path(__file__).parents[2])
    assert state_in(journals()) == {'n': 1}


def count_on(journals, reader):
    """Count from what the journal says for ever, and tell each number once it is written."""
    journal = journals()
    n = (state_in(journal) or {'n': 0})['n']
    while True:
        n += 1
        journal.write({'n': n, 'ballast': 'x' * random.randrange(300)})
        assert journal.error == ''
        os.write(reader, b'%20d' % n)


@pytest.mark.parametrize('largest', [module.LARGEST_JOURNAL, 2000], ids=['seldom', 'often'])
def test_killed_at_any_moment_nothing_that_was_written_is_lost(journals, monkeypatch, largest):
    """With files replaced seldom and often."""
    monkeypatch.setattr(module, 'LARGEST_JOURNAL', largest)
    told = 0
    for _ in range(50):
        reader, writer = os.pipe()
        child = in_child(lambda writer=writer: count_on(journals, writer))
        os.close(writer)
        pause = random.uniform(0.0, 0.05)  # From before the first line to thousands of them.
        if random.random() < 0.8:
            assert os.read(reader, 20)
        threading.Event().wait(pause)
        os.kill(child, signal.SIGKILL)
        with open(reader, 'rb') as pipe:
            numbers = pipe.read()
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
        told = max(told, int(numbers[-20:] or 0))
        assert (state_in(journals()) or {'n': 0})['n'] >= told
    assert told > 50
