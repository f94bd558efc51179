"""The base station: goal priorities as a live parameter, published as requests."""

from __future__ import annotations

import sys
import uuid
from dataclasses import replace

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import MultiArrayDimension, String, UInt8MultiArray

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.memory import STATE_DIR, open_journal
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.onboard.priority_request import PriorityRequest

PARAMETERS = (
    NodeParameter('mission', '', 'Mission file', path=True, example='config/case_study.yaml'),
    NodeParameter('rate', 1.0, 'Repetition rate [Hz]', 0.1, 20.0),
    STATE_DIR,
    LISTENING,
)

REQUESTED_PRIORITIES = NodeParameter(
    'priorities',
    [0],
    'Priority of each goal in mission order: 0 none, 1 low, 2 high',
    read_only=False,
)
"""Live parameter; its default is as many zeros as there are goals."""

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
        self._goals = tuple(goal.name for goal in mission.goals)
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
        self._request = self._last_request()
        self._begin()
        self.add_on_set_parameters_callback(self._check)
        self.add_post_set_parameters_callback(self._on_set)
        self._presence = Presence(self, 'base_station', settings.listening_time)
        self.create_timer(1.0 / settings.rate, self._publish, clock=safety_clock())

    def _last_request(self) -> PriorityRequest:
        """What the station before this one asked for, where that is known and of this mission."""
        try:
            record = self._journal.read()
            if record is None:
                return PriorityRequest(self._goals)
            if record.mission == self._journal.mission:
                return PriorityRequest(self._goals, record.state)
            trouble = f'{self._journal.path}: of a mission with other goals or another grid'
        except ValueError as error:
            trouble = str(error)
        self.get_logger().warning(f'{trouble}; not used: nothing was asked for')
        return PriorityRequest(self._goals)

    def _begin(self) -> None:
        """Go on with the last request, unless this station is given other priorities."""
        row = replace(REQUESTED_PRIORITIES, default=[0] * len(self._goals))
        given = declare(self, (row,)).priorities
        try:
            new = self._request.begin(given, _new_id())
        except ValueError as error:
            raise ValueError(f'parameter priorities: {error}') from error
        if new:
            self._tell()
        elif self._request.request:
            self._tell(
                f' goes on; achieved: {", ".join(self._request.achieved) or "nothing yet"}; '
                'to ask anew, set the parameter priorities'
            )
            asked = list(self._request.asked)
            self.set_parameters([RosParameter('priorities', value=asked)])

    def _tell(self, more: str = '') -> None:
        asked = list(self._request.asked)
        self.get_logger().info(f'priorities {asked}, request {self._request.request}{more}')

    def _check(self, parameters: list[RosParameter]) -> SetParametersResult:
        values = (p.value for p in parameters if p.name == 'priorities')
        fault = next(filter(None, map(self._request.fault_in, values)), '')
        reason = fault and f'parameter priorities: {fault}'
        return SetParametersResult(successful=not fault, reason=reason)

    def _on_set(self, parameters: list[RosParameter]) -> None:
        for parameter in parameters:
            if parameter.name == 'priorities':
                self._request.ask(parameter.value, _new_id())
                self._record()  # Whoever asks may see this process die before it speaks.
                self._tell()
                self._publish()

    def _on_completed(self, message: String) -> None:
        if self._request.complete(message.data):
            self._publish()

    def _publish(self) -> None:
        """Record the request, then say it: what has been heard is not forgotten."""
        if not self._request.request or self._presence.silent:
            return
        self._record()
        size = len(self._goals)
        message = UInt8MultiArray(data=self._request.priorities)
        message.layout.dim = [
            MultiArrayDimension(label=self._request.request, size=size, stride=size)
        ]
        self._publisher.publish(message)

    def _record(self) -> None:
        self._journal.write(self._request.memory)
        if self._journal.error:
            self.get_logger().warning(
                f'a station started again may not know this request: {self._journal.error}',
                throttle_duration_sec=COMPLAINT_PERIOD,
            )


def _new_id() -> str:
    """Id that no request of any station has: a manager takes a known one for a repetition."""
    return uuid.uuid4().hex


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(BaseStation, (*PARAMETERS, REQUESTED_PRIORITIES), args)


if __name__ == '__main__':
    sys.exit(main())
