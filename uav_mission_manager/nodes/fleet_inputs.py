"""What the fleet's base station hears of its vehicles, as changes of the reports on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import String

from uav_mission_manager.autopilot.bridge import WARNING_PHASES
from uav_mission_manager.console.heard import decision_from
from uav_mission_manager.console.messages import (
    DECISION_TOPIC,
    DIAGNOSTICS_TOPIC,
    bridge_reports,
)
from uav_mission_manager.echo import shown
from uav_mission_manager.fleet import FleetDispatcher
from uav_mission_manager.mdp import StateSpace
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.complaints import Complaints
from uav_mission_manager.nodes.vehicle_inputs import NO_EVENTS

NOT_FLOWN = tuple(phase.value for phase in WARNING_PHASES)
"""Phases of a bridge in which the manager's command is not flown."""


class FleetInputs:
    """Subscribes to what managers decide and bridges do, and to what became of goals.

    Parameters
    ----------
    node : Node
    dispatcher : FleetDispatcher
        Has the reports.
    digest : str
        Of the policy set that all managers shall use; '' for any.
    time : callable
        Returns the time [s] that reports are of.
    changed : callable
        Is called after each change.
    """

    def __init__(
        self,
        node: Node,
        dispatcher: FleetDispatcher,
        digest: str,
        time: Callable[[], float],
        changed: Callable[[], None],
    ) -> None:
        self._node, self._dispatcher, self._digest = node, dispatcher, digest
        self._time, self._changed = time, changed
        self._space = StateSpace.of(dispatcher.mission)
        self._complaints = Complaints(lambda text: node.get_logger().warning(text))
        for vehicle in dispatcher.reports:
            self._hear(vehicle, DECISION_TOPIC, DiagnosticArray, qos.LATCHED, self._on_decision)
            self._hear(vehicle, 'goal_completed', String, qos.EVENT, self._on_completed)
            self._hear(vehicle, 'goal_refused', String, qos.EVENT, self._on_refused)
        node.create_subscription(
            DiagnosticArray,
            DIAGNOSTICS_TOPIC,
            self._on_diagnostics,
            qos.RELIABLE,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    @property
    def complaints(self) -> dict[str, str]:
        """What is wrong with what is heard, by vehicle."""
        self._complaints.flush()
        return self._complaints.current

    def _hear(self, vehicle: str, topic: str, kind: Any, profile: Any, heard: Any) -> None:
        self._node.create_subscription(
            kind,
            f'{vehicle}/{topic}',
            partial(heard, vehicle),
            profile,
            event_callbacks=NO_EVENTS,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def _on_decision(self, vehicle: str, message: DiagnosticArray) -> None:
        for status in message.status:
            try:
                heard = decision_from(status.message, _values(status))
                if heard.state:
                    self._space.check([heard.state])
                if heard.state and self._digest not in ('', heard.digest):
                    raise ValueError(f'policy set {shown(heard.digest)} is not {self._digest}')
            except ValueError as error:
                text = f'{vehicle}/{DECISION_TOPIC}: {shown(error)}'
                self._complaints.add(vehicle, text)
                self._note_decision(vehicle, (), text)
                continue
            self._complaints.settle(vehicle)
            self._note_decision(vehicle, heard.state, heard.reason)

    def _note_decision(self, vehicle: str, state: tuple[int, ...], reason: str) -> None:
        reports = self._dispatcher.reports
        now = self._time()
        reports[vehicle] = reports[vehicle].with_decision(state, reason, now)
        self._changed()

    def _on_completed(self, vehicle: str, message: String) -> None:
        if self._dispatcher.complete(message.data):
            self._node.get_logger().info(f'{vehicle} completed {message.data}')
            self._changed()

    def _on_refused(self, vehicle: str, message: String) -> None:
        if self._dispatcher.refuse(vehicle, message.data):
            self._node.get_logger().warning(f'{vehicle} refused {message.data}')
            self._changed()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        reports, now = self._dispatcher.reports, self._time()
        for vehicle, status in bridge_reports(message):
            if vehicle in reports:
                values = _values(status)
                altitude = _number(values.get('flight_altitude', ''))
                disobedience = _disobedience(status, values)
                reports[vehicle] = reports[vehicle].with_bridge(disobedience, altitude, now)
                self._changed()


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _disobedience(status: DiagnosticStatus, values: dict[str, str]) -> str:
    """Why a vehicle does not fly what its manager commands; '' where it does."""
    if values.get('link') != 'up':
        return 'no link to the autopilot'
    if values.get('phase') in NOT_FLOWN:
        return shown(status.message)
    if 'True' not in (values.get('armed'), values.get('allow_arming')):
        return 'on the ground, and allow_arming is false'
    return ''
