"""Input to command: how long the manager takes, beside a node that only echoes.

    make bench SCRIPTS=benchmarks/latency.py

A threat level is published and the changed command awaited, between processes; in turn with it a
string is sent to a minimal rclpy node in a process of its own, and its echo awaited, for noise to
hit both alike. Meanwhile battery, position and fault mode flow as from a bridge. Writes
latency.md; ends with exit code 1 where the manager takes more than it may. About two minutes.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from parts import pages
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.nodes import qos

MOST = {50.0: 1.5, 99.0: 2.0}
"""Ratio that the manager's time may have to that of the echo, by percentile."""

WARM_UP = 200
"""First samples of each that do not count: a choice, until caches and discovery have settled."""

GAPS = 0.008, 0.016
"""Time [s] between two samples: a choice, for what a node does after its answer to be over."""

LIMIT = 30.0
"""Time [s] after which an answer is missing: a choice, well above that of discovery."""

BATTERY_RATE, ODOM_RATE, FAULT_RATE = 2.0, 10.0, 1.0
"""What a bridge sends [Hz]."""

MANAGER = {
    'policy': pages.ROOT / 'policies' / 'case_study',
    'command_dwell': 0.0,
    'settling_time': 0.0,
    'listening_time': 0.0,
}
"""Parameters with which each input gives a command at once."""


class Probe(Node):
    """Sends inputs and awaits what they bring."""

    def __init__(self) -> None:
        super().__init__('probe')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._heard = {'command': '', 'echo': ''}
        self._priorities = self.create_publisher(UInt8MultiArray, 'goal_priorities', qos.STATE_IN)
        self._threat = self.create_publisher(String, 'threat_level', qos.STATE_IN)
        self._call = self.create_publisher(String, 'call', qos.STATE_IN)
        self.create_subscription(String, 'mission_command', self._hear('command'), qos.LATCHED)
        self.create_subscription(String, 'echo', self._hear('echo'), qos.LATCHED)
        self._high, self._calls = False, 0

    def _hear(self, name: str) -> Callable[[String], None]:
        def take(message: String) -> None:
            self._heard[name] = message.data

        return take

    def until(self, condition: Callable[[], bool], what: str, poll: float = LIMIT) -> None:
        """Spin until it is true."""
        end = time.monotonic() + LIMIT
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f'{what}: not within {LIMIT:g} s')
            self._executor.spin_once(timeout_sec=poll)

    def begin(self) -> None:
        """Wait until both nodes answer."""

        def asked() -> bool:
            self._priorities.publish(UInt8MultiArray(data=[1, 1, 1]))
            self._call.publish(String(data='there?'))
            return self._heard['command'].startswith('commit') and bool(self._heard['echo'])

        self.until(asked, 'manager and echo', 0.1)

    def threat(self) -> float:
        """Time [s] from a changed threat level to the changed command."""
        self._high = not self._high
        before = self._heard['command']
        start = time.perf_counter()
        self._threat.publish(String(data='high' if self._high else 'none'))
        self.until(lambda: self._heard['command'] != before, 'another command')
        return time.perf_counter() - start

    def echo(self) -> float:
        """Time [s] from a string to its echo."""
        self._calls += 1
        text = f'call {self._calls}'
        start = time.perf_counter()
        self._call.publish(String(data=text))
        self.until(lambda: self._heard['echo'] == text, 'the echo')
        return time.perf_counter() - start

    def rest(self, seconds: float) -> None:
        """Let time pass."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)


def serve_echo(node: Node) -> None:
    """Answer every string with itself."""
    echo = node.create_publisher(String, 'echo', qos.LATCHED)
    node.create_subscription(String, 'call', echo.publish, qos.STATE_IN)


def serve_vehicle(node: Node) -> None:
    """Say what a bridge says of a vehicle at its base."""

    def repeat(topic: str, make: Callable[[], Any], profile: Any, rate: float) -> None:
        publisher = node.create_publisher(type(make()), topic, profile)
        node.create_timer(1.0 / rate, lambda: publisher.publish(make()))

    def odom() -> Odometry:
        message = Odometry()
        message.header.frame_id = 'map'
        message.header.stamp = node.get_clock().now().to_msg()
        return message

    def battery() -> BatteryState:
        message = BatteryState(percentage=0.9, voltage=16.0)
        message.header.stamp = node.get_clock().now().to_msg()
        return message

    repeat('battery_state', battery, qos.SENSOR, BATTERY_RATE)
    repeat('odom', odom, qos.SENSOR, ODOM_RATE)
    repeat('fault_mode', lambda: String(data='nominal'), qos.STATE_IN, FAULT_RATE)


SERVERS = {'echo': serve_echo, 'vehicle': serve_vehicle}
"""What this script is in processes of its own."""


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--samples', type=int, default=3000, help='of each; default: %(default)s')
    parser.add_argument('--manager', default='uav_mission_manager.nodes.manager', help='module')
    parser.add_argument('--serve', choices=SERVERS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        return _serve(options.serve)
    load = os.getloadavg()[0]
    times = _measure(options)
    ratios = {
        p: np.percentile(times['manager'], p) / np.percentile(times['echo'], p) for p in MOST
    }
    pages.publish(
        pages.folder(options) / 'latency.md', 'Latency', [INTRODUCTION, _table(times, load)]
    )
    return int(any(ratios[p] > most for p, most in MOST.items()))


def _serve(name: str) -> int:
    rclpy.init()
    node = Node(name)
    SERVERS[name](node)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()
    return 0


def _measure(options: argparse.Namespace) -> dict[str, np.ndarray]:
    """Times [s] of manager and echo, in turn."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', str(os.getpid() % 100 + 1))
    parameters = [word for name, value in MANAGER.items() for word in ('-p', f'{name}:={value}')]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        os.environ['ROS_HOME'] = folder
        for name in SERVERS:
            stack.enter_context(_process(folder, __file__, '--serve', name))
        stack.enter_context(_process(folder, '-m', options.manager, '--ros-args', *parameters))
        rclpy.init()
        probe = Probe()
        probe.begin()
        times: dict[str, list[float]] = {'manager': [], 'echo': []}
        chance = random.Random(0)
        for _ in range(WARM_UP + options.samples):
            for name, sample in (('manager', probe.threat), ('echo', probe.echo)):
                probe.rest(chance.uniform(*GAPS))
                times[name].append(sample())
        rclpy.shutdown()
    return {name: np.array(all_times[WARM_UP:]) for name, all_times in times.items()}


@contextmanager
def _process(folder: str, *words: str) -> Iterator[None]:
    """Run Python in a process of its own; its output is shown only where it ended by itself."""
    log = Path(folder) / f'{time.monotonic_ns()}.log'
    with log.open('wb') as output:
        process = subprocess.Popen(
            [sys.executable, *words], stdout=output, stderr=subprocess.STDOUT
        )
    try:
        yield
    finally:
        if process.poll() is not None:
            print(log.read_text(encoding='utf-8'), file=sys.stderr)
        process.terminate()
        process.wait()


INTRODUCTION = f"""\
Time from an input to the command that it changes, between processes: a threat level is published
and the new `mission_command` awaited. Beside it the time from a string to its echo by a minimal
rclpy node. Both are taken in turn, while battery ({BATTERY_RATE:g} Hz), position
({ODOM_RATE:g} Hz) and fault mode flow as from a bridge."""


def _table(times: dict[str, np.ndarray], load: float) -> str:
    rows = []
    for p, most in MOST.items():
        manager, echo = (np.percentile(times[name], p) for name in ('manager', 'echo'))
        label = 'median' if p == 50.0 else f'{p:g} % are below'
        ratio = f'{manager / echo:.2f}'
        rows.append([label, f'{manager * 1e3:.2f}', f'{echo * 1e3:.2f}', ratio, f'{most:g}'])
    table = pages.table(['', 'manager [ms]', 'echo [ms]', 'ratio', 'at most'], rows)
    count = len(times['manager'])
    return f'{table}\n\n{count} samples of each; load of the machine before: {load:.2f}.'


if __name__ == '__main__':
    raise SystemExit(main())
