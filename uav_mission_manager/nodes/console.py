"""The console: a page for operators, of all vehicles that are heard."""

from __future__ import annotations

import re
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from uav_mission_manager.console import DEFAULT_OLD_AFTER, DEFAULT_PORT, page_serving
from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.messages import (
    DECISION_TOPIC,
    DIAGNOSTICS_TOPIC,
    FLEET_TOPIC,
    bridge_reports,
    shares_of,
)
from uav_mission_manager.console.policies import PolicyShelf
from uav_mission_manager.echo import quoted
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.console_inputs import VehicleEar
from uav_mission_manager.nodes.console_orders import OrderDesk
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.paths import expanded

PARAMETERS = (
    NodeParameter(
        'policy',
        '',
        'Directories of the policy sets that the managers use, separated by :',
        example='policies/case_study',
    ),
    NodeParameter(
        'host', '127.0.0.1', 'Address to serve the page on; others than this need a token'
    ),
    NodeParameter('port', DEFAULT_PORT, 'TCP port of the page; 0 is any that is free', 0, 65535),
    NodeParameter('token', '', 'Word without which nobody is let in; needed where others may ask'),
    NodeParameter(
        'old_after',
        DEFAULT_OLD_AFTER,
        'Age above which what was heard is shown as old [s]',
        0.5,
        60.0,
    ),
)

REST = 0.03
"""Time [s] between two looks at the topics of all vehicles: a choice, not to be seen on a page."""

SEARCH_PERIOD = 1.0
"""Time [s] between two looks for vehicles: a choice."""


class Console(Node):
    """Serves a page with map, command and reason, values, timeline and controls of each vehicle.

    It hears every manager below its own namespace, so in `/`, the default, all. The page is at
    http://HOST:PORT/ and loads nothing from elsewhere.
    """

    def __init__(self) -> None:
        super().__init__('console')
        p = declare(self, PARAMETERS)
        serving = page_serving()
        if not re.fullmatch(r'[\w-]*', p.token, re.ASCII):
            raise ValueError(
                f'parameter token: {quoted(p.token)} has other characters than letters, digits, '
                '- and _'
            )
        if not (p.token or serving.is_loopback(p.host)):
            raise ValueError(f'parameter token: not given; host {p.host} can be reached by others')
        steady = safety_clock()
        shelf = PolicyShelf([str(expanded(path)) for path in p.policy.split(':')])
        self._fleet = Fleet(shelf, time.monotonic, p.old_after)
        self._ears: dict[str, VehicleEar] = {}
        self._shares: dict[str, str] = {}
        self._stations: set[str] = set()
        OrderDesk(self, self._fleet)
        listener = serving.listening_socket(p.host, p.port)
        self.create_subscription(
            DiagnosticArray,
            DIAGNOSTICS_TOPIC,
            self._on_diagnostics,
            qos.RELIABLE,
            qos_overriding_options=qos.OVERRIDABLE,
        )
        self.create_timer(SEARCH_PERIOD, self._search, clock=steady)
        self._server = serving.PageServer(self._fleet, listener, p.token)
        place = f'[{p.host}]' if ':' in p.host else p.host
        self.get_logger().info(f'page: http://{place}:{listener.getsockname()[1]}/')

    def destroy_node(self) -> None:
        """Close the page, too."""
        self._server.close()
        super().destroy_node()

    def _search(self) -> None:
        """Listen to vehicles that were not there before."""
        own = self.get_namespace().rstrip('/')
        for name, _ in self.get_topic_names_and_types():
            vehicle = name.removesuffix(f'/{DECISION_TOPIC}')
            inside = vehicle == own or vehicle.startswith(f'{own}/')
            if vehicle != name and inside and vehicle not in self._ears:
                self._ears[vehicle] = VehicleEar(self, self._fleet, vehicle)
                self.get_logger().info(f'vehicle {vehicle or "/"}')
                self._ears[vehicle].take_share(self._shares.get(vehicle, ''))
            if name.startswith(f'{own}/') and name.endswith(f'/{FLEET_TOPIC}'):
                self._listen_to_station(name)

    def _listen_to_station(self, topic: str) -> None:
        """Hear which vehicle is given which goal by the base station of several."""
        if topic not in self._stations:
            self._stations.add(topic)
            self.create_subscription(DiagnosticArray, topic, self._on_shares, qos.LATCHED)

    def _on_shares(self, message: DiagnosticArray) -> None:
        self._shares.update(shares_of(message))
        for vehicle, words in self._shares.items():
            if vehicle in self._ears:
                self._ears[vehicle].take_share(words)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for vehicle, status in bridge_reports(message):
            if vehicle in self._ears:
                self._ears[vehicle].take_diagnostics(message.header, status)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Console, PARAMETERS, args, REST)


if __name__ == '__main__':
    sys.exit(main())
