"""What the page orders, as calls of services, parameters and messages; answers go back to it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
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

REPORTS = 5
"""How often a threat level is said: a choice, over half a second, as a reader that has just been
found may lose the first ones."""

ANSWER_TIME = 5.0
"""Time [s] for an answer, after which an order counts as lost: a choice."""

SERVICES = {
    'hold': 'mavlink_bridge/hold',
    'resume': 'mavlink_bridge/resume',
    'reload': 'manager/reload_policy',
}
"""Services of a vehicle by the order that calls them."""


@dataclass
class ServiceCall:
    """An order that waits for its service, and then for the answer."""

    order: OperatorOrder
    client: Client
    request: Any
    until: float
    future: Any = None

    def go_on(self, now: float) -> tuple[bool, str] | None:
        """Return whether it was done, and a word about it; None while it is not known."""
        if self.future is None and self.client.service_is_ready():
            self.future = self.client.call_async(self.request)
        if self.future is not None and self.future.done():
            return READINGS[type(self.request)](self.future.result())
        if now < self.until:
            return None
        waits = 'nobody offers' if self.future is None else 'no answer of'
        return False, f'{waits} {self.client.srv_name}'


@dataclass
class ThreatReport:
    """An order that waits for listeners, and is then said several times, for one may be lost."""

    order: OperatorOrder
    publisher: Publisher
    until: float
    left: int = REPORTS

    def go_on(self, now: float) -> tuple[bool, str] | None:
        """Return whether it was said, and a word about it; None while it is not yet."""
        level = THREAT_LEVELS[self.order.values[0]]
        if self.publisher.get_subscription_count() > 0:
            self.publisher.publish(String(data=level))
            self.left -= 1
        if not self.left:
            return True, f'told: {level}'
        return None if now < self.until else (False, f'nobody hears {self.publisher.topic_name}')


class OrderDesk:
    """Gives the orders of the page."""

    def __init__(self, node: Node, fleet: Fleet) -> None:
        self._node, self._fleet = node, fleet
        self._clients: dict[str, Client] = {}
        self._threats: dict[str, Publisher] = {}
        self._given: list[ServiceCall | ThreatReport] = []
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
        with suppress(Empty):
            while True:
                order = self._fleet.orders.get_nowait()
                words = f'{order.kind} {order.vehicle} {order.values or ""}'
                self._node.get_logger().info(f'ordered: {words}')
                self._given.append(self._begin(order))
        for given in list(self._given):
            if (end := given.go_on(self._fleet.clock())) is not None:
                self._given.remove(given)
                self._fleet.answer(given.order, *end)

    def _begin(self, order: OperatorOrder) -> ServiceCall | ThreatReport:
        until = self._fleet.clock() + ANSWER_TIME
        if order.kind == 'threat':
            return ThreatReport(order, self._threats[order.vehicle], until)
        if order.kind == 'priorities':
            name = f'{order.vehicle}/base_station/set_parameters'
            parameter = Parameter('priorities', value=list(order.values)).to_parameter_msg()
            request = SetParameters.Request(parameters=[parameter])
            return ServiceCall(order, self._client(SetParameters, name), request, until)
        client = self._client(Trigger, f'{order.vehicle}/{SERVICES[order.kind]}')
        return ServiceCall(order, client, Trigger.Request(), until)


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
