"""To try it: the nodes of one vehicle for the shipped mission, and a simulated autopilot.

ros2 launch uav_mission_manager mission.launch.py system:=1 simulate:=true allow_arming:=true

Vehicles with MAVLink system ids of their own have namespaces and ports of their own.
"""

from __future__ import annotations

import tempfile

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.substitutions import ExecutableInPackage

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.paths import expanded, share_directory
from uav_mission_manager.policy import load_policy

PACKAGE = 'uav_mission_manager'
SHARE = share_directory()
FIRST_PORT, PORTS_APART = 14550, 10
"""UDP port of system 1, and how far apart the ports of systems are: ArduPilot SITL's."""

ARGUMENTS = {
    'system': ('1', 'MAVLink system id of the vehicle, 1 to 255'),
    'namespace': ('', 'namespace of the vehicle; empty is uav<system>'),
    'mission': (
        f'{SHARE}/config/case_study.yaml',
        'mission file that the policy set was built from',
    ),
    'policy': (f'{SHARE}/policies/case_study', 'directory of the policy set'),
    'connection': (
        '',
        'pymavlink connection string of the bridge; empty is udpin:127.0.0.1: and the port '
        '14550 + 10 * (system - 1), as ArduPilot SITL counts its instances',
    ),
    'params_file': (
        f'{SHARE}/config/nodes.yaml',
        'file of node parameters; the arguments here override it',
    ),
    'allow_arming': ('false', 'true: the bridge may arm and take off'),
    'flight_altitude': ('', "height at which the bridge flies [m], a fleet's vehicles apart"),
    'base_station': ('true', 'false: another node, such as fleet, asks for goals'),
    'rviz': ('false', 'true: RViz shows the vehicle; it needs the package rviz2'),
    'foxglove': (
        'false',
        'true: Foxglove can connect to ws://127.0.0.1:8765; it needs the package foxglove_bridge',
    ),
    'simulate': (
        'false',
        'true: start a simulated autopilot at the mission origin, and remember nothing of it',
    ),
}


def system_id(context: LaunchContext) -> int:
    """Return the vehicle's MAVLink system id; refuse what is none."""
    text = LaunchConfiguration('system').perform(context)
    if not (text.isdecimal() and 1 <= int(text) <= 255):
        raise RuntimeError(f'system {text!r} is not a MAVLink system id, 1 to 255')
    return int(text)


def connection(context: LaunchContext) -> str:
    """Return the bridge's end of the connection: as given, or on the port of the system id."""
    port = FIRST_PORT + PORTS_APART * (system_id(context) - 1)
    given = str(LaunchConfiguration('connection').perform(context))
    return given or f'udpin:127.0.0.1:{port}'


def bringup(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return the nodes of one vehicle, in its namespace and on its port."""
    system = system_id(context)
    arguments = {
        name: LaunchConfiguration(name).perform(context)
        for name in (
            *('mission', 'policy', 'params_file', 'allow_arming'),
            *('flight_altitude', 'base_station', 'rviz', 'foxglove'),
        )
    }
    arguments |= {
        'namespace': LaunchConfiguration('namespace').perform(context) or f'uav{system}',
        'connection': connection(context),
        'system': str(system),
    }
    if IfCondition(LaunchConfiguration('simulate')).evaluate(context):
        # The next simulation begins on the ground, wherever this one ends.
        arguments['state_dir'] = tempfile.mkdtemp(prefix=f'{PACKAGE}-')
    source = PythonLaunchDescriptionSource(f'{SHARE}/launch/bringup.launch.py')
    return [IncludeLaunchDescription(source, launch_arguments=arguments.items())]


def one_mission(context: LaunchContext) -> None:
    """Refuse a policy set that was built from another mission file."""
    path = LaunchConfiguration('mission').perform(context)
    policy = LaunchConfiguration('policy').perform(context)
    if load_mission(expanded(path)) != load_policy(expanded(policy)).mission:
        raise RuntimeError(f'policy {policy} was not built from mission {path}')


def simulated_autopilot(context: LaunchContext) -> list[ExecuteProcess]:
    """Return the simulator, at the mission's origin and the other end of the connection."""
    mission = load_mission(expanded(LaunchConfiguration('mission').perform(context)))
    origin = mission.grid.origin
    if origin is None:
        raise RuntimeError(f'mission {mission.name} has no grid.origin: the simulator needs it')
    return [
        ExecuteProcess(
            cmd=[
                ExecutableInPackage(executable='sim_autopilot', package=PACKAGE),
                '--connection',
                connection(context).replace('udpin:', 'udpout:'),
                f'--system-id={system_id(context)}',
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
            OpaqueFunction(function=bringup),
            OpaqueFunction(
                function=simulated_autopilot,
                condition=IfCondition(LaunchConfiguration('simulate')),
            ),
        ]
    )
