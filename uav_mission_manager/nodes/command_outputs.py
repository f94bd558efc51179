"""What the manager publishes: goals, command and pose, and after them why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Header, String, UInt8MultiArray
from visualization_msgs.msg import MarkerArray

from uav_mission_manager.frames import vehicle_name
from uav_mission_manager.mdp import Mission
from uav_mission_manager.nodes import qos, reporting
from uav_mission_manager.nodes.clocks import safety_clock
from uav_mission_manager.nodes.markers import MarkerScene
from uav_mission_manager.onboard import Refusal, Situation, format_command
from uav_mission_manager.policy import Decision

NO_PUBLISHER_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""A subscriber that does not suit is told so itself; rclpy looks for each such event before it
looks for messages, so a command would wait for it."""

MARKER_PERIOD = 0.2
"""Time [s] between two drawings of markers, at least: a choice, smooth enough to an eye. They take
longer than a decision, and the next one shall not wait for them."""

UNNAMED_VEHICLE = 'vehicle'
"""What the diagnostics call the hardware of a vehicle without a namespace."""


class CommandOutputs:
    """Publishes what changed, or everything when it is time to repeat it.

    Attributes
    ----------
    scene : MarkerScene
        Is to be told where the vehicle is.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        vehicle = vehicle_name(node.get_namespace())
        self._hardware = vehicle or UNNAMED_VEHICLE
        self.scene = MarkerScene(vehicle)
        self._command = ''
        self._destination: int | None = None
        self._goals: tuple[int, ...] = ()
        self._command_out = self._output(String, 'mission_command')
        self._pose_out = self._output(PoseStamped, 'command_pose')
        self._goals_out = self._output(UInt8MultiArray, 'goal_states')
        self._decision_out = self._output(DiagnosticArray, '~/decision')
        self._markers_out = self._output(MarkerArray, '~/markers')
        self._diagnostics_out = self._output(DiagnosticArray, '/diagnostics', qos.RELIABLE)
        self._trace_out = self._output(String, '~/trace', qos.TRACE)
        self._undrawn: tuple[Decision | Refusal, Situation, str] | None = None
        node.create_timer(MARKER_PERIOD, self._draw, clock=safety_clock())

    def _output(self, kind: Any, topic: str, profile: QoSProfile | None = None) -> Publisher:
        return self._node.create_publisher(
            kind,
            topic,
            profile or qos.LATCHED,
            event_callbacks=NO_PUBLISHER_EVENTS,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def _header(self) -> Header:
        return Header(stamp=self._node.get_clock().now().to_msg())

    def goals(self, priorities: tuple[int, ...], repeat: bool) -> None:
        """Publish what is wanted; call it before the command that follows from it."""
        if repeat or priorities != self._goals:
            self._goals = priorities
            self._goals_out.publish(UInt8MultiArray(data=priorities))

    def command(self, mission: Mission, decision: Decision, repeat: bool) -> bool:
        """Publish a decision's command, and where it leads before it; return if it is new."""
        action, command = decision.action, format_command(mission, decision.action)
        changed = command != self._command
        if repeat or changed:
            if repeat or action.destination != self._destination:
                pose = reporting.cell_pose(mission.grid, action.destination, self._header().stamp)
                self._pose_out.publish(pose)
            self._command_out.publish(String(data=command))
            self._command, self._destination = command, action.destination
        return changed

    def silence(self) -> bool:
        """Publish no command; return if there was one before."""
        changed = bool(self._command)
        self._command, self._destination = '', None
        return changed

    def explain(
        self, outcome: Decision | Refusal, situation: Situation, now: float, digest: str
    ) -> None:
        """Publish why it was decided so, and soon the markers."""
        header, name = self._header(), f'{self._node.get_fully_qualified_name()}: decision'
        status = reporting.decision_status(name, outcome, situation, now, digest)
        status.hardware_id = self._hardware
        self._decision_out.publish(DiagnosticArray(header=header, status=[status]))
        self._undrawn = outcome, situation, digest

    def _draw(self) -> None:
        """Publish markers of the last decision that has none yet."""
        if self._undrawn is None:
            return
        (outcome, situation, digest), self._undrawn = self._undrawn, None
        charge, stamp = reporting.charge_left(situation), self._header().stamp
        self._markers_out.publish(self.scene.draw(outcome, situation, charge, digest, stamp))

    def diagnose(self, statuses: Sequence[DiagnosticStatus]) -> None:
        """Publish how the node is."""
        for status in statuses:
            status.hardware_id = self._hardware
        self._diagnostics_out.publish(DiagnosticArray(header=self._header(), status=statuses))

    def trace(self, entry: str) -> None:
        """Publish what was decided on, for a recording; see `onboard.trace`."""
        if entry:
            self._trace_out.publish(String(data=entry))
