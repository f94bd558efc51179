"""The mission as a Markov decision process: each equation of the model once.

`mission_file` reads a `Mission`; `states` and `actions` say what is decided on; `feasibility`,
`cost`, `dynamics` and `routes` are the model, as pure functions that return arrays.
"""

from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp.actions import (
    Action,
    ActionKind,
    action_name,
    global_actions,
    global_to_local,
    local_actions,
    local_to_global,
)
from uav_mission_manager.mdp.cost import stage_costs
from uav_mission_manager.mdp.energy import Energy
from uav_mission_manager.mdp.feasibility import allowed_actions
from uav_mission_manager.mdp.grid import Grid
from uav_mission_manager.mdp.mission import (
    FAULT_MODES,
    PRIORITY_LEVELS,
    THREAT_LEVELS,
    Goal,
    Mission,
)
from uav_mission_manager.mdp.mission_file import load_mission, mission_from_dict
from uav_mission_manager.mdp.states import StateError, StateSpace, StateView
from uav_mission_manager.mdp.tables import MissionError

__all__ = [
    'FAULT_MODES',
    'PRIORITY_LEVELS',
    'THREAT_LEVELS',
    'Action',
    'ActionKind',
    'Energy',
    'Goal',
    'Grid',
    'Mission',
    'MissionError',
    'Origin',
    'StateError',
    'StateSpace',
    'StateView',
    'action_name',
    'allowed_actions',
    'global_actions',
    'global_to_local',
    'load_mission',
    'local_actions',
    'local_to_global',
    'mission_from_dict',
    'stage_costs',
]
