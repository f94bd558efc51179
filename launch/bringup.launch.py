"""The nodes of one vehicle: base station, manager and bridge, by a file of parameters; a recorder.

ros2 launch uav_mission_manager bringup.launch.py namespace:=uav1 params_file:=/path/to/my.yaml

A node that ends is started again, and goes on as before: its state is in files. `rviz:=true` and
`foxglove:=true` show the vehicle; these are packages of ROS, to be installed. One aggregator of
diagnostics does for all vehicles, so it is started by itself, with config/diagnostics.yaml.
"""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from uav_mission_manager.paths import share_directory

PACKAGE = 'uav_mission_manager'
RESPAWN_DELAY = 1.0
"""Time [s] until a node that has ended is started again: a choice, well within the time for which
the bridge holds before it returns."""

ARGUMENTS = {
    'namespace': ('', 'namespace of the vehicle'),
    'params_file': (
        f'{share_directory()}/config/nodes.yaml',
        'file of node parameters; the arguments below, where they are not empty, override it',
    ),
    'use_respawn': ('true', 'true: a node that ends is started again'),
    'autostart': ('', 'false: manager and bridge wait for `ros2 lifecycle set`'),
    'use_sim_time': ('', 'true: the time of messages is that of /clock'),
    'mission': ('', 'mission file of the base station and the bridge'),
    'policy': ('', 'directory of the policy set built from it'),
    'connection': ('', 'pymavlink connection string of the bridge'),
    'system': ('', 'MAVLink system id of the vehicle'),
    'allow_arming': ('', 'true: the bridge may arm and take off'),
    'flight_altitude': ('', "height at which the bridge flies [m], a fleet's vehicles apart"),
    'base_station': ('true', 'false: another node, such as fleet, asks for goals'),
    'state_dir': ('', 'folder in which the nodes keep what the next ones have to know'),
    'bag': ('', 'folder to record into; empty: it is not recorded'),
    'rviz': ('false', 'true: RViz shows the vehicle; it needs the package rviz2'),
    'foxglove': (
        'false',
        'true: Foxglove can connect to ws://127.0.0.1:8765, to see all vehicles; it needs the '
        'package foxglove_bridge',
    ),
}
BOOLEANS = {'true': True, 'false': False}
NODES = {
    'base_station': {'mission': str, 'state_dir': str, 'use_sim_time': bool},
    'manager': {'policy': str, 'state_dir': str, 'autostart': bool, 'use_sim_time': bool},
    'mavlink_bridge': {
        'mission': str,
        'connection': str,
        'system': int,
        'allow_arming': bool,
        'flight_altitude': float,
        'state_dir': str,
        'autostart': bool,
        'use_sim_time': bool,
    },
    'mission_record': {'bag': str},
}
"""Which of the arguments are parameters of which node, and their types."""

SHOWN_TOPICS = ('/manager/markers', '/odom')
"""What config/mission.rviz shows, in the vehicle's namespace."""

PARAMETER_NAMES = {'system': 'target_system'}
"""Parameters that have another name than the argument."""


def given(context: LaunchContext, name: str, kind: type = str) -> str | float | bool | None:
    """Return a launch argument as a value, None where it is empty."""
    text = LaunchConfiguration(name).perform(context)
    if not text:
        return None
    if kind is bool:
        if text.lower() not in BOOLEANS:
            raise RuntimeError(f'{name} {text!r} is neither true nor false')
        return BOOLEANS[text.lower()]
    if kind is int:
        if not (text.isascii() and text.isdigit()):
            raise RuntimeError(f'{name} {text!r} is not a number')
        return int(text)
    if kind is float:
        try:
            return float(text)
        except ValueError:
            raise RuntimeError(f'{name} {text!r} is not a number') from None
    return str(text)


def nodes(context: LaunchContext) -> list[Node]:
    """Return this package's nodes of one vehicle, in its namespace."""

    def parameters(executable: str) -> dict[str, ParameterValue]:
        values = {
            PARAMETER_NAMES.get(name, name): (given(context, name, kind), kind)
            for name, kind in NODES[executable].items()
        }
        return {
            name: ParameterValue(value, value_type=kind)
            for name, (value, kind) in values.items()
            if value is not None
        }

    return [
        Node(
            package=PACKAGE,
            executable=executable,
            namespace=given(context, 'namespace') or '',
            parameters=[given(context, 'params_file'), parameters(executable)],
            respawn=bool(given(context, 'use_respawn', bool)),
            respawn_delay=RESPAWN_DELAY,
            output='screen',
        )
        for executable in NODES
        if wanted(context, executable)
    ]


def wanted(context: LaunchContext, executable: str) -> bool:
    """Whether a node is to be started."""
    if executable == 'base_station':
        return bool(given(context, 'base_station', bool))
    return executable != 'mission_record' or bool(given(context, 'bag'))


def viewers(context: LaunchContext) -> list[Node]:
    """Return ROS's own programs by which the vehicle is watched."""
    found = []
    if given(context, 'rviz', bool):
        found.append(
            Node(
                package='rviz2',
                executable='rviz2',
                namespace=given(context, 'namespace') or '',
                arguments=['-d', f'{share_directory()}/config/mission.rviz'],
                remappings=[(topic, topic.lstrip('/')) for topic in SHOWN_TOPICS],
            )
        )
    if given(context, 'foxglove', bool):
        here = {'address': '127.0.0.1', 'port': 8765}
        found.append(
            Node(package='foxglove_bridge', executable='foxglove_bridge', parameters=[here])
        )
    return found


def generate_launch_description() -> LaunchDescription:
    """Describe the processes; every argument has a default."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, (default, text) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=nodes),
            OpaqueFunction(function=viewers),
        ]
    )
