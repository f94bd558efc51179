"""Telemetry as ROS messages."""

from __future__ import annotations

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, NavSatFix, NavSatStatus

from uav_mission_manager.autopilot.telemetry import BatteryReading, Position
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.mdp import Origin


def battery_state(number: int, battery: BatteryReading, stamp: Time) -> BatteryState:
    """Return the ROS message; its current is negative while discharging.

    Its location is the battery's id on the vehicle, as mavros has it.
    """
    message = BatteryState(
        location=f'id{number}',
        voltage=battery.voltage,
        current=-battery.current,
        percentage=battery.charge,
        temperature=math.nan,
        charge=math.nan,
        capacity=math.nan,
        design_capacity=math.nan,
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_UNKNOWN,
        present=True,
    )
    message.power_supply_health = (
        BatteryState.POWER_SUPPLY_HEALTH_GOOD
        if battery.healthy
        else BatteryState.POWER_SUPPLY_HEALTH_UNSPEC_FAILURE
    )
    message.header.stamp = stamp
    return message


def odometry(position: Position, origin: Origin, frame: str, stamp: Time) -> Odometry:
    """Return the position in `map` (ENU), levelled, with the velocity in the vehicle's frame."""
    message = Odometry(child_frame_id=frame)
    message.header.frame_id, message.header.stamp = MAP_FRAME, stamp
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y = origin.to_local(position.latitude, position.longitude)
    place.z = position.altitude - origin.altitude
    yaw = 0.0 if math.isnan(position.heading) else math.pi / 2.0 - position.heading
    turn.z, turn.w = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
    east, north, up = position.velocity
    twist = message.twist.twist.linear
    twist.x = math.cos(yaw) * east + math.sin(yaw) * north
    twist.y = math.cos(yaw) * north - math.sin(yaw) * east
    twist.z = up
    return message


def transform(odom: Odometry) -> TransformStamped:
    """Return where the vehicle's frame is in `map`: what odometry says, for tf2."""
    message = TransformStamped(header=odom.header, child_frame_id=odom.child_frame_id)
    place, shift = odom.pose.pose.position, message.transform.translation
    shift.x, shift.y, shift.z = place.x, place.y, place.z
    message.transform.rotation = odom.pose.pose.orientation
    return message


def nav_sat_fix(position: Position, has_fix: bool, frame: str, stamp: Time) -> NavSatFix:
    """Return the geographic position; its altitude is above mean sea level."""
    message = NavSatFix(
        latitude=position.latitude, longitude=position.longitude, altitude=position.altitude
    )
    message.status.status = NavSatStatus.STATUS_FIX if has_fix else NavSatStatus.STATUS_NO_FIX
    message.header.frame_id, message.header.stamp = frame, stamp
    return message
