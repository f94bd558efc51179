"""The solver: builds a policy set on request and announces it to the manager."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.background import Child, in_thread
from uav_mission_manager.nodes.failures import START_ERRORS, one_line
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.nodes.slots import Placement, SlotsInFlight
from uav_mission_manager.paths import expanded
from uav_mission_manager.policy import DEFAULT_METHOD, METHODS

PARAMETERS = (
    NodeParameter(
        'mission',
        '',
        'Mission file, read at every build',
        read_only=False,
        path=True,
        example='config/case_study.yaml',
    ),
    NodeParameter(
        'method', DEFAULT_METHOD, f'How the policy is made: {", ".join(METHODS)}', read_only=False
    ),
    NodeParameter(
        'max_goals',
        6,
        'Goals of a mission up to which a requested one is added where no slot is free',
        0,
        100,
        read_only=False,
    ),
    NodeParameter(
        'out',
        '',
        'Directory of the policy set; empty is uav_mission_manager/MISSION in ROS_HOME (~/.ros)',
        read_only=False,
        path=True,
    ),
)


@dataclass(frozen=True)
class BuiltSet:
    """A policy set that was built: its path and digest, and what to say of it."""

    path: str
    digest: str
    said: str


BuildWork = Callable[[Placement, str], Coroutine[Any, Any, BuiltSet]]
"""Builds the set of a mission file, or of what it makes of it, by a method."""

REQUEST_REFUSED = 'goal request refused'
"""How a line begins that says why."""


class Solver(Node):
    """Builds a policy set when `~/build` is called and announces it on `policy_set`.

    So it does when a goal is requested on `goal_requests`, of the mission with that goal
    (`mdp.placing`). The build is a process of its own, one at a time. One that fails, or that ends
    with the node, announces nothing and leaves the old policy set as it is.
    """

    def __init__(self) -> None:
        super().__init__('solver')
        declare(self, PARAMETERS)
        self._building = ''
        self._child: Child | None = None
        self._publisher = self.create_publisher(
            String, 'policy_set', qos.LATCHED, qos_overriding_options=qos.OVERRIDABLE
        )
        waiting = ReentrantCallbackGroup()  # Others go on while a policy is built.
        self.create_service(Trigger, '~/build', self._on_build, callback_group=waiting)
        self._slots = SlotsInFlight(self)
        self.create_subscription(
            String,
            'goal_requests',
            self._on_goal_request,  # type: ignore[arg-type]  # Coroutines are as good.
            qos.EVENT,
            callback_group=waiting,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def destroy_node(self) -> None:
        """End a build, too."""
        if self._child is not None:
            self._child.end()
        super().destroy_node()

    async def _on_build(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        built = await self._make('no policy set built', self._build_again)
        response.success, response.message = built
        return response

    async def _on_goal_request(self, message: String) -> None:
        if self._building:
            busy = f'{self._building} is being built; ask again when it is done'
            self.get_logger().error(f'{REQUEST_REFUSED}: {busy}')
        else:
            await self._make(REQUEST_REFUSED, partial(self._place, message.data))

    async def _make(self, failure: str, build: BuildWork) -> tuple[bool, str]:
        """Build a policy set and announce it; return whether it was built, and what to say."""
        if self._building:
            return False, f'{self._building} is being built; call again when it is done'
        try:
            given = self._given()
            mission_file, method, out = given['mission'], given['method'], given['out']
            self._building = shown(mission_file)
            mission = await in_thread(self, partial(load_mission, mission_file))
            place = Path(out).resolve() if out else _default_out(mission.name)
            built = await build(Placement(mission, mission_file, place), method)
        except (*START_ERRORS, LookupError) as error:
            why = one_line(error)
            self.get_logger().error(f'{failure}: {why}')
            return False, why
        finally:
            self._building, self._child = '', None
        self.get_logger().info(built.said)
        self._publisher.publish(String(data=built.path))
        self._slots.announced(built.digest)
        return True, built.said

    def _given(self) -> dict[str, Any]:
        """Values of the parameters now. Raises `ValueError`."""
        return {row.name: row.checked(self.get_parameter(row.name).value) for row in PARAMETERS}

    async def _build_again(self, asked: Placement, method: str) -> BuiltSet:
        """Build the set of a mission; goals in its slots stay where they are."""
        kept = await in_thread(self, partial(self._slots.kept, asked.mission, asked.out))
        return await self._build(kept or asked, method)

    async def _place(self, text: str, asked: Placement, method: str) -> BuiltSet:
        """Build the set of a mission with a requested goal."""
        most = self._given()['max_goals']
        look = partial(self._slots.place, asked.mission, asked.out, most, text)
        placement, said = await in_thread(self, look)
        built = await self._build(placement, method)
        return replace(built, said=f'{said}: {built.said}')

    async def _build(self, what: Placement, method: str) -> BuiltSet:
        name, path = shown(what.mission.name), str(what.out)
        self.get_logger().info(f'building {name}, method {shown(method)}')
        self._child = Child(
            'cli.policy_build', f'--out={path}', f'--method={method}', '--json', '--', what.file
        )
        said = json.loads(await in_thread(self, self._child.output))
        parts = name, said['method'], said['digest'][:12], f'{said["seconds"]:.1f} s'
        return BuiltSet(path, said['digest'], f'{path}: {", ".join(parts)}')


def _default_out(name: str) -> Path:
    home = expanded(os.environ.get('ROS_HOME') or '~/.ros')
    return home.resolve() / 'uav_mission_manager' / name.replace('/', '_')


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Solver, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
