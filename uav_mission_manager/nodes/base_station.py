"""The base station: goal priorities as a live parameter, published as requests."""

from __future__ import annotations

import sys
import uuid
from collections.abc import Sequence
from dataclasses import replace

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import MultiArrayDimension, String, UInt8MultiArray

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.runtime import run_node, safety_clock

PARAMETERS = (
    NodeParameter('mission', '', 'Mission file', path=True, example='config/case_study.yaml'),
    NodeParameter('rate', 1.0, 'Repetition rate [Hz]', 0.1, 20.0),
    LISTENING,
)

REQUESTED_PRIORITIES = NodeParameter(
    'priorities',
    [0],
    'Priority of each goal in mission order: 0 none, 1 low, 2 high',
    read_only=False,
)
"""Live parameter; its default is as many zeros as there are goals."""


class BaseStation(Node):
    """Publishes its parameter `priorities`: one value a goal, 0 none, 1 low, 2 high.

    A change is published at once, as a new request, and every request is repeated at `rate`. In
    its first seconds it only listens whether another base station is there.
    """

    def __init__(self) -> None:
        super().__init__('base_station')
        settings = declare(self, PARAMETERS, later=(REQUESTED_PRIORITIES,))
        self._goals = tuple(goal.name for goal in load_mission(settings.mission).goals)
        row = replace(REQUESTED_PRIORITIES, default=[0] * len(self._goals))
        priorities = declare(self, (row,)).priorities
        reason = self._fault_in(priorities)
        if reason:
            raise ValueError(reason)
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
        self._message: UInt8MultiArray | None = None
        self._presence = Presence(self, 'base_station', settings.listening_time)
        if any(priorities):  # A station that restarts with none must not end a mission.
            self._request(priorities)
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._on_set)
        self.create_timer(1.0 / settings.rate, self._publish, clock=safety_clock(self))

    def _fault_in(self, priorities: Sequence[int]) -> str:
        if len(priorities) != len(self._goals):
            return (
                f'parameter priorities: {len(priorities)} values, the mission has '
                f'{len(self._goals)} goals ({", ".join(self._goals)})'
            )
        for goal, value in zip(self._goals, priorities, strict=True):
            if value not in (0, 1, 2):
                return f'parameter priorities: {goal} is {value}, not 0, 1 or 2'
        return ''

    def _check(self, parameters: list[RosParameter]) -> SetParametersResult:
        reasons = (self._fault_in(p.value) for p in parameters if p.name == 'priorities')
        reason = next(filter(None, reasons), '')
        return SetParametersResult(successful=not reason, reason=reason)

    def _on_set(self, parameters: list[RosParameter]) -> None:
        for parameter in parameters:
            if parameter.name == 'priorities':
                self._request(parameter.value)

    def _request(self, priorities: Sequence[int]) -> None:
        # Unique across restarts, or a new station's first request could pass for a repetition.
        label = uuid.uuid4().hex
        self._message = UInt8MultiArray(data=priorities)
        self._message.layout.dim = [
            MultiArrayDimension(label=label, size=len(priorities), stride=len(priorities))
        ]
        self.get_logger().info(f'priorities {list(priorities)}, request {label}')
        self._publish()

    def _on_completed(self, message: String) -> None:
        """Set an achieved goal to 0 in the request, lest a restarted manager revive it."""
        if self._message is not None and message.data in self._goals:
            self._message.data[self._goals.index(message.data)] = 0

    def _publish(self) -> None:
        if self._message is not None and not self._presence.silent:
            self._publisher.publish(self._message)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(BaseStation, (*PARAMETERS, REQUESTED_PRIORITIES), args)


if __name__ == '__main__':
    sys.exit(main())
