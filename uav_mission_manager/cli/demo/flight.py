"""What the demo sees of a mission, and what it does to the vehicle."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import String

from uav_mission_manager.autopilot.task import Phase
from uav_mission_manager.cli.demo.stack import NAMESPACE
from uav_mission_manager.cli.demo.view import View
from uav_mission_manager.mdp import Mission
from uav_mission_manager.nodes import qos

INJECTION_PERIOD = 0.5
"""Time [s] after which a parameter that the simulator has not confirmed is set again: a choice."""


@dataclass
class ThreatArea:
    """A threat in one cell, or everywhere with `cell` None."""

    level: str = 'none'
    cell: int | None = None


class DemoFlight(Node):
    """Watches one mission, and plays the base station's operator, the enemy and the ground crew.

    Attributes
    ----------
    command, state : str, tuple of int
        The manager's last decision.
    cell, fault : int, str
        Where the vehicle is, and its fault mode.
    armed : bool
    asked, completed, refused : set of str, list of str, set of str
        Goals asked for; in order, achieved; given up.
    """

    def __init__(self, mission: Mission, crew_connection: str, view: View) -> None:
        super().__init__('demo', namespace=NAMESPACE)
        self.mission, self.view = mission, view
        self.command, self.fault = '', ''
        self.state: tuple[int, ...] = ()
        self.cell, self.armed = -1, False
        self.position = (float('nan'), float('nan'), float('nan'))
        self.phase = ''
        self.asked: set[str] = set()
        self.completed: list[str] = []
        self.refused: set[str] = set()
        self.threat = ThreatArea()
        self._crew = mavutil.mavlink_connection(crew_connection, source_system=255)
        self._injections: dict[str, float] = {}
        self._next_injection = 0.0
        self._priorities: list[int] | None = None
        self._threat_out = self.create_publisher(String, 'threat_level', qos.LATCHED)
        self._station = self.create_client(SetParameters, 'base_station/set_parameters')
        self._listen()
        self.create_timer(0.2, self._publish_threat)
        self.create_timer(0.1, self._work)

    def _listen(self) -> None:
        def listen(kind: Any, topic: str, callback: Any, profile: Any) -> None:
            self.create_subscription(kind, topic, callback, profile)

        listen(DiagnosticArray, 'manager/decision', self._on_decision, qos.LATCHED)
        listen(DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.RELIABLE)
        listen(Odometry, 'odom', self._on_odom, qos.SENSOR)
        listen(String, 'fault_mode', self._on_fault, qos.STATE_IN)
        listen(String, 'goal_completed', self._on_completed, qos.EVENT)
        listen(String, 'goal_refused', self._on_refused, qos.EVENT)

    def close(self) -> None:
        """Close the crew's link and the node."""
        self._crew.close()
        self.destroy_node()

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle stands disarmed."""
        return not self.armed and self.phase in (Phase.GROUND.value, Phase.HOLDING.value)

    @property
    def place(self) -> str:
        """Where the vehicle stands disarmed: 'home', 'at the service cell', or '' elsewhere."""
        grid = self.mission.grid
        places = {grid.service: 'at the service cell', grid.base: 'home'}
        return places.get(self.cell, '') if self.on_ground else ''

    @property
    def home(self) -> bool:
        """Whether the vehicle stands disarmed at the base."""
        return self.place == 'home'

    @property
    def over(self) -> set[str]:
        """Goals that were completed or refused."""
        return {*self.completed, *self.refused}

    def ask(self, /, **priorities: int) -> None:
        """As the base station, set the priorities of goals by name; the others become 0."""
        self.asked |= {name for name, priority in priorities.items() if priority}
        wanted = [priorities.get(goal.name, 0) for goal in self.mission.goals]
        self._priorities = wanted
        text = ', '.join(f'{name} {("0", "low", "high")[g]}' for name, g in priorities.items())
        self.view.event(f'base station: {text or "no goal"}')

    def meet(self, level: str, cell: int | None = None) -> None:
        """As the enemy, set the threat level in one cell, or everywhere."""
        self.threat = ThreatArea(level, cell)
        where = '' if cell is None else f' in cell {cell}'
        self.view.event(f'threat: {level}{where}')

    def inject(self, what: str, **parameters: float) -> None:
        """Set parameters of the simulated autopilot until it confirms them."""
        self._injections.update(parameters)
        self._next_injection = 0.0
        self.view.event(what)

    def _publish_threat(self) -> None:
        met = self.threat.cell in (None, self.cell)
        self._threat_out.publish(String(data=self.threat.level if met else 'none'))

    def _work(self) -> None:
        """Send what the base station and the crew have not sent yet."""
        if self._priorities is not None and self._station.service_is_ready():
            parameter = Parameter('priorities', value=self._priorities).to_parameter_msg()
            self._station.call_async(SetParameters.Request(parameters=[parameter]))
            self._priorities = None
        while (message := self._crew.recv_match(type='PARAM_VALUE')) is not None:
            self._injections.pop(message.param_id, None)
        if self._injections and time.monotonic() >= self._next_injection:
            self._next_injection = time.monotonic() + INJECTION_PERIOD
            for name, value in self._injections.items():
                self._crew.mav.param_set_send(
                    1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32
                )

    def _on_decision(self, message: DiagnosticArray) -> None:
        status = message.status[0]
        values = {pair.key: pair.value for pair in status.values}
        state = tuple(map(int, values['state'].split())) if 'state' in values else ()
        command = values.get('command', '')
        if (state, command) != (self.state, self.command):
            self.state, self.command = state, command
            self.view.decision(state, command or '(silent)', status.message, self._where())

    def _where(self) -> str:
        if self.cell < 0:
            return 'unknown'
        return f'cell {self.cell} ({", ".join(str(round(x)) for x in self.position)}) m'

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not status.name.startswith(f'{NAMESPACE}/mavlink_bridge'):
                continue
            values = {pair.key: pair.value for pair in status.values}
            self.armed = values.get('armed') == 'True'
            phase = values.get('phase', '')
            if phase != self.phase and status.level != DiagnosticStatus.OK:
                self.view.event(f'bridge: {status.message}')
            self.phase = phase

    def _on_odom(self, message: Odometry) -> None:
        position = message.pose.pose.position
        self.position = (position.x, position.y, position.z)
        self.cell = self.mission.grid.cell_at(position.x, position.y)

    def _on_fault(self, message: String) -> None:
        if message.data != self.fault:
            self.view.event(f'vehicle: fault mode {message.data}')
        self.fault = message.data

    def _on_completed(self, message: String) -> None:
        self.completed.append(message.data)
        self.view.event(f'vehicle: {message.data} completed')

    def _on_refused(self, message: String) -> None:
        if message.data not in self.refused:
            self.view.event(f'vehicle: {message.data} refused')
        self.refused.add(message.data)
