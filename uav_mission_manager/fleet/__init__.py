"""A fleet at its base station: what was heard of each vehicle in, each one's goals out. No ROS."""

from uav_mission_manager.fleet.dispatcher import FleetDispatcher
from uav_mission_manager.fleet.reports import FleetRole, FleetSettings, VehicleReport
from uav_mission_manager.fleet.sharing import FleetDecision, VehicleShare, share_goals

__all__ = [
    'FleetDecision',
    'FleetDispatcher',
    'FleetRole',
    'FleetSettings',
    'VehicleReport',
    'VehicleShare',
    'share_goals',
]
