"""The solver: builds a policy set on request and announces it to the manager."""

from __future__ import annotations

import json
import os
import sys
from functools import partial
from pathlib import Path

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
        'out',
        '',
        'Directory of the policy set; empty is uav_mission_manager/MISSION in ROS_HOME (~/.ros)',
        read_only=False,
        path=True,
    ),
)


class Solver(Node):
    """Builds a policy set when `~/build` is called and announces it on `policy_set`.

    The build is a process of its own, one at a time. One that fails, or that ends with the node,
    announces nothing and leaves the old policy set as it is.
    """

    def __init__(self) -> None:
        super().__init__('solver')
        declare(self, PARAMETERS)
        self._building = ''
        self._child: Child | None = None
        self._publisher = self.create_publisher(
            String, 'policy_set', qos.LATCHED, qos_overriding_options=qos.OVERRIDABLE
        )
        self.create_service(
            Trigger, '~/build', self._on_build, callback_group=ReentrantCallbackGroup()
        )

    def destroy_node(self) -> None:
        """End a build, too."""
        if self._child is not None:
            self._child.end()
        super().destroy_node()

    async def _on_build(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._building:
            response.message = f'{self._building} is being built; call again when it is done'
            return response
        try:
            mission, method, out = (
                row.checked(self.get_parameter(row.name).value) for row in PARAMETERS
            )
            self._building = shown(mission)
            path, response.message = await self._build(mission, method, out)
            response.success = True
        except (*START_ERRORS, LookupError) as error:
            response.message = one_line(error)
            self.get_logger().error(f'no policy set built: {response.message}')
            return response
        finally:
            self._building, self._child = '', None
        self.get_logger().info(response.message)
        self._publisher.publish(String(data=path))
        return response

    async def _build(self, mission_file: str, method: str, out: str) -> tuple[str, str]:
        mission = await in_thread(self, partial(load_mission, mission_file))
        path = str(Path(out).resolve() if out else _default_out(mission.name))
        self.get_logger().info(f'building {shown(mission.name)}, method {shown(method)}')
        self._child = Child(
            'cli.policy_build', f'--out={path}', f'--method={method}', '--json', '--', mission_file
        )
        said = json.loads(await in_thread(self, self._child.output))
        parts = (
            shown(mission.name),
            said['method'],
            said['digest'][:12],
            f'{said["seconds"]:.1f} s',
        )
        return path, f'{path}: {", ".join(parts)}'


def _default_out(name: str) -> Path:
    home = expanded(os.environ.get('ROS_HOME') or '~/.ros')
    return home.resolve() / 'uav_mission_manager' / name.replace('/', '_')


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Solver, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
