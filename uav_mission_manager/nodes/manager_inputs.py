"""What the manager tells the bridge: commands with their destinations, and if goals are wanted."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.mdp import Action
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock, seconds
from uav_mission_manager.nodes.complaints import Complaints
from uav_mission_manager.nodes.flight_plan import FlightPlan, Plans
from uav_mission_manager.onboard import InputError, parse_command
from uav_mission_manager.onboard.stamps import stamp_age

LONGEST_COMPLAINT = 400
"""Characters of a complaint: a choice, what is echoed and a few lines about it."""


class ManagerInputs:
    """Hears the manager, and hands its commands to the pilot.

    The destination of a command comes from the bridge's own mission file. A `command_pose` in
    another cell says that the manager has another mission; its commands are then refused. So is
    what is older than `timeout`, or comes from the future: the latched word of a manager that is
    silent by now, or of one whose clock is wrong.

    Another plan takes the place of the present one with the first command that is to be flown by
    it alone: the manager knows when a goal that is no more is left.

    Attributes
    ----------
    command : str
        The last command taken.
    timeout : float
        See above [s].
    """

    def __init__(self, node: Node, plans: Plans, pilot: Pilot, timeout: float) -> None:
        self._node, self._plans, self._pilot = node, plans, pilot
        self.timeout = timeout
        self._clock = safety_clock()
        self._complaints = Complaints(lambda text: node.get_logger().error(text))
        self._complained_at: dict[str, float] = {}
        self.command = self._received = self._pose_trouble = ''
        self.action: Action | None = None
        self._pose_cell: int | None = None
        self._posed_at = self._commanded_at = self._goals_at = -math.inf
        # The manager publishes goals and pose before the command. Where all have arrived, the
        # subscription made first is served first.
        inputs: tuple[tuple[Any, str, Any], ...] = (
            (UInt8MultiArray, 'goal_states', self._on_goals),
            (PoseStamped, 'command_pose', self._on_pose),
            (String, 'mission_command', self._on_command),
        )
        for kind, topic, callback in inputs:
            node.create_subscription(
                kind, topic, callback, qos.LATCHED, qos_overriding_options=qos.OVERRIDABLE
            )

    @property
    def command_age(self) -> float:
        """Time [s] since the command was repeated."""
        return self._now() - self._commanded_at

    @property
    def complaints(self) -> tuple[str, ...]:
        """What is wrong with what is heard now."""
        now, current = self._now(), self._complaints.current
        return tuple(
            text
            for topic, text in current.items()
            if not self._old(self._complained_at[topic], now)
        )

    def look(self) -> None:
        """Forget what was not said again; call it often."""
        if self._old(self._goals_at, self._now()):
            self._pilot.goals_wanted = None
        self._complaints.flush()

    def _now(self) -> float:
        return seconds(self._clock)

    def _old(self, time: float, now: float) -> bool:
        return now - time > self.timeout

    def _on_goals(self, message: UInt8MultiArray, info: dict[str, int]) -> None:
        if not self._trouble('goal_states', *_times(info)):
            self._complaints.settle('goal_states')
            self._pilot.goals_wanted, self._goals_at = any(message.data), self._now()

    def _on_pose(self, message: PoseStamped) -> None:
        if message.header.frame_id != MAP_FRAME:
            return
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        self._pose_trouble = self._trouble('command_pose', stamp, seconds(self._node.get_clock()))
        if not self._pose_trouble:
            self._complaints.settle('command_pose')
        grid, point = self._plans.present.mission.grid, message.pose.position
        inside = not self._pose_trouble and grid.contains(point.x, point.y)
        self._pose_cell = grid.cell_at(point.x, point.y) if inside else None
        self._posed_at = self._now()

    def _on_command(self, message: String, info: dict[str, int]) -> None:
        if self._trouble('mission_command', *_times(info), f'{quoted(message.data)} '):
            return
        repeated, self._received = message.data == self._received, message.data
        plan = self._plan_of(message.data)
        try:
            action = parse_command(plan.mission, message.data)
        except ValueError as error:
            self._complain('mission_command', f'{error}; keeping {self.command or "none"!r}')
            return
        now = self._now()
        posed = not self._old(self._posed_at, now)
        if self._pose_cell == action.destination if posed else repeated:
            self._complaints.settle('mission_command')
            self.command, self.action, self._commanded_at = message.data, action, now
            self._pilot.command(plan.task(action, message.data), now)
        elif repeated:  # Else the pose may still be on its way.
            self._complain(
                'mission_command',
                self._pose_trouble
                or 'command_pose is not the destination of mission_command in '
                f'{plan.mission.name}: the manager has another mission; not flown',
            )

    def _plan_of(self, command: str) -> FlightPlan:
        """Return what to fly a command by, from now on the next plan if it is of that alone."""
        plans = self._plans
        if (
            plans.next
            and not self._is_of(plans.present, command)
            and self._is_of(plans.next, command)
        ):
            plans.present, plans.next = plans.next, None
            goals = shown(', '.join(plans.goals()))
            self._node.get_logger().info(f'goals are now {goals}: {shown(plans.present.source)}')
        return plans.present

    def _is_of(self, plan: FlightPlan, command: str) -> bool:
        """Whether a command leads by a plan to where the manager says."""
        try:
            destination = parse_command(plan.mission, command).destination
        except ValueError:
            return False
        return destination == self._pose_cell and not self._old(self._posed_at, self._now())

    def _trouble(self, topic: str, stamp: float, clock: float, what: str = '') -> str:
        """Say so where a message is too old, or too new, to be believed; '' where it is not."""
        try:
            stamp_age(topic, stamp, clock, self.timeout)
        except InputError as error:
            return self._complain(topic, f'{error}; {what}ignored')
        return ''

    def _complain(self, topic: str, text: str) -> str:
        self._complained_at[topic] = self._now()
        self._complaints.add(topic, shown(text, LONGEST_COMPLAINT))
        return text


def _times(info: dict[str, int]) -> tuple[float, float]:
    """Return when a message was sent, by its sender's clock, and received, by this one's [s]."""
    return info['source_timestamp'] * 1e-9, info['received_timestamp'] * 1e-9
