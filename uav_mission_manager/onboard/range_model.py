"""Range flags on board: those of the range model, with a margin to come back by."""

from __future__ import annotations

from collections.abc import Sequence

from uav_mission_manager.mdp import Energy
from uav_mission_manager.mdp.range_model import flight_range

FULL_CHARGE = 0.95
"""State of charge (0 to 1) that counts as full; a choice."""

FLAG_MARGIN = 0.02
"""Charge (0 to 1) that must be there besides the hysteresis for a lost flag to come back: two
points of the usual gauge, more than it flickers by; a choice."""


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
