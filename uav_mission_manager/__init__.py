"""Mission decisions for a UAV from Markov decision processes solved before flight."""

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.policy import build_policy, load_policy

__all__ = ['build_policy', 'load_mission', 'load_policy']
