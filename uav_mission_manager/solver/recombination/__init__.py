"""Algorithm 2: recombination rules, priorities, meta-policies, assignment and fleet."""

from uav_mission_manager.mdp.fleet_rules import FleetRules, PriorityWeights
from uav_mission_manager.solver.recombination.fleet import FleetPlan, FleetPlanner, LocalPolicy
from uav_mission_manager.solver.recombination.priority import (
    PriorityScore,
    ranked,
)
from uav_mission_manager.solver.recombination.rules import best_value, highest_priority, summed

__all__ = [
    'FleetPlan',
    'FleetPlanner',
    'FleetRules',
    'LocalPolicy',
    'PriorityScore',
    'PriorityWeights',
    'best_value',
    'highest_priority',
    'ranked',
    'summed',
]
