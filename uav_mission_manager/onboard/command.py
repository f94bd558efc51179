"""The mission command as text: `commit GOAL normal`, `none agile`, `recharge`, `repair`."""

from __future__ import annotations

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import Action, Mission, action_name, global_actions

format_command = action_name
"""Return an action of a mission in the command grammar: the name it has everywhere."""


def parse_command(mission: Mission, text: str) -> Action:
    """Return the action a command asks for.

    Raises
    ------
    ValueError
        One line saying what is wrong and what would be right.
    """
    commands = {format_command(mission, action): action for action in global_actions(mission)}
    action = commands.get(' '.join(text.split()))
    if action is None:
        known = ', '.join(commands)
        raise ValueError(f'mission_command: {quoted(text)} is not one of: {shown(known)}')
    return action
