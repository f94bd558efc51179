"""On board: range model, situation, command grammar. Pure: no ROS, no clock, no files."""

from uav_mission_manager.onboard.command import format_command, parse_command
from uav_mission_manager.onboard.dwell import StandingCommand, dwell
from uav_mission_manager.onboard.inputs import InputError
from uav_mission_manager.onboard.range_model import (
    endurance,
    flight_range,
    range_flags,
    required_ranges,
)
from uav_mission_manager.onboard.situation import Refusal, Situation, decide

__all__ = [
    'InputError',
    'Refusal',
    'Situation',
    'StandingCommand',
    'decide',
    'dwell',
    'endurance',
    'flight_range',
    'format_command',
    'parse_command',
    'range_flags',
    'required_ranges',
]
