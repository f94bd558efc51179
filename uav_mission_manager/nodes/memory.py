"""Where a node keeps what the next one in its place has to know."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rclpy.node import Node

from uav_mission_manager.echo import said_by
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

BOOT_ID = Path('/proc/sys/kernel/random/boot_id').read_text().strip()
"""Linux's name of the time since this computer was started."""

POWER_ON_TIME = 30.0
"""Time [s] by which an autopilot's start may come before this computer's, when both are switched
on together: a choice, longer than a system takes to start, and shorter than it takes to fly."""


def moment(now: float) -> dict[str, object]:
    """Return JSON values of a time of the steady clock [s], which `time_here` understands."""
    return {'boot': BOOT_ID, 'time': now}


def time_here(moment: Mapping[str, Any]) -> float:
    """Return the time of a `moment` by the steady clock of this boot [s].

    Of one before this boot only the latest time is known at which a vehicle that was switched on
    with this computer was not switched on yet.
    """
    return float(moment['time']) if moment['boot'] == BOOT_ID else -POWER_ON_TIME


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
        raise ValueError(f'parameter state_dir: {said_by(error)}') from error


def state_before(journal: Journal) -> tuple[dict[str, Any] | None, str]:
    """Return the state that the node before this one wrote down, and why it is not used.

    None where there is none, or it is damaged or of another mission; '' where that is no trouble.
    """
    try:
        record = journal.read()
    except ValueError as error:
        return None, str(error)
    if record is None:
        return None, ''
    if record.mission == journal.mission:
        return record.state, ''
    return None, f'{journal.path}: of a mission with other goals or another grid'


def _default() -> Path:
    for variable, folder in ('ROS_HOME', '.'), ('HOME', '.ros'):
        if home := os.environ.get(variable):
            return expanded(home) / folder / 'uav_mission_manager' / 'state'
    raise ValueError('not given, and neither ROS_HOME nor HOME is set')
