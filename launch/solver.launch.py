"""The solver of one vehicle, on the vehicle or on the ground; `~/build` starts it.

ros2 launch uav_mission_manager solver.launch.py namespace:=uav1 mission:=/path/to/mission.yaml
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import DEFAULT_METHOD, METHODS

PACKAGE = 'uav_mission_manager'
SHARE = share_directory()
ARGUMENTS = {
    'namespace': ('uav1', 'namespace of the vehicle'),
    'mission': (f'{SHARE}/config/case_study.yaml', 'mission file'),
    'params_file': (
        f'{SHARE}/config/nodes.yaml',
        'file of node parameters; the arguments here override it',
    ),
    'method': (DEFAULT_METHOD, f'how the policy is made: {", ".join(METHODS)}'),
}


def argument(name: str) -> ParameterValue:
    """Return the launch argument `name` as a node parameter."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def node(executable: str, **parameters: ParameterValue) -> Node:
    """Return one of this package's nodes in the vehicle's namespace."""
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params_file'), parameters],
        output='screen',
    )


def generate_launch_description() -> LaunchDescription:
    """Describe the process; every argument has a default."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            node('solver', mission=argument('mission'), method=argument('method')),
        ]
    )
