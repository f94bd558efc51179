"""The live parameter `priorities`: what an operator asks of a vehicle, or of a fleet."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from dataclasses import replace

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from std_msgs.msg import MultiArrayDimension, UInt8MultiArray

from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.onboard.priority_request import PriorityRequest

REQUESTED_PRIORITIES = NodeParameter(
    'priorities',
    [0],
    'Priority of each goal in mission order: 0 none, 1 low, 2 high',
    read_only=False,
)
"""The parameter's row; its default is as many zeros as there are goals."""


class PriorityParameter:
    """Declares the parameter; setting it is a new request.

    Parameters
    ----------
    node : Node
    request : PriorityRequest
        The last one, to go on with.
    goals : int
        Number of goals.
    asked : callable
        Is called after each new request.

    Raises
    ------
    ValueError
        If the node was given priorities that cannot be asked for.
    """

    def __init__(
        self, node: Node, request: PriorityRequest, goals: int, asked: Callable[[], None]
    ) -> None:
        self._node, self._request, self._asked = node, request, asked
        self._begin(goals)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._on_set)

    def close(self) -> None:
        """Take the parameter away again."""
        self._node.remove_on_set_parameters_callback(self._check)
        self._node.remove_post_set_parameters_callback(self._on_set)
        self._node.undeclare_parameter(REQUESTED_PRIORITIES.name)

    def _begin(self, goals: int) -> None:
        """Go on with the last request, unless this node is given other priorities."""
        row = replace(REQUESTED_PRIORITIES, default=[0] * goals)
        given = declare(self._node, (row,)).priorities
        try:
            new = self._request.begin(given, new_request_id())
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
            self._node.set_parameters([RosParameter('priorities', value=asked)])

    def _tell(self, more: str = '') -> None:
        asked, request = list(self._request.asked), self._request.request
        self._node.get_logger().info(f'priorities {asked}, request {request}{more}')

    def _check(self, parameters: list[RosParameter]) -> SetParametersResult:
        values = (p.value for p in parameters if p.name == 'priorities')
        fault = next(filter(None, map(self._request.fault_in, values)), '')
        reason = fault and f'parameter priorities: {fault}'
        return SetParametersResult(successful=not fault, reason=reason)

    def _on_set(self, parameters: list[RosParameter]) -> None:
        for parameter in parameters:
            if parameter.name == 'priorities':
                self._request.ask(parameter.value, new_request_id())
                self._asked()
                self._tell()


def new_request_id() -> str:
    """Id that no request of any station has: a manager takes a known one for a repetition."""
    return uuid.uuid4().hex


def priorities_message(request: PriorityRequest) -> UInt8MultiArray:
    """Return what a vehicle's manager is asked for."""
    values: Sequence[int] = request.priorities
    message, size = UInt8MultiArray(data=values), len(values)
    message.layout.dim = [MultiArrayDimension(label=request.request, size=size, stride=size)]
    return message
