"""What other programs say of the goals at which they do the work."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import String

from uav_mission_manager.autopilot.bridge import VehicleBridge
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock, seconds


class GoalAnswers:
    """Hears `goal_completed`, the bridge's own word included, and `goal_failed`.

    Parameters
    ----------
    node : Node
    bridge : VehicleBridge
        Whose task at a goal it is.
    log : callable
        Takes whether a line is a warning, and the line.
    """

    def __init__(
        self, node: Node, bridge: VehicleBridge, log: Callable[[bool, str], None]
    ) -> None:
        self._bridge, self._log, self._clock = bridge, log, safety_clock()
        for topic, callback in (
            ('goal_completed', self._on_completed),
            ('goal_failed', self._on_failed),
        ):
            node.create_subscription(
                String, topic, callback, qos.EVENT, qos_overriding_options=qos.OVERRIDABLE
            )

    def _on_completed(self, message: String) -> None:
        if message.data and message.data == self._bridge.output.active:
            self._log(False, f'goal {message.data} completed, as another program says')
        self._bridge.pilot.work.completed(message.data, seconds(self._clock))

    def _on_failed(self, message: String) -> None:
        """NAME, or NAME: REASON."""
        goal, _, why = message.data.partition(': ')
        if not goal or goal != self._bridge.output.active:
            self._log(True, f'goal_failed: nothing waits for {quoted(message.data)}; ignored')
        else:
            self._bridge.pilot.work.fail(shown(why) or 'failed, and nobody says why')
