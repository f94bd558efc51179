"""Timers and time-outs go by a clock that no step of the system's time can stop or turn back."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros_helpers import Ros
from std_msgs.msg import UInt8MultiArray

from uav_mission_manager.nodes import qos

REPEATED = [
    ('manager', '/diagnostics', DiagnosticArray, qos.RELIABLE),
    ('mavlink_bridge', '/diagnostics', DiagnosticArray, qos.RELIABLE),
    ('base_station', 'goal_priorities', UInt8MultiArray, qos.STATE_IN),
]
ARGUMENTS = {
    'manager': (),
    'mavlink_bridge': ('-p', 'connection:=udpout:127.0.0.1:9'),
    'base_station': ('-p', 'priorities:=[1, 0, 0]'),
}


@pytest.mark.parametrize(('node', 'topic', 'kind', 'profile'), REPEATED)
def test_a_node_goes_on_when_ros_time_goes_back_and_stands(ros: Ros, node, topic, kind, profile):
    messages = ros.listen(topic, kind, profile)
    ros.start(f'nodes.{node}', '--ros-args', *ARGUMENTS[node])
    ros.until(lambda: messages, f'{topic} of {node}')
    assert ros.set_parameter(node, 'use_sim_time', True).successful
    count = len(messages)
    ros.until(lambda: len(messages) > count + 2, f'{topic} of {node} under stopped time')


@pytest.mark.parametrize(('node', 'topic', 'kind', 'profile'), REPEATED)
def test_a_node_goes_on_without_simulated_time(ros: Ros, node, topic, kind, profile):
    messages = ros.listen(topic, kind, profile)
    ros.start(f'nodes.{node}', '--ros-args', '-p', 'use_sim_time:=true', *ARGUMENTS[node])
    ros.until(lambda: len(messages) > 3, f'{topic} of {node}')
