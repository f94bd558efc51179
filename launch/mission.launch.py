"""One vehicle: base station, manager and bridge, and a simulated autopilot if asked for.

ros2 launch uav_mission_manager mission.launch.py namespace:=uav1 simulate:=true allow_arming:=true
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import load_policy

PACKAGE = 'uav_mission_manager'
SHARE = share_directory()
ARGUMENTS = {
    'namespace': ('uav1', 'namespace of the vehicle'),
    'mission': (
        f'{SHARE}/config/case_study.yaml',
        'mission file that the policy set was built from',
    ),
    'policy': (f'{SHARE}/policies/case_study', 'directory of the policy set'),
    'connection': ('udpin:127.0.0.1:14550', 'pymavlink connection string of the bridge'),
    'params': (
        f'{SHARE}/config/nodes.yaml',
        'file of node parameters; the arguments here override it',
    ),
    'allow_arming': ('false', 'true: the bridge may arm and take off'),
    'simulate': ('false', 'true: start a simulated autopilot at the mission origin'),
}


def argument(name: str, value_type: type = str) -> ParameterValue:
    """Return the launch argument `name` as a node parameter."""
    return ParameterValue(LaunchConfiguration(name), value_type=value_type)


def node(executable: str, **parameters: ParameterValue) -> Node:
    """Return one of this package's nodes in the vehicle's namespace."""
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params'), parameters],
        output='screen',
    )


def one_mission(context: LaunchContext) -> None:
    """Refuse a policy set that was built from another mission file."""
    path, policy = (LaunchConfiguration(name).perform(context) for name in ('mission', 'policy'))
    if load_mission(path) != load_policy(policy).mission:
        raise RuntimeError(f'policy {policy} was not built from mission {path}')


def simulated_autopilot(context: LaunchContext) -> list[ExecuteProcess]:
    """Return the simulator, at the mission's origin and the other end of the connection."""
    mission = load_mission(LaunchConfiguration('mission').perform(context))
    origin = mission.grid.origin
    if origin is None:
        raise RuntimeError(f'mission {mission.name} has no grid.origin: the simulator needs it')
    connection = LaunchConfiguration('connection').perform(context)
    return [
        ExecuteProcess(
            cmd=[
                ExecutableInPackage(executable='sim_autopilot', package=PACKAGE),
                '--connection',
                connection.replace('udpin:', 'udpout:'),
                f'--origin={origin.latitude},{origin.longitude},{origin.altitude}',
            ],
            output='screen',
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the processes; every argument has a default."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=one_mission),
            node('base_station', mission=argument('mission')),
            node('manager', policy=argument('policy')),
            node(
                'mavlink_bridge',
                mission=argument('mission'),
                connection=argument('connection'),
                allow_arming=argument('allow_arming', bool),
            ),
            OpaqueFunction(
                function=simulated_autopilot,
                condition=IfCondition(LaunchConfiguration('simulate')),
            ),
        ]
    )
