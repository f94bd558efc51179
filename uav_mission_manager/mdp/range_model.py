"""Range from the charge left, by the paper's energy model.

    tau = SoC b_c v / P,    sigma = beta tau - k1 q - k2 rho,    r_j = 1 iff sigma >= d_j

with a constant speed profile beta; d_j is the distance to goal j and on to the service cell.
"""

from __future__ import annotations

import math

from uav_mission_manager.mdp.energy import Energy
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR
from uav_mission_manager.mdp.mission import Mission


def endurance(energy: Energy, charge: float) -> float:
    """Flight time tau [s] left at a state of charge SoC (0 to 1)."""
    return charge * energy.capacity * energy.voltage / energy.power * SECONDS_PER_HOUR


def flight_range(energy: Energy, charge: float) -> float:
    """Range sigma [m] left at a state of charge SoC (0 to 1); may be negative."""
    return (
        energy.speed * endurance(energy, charge)
        - energy.wind_penalty * energy.wind
        - energy.payload_penalty * energy.payload
    )


def required_ranges(mission: Mission, position: tuple[float, float]) -> tuple[float, ...]:
    """Ranges d_j [m] from a position (east, north) [m] to each goal and on to the service cell."""
    service = mission.grid.position(mission.grid.service)
    cells = (mission.grid.position(goal.cell) for goal in mission.goals)
    return tuple(math.dist(position, cell) + math.dist(cell, service) for cell in cells)
