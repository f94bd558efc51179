"""Policies: building them, policy sets on disk, and the on-line decision."""

from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.decision import Decision
from uav_mission_manager.policy.policy import METHODS, Policy, build_policy, load_policy
from uav_mission_manager.policy.store import PolicyError

__all__ = [
    'METHODS',
    'Checkpoint',
    'Decision',
    'Policy',
    'PolicyError',
    'build_policy',
    'load_policy',
]
