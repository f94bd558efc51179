"""A vehicle that repeats its state, for tests of the manager's process."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from ros_helpers import ROOT, NodeProcess, Ros
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Header, MultiArrayDimension, String, UInt8MultiArray
from visualization_msgs.msg import MarkerArray

from uav_mission_manager import load_mission
from uav_mission_manager.nodes import qos

CASE_STUDY = ROOT / 'config' / 'case_study.yaml'
SHIPPED = ROOT / 'policies' / 'case_study'
AT_ONCE = '-p', 'settling_time:=0.0'
"""Inputs count at once, for tests of something else."""


def request(values: list[int], label: str = '') -> UInt8MultiArray:
    message = UInt8MultiArray(data=values)
    message.layout.dim = [MultiArrayDimension(label=label)] if label else []
    return message


class Flight:
    """A vehicle that repeats its state, and everything the manager says about it."""

    def __init__(self, ros: Ros) -> None:
        self.ros, self.grid = ros, load_mission(CASE_STUDY).grid
        self.charge, self.cell, self.fault = 0.9, 0, 'nominal'
        self.health = BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN
        self.silent = False
        self.stamp_offsets: dict[str, float] = {}
        """How old [s] the stamps of a topic are; without an entry there are none."""
        ros.advertise('goal_priorities', UInt8MultiArray, qos.STATE_IN)
        ros.advertise('goal_completed', String, qos.EVENT)
        ros.advertise('goal_refused', String, qos.EVENT)
        ros.advertise('threat_level', String, qos.STATE_IN)
        ros.advertise('policy_set', String, qos.LATCHED)
        ros.repeat('battery_state', self._battery, qos.SENSOR)
        ros.repeat('odom', self._odometry, qos.SENSOR)
        ros.repeat('fault_mode', self._fault, qos.STATE_IN)
        self.commands = ros.listen('mission_command', String, qos.LATCHED)
        self.poses = ros.listen('command_pose', PoseStamped, qos.LATCHED)
        self.goals = ros.listen('goal_states', UInt8MultiArray, qos.LATCHED)
        self.decisions = ros.listen('manager/decision', DiagnosticArray, qos.LATCHED)
        self.markers = ros.listen('manager/markers', MarkerArray, qos.LATCHED)
        self.diagnostics = ros.listen('/diagnostics', DiagnosticArray, qos.RELIABLE)

    def _battery(self) -> BatteryState | None:
        if self.silent:
            return None
        message = BatteryState(percentage=self.charge, power_supply_health=self.health)
        self._stamp(message.header, 'battery_state')
        return message

    def _odometry(self) -> Odometry | None:
        if self.silent:
            return None
        message = Odometry()
        message.header.frame_id = 'map'
        position = message.pose.pose.position
        position.x, position.y = self.grid.position(self.cell)
        self._stamp(message.header, 'odom')
        return message

    def _stamp(self, header: Header, topic: str) -> None:
        if topic in self.stamp_offsets:
            nanoseconds = time.time_ns() - round(self.stamp_offsets[topic] * 1e9)
            header.stamp.sec, header.stamp.nanosec = divmod(nanoseconds, 10**9)

    def _fault(self) -> String | None:
        return None if self.silent else String(data=self.fault)

    def start(self, *arguments: str) -> NodeProcess:
        """Start a manager with inputs that count at once, unless `arguments` say otherwise."""
        return self.ros.start('nodes.manager', '--ros-args', *AT_ONCE, *arguments)

    def until_asked(self, values: list[int], label: str = '') -> None:
        """Ask until it is known to be wanted: a first message may be lost."""

        def known() -> bool:
            self.ask(values, label)
            return bool(self.goals) and list(self.goals[-1].data) == values

        self.ros.until(known, f'priorities {values}')

    def ask(self, values: list[int], label: str = '') -> None:
        self.ros.publish('goal_priorities', request(values, label), qos.STATE_IN)

    def until_threat(self, level: str) -> None:
        """Report a threat until it is known: a first message may be lost."""

        def known() -> bool:
            self.threat(level)
            return any(p.key == 'threat_level' for p in self.diagnosis('inputs').values)

        self.ros.until(known, f'threat {level}')

    def until_threat_counts(self, level: int) -> None:
        """Wait for a decision with t in its state."""

        def counts() -> bool:
            state = self.decision().get('state', '').split()
            return bool(state) and state[-2] == str(level)

        self.ros.until(counts, f'threat {level}')

    def complete(self, goal: str) -> None:
        self.ros.publish('goal_completed', String(data=goal), qos.EVENT)

    def refuse(self, goal: str) -> None:
        self.ros.publish('goal_refused', String(data=goal), qos.EVENT)

    def threat(self, level: str) -> None:
        self.ros.publish('threat_level', String(data=level), qos.STATE_IN)

    def until_command(self, command: str) -> None:
        self.ros.until(
            lambda: self.commands and self.commands[-1].data == command, f'command {command!r}'
        )

    def until_target(self, x: float, y: float) -> None:
        def there() -> bool:
            position = self.poses[-1].pose.position
            return (position.x, position.y) == (x, y)

        self.ros.until(there, f'target {x}, {y}')

    def until_goals(self, values: list[int]) -> None:
        self.ros.until(
            lambda: self.goals and list(self.goals[-1].data) == values, f'goal_states {values}'
        )

    def decision(self) -> dict[str, str]:
        values = self.decisions[-1].status[0].values if self.decisions else ()
        return {pair.key: pair.value for pair in values}

    def diagnosis(self, part: str) -> DiagnosticStatus:
        """Return what the manager said last of a part of it; nothing if it has not yet."""
        said = (status for message in reversed(self.diagnostics) for status in message.status)
        mine = (status for status in said if status.name.endswith(f'manager: {part}'))
        return next(mine, DiagnosticStatus(level=DiagnosticStatus.STALE))

    def until_diagnosis(self, part: str, level: bytes, words: str) -> None:
        def seen() -> bool:
            status = self.diagnosis(part)
            return status.level == level and words in status.message

        self.ros.until(seen, f'diagnostics {part}: {words}')
