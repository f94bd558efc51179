"""The topics on which a vehicle's nodes and their programs speak, and what they are of."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, NavSatFix
from std_msgs.msg import String, UInt8MultiArray
from visualization_msgs.msg import MarkerArray

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # It is part of every ROS, and not of the wheels on PyPI.
    TFMessage = None

TOPICS: dict[str, Any] = {
    'battery_state': BatteryState,
    'odom': Odometry,
    'global_position': NavSatFix,
    'fault_mode': String,
    'threat_level': String,
    'goal_priorities': UInt8MultiArray,
    'goal_active': String,
    'goal_completed': String,
    'goal_failed': String,
    'goal_refused': String,
    'mission_command': String,
    'command_pose': PoseStamped,
    'goal_states': UInt8MultiArray,
    'goal_requests': String,
    'policy_set': String,
    'manager/decision': DiagnosticArray,
    'manager/trace': String,
    'manager/markers': MarkerArray,
    'presence/manager': String,
    'presence/base_station': String,
    'presence/mavlink_bridge': String,
    '/diagnostics': DiagnosticArray,
}
"""All of them, relative to the vehicle's namespace; a test holds them against the nodes."""

if TFMessage is not None:
    TOPICS['/tf'] = TFMessage
