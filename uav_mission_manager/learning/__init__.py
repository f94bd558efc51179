"""What flights and measurements say of a mission's numbers, and a new mission file with it."""

from uav_mission_manager.learning.counts import Counts, count
from uav_mission_manager.learning.epochs import FlownEpochs, joined, simulated_epochs
from uav_mission_manager.learning.estimates import LearnedNumber
from uav_mission_manager.learning.new_mission import (
    DEFAULT_WEIGHT,
    Measured,
    NewMission,
    with_counts,
    with_measured,
)
from uav_mission_manager.learning.policy_effect import PolicyEffect, effect
from uav_mission_manager.learning.posterior import LEVEL_TEXT, Posterior

__all__ = [
    'DEFAULT_WEIGHT',
    'LEVEL_TEXT',
    'Counts',
    'FlownEpochs',
    'LearnedNumber',
    'Measured',
    'NewMission',
    'PolicyEffect',
    'Posterior',
    'count',
    'effect',
    'joined',
    'simulated_epochs',
    'with_counts',
    'with_measured',
]
