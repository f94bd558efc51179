"""Whatever its link waits for, the bridge answers, tells and ends."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from ros_helpers import NodeProcess, Ros

from uav_mission_manager.nodes import qos

CONNECTIONS = [
    *(f'/dev/blocked-{call}' for call in ('open', 'recv', 'write', 'close')),
    'tcp:silent',
]


def silent_server() -> socket.socket:
    """A server that accepts nobody: whoever connects waits."""
    server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    server.bind(('127.0.0.1', 0))
    server.listen(0)
    for _ in range(2):
        peer = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        peer.setblocking(False)
        peer.connect_ex(server.getsockname())
        WAITING.append(peer)
    return server


PROMPT_TIME = 20.0
"""Seconds for what takes a few, on a busy machine; whatever waits for the link takes for ever."""

WAITING: list[socket.socket] = []


@pytest.fixture
def server():
    silent = silent_server()
    yield silent
    for each in (silent, *WAITING):
        each.close()
    WAITING.clear()


def start(ros: Ros, connection: str) -> NodeProcess:
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get('PYTHONPATH', '')])
    arguments = [
        f'connection:={connection}',
        f'mission:={Path(__file__).parents[2]}/config/case_study.yaml',
        'listening_time:=0.0',
    ]
    words = [word for argument in arguments for word in ('-p', argument)]
    process = NodeProcess(
        ros.domain, ros.folder, 'blocked_bridge', '--ros-args', *words, PYTHONPATH=path
    )
    ros.processes.append(process)
    return process


@pytest.mark.parametrize('connection', CONNECTIONS)
def test_hold_diagnostics_and_the_end_do_not_wait(ros: Ros, server, connection):
    diagnostics = ros.listen('/diagnostics', DiagnosticArray, qos.RELIABLE)
    connection = connection.replace('silent', f'127.0.0.1:{server.getsockname()[1]}')
    bridge = start(ros, connection)
    ros.until(lambda: diagnostics, 'diagnostics')
    answer = ros.call('mavlink_bridge/hold')
    assert 'holds when it is back' in answer.message
    count = len(diagnostics)
    ros.until(lambda: len(diagnostics) >= count + 4, 'diagnostics, every second', PROMPT_TIME)
    bridge.process.send_signal(signal.SIGTERM)
    assert bridge.process.wait(PROMPT_TIME) == 0
