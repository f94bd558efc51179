"""Nodes with ROS's life cycle: configured, activated, deactivated and cleaned up from outside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from uav_mission_manager.nodes.failures import one_line
from uav_mission_manager.nodes.overrides import refuse_unknown
from uav_mission_manager.nodes.parameters import NodeParameter

AUTOSTART = NodeParameter(
    'autostart',
    True,
    'Whether it configures and activates itself at the start; else it waits to be told, as by '
    '`ros2 lifecycle set`',
)
"""Parameter of every node with a life cycle."""

SUCCESS, FAILURE, ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)

CREATED = ('timer', 'subscription', 'client', 'service', 'publisher')
"""What a transition creates on its node, in the order in which it is destroyed again."""


class ManagedNode(LifecycleNode):
    """A node with ROS's life cycle, and `AUTOSTART` among its parameters.

    Subclasses say what its transitions do. What `configure` and `activate` create on the node
    lives until their opposites, `cleanup` and `deactivate`: an inactive node hears nothing that it
    would not hear after `configure`, and nothing of it stays latched.

    Attributes
    ----------
    active : bool
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.active = False
        self._there_before: list[dict[str, set[Any]]] = []
        """What was on the node before `configure` and before `activate`, while undone neither."""
        self._failure: Exception | None = None
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def configure(self) -> None:
        """Load and open what is needed. May raise: the node stays unconfigured."""

    def activate(self) -> None:
        """Begin to work. May raise: the node stays inactive."""

    def deactivate(self) -> None:
        """Undo `activate`, also half of one that has failed."""

    def cleanup(self) -> None:
        """Undo `configure`, also half of one that has failed."""

    def start(self) -> None:
        """Configure and activate where `AUTOSTART` says so; raises what they raise."""
        if not self.get_parameter(AUTOSTART.name).value:
            self.get_logger().info('unconfigured: waits for `ros2 lifecycle set`')
            return
        for trigger in self.trigger_configure, self.trigger_activate:
            if trigger() != SUCCESS and self._failure is not None:
                raise self._failure

    def destroy_node(self) -> None:
        """Undo what the node has begun, too."""
        self._leave_all()
        super().destroy_node()

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Configure."""
        return self._enter(self.configure, self.cleanup)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Activate; the topics are there now, and so are their parameters."""

        def begin() -> None:
            self.activate()
            refuse_unknown(self, qos=True)

        result = self._enter(begin, self.deactivate)
        self.active = result == SUCCESS
        return result

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate."""
        return self._leave(self.deactivate)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Clean up."""
        return self._leave(self.cleanup)

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """End the work for good; the process waits for a signal."""
        self._leave_all()
        return SUCCESS

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Begin anew, unconfigured, after a step back that has failed."""
        self._leave_all()
        return SUCCESS

    def _enter(
        self, begin: Callable[[], None], undo: Callable[[], None]
    ) -> TransitionCallbackReturn:
        self._there_before.append(self._entities())
        try:
            begin()
        except Exception as error:
            self._leave(undo)
            self._failure = error
            return FAILURE
        return SUCCESS

    def _leave(self, undo: Callable[[], None]) -> TransitionCallbackReturn:
        self.active = False
        try:
            undo()
        except Exception as error:
            self._failure = error
            return ERROR
        finally:
            before = self._there_before.pop()
            for kind, entities in self._entities().items():
                for entity in entities - before[kind]:
                    getattr(self, f'destroy_{kind}')(entity)
        return SUCCESS

    def _leave_all(self) -> None:
        while self._there_before:
            self._leave((self.cleanup, self.deactivate)[len(self._there_before) - 1])

    def _entities(self) -> dict[str, set[Any]]:
        return {kind: set(getattr(self, f'{kind}s')) for kind in CREATED}

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Say how it went; rclpy does not, and ends the node at a transition that there is not."""
        wanted = request.transition.label or f'transition {request.transition.id}'
        self._failure = None
        try:
            response = self._change_state(request, response)
        except rclpy_implementation.RCLError:
            response.success = False
        state = self._state_machine.current_state[1]
        if response.success:
            self.get_logger().info(state)
        else:
            why = one_line(self._failure) if self._failure else f'not possible when {state}'
            self.get_logger().error(f'{wanted} failed: {why}')
        return response
