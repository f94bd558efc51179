"""On board: range model, situation, command grammar. Pure: no ROS, no clock, no files."""

from uav_mission_manager.onboard.command import format_command, parse_command
from uav_mission_manager.onboard.deciding import Refusal, decide
from uav_mission_manager.onboard.dwell import StandingCommand, dwell
from uav_mission_manager.onboard.inputs import InputError
from uav_mission_manager.onboard.mission_manager import ManagerSettings, MissionManager
from uav_mission_manager.onboard.range_model import range_flags
from uav_mission_manager.onboard.situation import Situation

__all__ = [
    'InputError',
    'ManagerSettings',
    'MissionManager',
    'Refusal',
    'Situation',
    'StandingCommand',
    'decide',
    'dwell',
    'format_command',
    'parse_command',
    'range_flags',
]
