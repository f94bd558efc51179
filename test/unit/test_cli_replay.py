"""`mission_replay`: bags of all makes, what differs, and what is no bag."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from random_trace import Recorded, take_over
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from test_recording import LATCHED

from uav_mission_manager.cli.mission_replay import main
from uav_mission_manager.cli.recorded_flight import recorded_flight
from uav_mission_manager.console.heard import Heard
from uav_mission_manager.policy import Policy, build_policy, load_policy

ROOT = Path(__file__).parents[2]
CASE_STUDY, CASE_ONE = (str(ROOT / 'policies' / name) for name in ('case_study', 'case_one'))
TEXT, TRACE = 'std_msgs/msg/String', '/uav1/manager/trace'
STORE = get_typestore(Stores.ROS2_JAZZY)
MCAP, SQLITE = StoragePlugin.MCAP, StoragePlugin.SQLITE3
START = 1_795_752_784_466_701_872
PERIOD = 50_000_000


@pytest.fixture(scope='module')
def policy() -> Policy:
    return load_policy(CASE_STUDY)


@pytest.fixture(scope='module')
def flight(policy: Policy) -> Recorded:
    return Recorded(policy, 4)


@pytest.fixture(scope='module')
def other(policy: Policy, tmp_path_factory: pytest.TempPathFactory) -> str:
    mission = policy.mission
    goals = tuple(replace(g, eta=20.0 - g.eta, delta=10.0 - g.delta) for g in mission.goals)
    folder = tmp_path_factory.mktemp('policies') / 'other'
    build_policy(replace(mission, goals=goals)).save(folder)
    return str(folder)


def said(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[TEXT](text), TEXT))


def write_bag(
    folder: Path,
    entries: Sequence[str],
    storage: StoragePlugin = MCAP,
    version: int = 9,
    compression: CompressionMode = CompressionMode.NONE,
    topics: Sequence[str] = (TRACE,),
) -> Path:
    writer = Writer(folder, version=version, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = [
            writer.add_connection(
                topic, TEXT, typestore=STORE, offered_qos_profiles=[LATCHED, LATCHED]
            )
            for topic in topics
        ]
        for number, entry in enumerate(entries):
            for connection in connections:
                writer.write(connection, START + number * PERIOD, said(entry))
    return folder


@pytest.fixture
def bag(tmp_path: Path, flight: Recorded) -> Path:
    return write_bag(tmp_path / 'bag', flight.entries)


Replay = Callable[..., dict[str, Any]]


@pytest.fixture
def replay(capsys: pytest.CaptureFixture[str]) -> Replay:
    def run(bag: Path, *options: str, policy: str = CASE_STUDY) -> dict[str, Any]:
        assert main([str(bag), '--policy', policy, '--json', *options]) == 0
        return json.loads(capsys.readouterr().out)

    return run


def assert_all_the_same(answer: dict[str, Any], flight: Recorded) -> None:
    assert answer['decisions'] == answer['same'] == answer['identical'] == len(flight.outcomes)
    assert (answer['different'], answer['differences']) == (0, [])
    assert answer['not_replayed'] == answer['gaps'] == 0


@pytest.mark.parametrize('version', [8, 9])
@pytest.mark.parametrize(
    ('storage', 'compression'),
    [
        *((MCAP, mode) for mode in CompressionMode),
        *((SQLITE, mode) for mode in CompressionMode if mode != CompressionMode.STORAGE),
    ],
)
def test_bags_of_all_makes_are_read_alike(
    tmp_path: Path,
    flight: Recorded,
    replay: Replay,
    storage: StoragePlugin,
    compression: CompressionMode,
    version: int,
) -> None:
    bag = write_bag(tmp_path / 'bag', flight.entries, storage, version, compression)
    found = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    [topic] = found['topics_with_message_count']
    form = type(topic['topic_metadata']['offered_qos_profiles'])
    assert form is {8: str, 9: list}[version]
    assert_all_the_same(replay(bag), flight)


def humble_bag(folder: Path, entries: Sequence[str]) -> Path:
    """What ROS 2 Humble's recorder leaves, by hand: SQLite, metadata of version 5."""
    folder.mkdir()
    quality = '- history: 3\n  depth: 0\n  reliability: 1\n  durability: 1\n'
    for name in 'deadline', 'lifespan', 'liveliness_lease_duration':
        quality += f'  {name}:\n    sec: 9223372036\n    nsec: 854775807\n'
    quality += '  liveliness: 1\n  avoid_ros_namespace_conventions: false'
    with sqlite3.connect(folder / 'bag_0.db3') as base:
        base.executescript(
            'CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);'
            'CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,'
            ' metadata TEXT NOT NULL);'
            'CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,'
            ' serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);'
            'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,'
            ' timestamp INTEGER NOT NULL, data BLOB NOT NULL);'
            "INSERT INTO schema VALUES (3, 'humble');"
        )
        base.execute('INSERT INTO topics VALUES (1, ?, ?, ?, ?)', (TRACE, TEXT, 'cdr', quality))
        rows = [(1, START + number * PERIOD, said(entry)) for number, entry in enumerate(entries)]
        base.executemany('INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)', rows)
    span = {
        'duration': {'nanoseconds': (len(entries) - 1) * PERIOD},
        'starting_time': {'nanoseconds_since_epoch': START},
        'message_count': len(entries),
    }
    topic = {'name': TRACE, 'type': TEXT, 'serialization_format': 'cdr'}
    information = {
        'version': 5,
        'storage_identifier': 'sqlite3',
        **span,
        'topics_with_message_count': [
            {
                'topic_metadata': {**topic, 'offered_qos_profiles': quality},
                'message_count': len(entries),
            }
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': ['bag_0.db3'],
        'files': [{'path': 'bag_0.db3', **span}],
    }
    (folder / 'metadata.yaml').write_text(
        yaml.safe_dump({'rosbag2_bagfile_information': information})
    )
    return folder


def test_a_bag_of_humble_is_read_too(tmp_path: Path, flight: Recorded, replay: Replay) -> None:
    assert_all_the_same(replay(humble_bag(tmp_path / 'bag', flight.entries)), flight)


def test_a_file_of_a_bag_is_read_alone(bag: Path, flight: Recorded, replay: Replay) -> None:
    assert_all_the_same(replay(bag / 'bag.mcap'), flight)


def test_another_policy_s_decisions_are_told(
    bag: Path, flight: Recorded, replay: Replay, other: str
) -> None:
    answer, policy = replay(bag, policy=other), load_policy(other)
    assert answer['policy'] == {
        'directory': other,
        'method': policy.method,
        'digest': policy.digest,
    }
    assert set(answer['flown_by']) == {load_policy(CASE_STUDY).digest}
    assert answer['decisions'] == len(flight.outcomes) == answer['same'] + answer['different']
    differences = answer['differences']
    assert sum(each['decisions'] for each in differences) == answer['different'] > 0
    for each in differences:
        assert 0.0 <= each['seconds'] <= each['until'] <= answer['seconds']
        recorded, replayed = each['recorded'], each['replayed']
        if 'refused' in recorded or 'refused' in replayed:
            continue
        assert recorded['command'] != replayed['command']
        values = policy.decide(replayed['state']).values
        assert [float('inf') if v is None else v for v in replayed['values']] == list(values)


def test_a_goal_requested_in_flight_is_followed_where_its_policy_set_is_given_too(
    tmp_path: Path,
    policy: Policy,
    replay: Replay,
    other: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    entries, outcomes, policies = take_over(policy.mission)
    bag, sets = write_bag(tmp_path / 'bag', entries), [str(tmp_path / name) for name in 'ab']
    for each, folder in zip(policies, sets, strict=True):
        each.save(folder)
    answer = replay(bag, '--policy', sets[1], policy=sets[0])
    assert answer['decisions'] == answer['identical'] == len(outcomes)
    told = answer['policy'], *answer['further_policies']
    assert [each['directory'] for each in told] == sets
    assert [each['digest'] for each in told] == [load_policy(folder).digest for folder in sets]
    for directory in sets:
        assert 'in a mission with other goals' in refusal(
            [str(bag), '--policy', directory], capsys
        )
    same = refusal([str(bag), '--policy', CASE_STUDY, '--policy', other], capsys)
    assert 'have the same goals and grid' in same


def test_people_are_shown_what_differs(
    bag: Path, other: str, replay: Replay, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = replay(bag, policy=other)
    assert main([str(bag), '--policy', other]) == 0
    lines = capsys.readouterr().out.splitlines()
    first = next(d for d in answer['differences'] if 'command' in d['recorded'])
    recorded, replayed = first['recorded'], first['replayed']
    [place] = [number for number, line in enumerate(lines) if f'{first["seconds"]:.2f} s' in line]
    assert f'{recorded["command"]} was commanded' in lines[place]
    names = ['f', 'r1', 'r2', 'r3', 'g1', 'g2', 'g3', 'l', 'c', 't', 'm']
    pairs = zip(names, recorded['state'], strict=True)
    assert ' '.join(f'{name}={value}' for name, value in pairs) in lines[place + 1]
    assert f'{recorded["values"][recorded["action"] - 1]:.6g}' in lines[place + 1]
    if 'command' in replayed:
        assert f'{replayed["values"][recorded["action"] - 1] or 0:.6g}' in lines[place + 2] or (
            'not allowed' in lines[place + 2]
        )
    assert lines[-1].startswith(f'{answer["decisions"]:,} decisions: ')
    assert f'; {answer["different"]:,} different' in lines[-1]


def test_one_of_several_vehicles_is_chosen(
    tmp_path: Path, flight: Recorded, replay: Replay, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = '/manager/trace', TRACE, '/uav2/manager/trace'
    bag = write_bag(tmp_path / 'bag', flight.entries, topics=topics)
    for vehicle in '/', '/uav2', '/uav1/':
        assert_all_the_same(replay(bag, '--namespace', vehicle), flight)
    for options, words in (
        ([], 'of several vehicles: /, /uav1, /uav2; choose one by --namespace'),
        (['--namespace', '/uav3'], '--namespace: /uav3 is not in'),
    ):
        assert words in refusal([str(bag), '--policy', CASE_STUDY, *options], capsys)


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which the command ends."""
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert capsys.readouterr().out == ''
    line = str(end.value)
    assert line.startswith('mission_replay: ')
    assert len(line.splitlines()) == 1
    assert len(line) < 700
    return line


def without_metadata(bag: Path) -> None:
    (bag / 'metadata.yaml').unlink()


def cut_off(bag: Path) -> None:
    file = bag / 'bag.mcap'
    file.write_bytes(file.read_bytes()[:-2000])


def noise(bag: Path) -> None:
    (bag / 'bag.mcap').write_bytes(bytes(range(256)) * 50)


def wrong_in_the_middle(bag: Path) -> None:
    file = bag / 'bag.mcap'
    content = bytearray(file.read_bytes())
    middle = len(content) // 3
    content[middle : middle + 500] = b'\xff' * 500
    file.write_bytes(content)


def bad_metadata(bag: Path) -> None:
    (bag / 'metadata.yaml').write_text('[' * 2000)


def other_metadata(bag: Path) -> None:
    (bag / 'metadata.yaml').write_text('rosbag2_bagfile_information: 3')


def no_files(bag: Path) -> None:
    (bag / 'bag.mcap').unlink()


def pipe(bag: Path) -> None:
    (bag / 'bag.mcap').unlink()
    os.mkfifo(bag / 'bag.mcap')


@pytest.mark.parametrize(
    ('damage', 'words'),
    [
        (without_metadata, 'no metadata.yaml; `ros2 bag reindex`'),
        (cut_off, 'not a bag that can be read'),
        (noise, 'not a bag that can be read'),
        (wrong_in_the_middle, 'bag'),
        (bad_metadata, 'not a bag that can be read'),
        (other_metadata, 'not a bag that can be read'),
        (no_files, 'not a bag that can be read'),
        (pipe, 'no regular file'),
    ],
)
def test_what_is_damaged_is_refused_in_one_line(
    bag: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], None],
    words: str,
) -> None:
    damage(bag)
    assert words in refusal([str(bag), '--policy', CASE_STUDY], capsys)


def test_what_is_no_bag_is_refused_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(tmp_path / 'pipe.mcap')
    for place, words in (
        ('nowhere', 'there is no such bag'),
        (str(ROOT / 'LICENSE'), 'no bag'),
        (str(ROOT), 'no bag: it has no metadata.yaml'),
        (str(tmp_path / 'pipe.mcap'), 'no bag'),
        ('/dev/null', 'no bag'),
        ('', 'no bag'),
        ('x' * 5000, ''),
    ):
        assert words in refusal([place, '--policy', CASE_STUDY], capsys)
    assert 'LICENSE' in refusal([str(bag), '--policy', str(ROOT / 'LICENSE')], capsys)


def test_a_bag_without_a_trace_says_what_it_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / 'bag', ['high'], topics=['/threat_level', '/odom'])
    line = refusal([str(bag), '--policy', CASE_STUDY], capsys)
    assert 'no manager/trace in it' in line
    assert '/odom, /threat_level' in line


def test_a_bag_of_another_mission_is_refused(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal([str(bag), '--policy', CASE_ONE], capsys)
    assert f'{bag}: at 0.00 s: recorded in a mission with other goals or another grid' in line


def test_a_trace_of_something_else_is_refused(
    tmp_path: Path, flight: Recorded, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = [*flight.entries[:4], 'hello', *flight.entries[4:]]
    line = refusal([str(write_bag(tmp_path / 'bag', entries)), '--policy', CASE_STUDY], capsys)
    assert 'at 0.20 s: no entry of a trace' in line


def test_without_the_library_it_says_what_to_install(bag: Path) -> None:
    code = (
        'import sys, importlib.util as u\n'
        'find = u.find_spec\n'
        'u.find_spec = lambda name, *rest: None if name == "rosbags" else find(name, *rest)\n'
        'from uav_mission_manager.cli.mission_replay import main\n'
        f'main([{str(bag)!r}, "--policy", {CASE_STUDY!r}])\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (1, '')
    assert done.stderr == 'mission_replay: needs rosbags: pip install rosbags\n'


def test_it_needs_no_ros(bag: Path) -> None:
    code = (
        'import sys\n'
        'sys.modules["rclpy"] = sys.modules["std_msgs"] = None\n'
        'from uav_mission_manager.cli.mission_replay import main\n'
        f'main([{str(bag)!r}, "--policy", {CASE_STUDY!r}])\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert ' different' in done.stdout.splitlines()[-1]


@pytest.mark.parametrize('port', ['65536', '-1', 'http'])
def test_a_port_that_is_none_is_refused(
    bag: Path, port: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main([str(bag), '--policy', CASE_STUDY, '--serve', f'--port={port}'])
    assert end.value.code == 2
    assert f"'{port}' is no port from 0 to 65535" in capsys.readouterr().err


def test_of_a_bag_with_nothing_but_a_trace_nothing_was_heard(bag: Path) -> None:
    flight = recorded_flight(bag, None)
    assert (flight.vehicle, flight.at(1e9)) == ('/uav1', Heard())


def test_of_a_bag_whose_topics_are_of_something_else_there_is_no_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('nicegui')
    bag = write_bag(tmp_path / 'bag', ['high'], topics=[TRACE, '/uav1/odom'])
    line = refusal([str(bag), '--policy', CASE_STUDY, '--serve', '--port=0'], capsys)
    assert f'{bag}: not a bag that can be read' in line
    assert 'no attribute' in line
