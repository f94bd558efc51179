"""Parameters of the simulated autopilot, under ArduPilot's names where it has one."""

from __future__ import annotations

import math
from typing import NamedTuple

INT8, INT32, REAL32 = 2, 6, 9  # MAV_PARAM_TYPE


class Parameter(NamedTuple):
    """A parameter's default, MAVLink type and range; a value outside is brought to the limit."""

    default: float
    type: int = REAL32
    minimum: float = 0.0
    maximum: float = math.inf


TABLE = {
    'SIM_SPEEDUP': Parameter(1.0, minimum=0.1, maximum=200.0),
    'SIM_ENGINE_FAIL': Parameter(0.0, INT32, maximum=15.0),  # mask of weakened motors
    'SIM_ENGINE_MUL': Parameter(1.0, maximum=1.0),  # their effectiveness
    'SIM_BATT_PCT': Parameter(100.0, maximum=100.0),  # not in ArduPilot: the charge, now
    'SIM_BATT_VOLTAGE': Parameter(0.0, maximum=60.0),  # [V]; 0: from the charge
    'SIM_BATT_CAP_AH': Parameter(5.0, minimum=0.1),
    'SIM_WIND_SPD': Parameter(0.0, maximum=50.0),  # [m/s]
    'SIM_WIND_DIR': Parameter(180.0, maximum=360.0),  # [deg] it blows from
    'SIM_GPS1_ENABLE': Parameter(1.0, INT8, maximum=1.0),
    'SIM_MAG1_FAIL': Parameter(0.0, INT8, maximum=1.0),
    'SIM_BARO_DISABLE': Parameter(0.0, INT8, maximum=1.0),
    'SIM_CAM_FAIL': Parameter(0.0, INT8, maximum=1.0),  # not in ArduPilot
    'WPNAV_SPEED': Parameter(1000.0, minimum=20.0, maximum=2000.0),  # [cm/s]
    'WPNAV_SPEED_UP': Parameter(250.0, minimum=10.0, maximum=1000.0),
    'WPNAV_SPEED_DN': Parameter(150.0, minimum=10.0, maximum=500.0),
    'LAND_SPEED': Parameter(50.0, minimum=30.0, maximum=200.0),
    'RTL_ALT': Parameter(1500.0, INT32, minimum=30.0, maximum=300000.0),  # [cm]
    'RTL_LOIT_TIME': Parameter(5000.0, INT32, maximum=60000.0),  # [ms]
    'DISARM_DELAY': Parameter(10.0, INT8, maximum=127.0),  # [s]
    'BATT_LOW_VOLT': Parameter(10.5),  # [V]
    'BATT_CRT_VOLT': Parameter(10.2),
    'BATT_LOW_TIMER': Parameter(10.0, INT8, maximum=120.0),  # [s]
}


class Parameters(dict[str, float]):
    """The values now, by name; assigning brings a value into its range."""

    def __init__(self) -> None:
        super().__init__((name, parameter.default) for name, parameter in TABLE.items())

    def __setitem__(self, name: str, value: float) -> None:
        parameter = TABLE[name]
        value = min(max(value, parameter.minimum), parameter.maximum)
        super().__setitem__(name, float(value if parameter.type == REAL32 else round(value)))
