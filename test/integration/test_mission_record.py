"""The recorder: all that a vehicle's nodes say is in the bag, however the recorder ends."""

from __future__ import annotations

import itertools
import resource
import signal
from pathlib import Path

import pytest
from rclpy.qos import QoSProfile
from ros_helpers import NodeProcess, Ros
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.topics import TOPICS

OF_ROS = {'/parameter_events', '/rosout'}
STORE = get_typestore(Stores.ROS2_JAZZY)
TEXT = 'std_msgs/msg/String'


def record(ros: Ros, bag: Path) -> NodeProcess:
    process = ros.start('nodes.mission_record', '--ros-args', '-p', f'bag:={bag}')
    ros.until(lambda: process.lines('records into'), 'a recorder')
    return process


def texts(bag: Path, topic: str) -> list[str]:
    with Reader(bag) as reader:
        found = [m for each, _, m in reader.messages() if each.topic == topic]
        return [STORE.deserialize_cdr(m, TEXT).data for m in found]


def test_it_knows_all_topics_of_the_nodes(ros: Ros) -> None:
    for node in 'manager', 'base_station', 'mavlink_bridge', 'solver':
        ros.start(f'nodes.{node}')
    expected = {topic if topic.startswith('/') else f'/{topic}' for topic in TOPICS}

    def there() -> set[str]:
        topics = {name for name, _ in ros.node.get_topic_names_and_types()}
        return {t for t in topics if not t.endswith('/transition_event')} - OF_ROS

    ros.until(lambda: there() >= expected, 'all topics')
    assert there() == expected
    kinds = dict(ros.node.get_topic_names_and_types())
    for topic, kind in TOPICS.items():
        name = topic if topic.startswith('/') else f'/{topic}'
        assert [each.rpartition('/')[2] for each in kinds[name]] == [kind.__name__]


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_what_was_said_is_there_when_it_has_ended(ros: Ros, tmp_path: Path, number: int) -> None:
    publisher = ros.node.create_publisher(String, 'mission_command', qos.LATCHED)
    publisher.publish(String(data='before it was there'))
    process = record(ros, tmp_path / 'bag')
    ros.until(publisher.get_subscription_count, 'the recorder')
    loud = ros.node.create_publisher(BatteryState, 'battery_state', qos.SENSOR)
    ros.until(loud.get_subscription_count, 'the recorder of batteries')
    loud.publish(BatteryState(percentage=0.5))
    for count in range(50):
        publisher.publish(String(data=str(count)))
    assert publisher.wait_for_all_acked()
    ros.until(
        lambda: (
            (tmp_path / 'bag' / 'metadata.yaml').exists()
            and '49' in texts(tmp_path / 'bag', '/mission_command')
        ),
        'the last one saved',
    )
    publisher.publish(String(data='the last word'))
    assert publisher.wait_for_all_acked()
    assert process.stop(number) == 0
    heard = texts(tmp_path / 'bag', '/mission_command')
    assert heard[:51] == ['before it was there', *map(str, range(50))]
    with Reader(tmp_path / 'bag') as reader:
        offered = {each.topic: each.ext.offered_qos_profiles for each in reader.connections}
        [battery] = [m for each, _, m in reader.messages() if each.topic == '/battery_state']
    assert STORE.deserialize_cdr(battery, 'sensor_msgs/msg/BatteryState').percentage == 0.5
    for topic, reliability, durability in (
        ('/mission_command', QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL),
        ('/battery_state', QosReliability.BEST_EFFORT, QosDurability.VOLATILE),
    ):
        [profile] = offered[topic]
        assert (profile.reliability, profile.durability) == (reliability, durability)


@pytest.mark.parametrize('both_before', [True, False])
def test_two_who_offer_otherwise_are_both_heard_once(
    ros: Ros, tmp_path: Path, both_before: bool
) -> None:
    """One latches and one does not; who does not may come before the recorder or after it."""
    bag, numbers = tmp_path / 'bag', itertools.count()

    def heard() -> list[str]:
        return texts(bag, '/threat_level') if (bag / 'metadata.yaml').exists() else []

    def repeat() -> None:
        publisher = ros.node.create_publisher(String, 'threat_level', QoSProfile(depth=10))
        # A publisher may see the recorder before that one hears it.
        ros.node.create_timer(0.1, lambda: publisher.publish(String(data=str(next(numbers)))))

    latched = ros.node.create_publisher(String, 'threat_level', qos.LATCHED)
    latched.publish(String(data='latched'))
    if both_before:
        repeat()
    process = record(ros, bag)
    ros.until(lambda: 'latched' in heard(), 'what was latched')
    if not both_before:
        repeat()
    ros.until(lambda: set(heard()) > {'latched'}, 'both')
    latched.publish(String(data='latched later'))
    last = next(numbers)
    ros.until(lambda: {'latched later', str(last + 1)} <= set(heard()), 'both again')
    assert process.stop() == 0
    assert process.lines('incompatible QoS') == []
    assert len(heard()) == len(set(heard()))


def test_killed_it_leaves_a_whole_bag_and_the_next_one_makes_another(
    ros: Ros, tmp_path: Path
) -> None:
    publisher = ros.node.create_publisher(String, 'goal_completed', qos.EVENT)
    bag = tmp_path / 'bag'
    process = record(ros, bag)
    ros.until(publisher.get_subscription_count, 'the recorder')
    count = 0

    def say() -> None:
        nonlocal count
        publisher.publish(String(data=str(count)))
        count += 1

    ros.node.create_timer(0.01, say)
    ros.until(lambda: (bag / 'metadata.yaml').exists(), 'a save')
    for more in 100, 70, 30:
        known = len(texts(bag, '/goal_completed'))
        ros.until(lambda k=known, m=more: len(texts(bag, '/goal_completed')) > k + m, 'a save')
    known = len(texts(bag, '/goal_completed'))
    process.kill()
    heard = texts(bag, '/goal_completed')
    assert heard == list(map(str, range(int(heard[0]), int(heard[0]) + len(heard))))
    assert len(heard) >= known > 200
    second = record(ros, bag)
    ros.until(lambda: (tmp_path / 'bag-2' / 'metadata.yaml').exists(), 'another bag')
    assert second.stop() == 0
    assert texts(bag, '/goal_completed') == heard


def test_without_room_it_ends_in_one_line_and_nobody_else_does(ros: Ros, tmp_path: Path) -> None:
    station = ros.start('nodes.base_station')
    publisher = ros.node.create_publisher(String, 'goal_completed', qos.EVENT)
    process = record(ros, tmp_path / 'bag')
    ros.until(lambda: publisher.get_subscription_count() == 2, 'the recorder, and the station')
    publisher.publish(String(data='goal1'))
    ros.until(
        lambda: (
            (tmp_path / 'bag' / 'metadata.yaml').exists()
            and 'goal1' in texts(tmp_path / 'bag', '/goal_completed')
        ),
        'a save',
    )
    resource.prlimit(process.process.pid, resource.RLIMIT_FSIZE, (1000, 1000))
    publisher.publish(String(data='goal2'))
    assert process.wait() == 1
    [line] = process.lines('FATAL')
    assert f'recording ended: {tmp_path / "bag"}' in line
    assert 'cannot be written' in line
    assert 'Traceback' not in process.output
    assert 'goal1' in texts(tmp_path / 'bag', '/goal_completed')
    assert station.process.poll() is None


def test_a_place_that_cannot_be_is_refused_in_one_line(ros: Ros) -> None:
    process = ros.start('nodes.mission_record', '--ros-args', '-p', 'bag:=/proc/no/bag')
    assert process.wait() == 1
    [line] = process.lines('FATAL')
    assert '/proc/no' in line
