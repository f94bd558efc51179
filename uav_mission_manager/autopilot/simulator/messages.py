"""What the simulated autopilot tells: one function for each message it can stream."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode
from uav_mission_manager.autopilot.simulator.physics import MAX_SPAN

UNKNOWN_UINT16 = 65535
"""MAVLink's value of an unknown uint16_t."""

SERVO_OUTPUTS = 8
"""Outputs in SERVO_OUTPUT_RAW, without MAVLink 2's extension."""

BOOT_UNIX_TIME = 1767225600.0
"""Unix time [s] when every simulation boots: a choice, 2026 begins, whatever the wall clock."""

ALWAYS_HEALTHY_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS  # also without fix, as seen on ArduCopter
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS  # during boot too
)
"""SYS_STATUS bits of what never fails here."""

HEALTH_CHECKS: dict[int, Callable[[SimulatedFlight], bool]] = {
    mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG: lambda flight: not flight.parameters['SIM_MAG1_FAIL'],
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE: lambda flight: (
        not flight.parameters['SIM_BARO_DISABLE']
    ),
    mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER: lambda flight: not flight.failsafes.radio,
    mavlink.MAV_SYS_STATUS_SENSOR_BATTERY: lambda flight: flight.battery.level == 0,
    mavlink.MAV_SYS_STATUS_SENSOR_PROPULSION: lambda flight: not flight.thrust_loss,
    mavlink.MAV_SYS_STATUS_GEOFENCE: lambda flight: not flight.failsafes.fence,
    mavlink.MAV_SYS_STATUS_PREARM_CHECK: lambda flight: flight.armed or not flight.arming_faults(),
}
"""SYS_STATUS bits of what may fail, each with whether it is healthy."""

EKF_FLAGS_WITHOUT_POSITION = (
    mavlink.EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_VELOCITY_VERT
    | mavlink.EKF_POS_VERT_ABS
    | mavlink.EKF_CONST_POS_MODE
)
"""EKF_STATUS_REPORT flags without a position, before there is one and long after it was lost. Seen
on ArduCopter."""

EKF_FLAGS_COASTING = mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_VERT_ABS
"""EKF_STATUS_REPORT flags just after the position was lost. Seen on ArduCopter."""

EKF_FLAGS_WITH_POSITION = (
    mavlink.EKF_ATTITUDE
    | mavlink.EKF_VELOCITY_HORIZ
    | mavlink.EKF_VELOCITY_VERT
    | mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS
    | mavlink.EKF_POS_VERT_ABS
    | mavlink.EKF_PRED_POS_HORIZ_REL
    | mavlink.EKF_PRED_POS_HORIZ_ABS
)
"""EKF_STATUS_REPORT flags with a position. Seen on ArduCopter."""


def heartbeat(flight: SimulatedFlight) -> Any:
    """Mode, arming and state; the GUIDED bit clears when the position is lost in flight."""
    base = (
        mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    lost = flight.armed and not flight.position_ok
    if flight.mode != SimulatedMode.STABILIZE and not lost:
        base |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    if flight.armed:
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    return mavlink.MAVLink_heartbeat_message(
        flight.body.frame.mav_type,
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        base,
        flight.mode,
        _state(flight),
        3,
    )


def _state(flight: SimulatedFlight) -> int:
    if flight.failsafe:
        return mavlink.MAV_STATE_CRITICAL
    if not flight.estimator.started:
        return mavlink.MAV_STATE_BOOT
    return mavlink.MAV_STATE_STANDBY if flight.landed else mavlink.MAV_STATE_ACTIVE


def _sys_status(flight: SimulatedFlight) -> Any:
    present = ALWAYS_HEALTHY_SENSORS | sum(HEALTH_CHECKS)
    healthy = sum(bit for bit, check in HEALTH_CHECKS.items() if check(flight))
    return mavlink.MAVLink_sys_status_message(
        present,
        present,
        ALWAYS_HEALTHY_SENSORS | healthy,
        150,
        _millivolts(flight),
        _centiamperes(flight),
        _percent(flight),
        0,
        0,
        0,
        0,
        0,
        0,
    )


def _battery_status(flight: SimulatedFlight) -> Any:
    battery = flight.body.battery
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_UNKNOWN,
        mavlink.MAV_BATTERY_TYPE_UNKNOWN,
        32767,
        [_millivolts(flight)] + [UNKNOWN_UINT16] * 9,
        _centiamperes(flight),
        round(battery.consumed * 1000.0),
        round(battery.energy / 100.0),
        _percent(flight),
        0,
        mavlink.MAV_BATTERY_CHARGE_STATE_OK + flight.battery.level,
    )


def _gps_raw(flight: SimulatedFlight) -> Any:
    fixed, found = flight.estimator.gps_fix, flight.estimator.gps_found
    fix = mavlink.GPS_FIX_TYPE_NO_FIX if found else mavlink.GPS_FIX_TYPE_NO_GPS
    if fixed:
        fix = mavlink.GPS_FIX_TYPE_RTK_FIXED
    latitude, longitude = _place(flight) if fixed else (0, 0)
    speed, course = cmath.polar(flight.body.velocity)
    return mavlink.MAVLink_gps_raw_int_message(
        _microseconds(flight),
        fix,
        latitude,
        longitude,
        _altitude(flight),
        121 if fixed else 9999,
        200,
        round(speed * 100.0),
        _centidegrees(course),
        10 if found else 0,  # it counts them on without a fix, as seen on ArduCopter
    )


def _global_position(flight: SimulatedFlight) -> Any:
    body = flight.body
    latitude, longitude = _place(flight) if flight.estimator.gps_found else (0, 0)
    return mavlink.MAVLink_global_position_int_message(
        _milliseconds(flight),
        latitude,
        longitude,
        _altitude(flight),
        round((body.altitude - flight.home.altitude) * 1000.0),
        round(body.velocity.real * 100.0),
        round(body.velocity.imag * 100.0),
        round(-body.climb * 100.0),
        _centidegrees(body.heading),
    )


def _local_position(flight: SimulatedFlight) -> Any:
    body = flight.body
    return mavlink.MAVLink_local_position_ned_message(
        _milliseconds(flight),
        body.position.real,
        body.position.imag,
        -body.altitude,
        body.velocity.real,
        body.velocity.imag,
        -body.climb,
    )


def _attitude(flight: SimulatedFlight) -> Any:
    lean = flight.body.tilt * cmath.exp(-1j * flight.body.heading)
    yaw = math.remainder(flight.body.heading, math.tau)
    return mavlink.MAVLink_attitude_message(
        _milliseconds(flight), lean.imag, -lean.real, yaw, 0.0, 0.0, 0.0
    )


def _vfr_hud(flight: SimulatedFlight) -> Any:
    body = flight.body
    throttle = body.mean_span() / MAX_SPAN * 100.0
    return mavlink.MAVLink_vfr_hud_message(
        abs(body.velocity - flight.wind),
        abs(body.velocity),
        int(math.degrees(body.heading)) % 360,
        round(throttle) if flight.armed else 0,
        flight.origin.altitude + body.altitude,
        body.climb,
    )


def _servo_output(flight: SimulatedFlight) -> Any:
    outputs = [round(pwm) for pwm in flight.body.motors]
    unused = [0] * (SERVO_OUTPUTS - len(outputs))
    return mavlink.MAVLink_servo_output_raw_message(
        _microseconds(flight) % 2**32, 0, *outputs, *unused
    )


def _extended_sys_state(flight: SimulatedFlight) -> Any:
    landed = mavlink.MAV_LANDED_STATE_IN_AIR
    if flight.landed:
        landed = mavlink.MAV_LANDED_STATE_ON_GROUND
    elif flight.landing:
        landed = mavlink.MAV_LANDED_STATE_LANDING
    elif flight.taking_off:
        landed = mavlink.MAV_LANDED_STATE_TAKEOFF
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed)


def _ekf_status(flight: SimulatedFlight) -> Any:
    estimator = flight.estimator
    flags = mavlink.EKF_UNINITIALIZED
    if estimator.attitude_ok:
        lost = EKF_FLAGS_COASTING if estimator.coasting else EKF_FLAGS_WITHOUT_POSITION
        flags = EKF_FLAGS_WITH_POSITION if estimator.position_ok else lost
    compass = 1.5 if flight.parameters['SIM_MAG1_FAIL'] else 0.05
    return mavlink.MAVLink_ekf_status_report_message(flags, 0.05, 0.05, 0.05, compass, 0.0)


def _home_position(flight: SimulatedFlight) -> Any:
    if not flight.estimator.home_known:
        return None
    home = flight.home
    latitude, longitude = flight.origin.to_geodetic(home.position)
    return mavlink.MAVLink_home_position_message(
        round(latitude * 1e7),
        round(longitude * 1e7),
        round((flight.origin.altitude + home.altitude) * 1000.0),
        home.position.real,
        home.position.imag,
        -home.altitude,
        [1.0, 0.0, 0.0, 0.0],
        0.0,
        0.0,
        0.0,
        _microseconds(flight),
    )


def _wind(flight: SimulatedFlight) -> Any:
    return mavlink.MAVLink_wind_message(
        math.remainder(flight.parameters['SIM_WIND_DIR'], 360.0), abs(flight.wind), 0.0
    )


def _system_time(flight: SimulatedFlight) -> Any:
    unix = round((BOOT_UNIX_TIME + flight.time) * 1e6)
    return mavlink.MAVLink_system_time_message(unix, _milliseconds(flight))


def _autopilot_version(_flight: SimulatedFlight) -> Any:
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    version = 4 << 24 | 7 << 16  # 4.7.0-dev
    return mavlink.MAVLink_autopilot_version_message(
        capabilities, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )


def timesync(flight: SimulatedFlight) -> Any:
    """Ask for the peer's time."""
    return mavlink.MAVLink_timesync_message(0, round(flight.time * 1e9))


MESSAGE_BUILDERS: dict[int, Callable[[SimulatedFlight], Any]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo_output,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    mavlink.MAVLINK_MSG_ID_TIMESYNC: timesync,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    mavlink.MAVLINK_MSG_ID_WIND: _wind,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf_status,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
}
"""Builder by message id, None where there is nothing to say yet; what is not here is refused."""


def _milliseconds(flight: SimulatedFlight) -> int:
    return round(flight.time * 1e3)


def _microseconds(flight: SimulatedFlight) -> int:
    return round(flight.time * 1e6)


def _centidegrees(angle: float) -> int:
    return round(math.degrees(angle) * 100.0) % 36000


def _millivolts(flight: SimulatedFlight) -> int:
    return round(flight.body.battery.voltage * 1000.0)


def _centiamperes(flight: SimulatedFlight) -> int:
    return min(round(flight.body.battery.current * 100.0), 32767)


def _percent(flight: SimulatedFlight) -> int:
    return math.floor(flight.body.battery.charge * 100.0 + 1e-6)


def _place(flight: SimulatedFlight) -> tuple[int, int]:
    latitude, longitude = flight.origin.to_geodetic(flight.body.position)
    return round(latitude * 1e7), round(longitude * 1e7)


def _altitude(flight: SimulatedFlight) -> int:
    return round((flight.origin.altitude + flight.body.altitude) * 1000.0)
