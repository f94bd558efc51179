"""A rosbag2 folder that is whole at any moment, however its writer ends.

The bag is in parts, as rosbag2 splits large ones. The last part, which grows, is written anew at
each `save` and takes the old one's place in one step, then so does `metadata.yaml`. So what was
there at the last save is read by whoever reads bags, without a repair.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import yaml

from uav_mission_manager.paths import write_whole
from uav_mission_manager.policy.replacement import flush

if TYPE_CHECKING:
    from rosbags.interfaces import Qos

PART_SIZE = 2 * 2**20
"""Bytes of messages after which the next part begins: a choice, a minute of flight; what is
written at each save is no more, and is compressed."""

FORMAT_VERSION: Final = 9
"""Version of rosbag2's format: that of ROS 2 Jazzy."""

MOST_FOLDERS = 10_000
"""Bags of one name, at most: a choice."""

Message = tuple[str, int, bytes]
"""Topic, time [ns], and what it says in ROS's serialisation."""

DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
"""The same as PyYAML's own, and faster, where it was built with it."""


def require_rosbags() -> None:
    """Raise `ValueError` where the library is not there that reads and writes bags."""
    if find_spec('rosbags') is None:
        raise ValueError('needs rosbags: pip install rosbags')


def bag_names(path: Path) -> Iterator[Path]:
    """Yield names for a bag: this one, and with -2, -3 and so on after it."""
    yield path
    for number in range(2, MOST_FOLDERS):
        yield path.with_name(f'{path.name}-{number}')


def new_folder(path: Path) -> Path:
    """Make a folder of the first of its `bag_names` that is not taken, and return it.

    Raises
    ------
    ValueError, OSError
        If it cannot be made.
    """
    for folder in bag_names(path):
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise ValueError(f'{path}: there are too many of this name')


class Recording:
    """Collects messages, and writes them at each `save`. One thread may add while another saves.

    Parameters
    ----------
    folder : Path
        An empty folder, the bag's.
    """

    def __init__(self, folder: Path) -> None:
        require_rosbags()
        from rosbags.typesys import Stores, get_typestore

        self.folder = folder
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._topics: dict[str, dict[str, Any]] = {}
        self._lock = threading.Lock()
        self._waiting: list[Message] = []
        self._part: list[Message] = []
        self._number = 0
        self._finished: dict[str, Any] = {}
        """What `metadata.yaml` says of the parts before the last."""

    def add_topic(self, name: str, kind: str, profiles: Sequence[Qos] = ()) -> None:
        """Say of a topic, once, what it is of, as `std_msgs/msg/String`, and how it is offered."""
        self._topics[name] = {
            'msgtype': kind,
            'msgdef': self._store.generate_msgdef(kind, ros_version=2)[0],
            'rihs01': self._store.hash_rihs01(kind),
            'offered_qos_profiles': profiles,
        }

    def add(self, topic: str, time: int, data: bytes) -> None:
        """Take a message of a known topic that came at a time [ns], which must not go back."""
        with self._lock:
            self._waiting.append((topic, time, data))

    def save(self) -> None:
        """Write what was added.

        Raises
        ------
        OSError
            With the path and why; the bag is then as it was at the last save.
        """
        with self._lock:
            news, self._waiting = self._waiting, []
        if not news:
            return
        self._part += news
        try:
            part = self._write_part()
        except OSError as error:
            raise OSError(f'{self.folder}: cannot be written: {error.strerror}') from error
        information = merged(self._finished, part) if self._finished else part
        metadata = {'rosbag2_bagfile_information': information}
        text = yaml.dump(metadata, Dumper=DUMPER, sort_keys=False)
        write_whole(self.folder / 'metadata.yaml', text)
        if sum(len(data) for _, _, data in self._part) > PART_SIZE:
            self._finished, self._part, self._number = information, [], self._number + 1

    def _write_part(self) -> dict[str, Any]:
        """Write the last part anew; return what a `metadata.yaml` says of it."""
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        name = f'{self.folder.name}_{self._number}'
        with TemporaryDirectory(dir=self.folder, prefix='.') as place:
            fresh = Path(place) / name
            writer = Writer(fresh, version=FORMAT_VERSION, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with writer:
                connections = {
                    topic: writer.add_connection(topic, **how)
                    for topic, how in dict(self._topics).items()
                }
                for topic, time, data in self._part:
                    writer.write(connections[topic], time, data)
            file = fresh / f'{name}.mcap'
            flush(file)
            file.replace(self.folder / file.name)
            metadata = yaml.safe_load((fresh / 'metadata.yaml').read_text(encoding='utf-8'))
        return metadata['rosbag2_bagfile_information']


def merged(before: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """Return what the `metadata.yaml` of a bag says that has one more part."""
    start = before['starting_time']['nanoseconds_since_epoch']
    end = part['starting_time']['nanoseconds_since_epoch'] + part['duration']['nanoseconds']
    counts = {
        topic['topic_metadata']['name']: topic['message_count']
        for topic in before['topics_with_message_count']
    }
    topics = [
        {**topic, 'message_count': topic['message_count'] + counts.get(name, 0)}
        for topic in part['topics_with_message_count']
        for name in [topic['topic_metadata']['name']]
    ]
    return {
        **part,
        'duration': {'nanoseconds': end - start},
        'starting_time': before['starting_time'],
        'message_count': before['message_count'] + part['message_count'],
        'topics_with_message_count': topics,
        'relative_file_paths': before['relative_file_paths'] + part['relative_file_paths'],
        'files': before['files'] + part['files'],
    }
