"""What a bag tells of a flight: the manager's trace, and what the console shows.

Any rosbag2 bag is read, without ROS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from uav_mission_manager.console.messages import (
    DECISION_TOPIC,
    DIAGNOSTICS_TOPIC,
    HEARD_CHANGES,
    Moment,
)
from uav_mission_manager.console.playback import RecordedFlight, heard_flight
from uav_mission_manager.echo import shown
from uav_mission_manager.onboard.recording import require_rosbags
from uav_mission_manager.onboard.trace import Replay, ReplayedStep

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Reader

TRACE = '/manager/trace'
"""Topic of the trace, after the vehicle's namespace."""

DECISIONS = f'/{DECISION_TOPIC}'
"""Topic of the decisions, after the vehicle's namespace."""

VEHICLE_TOPICS = {TRACE: 'std_msgs/msg/String', DECISIONS: 'diagnostic_msgs/msg/DiagnosticArray'}
"""What the topics are of by which a vehicle is found."""

LOOSE_FILES = '.mcap', '.db3'
"""How the files of a bag end, each of which may be read alone."""


class TraceEntry(NamedTuple):
    """An entry of a trace.

    Attributes
    ----------
    seconds : float
        Since the bag's beginning, when it was recorded.
    text : str
        See `uav_mission_manager.onboard.trace`.
    """

    seconds: float
    text: str


class HeardMessages(NamedTuple):
    """What the console hears of a vehicle, as a bag has it.

    Attributes
    ----------
    vehicle : str
        Its namespace.
    start : float
        When the bag begins [s], since 1970.
    duration : float
        How long it is [s].
    messages : iterator
        When each was recorded since the beginning, a key of `HEARD_CHANGES`, and what it says.
    """

    vehicle: str
    start: float
    duration: float
    messages: Iterator[tuple[Moment, str, Any]]


class UnsuitableBagError(ValueError):
    """A bag that has not what is needed."""


def recorded_trace(path: Path, vehicle: str | None) -> Iterator[TraceEntry]:
    """Yield the entries of a vehicle's trace, in the order of their recording.

    Parameters
    ----------
    path : Path
        A folder with `metadata.yaml`, or one of its files.
    vehicle : str or None
        Its namespace, such as `/uav1`; None for the only one.

    Raises
    ------
    ValueError
        One line: it is no bag, cannot be read, or has no such trace.
    """
    with _opened(path) as (reader, decoded):
        topic = _chosen(path, reader.connections, vehicle, TRACE) + TRACE
        found = [each for each in reader.connections if each.topic == topic]
        for connection, time, data in reader.messages(found):
            text = decoded(data, connection.msgtype).data
            yield TraceEntry((time - reader.start_time) * 1e-9, text)


def replayed_steps(
    path: Path, vehicle: str | None, replay: Replay
) -> Iterator[tuple[float, ReplayedStep]]:
    """Yield each decision of a trace with when it was recorded [s], decided anew.

    Raises what `recorded_trace` raises, and where an entry is none, the same with its time.
    """
    for seconds, text in recorded_trace(path, vehicle):
        try:
            for step in replay.take(text):
                yield seconds, step
        except ValueError as error:
            raise ValueError(f'{shown(path)}: at {seconds:.2f} s: {error}') from error


def recorded_flight(path: Path, vehicle: str | None) -> RecordedFlight:
    """Return what the console would have heard of a vehicle, chosen as by `recorded_trace`.

    Raises the same.
    """
    with heard_messages(path, vehicle, TRACE) as heard:
        return heard_flight(heard.vehicle, heard.messages, heard.duration)


@contextmanager
def heard_messages(path: Path, vehicle: str | None, topic: str) -> Iterator[HeardMessages]:
    """Give what a bag has of a vehicle, chosen as by `recorded_trace`; it must have a topic.

    Parameters
    ----------
    path, vehicle
        See `recorded_trace`.
    topic : str
        A key of `VEHICLE_TOPICS`.

    Raises
    ------
    ValueError
        One line: it is no bag, cannot be read, or has no such topic.
    """
    with _opened(path) as (reader, decoded):
        chosen = _chosen(path, reader.connections, vehicle, topic)
        topics = {
            topic if topic == DIAGNOSTICS_TOPIC else f'{chosen}/{topic}': topic
            for topic in HEARD_CHANGES
        }
        found = [each for each in reader.connections if each.topic in topics]

        def messages() -> Iterator[tuple[Moment, str, Any]]:
            for connection, time, data in reader.messages(found) if found else ():  # [] is all.
                time_of_day = datetime.fromtimestamp(time * 1e-9).strftime('%H:%M:%S')
                moment = Moment((time - reader.start_time) * 1e-9, time_of_day)
                yield moment, topics[connection.topic], decoded(data, connection.msgtype)

        yield HeardMessages(chosen, reader.start_time * 1e-9, reader.duration * 1e-9, messages())


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Reader, Callable[[bytes, str], Any]]]:
    """Give a reader, and what makes a message of bytes and the name of its type."""
    require_rosbags()
    _check_place(path)
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore

        with Reader(path) as reader:
            yield reader, get_typestore(Stores.ROS2_JAZZY).deserialize_cdr
    except (UnsuitableBagError, MemoryError):
        raise
    except Exception as error:  # The library lets through whatever a damaged file leads to.
        why = f'{type(error).__name__}: {error}'
        raise ValueError(f'{shown(path)}: not a bag that can be read: {shown(why)}') from error


def _check_place(path: Path) -> None:
    if path.is_dir():
        if not (path / 'metadata.yaml').is_file():
            raise ValueError(
                f'{shown(path)}: no bag: it has no metadata.yaml; `ros2 bag reindex` makes one '
                'for a recording that was cut off'
            )
        if odd := [each.name for each in path.iterdir() if not (each.is_file() or each.is_dir())]:
            raise ValueError(f'{shown(path)}: {shown(odd[0])} is no regular file')
    elif not path.exists():
        raise ValueError(f'{shown(path)}: there is no such bag')
    elif not (path.is_file() and path.suffix in LOOSE_FILES):
        raise ValueError(f'{shown(path)}: no bag: neither a folder nor a file in MCAP or SQLite')


def _chosen(path: Path, connections: Sequence[Connection], vehicle: str | None, topic: str) -> str:
    """Return the namespace of the vehicle, which has this topic."""
    vehicles = {
        each.topic.removesuffix(topic)
        for each in connections
        if each.topic.endswith(topic) and each.msgtype == VEHICLE_TOPICS[topic]
    }
    names = ', '.join(sorted(name or '/' for name in vehicles))
    if not vehicles:
        topics = ', '.join(sorted(each.topic for each in connections)) or 'nothing'
        raise UnsuitableBagError(
            f'{shown(path)}: no {topic[1:]} in it, which mission_record records; '
            f'it has {shown(topics)}'
        )
    if vehicle is None and len(vehicles) > 1:
        raise UnsuitableBagError(
            f'{shown(path)}: of several vehicles: {shown(names)}; choose one by --namespace'
        )
    chosen = min(vehicles) if vehicle is None else vehicle.rstrip('/')
    if chosen not in vehicles:
        raise UnsuitableBagError(
            f'--namespace: {shown(vehicle)} is not in {shown(path)}, which is of {shown(names)}'
        )
    return chosen
