"""One vehicle: its processes, which are killed and started again at once, and what is heard of it.

What is heard comes over DDS and over a second MAVLink link of the simulated autopilot, as a third
party hears it; nothing is asked of the code under test.
"""

from __future__ import annotations

import contextlib
import math
import signal
import socket
from collections.abc import Callable
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_helpers import ROOT, NodeProcess, Ros, free_port
from std_msgs.msg import String
from std_srvs.srv import Trigger

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos

MISSION, POLICY = ROOT / 'config' / 'case_study.yaml', ROOT / 'policies' / 'case_study'

KILLED = ('manager', 'mavlink_bridge', 'base_station')
"""Nodes that die."""

SPEEDUP = 5.0
"""Simulated seconds in a second: a choice, as fast as clocks of the nodes allow that run on."""

LISTENING_TIME = 0.5
"""`listening_time` of the nodes [s]: a choice, for more lives in an hour than by default."""

SERVICE_TIME = 8.0
"""`service_time` of the bridge [s]: a choice, longer than it takes to start again."""

PATIENCE = 60.0
"""`rtl_delay` of the bridge [s]: a choice, so long that no series of kills sends it home."""

ANSWER_TIME = 3.0
"""Time [s] after which a service that was asked is asked again: a choice."""

REPEAT_PERIOD = 1.0
"""Time [s] after which the crew's ground station, and the threat detector, say all again."""

QUEUE_TIME = 0.1
"""Time [s] in which what a killed node had sent arrives: a choice."""

BATTERY = 50.0
"""Capacity of the simulated battery [Ah]: a choice, so large that it brings no vehicle down whose
nodes die all the time."""

DISARM_DELAY = 10.0 * SPEEDUP
"""Time [s] after which the autopilot stops motors that idle on the ground, as a person may too:
ArduCopter's default by the clock of the nodes, which start again meanwhile."""

NEAR = 30.0
"""Distance [m] from the centre of a cell within which the vehicle is there: a choice."""

GUIDED, LAND, RTL = 4, 9, 6
"""ArduCopter's numbers of flight modes."""


class Chain:
    """Simulated autopilot, bridge, manager and base station, in a namespace and a folder."""

    def __init__(self, ros: Ros, number: int, given: tuple[int, ...] = ()) -> None:
        self.ros, self.namespace = ros, f'/uav{number}'
        self.folder = ros.folder / f'uav{number}'
        self.folder.mkdir(parents=True)
        self.mission = load_mission(MISSION)
        self.given = given
        self.threat = self.told_threat = 'none'  # now, and when the detector last spoke
        self.armed, self.mode = False, -1
        self.position, self.height = (math.nan, math.nan), math.nan
        self.ended: list[str] = []
        """Nodes that ended by themselves, or wrote a traceback, and what they said last."""
        self._ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._ground.bind(('127.0.0.1', 0))
        self._ground.setblocking(False)
        self._vehicle: Any = None
        self._mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._mav.robust_parsing = True
        self._said = -math.inf
        self._simulated = {'SIM_BATT_CAP_AH': BATTERY, 'DISARM_DELAY': DISARM_DELAY}
        self._detector = ros.node.create_publisher(
            String, self.topic('threat_level'), qos.STATE_IN
        )
        self.up = dict.fromkeys(KILLED, False)
        for name in KILLED:
            self.listen(f'presence/{name}', String, qos.EVENT, partial(self._on_presence, name))
        self._services = {
            name: ros.node.create_client(kind, self.topic(name))
            for name, kind in (
                ('base_station/set_parameters', SetParameters),
                ('mavlink_bridge/hold', Trigger),
                ('mavlink_bridge/resume', Trigger),
            )
        }
        self._arguments = self._parameters(free_port())
        self._processes = {name: self._begin(name) for name in self._arguments}

    def topic(self, name: str) -> str:
        """Return a topic's full name."""
        return f'{self.namespace}/{name}'

    def listen(self, topic: str, kind: Any, profile: Any, callback: Callable[[Any], None]) -> None:
        """Have a topic of the vehicle heard."""
        self.ros.node.create_subscription(kind, self.topic(topic), callback, profile)

    def _on_presence(self, name: str, _: String) -> None:
        self.up[name] = True

    # Processes

    def _parameters(self, port: int) -> dict[str, list[str]]:
        origin = self.mission.grid.origin
        links = (port, self._ground.getsockname()[1])
        common = {'state_dir': self.folder / 'state', 'listening_time': LISTENING_TIME}
        station: dict[str, object] = {'mission': MISSION, **common}
        if self.given:
            station['priorities'] = list(self.given)
        return {
            'sim_autopilot': [
                *(word for link in links for word in ('--connection', f'udpout:127.0.0.1:{link}')),
                f'--origin={origin.latitude},{origin.longitude},{origin.altitude}',
                f'--speedup={SPEEDUP}',
                '--camera',
            ],
            'mavlink_bridge': self._ros_arguments(
                mission=MISSION,
                connection=f'udpin:127.0.0.1:{port}',
                allow_arming=True,
                goal_dwell=1.0,
                service_time=SERVICE_TIME,
                rtl_delay=PATIENCE,
                **common,
            ),
            'manager': self._ros_arguments(policy=POLICY, **common),
            'base_station': self._ros_arguments(**station),
        }

    def _ros_arguments(self, **parameters: object) -> list[str]:
        words = [word for key, value in parameters.items() for word in ('-p', f'{key}:={value}')]
        return ['--ros-args', '-r', f'__ns:={self.namespace}', *words]

    def _begin(self, name: str) -> NodeProcess:
        package = 'autopilot' if name == 'sim_autopilot' else 'nodes'
        return NodeProcess(
            self.ros.domain,
            self.folder,
            f'uav_mission_manager.{package}.{name}',
            *self._arguments[name],
        )

    def kill(self, name: str, forget: bool = False) -> None:
        """Kill a node, and hear what it said last; it may have to `forget` what it wrote."""
        self._look(name)
        self._processes[name].kill()
        self.ros.spin(QUEUE_TIME)
        if forget:
            place = self.folder / 'state' / self.namespace.strip('/')
            (place / f'{name}.journal').unlink(missing_ok=True)

    def start(self, name: str) -> None:
        """Start a node again, as a supervisor does."""
        self.up[name] = False
        self._processes[name] = self._begin(name)

    def _look(self, name: str) -> None:
        process = self._processes[name]
        ended = process.process.poll() is not None
        if ended or 'Traceback' in process.output:
            end = f'exit code {process.process.returncode}' if ended else 'traceback'
            self.ended.append(f'{name}: {end}: {process.output[-600:]}')

    def close(self) -> None:
        """End everything."""
        for name in self._processes:
            self._look(name)
        for process in self._processes.values():
            process.process.send_signal(signal.SIGTERM)
        for process in self._processes.values():
            process.kill()
        self._ground.close()

    # What a crew can do

    def say(self, message: Any) -> None:
        """Send a message to the autopilot from a ground station."""
        if self._vehicle:
            self._ground.sendto(message.pack(self._mav), self._vehicle)

    def set_mode(self, mode: int) -> None:
        """Change the flight mode, as a pilot does."""
        enabled = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.say(mavlink.MAVLink_set_mode_message(1, enabled, mode))

    def simulate(self, name: str, value: float) -> None:
        """Set a parameter of the simulator, and see that it stays so."""
        self._simulated[name] = value
        self._set(name, value)

    def _set(self, name: str, value: float) -> None:
        self.say(
            mavlink.MAVLink_param_set_message(
                1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
            )
        )

    def ask_priorities(self, values: tuple[int, ...]) -> Any:
        """Send a request once; return its future."""
        message = Parameter('priorities', value=list(values)).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self._services['base_station/set_parameters'].call_async(request)

    def ask_bridge(self, service: str) -> Any:
        """Call ~/hold or ~/resume once; return its future."""
        return self._services[f'mavlink_bridge/{service}'].call_async(Trigger.Request())

    # What goes on

    def step(self, now: float) -> None:
        """Hear the vehicle, and let the detector speak."""
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self._vehicle = self._ground.recvfrom(4096)
                for message in self._mav.parse_buffer(data) or []:
                    self._hear(message)
        if now - self._said > REPEAT_PERIOD:
            self._said = now
            self._ask_streams()
            self.told_threat = self.threat
            self._detector.publish(String(data=self.threat))
            for name, value in self._simulated.items():
                self._set(name, value)
            if not self.armed:
                self._set('SIM_BATT_PCT', 100.0)  # Someone puts in another battery.
        for name, process in self._processes.items():
            if process.process.poll() is not None:
                self._look(name)
                self.start(name)

    def _ask_streams(self) -> None:
        for message, rate in (
            (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1.0),
            (mavlink.MAVLINK_MSG_ID_HEARTBEAT, 2.0),
        ):
            self.say(
                mavlink.MAVLink_command_long_message(
                    *(1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, message, 1e6 / rate),
                    *[0.0] * 5,
                )
            )

    def _hear(self, message: Any) -> None:
        kind, component = message.get_type(), message.get_srcComponent()
        if kind == 'HEARTBEAT' and component == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.mode = message.custom_mode
        elif kind == 'GLOBAL_POSITION_INT':
            origin = self.mission.grid.origin
            self.position = origin.to_local(message.lat / 1e7, message.lon / 1e7)
            self.height = message.alt / 1e3 - origin.altitude

    def far_from(self, cell: int) -> float:
        """Distance from the centre of a cell [m]."""
        return math.dist(self.position, self.mission.grid.position(cell))

    @property
    def aloft(self) -> bool:
        """Whether it is well above the ground."""
        return self.armed and self.height > 5.0
