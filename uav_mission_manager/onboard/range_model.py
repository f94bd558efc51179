"""Range from the charge left, by the paper's energy model.

    tau = SoC b_c v / P,    sigma = beta tau - k1 q - k2 rho,    r_j = 1 iff sigma >= d_j

with a constant speed profile beta. d_j is the way from here to goal j and on to the service cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uav_mission_manager.mdp import Energy, Mission

SECONDS_PER_HOUR = 3600.0
FULL_CHARGE = 0.95
"""State of charge that counts as full: no margin asks for more than it gives."""


def endurance(energy: Energy, charge: float) -> float:
    """Flight time tau [s] left at a state of charge SoC (0 to 1)."""
    return charge * energy.capacity * energy.voltage / energy.power * SECONDS_PER_HOUR


def flight_range(energy: Energy, charge: float) -> float:
    """Range sigma [m] left at a state of charge SoC (0 to 1); negative where wind eats it all."""
    return (
        energy.speed * endurance(energy, charge)
        - energy.wind_penalty * energy.wind
        - energy.payload_penalty * energy.payload
    )


def way_home(mission: Mission, position: tuple[float, float]) -> tuple[float, ...]:
    """Distances d_j [m] from a position (east, north) [m] over each goal to the service cell."""
    service = mission.grid.position(mission.grid.service)
    cells = (mission.grid.position(goal.cell) for goal in mission.goals)
    return tuple(math.dist(position, cell) + math.dist(cell, service) for cell in cells)


def range_flags(
    energy: Energy,
    charge: float,
    distances: Sequence[float],
    previous: Sequence[int],
    hysteresis: float,
) -> tuple[int, ...]:
    """Range flags r_j (0, 1): lost below d_j, back only at (1 + hysteresis) d_j.

    The margin never asks for more than a full charge gives, or recharging could not end.
    """
    sigma = flight_range(energy, charge)
    full = flight_range(energy, FULL_CHARGE)
    back = (max(d, min((1.0 + hysteresis) * d, full)) for d in distances)
    return tuple(
        int(sigma >= (d if held else needed))
        for d, needed, held in zip(distances, back, previous, strict=True)
    )
