"""Range from the charge left, by the paper's energy model.

    tau = SoC b_c v / P,    sigma = beta tau - k1 q - k2 rho,    r_j = 1 iff sigma >= d_j

with a constant speed profile beta; d_j is the distance to goal j and on to the service cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from uav_mission_manager.mdp import Energy, Mission
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR

FULL_CHARGE = 0.95
"""State of charge (0 to 1) that counts as full; a choice."""

FLAG_MARGIN = 0.02
"""Charge (0 to 1) that must be there besides the hysteresis for a lost flag to come back: two
points of the usual gauge, more than it flickers by; a choice."""


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


def range_flags(
    energy: Energy,
    charge: float,
    needed: Sequence[float],
    previous: Sequence[int],
    hysteresis: float,
    share: float = 1.0,
) -> tuple[int, ...]:
    """Range flags r_j (0, 1): lost below d_j, back at (1 + hysteresis) d_j and two points more.

    A range that a full charge gives is enough to come back, or recharging might never end.

    Parameters
    ----------
    energy : Energy
    charge : float
        State of charge, 0 to 1.
    needed : sequence of k floats
        d_j [m], see `required_ranges`.
    previous : sequence of k ints
        The flags so far.
    hysteresis : float
        Fraction of d_j.
    share : float
        What a full battery holds, of the capacity that the charge is counted by.
    """
    sigma = flight_range(energy, charge)
    full = flight_range(energy, FULL_CHARGE * share)
    margin = flight_range(energy, FLAG_MARGIN) - flight_range(energy, 0.0)
    back = (max(d, min((1.0 + hysteresis) * d + margin, full)) for d in needed)
    return tuple(
        int(sigma >= (d if held else regained))
        for d, regained, held in zip(needed, back, previous, strict=True)
    )
