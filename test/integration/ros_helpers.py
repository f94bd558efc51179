"""Nodes under test run in processes of their own; tests speak to them over DDS only."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from uav_mission_manager.nodes.background import dying_with_parent
from uav_mission_manager.nodes.ending import NODES
from uav_mission_manager.nodes.transport import without_shared_memory

ROOT = Path(__file__).resolve().parents[2]
ONE_OF_A_KIND = (
    *('nodes.manager', 'nodes.base_station', 'nodes.mavlink_bridge'),
    'nodes.fleet',
)
CASE_STUDY = {
    **dict.fromkeys(('nodes.manager', 'nodes.console'), f'policy:={ROOT}/policies/case_study'),
    **dict.fromkeys(
        ('nodes.base_station', 'nodes.mavlink_bridge', 'nodes.solver'),
        f'mission:={ROOT}/config/case_study.yaml',
    ),
    'nodes.fleet': f'mission:={ROOT}/config/fleet.yaml',
    'nodes.mission_record': 'bag:=$ROS_HOME/bag',
}
"""Parameters that nodes need, for the shipped mission and a folder of the test's."""

NODES_HERE = tuple(n for n in NODES if n != 'mission_record' or find_spec('rosbags'))
"""Nodes that can be started here: the recorder needs the extra `record`."""

LIMIT = 600.0
"""Seconds before a condition that never comes true fails the test, on a slow and busy machine."""


@contextmanager
def ros_domain() -> Iterator[int]:
    """Reserve a ROS domain id on this machine: whoever holds its port has it."""
    for domain in random.sample(range(1, 101), 100):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as guard:
            try:
                guard.bind(('127.0.0.1', 6100 + domain))
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError('all 100 ROS domain ids are in use')


def free_port() -> int:
    """Return a UDP port that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        return int(probe.getsockname()[1])


class Heard(list[Any]):
    """The messages of a topic that were sent since the last `clear`, as far as they have come."""

    def __init__(self) -> None:
        super().__init__()
        self._since = 0

    def clear(self) -> None:
        """Forget what was sent up to now, also what is still on its way."""
        self._since = time.time_ns()
        super().clear()

    def take(self, message: Any, info: Any) -> None:
        """Keep a message, with what rclpy knows of it."""
        if info['source_timestamp'] >= self._since:
            self.append(message)


class NodeProcess:
    """`python -m MODULE ARGS...` with its output in a file, and with a test's own ROS_HOME.

    What a node keeps there, the next one of its kind finds in the same test, and in no other. It
    dies with the test's process: one left behind would be heard by whoever has its domain next.
    """

    def __init__(
        self, domain: int, folder: Path, module: str, *args: str, cwd: Path = ROOT, **env: str
    ) -> None:
        self.path = folder / f'{module.rsplit(".", 1)[-1]}-{time.monotonic_ns()}.log'
        with self.path.open('w') as output:
            self.process = subprocess.Popen(
                [sys.executable, '-m', module, *args],
                cwd=cwd,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=os.environ
                | {
                    'ROS_DOMAIN_ID': str(domain),
                    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                    'ROS_HOME': str(folder),
                    'PYTHONUNBUFFERED': '1',
                    **env,
                },
                preexec_fn=dying_with_parent(),
            )

    @property
    def output(self) -> str:
        """Everything printed and logged so far."""
        return self.path.read_text(errors='replace')

    def lines(self, text: str) -> list[str]:
        """Lines of output that contain `text`."""
        return [line for line in self.output.splitlines() if text in line]

    def wait(self) -> int:
        """Return the exit code once the process has ended by itself."""
        return self.process.wait(LIMIT)

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Send a signal and return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.wait()

    def kill(self) -> None:
        """End the process whatever it does."""
        self.process.kill()
        self.process.wait(LIMIT)


class Ros:
    """The test's side: a ROS node of its own, and the nodes under test it started."""

    def __init__(self, domain: int, folder: Path) -> None:
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        without_shared_memory()
        self.domain, self.folder = domain, folder
        self.processes: list[NodeProcess] = []
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node('test_peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}

    def start(self, module: str, *args: str, **env: str) -> NodeProcess:
        """Start a node: a module below uav_mission_manager, e.g. `nodes.manager`.

        Unless `args` say otherwise it has the shipped mission, and one of which there may be one
        does not listen for another.
        """
        needed = CASE_STUDY.get(module)
        if needed and not any(word.startswith(needed.partition('=')[0]) for word in args):
            args += '--ros-args', '-p', needed
        if module == 'nodes.mavlink_bridge' and not any('connection' in word for word in args):
            args += '--ros-args', '-p', f'connection:=udpin:127.0.0.1:{free_port()}'
        if module in ONE_OF_A_KIND and not any('listening_time' in word for word in args):
            args += '--ros-args', '-p', 'listening_time:=0.0'
        process = NodeProcess(
            self.domain, self.folder, f'uav_mission_manager.{module}', *args, **env
        )
        self.processes.append(process)
        return process

    def listen(self, topic: str, kind: Any, qos: QoSProfile) -> Heard:
        """Return a list that grows with every message."""
        messages = Heard()
        self.node.create_subscription(kind, topic, messages.take, qos)
        return messages

    def advertise(self, topic: str, kind: Any, qos: QoSProfile) -> None:
        """Make the publisher of `publish` early.

        A publisher sees its subscriber before that one sees it, and what is published in between
        is lost. Publishers are found in the order they are made: one whose message has arrived
        says that those before it have been found too.
        """
        self._publishers[topic] = self.node.create_publisher(kind, topic, qos)

    def publish(self, topic: str, message: Any, qos: QoSProfile) -> None:
        """Publish once, after a subscriber is there."""
        if topic not in self._publishers:
            self.advertise(topic, type(message), qos)
        publisher = self._publishers[topic]
        self.until(lambda: publisher.get_subscription_count() > 0, f'a subscriber of {topic}')
        publisher.publish(message)

    def repeat(
        self,
        topic: str,
        make: Callable[[], Any],
        qos: QoSProfile,
        period: float = 0.2,
    ) -> Any:
        """Publish `make()` while the test waits; None is left out. Returns the timer."""
        publisher = self.node.create_publisher(type(make()), topic, qos)

        def tick() -> None:
            message = make()
            if message is not None:
                publisher.publish(message)

        return self.node.create_timer(period, tick)

    def spin(self, seconds: float) -> None:
        """Let time pass, e.g. to see that nothing happens in it."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def until(
        self,
        condition: Callable[[], Any],
        what: str = 'condition',
        limit: float = LIMIT,
    ) -> Any:
        """Spin until `condition()` is true and return its value."""
        end = time.monotonic() + limit
        while not (value := condition()):
            if time.monotonic() > end:
                logs = '\n'.join(process.output[-3000:] for process in self.processes)
                raise AssertionError(f'{what}: not within {limit} s\n{logs}')
            self.executor.spin_once(timeout_sec=0.05)
        return value

    def call(self, service: str, request: Any = None, kind: Any = Trigger) -> Any:
        """Call a service once and return its response.

        A server that has not yet found its client drops the response. Clients are found in the
        order they are made: once a later one has been answered, the first one will be.
        """
        client = self.node.create_client(kind, service)
        probe = self.node.create_client(
            GetParameters, f'{service.rpartition("/")[0]}/get_parameters'
        )
        try:
            self.until(client.service_is_ready, f'service {service}')
            self.until(probe.service_is_ready, f'parameters beside {service}')
            self.until(lambda: self._answered(probe), f'an answer beside {service}')
            future = client.call_async(request or kind.Request())
            self.until(future.done, f'an answer of {service}')
            return future.result()
        finally:
            self.node.destroy_client(probe)
            self.node.destroy_client(client)

    def _answered(self, probe: Any) -> bool:
        """Whether a harmless call is answered within a second."""
        future, end = probe.call_async(GetParameters.Request()), time.monotonic() + 1.0
        while not future.done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)
        return future.done()

    def set_parameter(self, node: str, name: str, value: Any) -> Any:
        """Set a parameter of another node and return the SetParametersResult."""
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.call(f'{node}/set_parameters', request, SetParameters).results[0]

    def close(self) -> None:
        """End every process and this node."""
        for process in self.processes:
            process.kill()
        # An executor that still waits for what a node is made of can crash its destruction.
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
