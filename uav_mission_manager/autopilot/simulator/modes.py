"""Flight modes of the simulated autopilot, and what they need."""

from __future__ import annotations

from enum import IntEnum


class SimulatedMode(IntEnum):
    """ArduCopter's numbers of the modes simulated."""

    STABILIZE = 0
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17


MODES_WITHOUT_POSITION = {SimulatedMode.STABILIZE, SimulatedMode.LAND}
"""Modes that fly without a position."""

ARMABLE_MODES = {SimulatedMode.STABILIZE, SimulatedMode.GUIDED, SimulatedMode.LOITER}
"""Modes in which the vehicle arms."""
