"""A recording is a bag at any moment: whole, in order, and what was saved is in it."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader

from uav_mission_manager.onboard import recording as module
from uav_mission_manager.onboard.recording import Recording, new_folder

TEXT, ODOMETRY = 'std_msgs/msg/String', 'nav_msgs/msg/Odometry'
FOREVER = QosTime(9223372036, 854775807)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    FOREVER,
    FOREVER,
    QosLiveliness.AUTOMATIC,
    FOREVER,
    avoid_ros_namespace_conventions=False,
)
SENSOR = LATCHED._replace(
    reliability=QosReliability.BEST_EFFORT, durability=QosDurability.VOLATILE
)

Messages = list[tuple[str, int, bytes]]


def messages(folder: Path) -> Messages:
    with Reader(folder) as reader:
        return [(each.topic, time, bytes(data)) for each, time, data in reader.messages()]


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    found = Recording(new_folder(tmp_path / 'bags' / 'flight'))
    found.add_topic('/a', TEXT, [LATCHED])
    return found


def some_messages(count: int, first: int = 0, topic: str = '/a') -> Messages:
    rng = random.Random(first)
    numbers = range(first, first + count)
    return [(topic, 10**18 + number * 10**6, rng.randbytes(300)) for number in numbers]


def test_after_each_save_all_is_there_in_order(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'PART_SIZE', 50_000)
    added: Messages = []
    for save in range(7):
        if save == 3:
            recording.add_topic('/b', ODOMETRY, [SENSOR])
        news = some_messages(100, 100 * save, '/b' if save == 5 else '/a')
        for message in news:
            recording.add(*message)
        added += news
        recording.save()
        assert messages(recording.folder) == added
    parts = sorted(path.name for path in recording.folder.glob('*.mcap'))
    assert parts == [f'flight_{number}.mcap' for number in range(4)]
    assert {path.name for path in recording.folder.iterdir()} == {*parts, 'metadata.yaml'}


def test_metadata_tells_of_all_parts(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'PART_SIZE', 10_000)
    recording.add_topic('/b', ODOMETRY, [SENSOR, SENSOR])
    for save in range(3):
        for message in some_messages(50, 50 * save):
            recording.add(*message)
        recording.save()
    recording.add('/b', 10**18 + 10**9, b'x')
    recording.save()
    text = (recording.folder / 'metadata.yaml').read_text()
    found = yaml.safe_load(text)['rosbag2_bagfile_information']
    assert found['version'] == 9
    assert found['storage_identifier'] == 'mcap'
    assert found['message_count'] == 151
    assert found['duration']['nanoseconds'] == 10**9
    assert found['starting_time']['nanoseconds_since_epoch'] == 10**18
    assert found['relative_file_paths'] == [f'flight_{number}.mcap' for number in range(4)]
    assert [file['message_count'] for file in found['files']] == [50, 50, 50, 1]
    topics = {each['topic_metadata']['name']: each for each in found['topics_with_message_count']}
    assert {name: each['message_count'] for name, each in topics.items()} == {'/a': 150, '/b': 1}
    offered = topics['/b']['topic_metadata']['offered_qos_profiles']
    assert [(each['reliability'], each['durability']) for each in offered] == [
        ('best_effort', 'volatile')
    ] * 2


def test_qualities_of_service_and_types_are_in_each_file(recording: Recording) -> None:
    recording.add(*some_messages(1)[0])
    recording.save()
    for place in recording.folder, recording.folder / 'flight_0.mcap':
        with Reader(place) as reader:
            [connection] = reader.connections
            assert connection.ext.offered_qos_profiles == [LATCHED]
            assert 'string data' in connection.msgdef.data


def test_nothing_new_writes_nothing(recording: Recording) -> None:
    recording.save()
    assert list(recording.folder.iterdir()) == []
    recording.add(*some_messages(1)[0])
    recording.save()
    before = (recording.folder / 'metadata.yaml').stat().st_ino
    recording.save()
    assert (recording.folder / 'metadata.yaml').stat().st_ino == before


def test_a_name_that_is_taken_is_counted_up(tmp_path: Path) -> None:
    made = [new_folder(tmp_path / 'deep' / 'bag').name for _ in range(3)]
    assert made == ['bag', 'bag-2', 'bag-3']
    (tmp_path / 'file').touch()
    assert new_folder(tmp_path / 'file').name == 'file-2'
    with pytest.raises(OSError, match='file'):
        new_folder(tmp_path / 'file' / 'bag')


WRITER = """
import os, sys
from pathlib import Path
from uav_mission_manager.onboard import recording
recording.PART_SIZE = 100 * int(sys.argv[2])
bag = recording.Recording(Path(sys.argv[1]))
bag.add_topic('/a', 'std_msgs/msg/String')
number, size = 0, int(sys.argv[2])
while True:
    for _ in range(20):
        bag.add('/a', 10**18 + number, number.to_bytes(8, 'little') + os.urandom(size))
        number += 1
    bag.save()
    print(number, flush=True)
"""


def numbers_in(bag: Path) -> list[int]:
    return [int.from_bytes(data[:8], 'little') for _, _, data in messages(bag)]


@pytest.mark.parametrize('saves', range(1, 13))
def test_killed_at_any_moment_it_has_all_that_was_saved(tmp_path: Path, saves: int) -> None:
    with subprocess.Popen(
        [sys.executable, '-c', WRITER, str(tmp_path), '200'], stdout=subprocess.PIPE, text=True
    ) as process:
        lines = [process.stdout.readline() for _ in range(saves)]
        process.send_signal(signal.SIGKILL)
        lines += process.stdout.readlines()
    saved = int([line for line in lines if line.endswith('\n')][-1])
    numbers = numbers_in(tmp_path)
    assert numbers == list(range(len(numbers)))
    assert saved <= len(numbers) <= saved + 20


@pytest.mark.parametrize('name', ['metadata.yaml', '{}_0.mcap'])
@pytest.mark.parametrize('attempt', range(3))
def test_killed_as_soon_as_a_file_changes_it_is_whole(
    tmp_path: Path, name: str, attempt: int
) -> None:
    """What is written in place is found half-written then."""
    file = tmp_path / name.format(tmp_path.name)
    with subprocess.Popen(
        [sys.executable, '-c', WRITER, str(tmp_path), '40000'], stdout=subprocess.PIPE, text=True
    ) as process:
        process.stdout.readline()
        before = os.stat(file)
        while (after := os.stat(file)).st_ino == before.st_ino and after.st_size == before.st_size:
            pass
        process.send_signal(signal.SIGKILL)
        process.stdout.readlines()
    numbers = numbers_in(tmp_path)
    assert numbers == list(range(len(numbers))) != []


FULL = """
import resource, sys
from pathlib import Path
from uav_mission_manager.onboard.recording import Recording
bag = Recording(Path(sys.argv[1]))
bag.add_topic('/a', 'std_msgs/msg/String')
bag.add('/a', 1, bytes(100))
bag.save()
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
import random
bag.add('/a', 2, random.Random(0).randbytes(100_000))
try:
    bag.save()
except OSError as error:
    print(error)
"""


def test_without_room_it_says_so_and_keeps_what_it_has(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-c', FULL, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout == f'{tmp_path}: cannot be written: {os.strerror(errno.EFBIG)}\n'
    assert [time for _, time, _ in messages(tmp_path)] == [1]
    assert len(list(tmp_path.iterdir())) == 2
