"""V* and Q on the mission's axes, in memory or out of core."""

from uav_mission_manager.solver.exact.axis_model import AxisModel
from uav_mission_manager.solver.exact.blocks import solve_blocks
from uav_mission_manager.solver.exact.device import DEVICES, find_device
from uav_mission_manager.solver.exact.look_ahead import LookAhead
from uav_mission_manager.solver.exact.sweep import ActionTable, Sweeper
from uav_mission_manager.solver.exact.value_iteration import (
    PRECISIONS,
    Solution,
    value_iteration,
)

__all__ = [
    'DEVICES',
    'PRECISIONS',
    'ActionTable',
    'AxisModel',
    'LookAhead',
    'Solution',
    'Sweeper',
    'find_device',
    'solve_blocks',
    'value_iteration',
]
