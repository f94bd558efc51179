"""The chain of nodes with a real ArduCopter; see `real_autopilot`."""

from __future__ import annotations

import math
import signal
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from real_autopilot import ArduCopter, Wire, free_port
from ros_helpers import ROOT, NodeProcess, Ros
from scenarios import Chain, Order
from std_msgs.msg import String

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos

CASE_STUDY = ROOT / 'config' / 'case_study.yaml'
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
        hear('goal_active', String, qos.LATCHED, self._on_active)
        hear('fault_mode', String, qos.STATE_IN, self._on_fault)
        hear('/diagnostics', DiagnosticArray, qos.RELIABLE, self._on_diagnostics)

    def _on_command(self, message: String) -> None:
        if message.data != self.command:
            self.commands.append((self.now, message.data))

    def _on_active(self, message: String) -> None:
        self.active = message.data

    def _on_fault(self, message: String) -> None:
        self._fault, self._fault_at = message.data, self.now

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        if message.status[0].name.endswith(': autopilot'):
            self._status, self._status_at = message.status[0], self.now
            self.reasons = [self.value('goal_refused')]

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

    def answer(self, goal: str, why: str = '') -> None:
        topic = 'goal_failed' if why else 'goal_completed'
        text = f'{goal}: {why}' if why else goal
        self.ros.publish(topic, String(data=text), qos.EVENT)

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
