"""Policies: building them, policy sets on disk, and the on-line decision."""

from uav_mission_manager.policy.build import DEFAULT, NAMES, ORDER, build_policy, load_policy
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.decision import Decision
from uav_mission_manager.policy.expansion_policy import ExpansionPolicy
from uav_mission_manager.policy.policy import METHODS, Policy
from uav_mission_manager.policy.store import PolicyError

__all__ = [
    'DEFAULT',
    'METHODS',
    'NAMES',
    'ORDER',
    'Certificate',
    'Checkpoint',
    'Decision',
    'ExpansionPolicy',
    'Policy',
    'PolicyError',
    'build_policy',
    'load_policy',
]
