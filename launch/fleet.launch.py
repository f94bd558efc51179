"""Several vehicles that share the goals of one mission, and their base station, the node fleet.

ros2 launch uav_mission_manager fleet.launch.py vehicles:=3 simulate:=true allow_arming:=true

Each vehicle is that of mission.launch.py with a MAVLink system id, a namespace, a port and a
flight height of its own, and without a base station of its own.
"""

from __future__ import annotations

import tempfile

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from uav_mission_manager.paths import share_directory

PACKAGE = 'uav_mission_manager'
SHARE = share_directory()
LOWEST, APART = 20.0, 10.0
"""Flight height [m] of the first vehicle, and from each to the next: choices."""

ARGUMENTS = {
    'vehicles': ('3', 'how many: MAVLink systems 1 to that, /uav1 and so on, 255 at most'),
    'mission': (f'{SHARE}/config/fleet.yaml', 'mission file that the policy set was built from'),
    'policy': (f'{SHARE}/policies/fleet', 'directory of the policy set of all vehicles'),
    'params_file': (
        f'{SHARE}/config/nodes.yaml',
        'file of node parameters; the arguments here override it',
    ),
    'allow_arming': ('false', 'true: the bridges may arm and take off'),
    'simulate': (
        'false',
        'true: start simulated autopilots at the mission origin, and remember nothing of them',
    ),
}


def number_of_vehicles(context: LaunchContext) -> int:
    """Return how many vehicles there are; refuse what is no number of them."""
    text = LaunchConfiguration('vehicles').perform(context)
    if not (text.isdecimal() and 1 <= int(text) <= 255):
        raise RuntimeError(f'vehicles {text!r} is not a number from 1 to 255')
    return int(text)


def crafts(context: LaunchContext) -> list[IncludeLaunchDescription]:
    """Return the nodes of each vehicle."""
    names = ('mission', 'policy', 'params_file', 'allow_arming', 'simulate')
    shared = {name: LaunchConfiguration(name).perform(context) for name in names}
    source = PythonLaunchDescriptionSource(f'{SHARE}/launch/mission.launch.py')
    return [
        IncludeLaunchDescription(
            source,
            launch_arguments={
                **shared,
                'system': str(system),
                'base_station': 'false',
                'flight_altitude': str(LOWEST + APART * (system - 1)),
            }.items(),
        )
        for system in range(1, number_of_vehicles(context) + 1)
    ]


def station(context: LaunchContext) -> list[Node]:
    """Return the base station of all vehicles."""
    values = {
        'mission': LaunchConfiguration('mission').perform(context),
        'policy': LaunchConfiguration('policy').perform(context),
        'vehicles': [f'uav{n}' for n in range(1, number_of_vehicles(context) + 1)],
    }
    if IfCondition(LaunchConfiguration('simulate')).evaluate(context):
        values['state_dir'] = tempfile.mkdtemp(prefix=f'{PACKAGE}-')
    return [
        Node(
            package=PACKAGE,
            executable='fleet',
            parameters=[LaunchConfiguration('params_file').perform(context), values],
            respawn=True,
            respawn_delay=1.0,
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
            OpaqueFunction(function=crafts),
            OpaqueFunction(function=station),
        ]
    )
