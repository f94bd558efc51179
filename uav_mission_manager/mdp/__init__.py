"""The mission as a Markov decision process: mission file, states, actions, dynamics, cost."""

from uav_mission_manager.mdp.actions import (
    Action,
    action_name,
    global_actions,
    global_to_local,
    local_actions,
    local_to_global,
)
from uav_mission_manager.mdp.fields import MissionError
from uav_mission_manager.mdp.grid import Grid, Origin
from uav_mission_manager.mdp.mission import FAULT_MODES, THREAT_LEVELS, Energy, Goal, Mission
from uav_mission_manager.mdp.mission_file import load_mission, mission_from_dict
from uav_mission_manager.mdp.states import StateError, StateSpace

__all__ = [
    'FAULT_MODES',
    'THREAT_LEVELS',
    'Action',
    'Energy',
    'Goal',
    'Grid',
    'Mission',
    'MissionError',
    'Origin',
    'StateError',
    'StateSpace',
    'action_name',
    'global_actions',
    'global_to_local',
    'load_mission',
    'local_actions',
    'local_to_global',
    'mission_from_dict',
]
