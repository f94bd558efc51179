"""The base station: goal priorities as a live parameter, published as requests."""

from __future__ import annotations

import sys

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.console.heard import PRIORITY
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.memory import STATE_DIR, open_journal, state_before
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.priority_parameter import (
    REQUESTED_PRIORITIES,
    PriorityParameter,
    priorities_message,
)
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.onboard.priority_request import PriorityRequest

PARAMETERS = (
    NodeParameter('mission', '', 'Mission file', path=True, example='config/case_study.yaml'),
    NodeParameter('rate', 1.0, 'Repetition rate [Hz]', 0.1, 20.0),
    STATE_DIR,
    LISTENING,
)

COMPLAINT_PERIOD = 30.0
"""Time [s] after which a request that cannot be recorded is told again: a choice."""


class BaseStation(Node):
    """Publishes its parameter `priorities`: one value a goal, 0 none, 1 low, 2 high.

    Setting it is a new request, published at once, and every request is repeated at `rate`, also
    by a station that is started again; the goals achieved by then stay achieved. In its first
    seconds it only listens whether another base station is there.
    """

    def __init__(self) -> None:
        super().__init__('base_station')
        settings = declare(self, PARAMETERS, later=(REQUESTED_PRIORITIES,))
        mission = load_mission(settings.mission)
        self._mission = mission
        self._journal = open_journal(self, settings.state_dir, 'base_station', mission)
        self._publisher = self.create_publisher(
            UInt8MultiArray,
            'goal_priorities',
            qos.STATE_IN,
            qos_overriding_options=qos.OVERRIDABLE,
        )
        self.create_subscription(
            String,
            'goal_completed',
            self._on_completed,
            qos.EVENT,
            qos_overriding_options=qos.OVERRIDABLE,
        )
        self.create_subscription(
            DiagnosticArray,
            'manager/decision',
            self._on_decision,
            qos.LATCHED,
            qos_overriding_options=qos.OVERRIDABLE,
        )
        memory, trouble = state_before(self._journal)
        if trouble:
            self.get_logger().warning(f'{trouble}; not used: nothing was asked for')
        self._request = PriorityRequest([goal.name for goal in mission.goals], memory)
        PriorityParameter(self, self._request, mission.k, self._on_asked)
        self._presence = Presence(self, 'base_station', settings.listening_time)
        self.create_timer(1.0 / settings.rate, self._publish, clock=safety_clock())

    def _on_asked(self) -> None:
        self._record()  # Whoever asks may see this process die before it speaks.
        self._publish()

    def _on_completed(self, message: String) -> None:
        if self._request.complete(message.data):
            self._publish()

    def _on_decision(self, message: DiagnosticArray) -> None:
        """Learn of goals that were requested in flight, unless it is another mission's manager."""
        keys = (pair.key for status in message.status for pair in status.values)
        names = [key.removesuffix(PRIORITY) for key in keys if key.endswith(PRIORITY)]
        goals = self._mission.goals
        if all(goal.slot or goal.name == name for goal, name in zip(goals, names)):
            self._request.learn(names)

    def _publish(self) -> None:
        """Record the request, then say it: what has been heard is not forgotten."""
        if not self._request.request or self._presence.silent:
            return
        self._record()
        self._publisher.publish(priorities_message(self._request))

    def _record(self) -> None:
        self._journal.write(self._request.memory)
        if self._journal.error:
            self.get_logger().warning(
                f'a station started again may not know this request: {self._journal.error}',
                throttle_duration_sec=COMPLAINT_PERIOD,
            )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(BaseStation, (*PARAMETERS, REQUESTED_PRIORITIES), args)


if __name__ == '__main__':
    sys.exit(main())
