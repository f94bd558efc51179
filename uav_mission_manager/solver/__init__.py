"""Solving the mission: sub-MDPs, Bellman backup, value iteration, recombination."""

from uav_mission_manager.solver.bounds.lower_bound import LowerBound, covering, lower_bound
from uav_mission_manager.solver.exact.look_ahead import LookAhead
from uav_mission_manager.solver.exact.sweep import Sweeper
from uav_mission_manager.solver.exact.value_iteration import PRECISIONS, Solution, value_iteration
from uav_mission_manager.solver.expansion.basis import Clusters, Group, cluster_states
from uav_mission_manager.solver.expansion.fit import Expansion, fit_expansion
from uav_mission_manager.solver.expansion.look_ahead import ExpansionLookAhead
from uav_mission_manager.solver.memory import MissionSizeError
from uav_mission_manager.solver.recombination.rules import (
    best_value,
    choose,
    highest_priority,
    summed,
)
from uav_mission_manager.solver.reduced import BellmanOperator
from uav_mission_manager.solver.submdp import (
    SubMdp,
    goal_sub_mdps,
    split_sub_mdps,
    whole_mission,
)

__all__ = [
    'PRECISIONS',
    'BellmanOperator',
    'Clusters',
    'Expansion',
    'ExpansionLookAhead',
    'Group',
    'LookAhead',
    'LowerBound',
    'MissionSizeError',
    'Solution',
    'SubMdp',
    'Sweeper',
    'best_value',
    'choose',
    'cluster_states',
    'covering',
    'fit_expansion',
    'goal_sub_mdps',
    'highest_priority',
    'lower_bound',
    'split_sub_mdps',
    'summed',
    'value_iteration',
    'whole_mission',
]
