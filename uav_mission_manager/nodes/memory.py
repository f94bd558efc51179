"""Where a node keeps what the next one in its place has to know."""

from __future__ import annotations

import os
from pathlib import Path

from rclpy.node import Node

from uav_mission_manager.mdp import Mission
from uav_mission_manager.nodes.parameters import NodeParameter
from uav_mission_manager.onboard.journal import Journal, goals_hash
from uav_mission_manager.paths import expanded

STATE_DIR = NodeParameter(
    'state_dir',
    '',
    'Folder in which the node keeps its state, by namespace, to go on as before when it is '
    'started again; empty is uav_mission_manager/state in ROS_HOME, else in ~/.ros',
    path=True,
)
"""Parameter of every node that goes on where the one before it ended."""


def open_journal(node: Node, state_dir: str, kind: str, mission: Mission) -> Journal:
    """Open the journal of a node of a vehicle: STATE_DIR/NAMESPACE/KIND.journal.

    Parameters
    ----------
    node : Node
        Its namespace is the vehicle's.
    state_dir : str
        The parameter's value.
    kind : str
        Such as `manager`.
    mission : Mission
        What the state is about.

    Raises
    ------
    ValueError
        One line naming the parameter: there is no such place, or it cannot be written.
    """
    try:
        place = Path(state_dir or _default()) / node.get_namespace().strip('/') / f'{kind}.journal'
        return Journal(place, kind, goals_hash(mission))
    except (OSError, ValueError) as error:
        raise ValueError(f'parameter state_dir: {error}') from error


def _default() -> Path:
    for variable, folder in ('ROS_HOME', '.'), ('HOME', '.ros'):
        if home := os.environ.get(variable):
            return expanded(home) / folder / 'uav_mission_manager' / 'state'
    raise ValueError('not given, and neither ROS_HOME nor HOME is set')
