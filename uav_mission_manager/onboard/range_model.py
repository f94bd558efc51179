"""What is in range on board: as in the model, with a margin to come back by."""

from __future__ import annotations

from collections.abc import Sequence

from uav_mission_manager.mdp import Energy, Mission
from uav_mission_manager.mdp.charge import charge_level, flags_at
from uav_mission_manager.mdp.range_model import flight_range, required_ranges
from uav_mission_manager.onboard.battery import Battery

FULL_CHARGE = 0.95
"""State of charge (0 to 1) that counts as full; a choice."""

FLAG_MARGIN = 0.02
"""Charge (0 to 1) that must be there besides the hysteresis for a lost flag to come back: two
points of the usual gauge, more than it flickers by; a choice."""

FULL_PACK = 0.895
"""Share of what it holds from which a battery is not worth waiting for: a choice, many chargers
stop at 90 %, and a message says that as a float32, which is a little less."""


def level_on_board(mission: Mission, battery: Battery, previous: int) -> int:
    """Level b of a battery: lower at once, higher only from `FLAG_MARGIN` above its lower end.

    The mission needs `energy`. Without a charge b is 0.
    """
    energy, levels = mission.energy, mission.range.levels
    assert energy is not None
    charge = battery.charge(energy)
    level = charge_level(levels, charge)
    if level <= previous or charge >= FULL_CHARGE:
        return level
    return max(previous, charge_level(levels, charge - FLAG_MARGIN))


def flags_on_board(
    mission: Mission,
    battery: Battery,
    position: tuple[float, float],
    place: tuple[int, int],
    held: Sequence[int],
    hysteresis: float,
) -> tuple[int, ...]:
    """Range flags r_j (0, 1) of a battery: with a charge the model's own, else `range_flags`.

    Parameters
    ----------
    mission : Mission
        With `energy`.
    battery : Battery
    position : tuple of (east, north)
        [m]
    place : tuple of (cell, level)
        l and b.
    held : sequence of k ints
        The flags so far.
    hysteresis : float
        See `range_flags`.
    """
    energy = mission.energy
    assert energy is not None
    if not battery.report.healthy:
        return (0,) * mission.k
    if mission.range.charge is not None:
        return flags_at(mission, *place)
    needed, charge = required_ranges(mission, position), battery.charge(energy)
    return range_flags(energy, charge, needed, held, hysteresis, battery.share(energy))


def range_flags(
    energy: Energy,
    charge: float,
    needed: Sequence[float],
    previous: Sequence[int],
    hysteresis: float,
    share: float = 1.0,
) -> tuple[int, ...]:
    """Range flags r_j (0, 1): lost below d_j, back at (1 + hysteresis) d_j and two points more.

    A range that `FULL_PACK` gives is enough to come back, or recharging might never end.

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
    full = flight_range(energy, FULL_PACK * share)
    margin = flight_range(energy, FLAG_MARGIN) - flight_range(energy, 0.0)
    back = (max(d, min((1.0 + hysteresis) * d + margin, full)) for d in needed)
    return tuple(
        int(sigma >= (d if held else regained))
        for d, regained, held in zip(needed, back, previous, strict=True)
    )
