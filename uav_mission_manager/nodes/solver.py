"""The solver: builds a policy set on request and announces it to the manager."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.ending import ENDING
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.runtime import one_line, run_node
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

    A build that fails, or that a signal ends, announces nothing and leaves the old policy set as
    it is.
    """

    def __init__(self) -> None:
        super().__init__('solver')
        declare(self, PARAMETERS)
        self._publisher = self.create_publisher(
            String, 'policy_set', qos.LATCHED, qos_overriding_options=qos.OVERRIDABLE
        )
        self.create_service(Trigger, '~/build', self._on_build)

    def _on_build(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            with ENDING.interruptible():
                path, response.message = self._build()
        except (ValueError, OSError, MemoryError) as error:
            response.success, response.message = False, one_line(error)
            self.get_logger().error(f'no policy set built: {response.message}')
            return response
        self.get_logger().info(response.message)
        self._publisher.publish(String(data=str(path)))
        response.success = True
        return response

    def _build(self) -> tuple[Path, str]:
        mission_file, method, out = (
            row.checked(self.get_parameter(row.name).value) for row in PARAMETERS
        )
        mission = load_mission(mission_file)
        self.get_logger().info(f'building {mission.name}, method {method}')
        start = self.get_clock().now()
        policy = build_policy(mission, method=method)
        path = Path(out).resolve() if out else _default_out(mission.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        policy.save(path)
        seconds = (self.get_clock().now() - start).nanoseconds * 1e-9
        return (
            path,
            f'{path}: {mission.name}, {policy.method}, {policy.digest[:12]}, {seconds:.1f} s',
        )


def _default_out(name: str) -> Path:
    home = expanded(os.environ.get('ROS_HOME') or '~/.ros')
    return home.resolve() / 'uav_mission_manager' / name.replace('/', '_')


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Solver, PARAMETERS, args)


if __name__ == '__main__':
    sys.exit(main())
