"""Nodes whose neighbours die in the wrong moment."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from ros_helpers import Ros
from std_msgs.msg import UInt8MultiArray

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.transport import LOOPBACK_PROFILE, without_shared_memory

RANGE, PROFILES = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'FASTRTPS_DEFAULT_PROFILES_FILE'
TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'


@pytest.fixture
def half_made(ros: Ros):
    """Shared memory of all who may come, as one leaves it that dies while making it."""
    first = 7400 + 250 * ros.domain + 10
    paths = [Path(f'/dev/shm/fastrtps_port{port}') for port in range(first, first + 64)]
    for path in paths:
        path.write_bytes(bytes(500_000))
    yield
    for path in paths:
        path.unlink()


def test_it_starts_and_is_heard_all_the_same(ros, half_made):
    heard = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
    station = ros.start('nodes.base_station', '--ros-args', '-p', 'priorities:=[1, 0, 0]')
    ros.until(lambda: heard, 'priorities')
    maps = Path(f'/proc/{station.process.pid}/maps').read_text()
    assert '/dev/shm/fastrtps' not in maps
    assert station.stop() == 0


@pytest.mark.parametrize(
    ('given', 'expected'),
    [
        ({}, {TRANSPORTS: 'UDPv4'}),
        ({RANGE: 'SUBNET'}, {RANGE: 'SUBNET', TRANSPORTS: 'UDPv4'}),
        (
            {RANGE: 'LOCALHOST'},
            {RANGE: 'SYSTEM_DEFAULT', PROFILES: str(LOOPBACK_PROFILE), TRANSPORTS: 'UDPv4'},
        ),
        ({TRANSPORTS: 'LARGE_DATA'}, {TRANSPORTS: 'LARGE_DATA'}),
        ({RANGE: 'LOCALHOST', PROFILES: 'my.xml'}, {RANGE: 'LOCALHOST', PROFILES: 'my.xml'}),
    ],
)
def test_it_is_left_to_whoever_wants_it_otherwise(monkeypatch, given, expected):
    for name in (RANGE, PROFILES, TRANSPORTS):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    without_shared_memory()
    without_shared_memory()
    names = {RANGE, PROFILES, TRANSPORTS} & set(os.environ)
    assert {name: os.environ[name] for name in names} == expected
