"""A crew for a bridge in a process of its own: what manager, autopilot and pilot do to it."""

from __future__ import annotations

import math
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from ros_helpers import ROOT, NodeProcess, Ros, free_port
from sensor_msgs.msg import BatteryState, NavSatFix
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos

CASE_STUDY = ROOT / 'config' / 'case_study.yaml'
GRID = load_mission(CASE_STUDY).grid
SPEEDUP = 10
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
GOAL1, GOAL2 = (GRID.position(cell) for cell in (5, 3))
SERVICE = GRID.position(GRID.service)


class Crew:
    """The bridge, and a manager that repeats `command`, `pose` and `wanted`, if not None."""

    def __init__(self, ros: Ros, allow_arming: bool = True, **parameters: object) -> None:
        self.ros = ros
        self.port = free_port()
        settings = {
            'mission': CASE_STUDY,
            'connection': f'udpin:127.0.0.1:{self.port}',
            'goal_dwell': 1.0,
            'service_time': 1.0,
            'manager_timeout': 2.0,
            'rtl_delay': 3.0,
            'allow_arming': allow_arming,
            **parameters,
        }
        self._arguments = [
            part for key, value in settings.items() for part in ('-p', f'{key}:={value}')
        ]
        self.bridge = self.start_bridge()
        self.command: str | None = None
        self.pose: tuple[float, float] | None = None
        self.pose_stamp = 0.0
        self.wanted: list[int] | None = [1, 1, 1]
        self._goals = ros.node.create_publisher(UInt8MultiArray, 'goal_states', qos.LATCHED)
        self._poses = ros.node.create_publisher(PoseStamped, 'command_pose', qos.LATCHED)
        self._commands = ros.node.create_publisher(String, 'mission_command', qos.LATCHED)
        ros.node.create_timer(0.2, self._repeat)
        self.batteries = ros.listen('battery_state', BatteryState, qos.SENSOR)
        self.odom = ros.listen('odom', Odometry, qos.SENSOR)
        self.fixes = ros.listen('global_position', NavSatFix, qos.SENSOR)
        self.faults = ros.listen('fault_mode', String, qos.STATE_IN)
        self.completed = ros.listen('goal_completed', String, qos.EVENT)
        self.refused = ros.listen('goal_refused', String, qos.EVENT)
        self.diagnostics = ros.listen('/diagnostics', DiagnosticArray, qos.RELIABLE)

    def start_bridge(self) -> NodeProcess:
        self.bridge = self.ros.start('nodes.mavlink_bridge', '--ros-args', *self._arguments)
        return self.bridge

    def restart_bridge(self, number: int = signal.SIGKILL) -> None:
        """End the bridge, and start it as a supervisor does."""
        self.bridge.stop(number)
        self.diagnostics.clear()
        self.start_bridge()

    def change_goals(self, folder: Path) -> None:
        """Give the next bridge a mission with another goal."""
        mission = yaml.safe_load(CASE_STUDY.read_text())
        mission['goals'][0]['name'] = 'another'
        path = folder / 'another.yaml'
        path.write_text(yaml.safe_dump(mission))
        self._arguments += '-p', f'mission:={path}'

    def _repeat(self) -> None:
        if self.pose is not None:
            message = PoseStamped()
            message.header.frame_id = 'map'
            message.header.stamp.sec = round(self.pose_stamp)
            message.pose.position.x, message.pose.position.y = self.pose
            self._poses.publish(message)
        if self.wanted is not None:
            self._goals.publish(UInt8MultiArray(data=self.wanted))
        if self.command is not None:
            self._commands.publish(String(data=self.command))

    @property
    def status(self) -> DiagnosticStatus:
        return self.diagnostics[-1].status[0] if self.diagnostics else DiagnosticStatus()

    def value(self, key: str) -> str:
        return next((v.value for v in self.status.values if v.key == key), '')

    def distance(self, place: tuple[float, float]) -> float:
        if not self.odom:
            return math.inf
        position = self.odom[-1].pose.pose.position
        return math.hypot(position.x - place[0], position.y - place[1])

    @property
    def height(self) -> float:
        return self.odom[-1].pose.pose.position.z

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        return self.ros.until(condition, f'{what}; the bridge says {self.status.message!r}')

    def until_phase(self, phase: str) -> None:
        self.until(lambda: self.value('phase') == phase, phase)


class Chain(Crew):
    """The crew with a simulated autopilot, and a second ground link."""

    def __init__(self, ros: Ros, **parameters: object) -> None:
        super().__init__(ros, **parameters)
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.bind(('127.0.0.1', 0))
        self.ground.setblocking(False)
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.start_simulator()

    def start_simulator(self) -> None:
        origin = GRID.origin
        self.simulator = self.ros.start(
            'autopilot.sim_autopilot',
            '--connection',
            f'udpout:127.0.0.1:{self.port}',
            '--connection',
            f'udpout:127.0.0.1:{self.ground.getsockname()[1]}',
            f'--origin={origin.latitude},{origin.longitude},{origin.altitude}',
            f'--speedup={SPEEDUP}',
        )

    def until_down_at(self, place: tuple[float, float]) -> None:
        self.until(
            lambda: (
                self.value('armed') == 'False'
                and self.distance(place) < 5.0
                and abs(self.height) < 1.0
            ),
            f'landed at {place}',
        )

    def say(self, message: Any) -> None:
        """Send a message to the autopilot from the ground."""

        def address() -> Any:
            try:
                return self.ground.recvfrom(2048)[1]
            except BlockingIOError:
                return None

        self.ground.sendto(message.pack(self.mav), self.until(address, 'the simulator'))

    def set(self, name: str, value: float) -> None:
        self.say(
            mavlink.MAVLink_param_set_message(
                1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
            )
        )

    def close(self) -> None:
        self.ground.close()


class Dummy(Crew):
    """The crew with an autopilot that says what a test has it say, and answers no command."""

    def __init__(self, ros: Ros, **parameters: object) -> None:
        super().__init__(ros, **parameters)
        self.mode, self.armed, self.landed = 4, False, 1
        self.latitude = GRID.origin.latitude
        self.mute: set[str] = set()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(('127.0.0.1', self.port))
        self._socket.setblocking(False)
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        ros.node.create_timer(0.1, self._speak)

    def _speak(self) -> None:
        position = round(self.latitude * 1e7), round(GRID.origin.longitude * 1e7)
        for message in (
            mavlink.MAVLink_heartbeat_message(
                2, 3, 217 if self.armed else 81, self.mode, 4 if self.armed else 3, 3
            ),
            mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 15200, 0, 80, *[0] * 6),
            mavlink.MAVLink_gps_raw_int_message(0, 3, *[0] * 8),
            mavlink.MAVLink_ekf_status_report_message(831, *[0] * 5),
            mavlink.MAVLink_extended_sys_state_message(0, self.landed),
            mavlink.MAVLink_global_position_int_message(
                0, *position, round(GRID.origin.altitude * 1e3), *[0] * 4, 65535
            ),
        ):
            if message.get_type() not in self.mute:
                try:
                    self._socket.send(message.pack(self._mav))
                except ConnectionRefusedError:  # The bridge is not there yet.
                    return

    def say(self, message: Any) -> None:
        self._socket.send(message.pack(self._mav))

    def heard(self) -> set[int]:
        """Commands that have arrived, by number, but requests for streams."""
        messages: list[Any] = []
        try:
            while True:
                messages += self._mav.parse_buffer(self._socket.recv(2048)) or []
        except (BlockingIOError, ConnectionRefusedError):
            return {
                m.command for m in messages if m.get_type() in ('COMMAND_LONG', 'COMMAND_INT')
            } - {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}

    def close(self) -> None:
        self._socket.close()


def crews(kind: type, ros: Ros) -> Iterator[Callable[..., Any]]:
    """Yield what makes crews of a kind, and close them in the end."""
    made: list[Any] = []

    def make(**parameters: object) -> Any:
        made.append(kind(ros, **parameters))
        return made[-1]

    yield make
    for each in made:
        each.close()
