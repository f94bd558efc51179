"""Motor layouts of the simulated vehicle, and how its autopilot shares the load between motors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

MIN_EFFECTIVENESS = 1e-3
"""Effectiveness below which a motor is as good as dead: a choice, that the load can be shared."""


@dataclass(frozen=True)
class MotorFrame:
    """ArduCopter's X frame of a kind, motors in the order of its outputs.

    Attributes
    ----------
    mav_type : int
        MAV_TYPE in HEARTBEAT.
    angles : tuple of float
        Where each motor is [deg], clockwise from the nose.
    spins : tuple of int
        1 for a motor that turns counter-clockwise, -1 clockwise.
    """

    mav_type: int
    angles: tuple[float, ...]
    spins: tuple[int, ...]

    @cached_property
    def mixer(self) -> NDArray[np.float64]:
        """What each motor (row) adds to thrust, roll, pitch and yaw (columns)."""
        angles = np.radians(self.angles)
        ones = np.ones(len(angles))
        return np.column_stack((ones, -np.sin(angles), np.cos(angles), np.array(self.spins)))

    @cached_property
    def rearward(self) -> NDArray[np.float64]:
        """How far back each motor is: 1 the rearmost, -1 the foremost."""
        back = -np.cos(np.radians(self.angles))
        return np.asarray(back / abs(back).max())


QUAD_X = MotorFrame(mavlink.MAV_TYPE_QUADROTOR, (45.0, -135.0, -45.0, 135.0), (1, 1, -1, -1))
"""Four motors."""

HEXA_X = MotorFrame(
    mavlink.MAV_TYPE_HEXAROTOR,
    (30.0, 90.0, 150.0, -150.0, -90.0, -30.0),
    (1, -1, 1, -1, 1, -1),
)
"""Six motors."""

OCTA_X = MotorFrame(
    mavlink.MAV_TYPE_OCTOROTOR,
    (22.5, 67.5, 112.5, 157.5, -157.5, -112.5, -67.5, -22.5),
    (-1, 1, -1, 1, -1, 1, -1, 1),
)
"""Eight motors."""

MOTOR_FRAMES = {'quad': QUAD_X, 'hexa': HEXA_X, 'octa': OCTA_X}
"""Frames by name."""


@lru_cache(maxsize=64)
def motor_loads(
    frame: MotorFrame, effectiveness: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Loads of motors that hold `frame` level: in hover, and more for each unit of rear load.

    A healthy vehicle hovers with 1 each. Controllers add the same wherever a column of the mixer
    says so: the loads are u = M x with M^T diag(effectiveness) u = M^T wanted. So the motor
    opposite a weak one unloads, unless there are only as many motors as columns.
    """
    mixer = frame.mixer
    strength = np.maximum(effectiveness, MIN_EFFECTIVENESS)[:, None]
    wanted = mixer.T @ np.column_stack((np.ones(len(mixer)), frame.rearward))
    hover, rear = (mixer @ np.linalg.solve(mixer.T @ (strength * mixer), wanted)).T
    return tuple(hover.tolist()), tuple(rear.tolist())
