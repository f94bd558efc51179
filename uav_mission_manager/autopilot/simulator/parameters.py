"""Parameters of the simulated autopilot, under ArduPilot's names where it has one."""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

INT8, INT32 = mavlink.MAV_PARAM_TYPE_INT8, mavlink.MAV_PARAM_TYPE_INT32
"""Types of a whole number."""

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
"""Type of any other number."""


class SimulatedParameter(NamedTuple):
    """A parameter's default, MAVLink type and range; a value outside is brought to the limit."""

    default: float
    type: int = REAL32
    minimum: float = 0.0
    maximum: float = math.inf


SIMULATED_PARAMETERS = {
    'SIM_SPEEDUP': SimulatedParameter(1.0, minimum=0.1, maximum=200.0),
    'SIM_ENGINE_FAIL': SimulatedParameter(0.0, INT32, maximum=255.0),  # mask of weakened motors
    'SIM_ENGINE_MUL': SimulatedParameter(1.0, maximum=1.0),  # their effectiveness
    'SIM_BATT_PCT': SimulatedParameter(100.0, maximum=100.0),  # not in ArduPilot: the charge, now
    'SIM_BATT_VOLTAGE': SimulatedParameter(0.0, maximum=60.0),  # [V]; 0: from the charge
    'SIM_BATT_CAP_AH': SimulatedParameter(5.0, minimum=0.1),
    'SIM_WIND_SPD': SimulatedParameter(0.0, maximum=50.0),  # [m/s]
    'SIM_WIND_DIR': SimulatedParameter(180.0, maximum=360.0),  # [deg] it blows from
    'SIM_WIND_TURB': SimulatedParameter(0.0, maximum=20.0),  # [m/s] of gusts, on either axis
    'SIM_GPS1_ENABLE': SimulatedParameter(1.0, INT8, maximum=1.0),
    'SIM_MAG1_FAIL': SimulatedParameter(0.0, INT8, maximum=1.0),
    'SIM_BARO_DISABLE': SimulatedParameter(0.0, INT8, maximum=1.0),
    'SIM_RC_FAIL': SimulatedParameter(0.0, INT8, maximum=2.0),  # not 0: no signal
    'SIM_RC3': SimulatedParameter(1000.0, maximum=2200.0),  # not in ArduPilot: throttle [us]
    'SIM_CAM_FAIL': SimulatedParameter(0.0, INT8, maximum=1.0),  # not in ArduPilot
    'SIM_CAM_REFUSE': SimulatedParameter(0.0, INT8, maximum=1.0),  # not in ArduPilot
    'WPNAV_SPEED': SimulatedParameter(1000.0, minimum=20.0, maximum=2000.0),  # [cm/s]
    'WPNAV_SPEED_UP': SimulatedParameter(250.0, minimum=10.0, maximum=1000.0),
    'WPNAV_SPEED_DN': SimulatedParameter(150.0, minimum=10.0, maximum=500.0),
    'LAND_SPEED': SimulatedParameter(50.0, minimum=30.0, maximum=200.0),
    'RTL_ALT': SimulatedParameter(1500.0, INT32, minimum=30.0, maximum=300000.0),  # [cm]
    'RTL_LOIT_TIME': SimulatedParameter(5000.0, INT32, maximum=60000.0),  # [ms]
    'DISARM_DELAY': SimulatedParameter(10.0, INT8, maximum=127.0),  # [s]
    'BATT_LOW_VOLT': SimulatedParameter(10.5),  # [V]
    'BATT_CRT_VOLT': SimulatedParameter(0.0),  # [V]; 0: none
    'BATT_LOW_TIMER': SimulatedParameter(10.0, INT8, maximum=120.0),  # [s]; 0: never
    'BATT_FS_LOW_ACT': SimulatedParameter(0.0, INT8, maximum=2.0),  # 0 warn, 1 land, 2 return
    'BATT_FS_CRT_ACT': SimulatedParameter(0.0, INT8, maximum=2.0),
    'FS_THR_ENABLE': SimulatedParameter(1.0, INT8, maximum=3.0),  # 0 off, 1, 2 return, 3 land
    'FS_THR_VALUE': SimulatedParameter(975.0, minimum=910.0, maximum=1100.0),  # [us]
    'FS_OPTIONS': SimulatedParameter(16.0, INT32, maximum=63.0),  # mask
    'FS_GCS_ENABLE': SimulatedParameter(0.0, INT8, maximum=5.0),  # 0 off, 1, 2 return, 5 land
    'FS_GCS_TIMEOUT': SimulatedParameter(5.0, minimum=2.0, maximum=120.0),  # [s]
    'MAV_GCS_SYSID': SimulatedParameter(255.0, INT32, minimum=1.0, maximum=255.0),
    'FENCE_ENABLE': SimulatedParameter(0.0, INT8, maximum=1.0),
    'FENCE_RADIUS': SimulatedParameter(300.0, minimum=30.0, maximum=10000.0),  # [m] from home
    'FENCE_ALT_MAX': SimulatedParameter(100.0, minimum=10.0, maximum=1000.0),  # [m] above home
}
"""All parameters by name; those that ArduPilot has with its own defaults and units."""


class Parameters(dict[str, float]):
    """The values now, by name; assigning brings a value into its range."""

    def __init__(self) -> None:
        super().__init__(
            (name, parameter.default) for name, parameter in SIMULATED_PARAMETERS.items()
        )

    def __setitem__(self, name: str, value: float) -> None:
        parameter = SIMULATED_PARAMETERS[name]
        value = min(max(value, parameter.minimum), parameter.maximum)
        super().__setitem__(name, float(value if parameter.type == REAL32 else round(value)))
