"""The chain of nodes with a real ArduCopter, whose dynamics ArduPilot simulates.

`ARDUCOPTER_BIN` names its executable, built for SITL. Its default parameters lie in the source
tree that it was built from, or in the folder that `ARDUCOPTER_DEFAULTS` names.
"""

from __future__ import annotations

import math
import os
import select
import signal
import socket
import struct
import subprocess
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from ros_helpers import ROOT, NodeProcess, Ros
from scenarios import Chain, Order
from std_msgs.msg import String

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos

CASE_STUDY = ROOT / 'config' / 'case_study.yaml'
BINARY = os.environ.get('ARDUCOPTER_BIN', '')
FRAMES = {'quad': ('+', ('copter.parm',)), 'hexa': ('hexa', ('copter.parm', 'copter-hexa.parm'))}
"""Model and default parameters by frame."""

FRESH = 2.5
"""Seconds after which what a node said is out of date."""

HEARING_TIME = 1.0
"""Seconds in which the bridge hears that the position is lost."""

BOOT_LIMIT = 120.0
"""Seconds, at most, until a booted autopilot is ready to arm in GUIDED; 43 were seen."""

BRIDGE = {
    'source_system': 245,
    'allow_arming': True,
    'goal_dwell': 1.0,
    'service_time': 3.0,
    'cruise_speed': 5.0,
    'agile_speed': 10.0,
    'manager_timeout': 3.0,
    'rtl_delay': 10.0,
}
"""Parameters of the bridge."""


def defaults_folder() -> Path:
    """Return where the default parameters lie."""
    beside = Path(BINARY).resolve().parents[3] / 'Tools' / 'autotest' / 'default_params'
    return Path(os.environ.get('ARDUCOPTER_DEFAULTS', beside))


def free_port() -> int:
    """Return a UDP port of this machine that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


class ArduCopter:
    """A running autopilot, with ports of its own made from a number."""

    def __init__(self, folder: Path, number: int, frame: str, home: str, serial0: str) -> None:
        model, files = FRAMES[frame]
        defaults = ','.join(str(defaults_folder() / name) for name in files)
        self.remote_control = free_port()
        self.folder = folder / 'arducopter'
        self.folder.mkdir()
        with (self.folder / 'output').open('w') as output:
            self._process = subprocess.Popen(
                [
                    *(BINARY, '-w', f'-I{number}', '--model', model, '--speedup', '1'),
                    *('--home', home, '--defaults', defaults, '--serial0', serial0),
                    *('--rc-in-port', str(self.remote_control)),
                ],
                cwd=self.folder,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10.0)


class Wire(threading.Thread):
    """UDP between autopilot and bridge, where a ground station listens and speaks too."""

    def __init__(self, bridge_port: int, record: Path) -> None:
        super().__init__(daemon=True)
        self.whole = True
        self.seen: deque[tuple[bool, Any, bool]] = deque()
        """From the vehicle or from the bridge; a message; whether it got through."""
        self._to_bridge = ('127.0.0.1', bridge_port)
        self._to_vehicle: Any = None
        self._vehicle, self._bridge = (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)
        )
        for side in (self._vehicle, self._bridge):
            side.bind(('127.0.0.1', 0))
        self.port = self._vehicle.getsockname()[1]
        self._ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._lock = threading.Lock()
        self._parsers = {True: mavlink.MAVLink(None), False: mavlink.MAVLink(None)}
        for parser in self._parsers.values():
            parser.robust_parsing = True
        self._record = record.open('wb')
        self._over = threading.Event()

    def say(self, message: Any) -> None:
        """Send a message of the ground station to the autopilot."""
        with self._lock:
            if self._to_vehicle:
                self._vehicle.sendto(message.pack(self._ground), self._to_vehicle)

    def forge(self, message: Any, v1: bool) -> None:
        """Send a message to the bridge as if the autopilot had."""
        data = message.pack(mavlink.MAVLink(None, 1, 1), force_mavlink1=v1)
        self._bridge.sendto(data, self._to_bridge)

    def run(self) -> None:
        """Pass on what comes, and be a ground station."""
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
        )
        next_beat = 0.0
        while not self._over.is_set():
            if time.monotonic() >= next_beat:
                next_beat = time.monotonic() + 1.0
                self.say(beat)
            for side in select.select([self._vehicle, self._bridge], [], [], 0.1)[0]:
                self._pass_on(side)
        self._record.close()

    def _pass_on(self, side: socket.socket) -> None:
        data, address = side.recvfrom(4096)
        from_vehicle, through = side is self._vehicle, self.whole
        if from_vehicle:
            self._to_vehicle = address
        for message in self._parsers[from_vehicle].parse_buffer(data) or []:
            if message.get_type() != 'BAD_DATA':
                self.seen.append((from_vehicle, message, through))
                self._record.write(struct.pack('>Q', round(time.time() * 1e6)))
                self._record.write(message.get_msgbuf())
        if through and from_vehicle:
            self._bridge.sendto(data, self._to_bridge)
        elif through and self._to_vehicle:
            self._vehicle.sendto(data, self._to_vehicle)

    def close(self) -> None:
        """Stop."""
        self._over.set()
        self.join()
        self._vehicle.close()
        self._bridge.close()


class RealChain(Chain):
    """Nodes and autopilot in processes of their own, in real time."""

    real = True

    def __init__(
        self,
        ros: Ros,
        frame: str = 'quad',
        mission: Path = CASE_STUDY,
        policy: Path = ROOT / 'policies' / 'case_study',
        tcp: bool = False,
        **parameters: object,
    ) -> None:
        super().__init__(load_mission(mission))
        self.ros, self.frame, self._policy, self._tcp = ros, frame, policy, tcp
        self._number = 100 + ros.domain  # Clear of the ports of those who count from 0.
        self.ordered_blindly: list[Order] = []
        self._located_at = -math.inf
        self.values: dict[str, float] = {}
        self._status = DiagnosticStatus()
        self._status_at = self._fault_at = -math.inf
        self._fault = ''
        port = free_port()
        self.wire = Wire(port, ros.folder / 'wire.tlog')
        self.autopilot: ArduCopter | None = None
        self._listen()
        self._settings = {
            'mission': mission,
            'connection': (
                f'tcp:127.0.0.1:{5760 + 10 * self._number}' if tcp else f'udpin:127.0.0.1:{port}'
            ),
            **BRIDGE,
            **parameters,
        }
        self.start_bridge()
        self._start('base_station', mission=mission)
        self.start_manager()
        self.wire.start()

    def _start(self, node: str, **parameters: object) -> NodeProcess:
        arguments = [p for name, value in parameters.items() for p in ('-p', f'{name}:={value}')]
        return self.ros.start(f'nodes.{node}', '--ros-args', *arguments)

    def _listen(self) -> None:
        def hear(topic: str, kind: Any, profile: Any, callback: Any) -> None:
            self.ros.node.create_subscription(kind, topic, callback, profile)

        hear('mission_command', String, qos.LATCHED, self._on_command)
        hear('goal_completed', String, qos.EVENT, lambda m: self.completed.append(m.data))
        hear('goal_refused', String, qos.EVENT, lambda m: self.refused.append(m.data))
        hear('fault_mode', String, qos.STATE_IN, self._on_fault)
        hear('/diagnostics', DiagnosticArray, qos.RELIABLE, self._on_diagnostics)

    def _on_command(self, message: String) -> None:
        if message.data != self.command:
            self.commands.append((self.now, message.data))

    def _on_fault(self, message: String) -> None:
        self._fault, self._fault_at = message.data, self.now

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if message.status[0].name.endswith(': autopilot'):
            self._status, self._status_at = message.status[0], self.now

    def launch(self) -> None:
        """Start the autopilot: on the wire, or with a TCP server for the bridge alone."""
        self.autopilot = ArduCopter(
            self.ros.folder,
            self._number,
            self.frame,
            f'{self.origin.latitude},{self.origin.longitude},{self.origin.altitude},353',
            'tcp:0' if self._tcp else f'udpclient:127.0.0.1:{self.wire.port}',
        )

    def until_ready(self) -> None:
        """Wait until nodes and autopilot are up."""

        def up() -> bool:
            ended = [p.output for p in self.ros.processes if p.process.poll() is not None]
            assert not ended, ended[0]
            return bool(self.ready and self.located and self.phase)

        self.until(up, 'ready', BOOT_LIMIT)

    def close(self) -> None:
        """End autopilot and wire; the nodes end with the ROS domain."""
        if self.autopilot:
            self.autopilot.stop()
        self.wire.close()

    # What a crew can do

    def want(self, *priorities: int) -> None:
        assert self.ros.set_parameter('base_station', 'priorities', list(priorities)).successful

    def spend(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self.ros.executor.spin_once(timeout_sec=0.02)
            while self.wire.seen:
                from_vehicle, message, through = self.wire.seen.popleft()
                if not from_vehicle:
                    self.watch_bridge(message)
                elif message.get_type() == 'PARAM_VALUE':
                    self.values[message.param_id] = message.param_value
                else:
                    self.watch_vehicle(message, through)

    def set(self, name: str, value: float) -> None:
        self.values.pop(name, None)
        for _ in range(5):
            self.say(
                mavlink.MAVLink_param_set_message(
                    1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
                )
            )
            end = self.now + 2.0
            while name not in self.values and self.now < end:
                self.spend(0.02)
            if math.isclose(self.values.get(name, math.nan), value, rel_tol=1e-5):
                return
        raise AssertionError(f'{name}: no such parameter, or it does not take {value}')

    def say(self, message: Any) -> None:
        self.wire.say(message)

    def forge(self, message: Any, v1: bool = False) -> None:
        self.wire.forge(message, v1)

    def cut(self) -> None:
        self.wire.whole = False

    def mend(self) -> None:
        self.wire.whole = True

    def stall(self, seconds: float) -> None:
        self.bridge.process.send_signal(signal.SIGSTOP)
        try:
            self.spend(seconds)
        finally:
            self.bridge.process.send_signal(signal.SIGCONT)

    def kill_manager(self) -> None:
        self._manager.kill()

    def start_manager(self) -> None:
        self._manager = self._start('manager', policy=self._policy)

    def start_bridge(self) -> None:
        """Start the bridge, anew if it was killed."""
        self.bridge = self._start('mavlink_bridge', **self._settings)

    def hold(self) -> tuple[bool, str]:
        answer = self.ros.call('mavlink_bridge/hold')
        return answer.success, answer.message

    def resume(self) -> tuple[bool, str]:
        answer = self.ros.call('mavlink_bridge/resume')
        return answer.success, answer.message

    # What goes over the wire

    def watch_vehicle(self, message: Any, to_the_bridge: bool) -> None:
        super().watch_vehicle(message, to_the_bridge)
        if self.located:
            self._located_at = self.now

    def watch_bridge(self, message: Any) -> None:
        before = len(self.orders)
        super().watch_bridge(message)
        if self.now - self._located_at > HEARING_TIME:
            self.ordered_blindly += self.orders[before:]

    # What the nodes say

    @property
    def now(self) -> float:
        return time.monotonic()

    def value(self, key: str) -> str:
        """Return a value of the bridge's diagnostics, '' while they are out of date."""
        if self.now - self._status_at > FRESH:
            return ''
        return next((v.value for v in self._status.values if v.key == key), '')

    @property
    def phase(self) -> str:
        return self.value('phase')

    @property
    def report(self) -> tuple[bool, str]:
        return self._status.level >= DiagnosticStatus.WARN, self._status.message

    @property
    def fault(self) -> str:
        return self._fault if self.now - self._fault_at <= FRESH else ''
