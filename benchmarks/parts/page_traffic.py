"""What vehicles send to the console: the topics of manager, bridge and base station."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import BatteryState
from std_msgs.msg import String, UInt8MultiArray

from parts.pages import ROOT
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.reporting import decision_status
from uav_mission_manager.nodes.topics import TOPICS
from uav_mission_manager.onboard import Situation
from uav_mission_manager.policy import load_policy

POSITION_PERIOD, STATE_PERIOD = 0.1, 0.5
"""Times [s] between positions, and between battery states and fault modes, as of a bridge."""

EPOCH = 5.0
"""Time [s] in which each vehicle comes into another state: a choice, twice as often as it would in
the case study's cells at 5 m/s."""

PROFILES = {
    'odom': qos.SENSOR,
    'battery_state': qos.SENSOR,
    'fault_mode': qos.STATE_IN,
    'threat_level': qos.STATE_IN,
    'goal_priorities': qos.STATE_IN,
    'manager/decision': qos.LATCHED,
}


class Traffic(Node):
    """Vehicles `/v1` and so on, whose messages are spread over time."""

    def __init__(self, count: int) -> None:
        super().__init__('traffic')
        self._policy = load_policy(ROOT / 'policies' / 'case_study')
        self._situation = Situation(self._policy.mission)
        self._out = [
            {
                topic: self.create_publisher(TOPICS[topic], f'/v{n}/{topic}', profile)
                for topic, profile in PROFILES.items()
            }
            for n in range(1, count + 1)
        ]
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', qos.RELIABLE)
        self._charge, self._ticks = 0.99, 0
        self._step = STATE_PERIOD / count
        self.create_timer(POSITION_PERIOD, self._move)
        self.create_timer(self._step, self._say_next)

    def send_charge(self, charge: float) -> None:
        """Change the charge of the first vehicle."""
        self._charge = charge
        self._publish_charge(self._out[0])

    def _now(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def _publish_charge(self, out: dict[str, Any]) -> None:
        message = BatteryState(percentage=self._charge if out is self._out[0] else 0.5)
        message.header.stamp = self.get_clock().now().to_msg()
        out['battery_state'].publish(message)

    def _move(self) -> None:
        for number, out in enumerate(self._out):
            message, angle = Odometry(), 0.3 * self._now() + number
            message.header.frame_id = 'map'
            message.header.stamp = self.get_clock().now().to_msg()
            place = message.pose.pose.position
            place.x, place.y, place.z = 75 + 60 * math.cos(angle), -25 + 20 * math.sin(angle), 20.0
            message.pose.pose.orientation.w = 1.0
            out['odom'].publish(message)

    def _say_next(self) -> None:
        """One vehicle after the other says the rest; each other time what comes every second."""
        self._ticks += 1
        turn, number = divmod(self._ticks, len(self._out))
        out = self._out[number]
        self._publish_charge(out)
        out['fault_mode'].publish(String(data='nominal'))
        if turn % 2:
            out['threat_level'].publish(String(data='none'))
            out['goal_priorities'].publish(UInt8MultiArray(data=(1, 2, 1)))
            self._decide(number, out)
            self._diagnose(number)

    def _decide(self, number: int, out: dict[str, Any]) -> None:
        cell = int(self._now() / EPOCH + number) % self._policy.mission.grid.q
        decision = self._policy.decide((1, 1, 1, 1, 1, 2, 1, cell, 0, 0, 0))
        status = decision_status('decision', decision, self._situation, 0.0, self._policy.digest)
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        out['manager/decision'].publish(message)

    def _diagnose(self, number: int) -> None:
        facts = {'phase': 'en route', 'link': 'up', 'mode': 'GUIDED', 'armed': 'True'}
        status = DiagnosticStatus(
            name=f'/v{number + 1}/mavlink_bridge: autopilot',
            message='en route: commit goal2 normal',
            values=[KeyValue(key=key, value=value) for key, value in facts.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)
