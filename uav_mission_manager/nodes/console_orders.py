"""What the page orders, as calls of services, parameters and messages; answers go back to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from std_msgs.msg import String
from std_srvs.srv import Trigger

from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.orders import OperatorOrder
from uav_mission_manager.mdp import THREAT_LEVELS
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.command_outputs import NO_PUBLISHER_EVENTS

DESK_PERIOD = 0.1
"""Time [s] between two looks for orders: a choice, not felt by a hand."""

ANSWER_TIME = 5.0
"""Time [s] for an answer, after which an order counts as lost: a choice."""

SERVICES = {
    'hold': 'mavlink_bridge/hold',
    'resume': 'mavlink_bridge/resume',
    'reload': 'manager/reload_policy',
}
"""Services of a vehicle by the order that calls them."""


@dataclass
class Call:
    """An order that waits for its service, and then for the answer."""

    order: OperatorOrder
    client: Client
    request: Any
    until: float
    future: Any = None


class OrderDesk:
    """Gives the orders of the page."""

    def __init__(self, node: Node, fleet: Fleet) -> None:
        self._node, self._fleet = node, fleet
        self._clients: dict[str, Client] = {}
        self._threats: dict[str, Publisher] = {}
        self._calls: list[Call] = []
        node.create_timer(DESK_PERIOD, self._work, clock=safety_clock())

    def _open(self, vehicle: str) -> None:
        """Find the services of a vehicle, before they are needed: an early call may be lost."""
        for name in SERVICES.values():
            self._client(Trigger, f'{vehicle}/{name}')
        self._client(SetParameters, f'{vehicle}/base_station/set_parameters')
        self._threats[vehicle] = self._node.create_publisher(
            String,
            f'{vehicle}/threat_level',
            qos.STATE_IN,
            event_callbacks=NO_PUBLISHER_EVENTS,  # A manager hears latched ones, too.
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def _client(self, kind: Any, name: str) -> Client:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        return self._clients[name]

    def _work(self) -> None:
        for vehicle in self._fleet.attended - self._threats.keys():
            self._open(vehicle)
        while True:
            try:
                order = self._fleet.orders.get_nowait()
            except Empty:
                break
            self._node.get_logger().info(f'ordered: {order.kind} {order.vehicle} {order.values}')
            self._begin(order)
        for call in list(self._calls):
            if self._done(call):
                self._calls.remove(call)

    def _begin(self, order: OperatorOrder) -> None:
        if order.kind == 'threat':
            level = THREAT_LEVELS[order.values[0]]
            listeners = self._threats[order.vehicle].get_subscription_count()
            self._threats[order.vehicle].publish(String(data=level))
            self._fleet.answer(order, listeners > 0, f'told {listeners} listeners: {level}')
            return
        until = self._fleet.clock() + ANSWER_TIME
        if order.kind == 'priorities':
            name = f'{order.vehicle}/base_station/set_parameters'
            parameter = Parameter('priorities', value=list(order.values)).to_parameter_msg()
            request = SetParameters.Request(parameters=[parameter])
            self._calls.append(Call(order, self._client(SetParameters, name), request, until))
            return
        client = self._client(Trigger, f'{order.vehicle}/{SERVICES[order.kind]}')
        self._calls.append(Call(order, client, Trigger.Request(), until))

    def _done(self, call: Call) -> bool:
        """Go on with a call; return whether it has ended."""
        if call.future is None and call.client.service_is_ready():
            call.future = call.client.call_async(call.request)
        if call.future is not None and call.future.done():
            good, text = READINGS[type(call.request)](call.future.result())
            self._fleet.answer(call.order, good, text)
            return True
        if self._fleet.clock() < call.until:
            return False
        waits = 'nobody offers' if call.future is None else 'no answer of'
        self._fleet.answer(call.order, False, f'{waits} {call.client.srv_name}')
        return True


def _read_trigger(response: Trigger.Response) -> tuple[bool, str]:
    return response.success, response.message


def _read_parameters(response: SetParameters.Response) -> tuple[bool, str]:
    result = response.results[0]
    return result.successful, result.reason or 'asked for'


READINGS: dict[type, Callable[[Any], tuple[bool, str]]] = {
    Trigger.Request: _read_trigger,
    SetParameters.Request: _read_parameters,
}
"""Success and words of an answer, by the kind of its request."""
