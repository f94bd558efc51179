"""What the bridge learns from a new policy set: where goals are that were requested in flight."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import String

from uav_mission_manager.mdp.placing import changed_goals
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.background import in_thread
from uav_mission_manager.nodes.failures import START_ERRORS, one_line
from uav_mission_manager.nodes.flight_plan import FlightPlan, Plans
from uav_mission_manager.policy.store import read_mission


def plan_after(plan: FlightPlan, path: str) -> FlightPlan | None:
    """Return the plan of the mission in a policy set; None if it has the same goals.

    Raises
    ------
    ValueError
        One line: the set cannot be read, or its mission cannot follow in flight.
    """
    mission = read_mission(Path(path))
    try:
        changed = changed_goals(plan.mission, mission)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error
    return FlightPlan(mission, plan.flight_altitude, path) if changed else None


class PlanOffers:
    """Hears `policy_set`, and has the plan of its mission at hand for the manager's commands.

    Parameters
    ----------
    node : Node
    plans : Plans
        Whose next one is set.
    log : callable
        Takes whether a line is a warning, and the line.
    """

    def __init__(self, node: Node, plans: Plans, log: Callable[[bool, str], None]) -> None:
        self._node, self._plans, self._log = node, plans, log
        node.create_subscription(
            String,
            'policy_set',
            self._on_policy_set,  # type: ignore[arg-type]  # Coroutines are as good.
            qos.LATCHED,
            callback_group=MutuallyExclusiveCallbackGroup(),  # Others go on, sets wait.
            qos_overriding_options=qos.OVERRIDABLE,
        )

    async def _on_policy_set(self, message: String) -> None:
        look = partial(plan_after, self._plans.present, message.data)
        try:
            self._plans.next = await in_thread(self._node, look)
        except START_ERRORS as error:
            self._log(True, f'policy_set: {one_line(error)}; the old plan stays')
