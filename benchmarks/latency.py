"""Input to command: how long the manager takes, beside a node that only echoes.

    make bench SCRIPTS=benchmarks/latency.py

A threat level is published and the changed command awaited, between processes, each time in
another situation; in turn with it a string is sent to a minimal rclpy node in a process of its
own, and its echo awaited, for noise to hit both alike. Writes latency.md; ends with exit code 1
where the manager takes more than it may. About four minutes.
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
from itertools import product
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from parts import pages
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String, UInt8MultiArray

sys.path.insert(0, str(pages.ROOT / 'test' / 'integration'))

from ros_helpers import ros_domain

from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.transport import without_shared_memory
from uav_mission_manager.policy import Policy, load_policy

MOST = {50.0: 1.5, 99.0: 2.0}
"""Ratio that the manager's time may have to that of the echo, by percentile."""

WARM_UP = 200
"""First samples of each that do not count: a choice, until caches and discovery have settled."""

GAPS = 0.008, 0.016
"""Time [s] between two samples: a choice, for what a node does after its answer to be over."""

LIMIT = 30.0
"""Time [s] after which an answer is missing: a choice, well above that of discovery."""

BATTERY_PERIOD = 0.5
"""Time [s] between two battery states, as of a bridge."""

HIGH = len(THREAT_LEVELS) - 1
"""The highest threat level t."""

POLICY = pages.ROOT / 'policies' / 'case_study'

MANAGER = {
    'policy': POLICY,
    'command_dwell': 0.0,
    'settling_time': 0.0,
    'listening_time': 0.0,
}
"""Parameters with which each input gives a command at once."""


Situation = tuple[int, tuple[int, ...], int]
"""Fault mode f, priorities g and cell l."""


def situations(policy: Policy) -> list[Situation]:
    """Situations with all goals in range where a high threat changes the command."""
    k, grid = policy.mission.k, policy.mission.grid

    def number(f: int, g: tuple[int, ...], cell: int, c: int, t: int, m: int) -> int:
        return policy.decide((f, *(1,) * k, *g, cell, c, t, m)).action.number

    return [
        (f, g, cell)
        for f in range(1, len(FAULT_MODES) + 1)
        for g in product(range(3), repeat=k)
        for cell in range(grid.q)
        if all(
            number(f, g, cell, c, 0, m) != number(f, g, cell, c, HIGH, m)
            for c in range(k + 1)
            for m in range(2)
        )
    ]


class Probe(Node):
    """Sends inputs and awaits what they bring."""

    def __init__(self, policy: Policy) -> None:
        super().__init__('probe')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)
        self._grid, self._situations = policy.mission.grid, situations(policy)
        self._chance = random.Random(0)
        self._heard = {'command': '', 'echo': '', 'state': ''}
        self._priorities = self.create_publisher(UInt8MultiArray, 'goal_priorities', qos.STATE_IN)
        self._fault = self.create_publisher(String, 'fault_mode', qos.STATE_IN)
        self._odometry = self.create_publisher(Odometry, 'odom', qos.SENSOR)
        self._battery = self.create_publisher(BatteryState, 'battery_state', qos.SENSOR)
        self._threat = self.create_publisher(String, 'threat_level', qos.STATE_IN)
        self._call = self.create_publisher(String, 'call', qos.STATE_IN)
        self.create_subscription(String, 'mission_command', self._hear('command'), qos.LATCHED)
        self.create_subscription(String, 'echo', self._hear('echo'), qos.LATCHED)
        self.create_subscription(
            DiagnosticArray, 'manager/decision', self._on_decision, qos.LATCHED
        )
        self.create_timer(BATTERY_PERIOD, self._charge)
        self._level, self._calls = 0, 0

    def _hear(self, name: str) -> Callable[[String], None]:
        def take(message: String) -> None:
            self._heard[name] = message.data

        return take

    def _on_decision(self, message: DiagnosticArray) -> None:
        values = {pair.key: pair.value for pair in message.status[0].values}
        self._heard['state'] = values.get('state', '')

    def _charge(self) -> None:
        message = BatteryState(percentage=0.9, voltage=16.0)
        message.header.stamp = self.get_clock().now().to_msg()
        self._battery.publish(message)

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
            self._say(self._situations[0])
            self._threat.publish(String(data=THREAT_LEVELS[0]))
            self._call.publish(String(data='there?'))
            return bool(self._heard['command'] and self._heard['echo'])

        self.until(asked, 'manager and echo', 0.1)

    def _say(self, situation: Situation) -> None:
        f, g, cell = situation
        self._fault.publish(String(data=FAULT_MODES[f - 1]))
        self._priorities.publish(UInt8MultiArray(data=g))
        message = Odometry()
        message.header.frame_id = 'map'
        message.header.stamp = self.get_clock().now().to_msg()
        message.pose.pose.position.x, message.pose.pose.position.y = self._grid.position(cell)
        self._odometry.publish(message)

    def move(self) -> None:
        """Come into another situation, and wait until the manager has decided in it."""
        situation = self._chance.choice(self._situations)
        self._say(situation)

        def decided() -> bool:
            if not self._heard['state']:
                return False
            f, *rest, cell, _, level, _ = map(int, self._heard['state'].split())
            g = tuple(rest[len(rest) // 2 :])
            return ((f, g, cell), level) == (situation, self._level)

        self.until(decided, f'a decision in {situation}')

    def threat(self) -> float:
        """Time [s] from a changed threat level to the changed command."""
        self._level = HIGH - self._level
        before = self._heard['command']
        start = time.perf_counter()
        self._threat.publish(String(data=THREAT_LEVELS[self._level]))
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

    def rest(self) -> None:
        """Let a random time pass."""
        end = time.monotonic() + self._chance.uniform(*GAPS)
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)


def serve_echo() -> int:
    """Answer every string with itself, in a process of its own."""
    rclpy.init()
    node = Node('echo')
    echo = node.create_publisher(String, 'echo', qos.LATCHED)
    node.create_subscription(String, 'call', echo.publish, qos.STATE_IN)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()
    return 0


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--samples', type=int, default=3000, help='of each; default: %(default)s')
    parser.add_argument('--manager', default='uav_mission_manager.nodes.manager', help='module')
    parser.add_argument('--echo', action='store_true', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.echo:
        return serve_echo()
    load = os.getloadavg()[0]
    times = _measure(options)
    ratios = {
        p: np.percentile(times['manager'], p) / np.percentile(times['echo'], p) for p in MOST
    }
    pages.publish(
        pages.folder(options) / 'latency.md', 'Latency', [INTRODUCTION, _table(times, load)]
    )
    return int(any(ratios[p] > most for p, most in MOST.items()))


def _measure(options: argparse.Namespace) -> dict[str, np.ndarray]:
    """Times [s] of manager and echo, in turn."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    without_shared_memory()
    parameters = [word for name, value in MANAGER.items() for word in ('-p', f'{name}:={value}')]
    with tempfile.TemporaryDirectory() as folder, ros_domain() as domain, ExitStack() as stack:
        os.environ |= {'ROS_HOME': folder, 'ROS_DOMAIN_ID': str(domain)}
        stack.enter_context(_process(folder, __file__, '--echo'))
        stack.enter_context(_process(folder, '-m', options.manager, '--ros-args', *parameters))
        rclpy.init()
        probe = Probe(load_policy(POLICY))
        probe.begin()
        times: dict[str, list[float]] = {'manager': [], 'echo': []}
        for _ in range(WARM_UP + options.samples):
            probe.move()
            for name, sample in (('manager', probe.threat), ('echo', probe.echo)):
                probe.rest()
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


INTRODUCTION = """\
Time from an input to the command that it changes, between processes: a threat level is published
and the new `mission_command` awaited. Before each sample fault mode, priorities and cell change at
random, so that the manager has seldom decided in the same state before. Beside it the time from a
string to its echo by a minimal rclpy node; both are taken in turn."""


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
