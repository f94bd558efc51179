"""Policies: building them, policy sets on disk, and the on-line decision."""

from uav_mission_manager.policy.build import (
    DEFAULT_METHOD,
    METHODS,
    build_policy,
    load_policy,
)
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.decision import Decision
from uav_mission_manager.policy.exact_policy import ExactPolicy
from uav_mission_manager.policy.expansion_policy import ExpansionPolicy
from uav_mission_manager.policy.plotting import plot_policy
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.prediction import DEFAULT_ORDER
from uav_mission_manager.policy.recombined_policy import RecombinedPolicy
from uav_mission_manager.policy.store import PolicyError

__all__ = [
    'DEFAULT_METHOD',
    'DEFAULT_ORDER',
    'METHODS',
    'Certificate',
    'Checkpoint',
    'Decision',
    'ExactPolicy',
    'ExpansionPolicy',
    'Policy',
    'PolicyError',
    'RecombinedPolicy',
    'build_policy',
    'load_policy',
    'plot_policy',
]
