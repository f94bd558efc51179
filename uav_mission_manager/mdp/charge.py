"""One battery: its state of charge in levels, what drains them, and which goals they reach.

With B levels, b = min(B - 1, floor(B SoC)). Range is told from the lower end of a level, less a
reserve, by the energy model of `uav_mission_manager.mdp.range_model`:

    r_j(b, l) = 1 iff sigma(b / B - reserve) >= d_j(l),    d_j from the centre of the cell l.

An epoch of flight takes x = B * (its energy) / (energy of the battery) levels in the mean, whether
the UAV moves or hovers, and with a noise nu x (1 - nu), x or x (1 + nu) with probability 1/4, 1/2
and 1/4. Each of these is split between the two whole numbers beside it so that the mean stays.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from uav_mission_manager.mdp.arrays import BoolArray, IntArray
from uav_mission_manager.mdp.energy import Drain, Energy
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.mdp.mission import Mission, Row
from uav_mission_manager.mdp.range_model import endurance, flight_range, required_ranges
from uav_mission_manager.mdp.states import StateView

NOISE_PROBABILITIES = ((-1, 0.25), (0, 0.5), (1, 0.25))
"""What the noise adds to the mean, in its own size, and how probably."""


def charge_level(levels: int, charge: float) -> int:
    """B of a state of charge SoC (0 to 1)."""
    return min(levels - 1, math.floor(levels * charge))


def level_range(mission: Mission, level: int) -> float:
    """Range sigma [m] that counts at a level of the charge."""
    energy, charge = mission.energy, mission.range.charge
    assert energy is not None
    assert charge is not None
    return flight_range(energy, level / charge.levels - charge.reserve)


def flags_at(mission: Mission, cell: int, level: int) -> tuple[int, ...]:
    """r_j(b, l) of each goal."""
    left, position = level_range(mission, level), mission.grid.position(cell)
    return tuple(int(left >= needed) for needed in required_ranges(mission, position))


def state_flags(mission: Mission, s: StateView) -> tuple[int, ...]:
    """The range flags r_j of one state by name, without the table that `RangeFlags` makes."""
    if mission.range.charge is None:
        return tuple(s.r.tolist())
    return flags_at(mission, int(s.l), int(s.b[0]))


def range_table(mission: Mission) -> BoolArray:
    """`flags_at` of a mission with a charge, over goal, cell and level: (k, q, B)."""
    left = [level_range(mission, level) for level in range(mission.range.levels)]
    positions = map(mission.grid.position, range(mission.grid.q))
    needed = [required_ranges(mission, position) for position in positions]
    return np.array(left) >= np.array(needed).T[..., None]


class RangeFlags:
    """The range flags of states: variables of their own, or told by charge and cell."""

    def __init__(self, mission: Mission) -> None:
        self._reach = range_table(mission).transpose(1, 2, 0) * 1 if mission.range.charge else None

    def __call__(self, s: StateView) -> IntArray:
        """r_j of states (N, ..) by name, shape (N, k)."""
        return s.r if self._reach is None else self._reach[s.l, s.b[..., 0]]


def drain_by_energy(energy: Energy, cell_size: float, levels: int, noise: float) -> Drain:
    """Levels that an epoch of flight drains, an epoch being a flight over a cell's width.

    Raises `Bad` where its energy cannot be had of the numbers.
    """
    agile_speed = energy.agile_speed or energy.speed
    agile = replace(energy, power=energy.agile_power or energy.power)
    rows = []
    for by_mode, speed in ((energy, energy.speed), (agile, agile_speed)):
        length, lasts = cell_size / speed, endurance(by_mode, 1.0)
        mean = levels * (length / lasts) if lasts else math.inf
        if not math.isfinite(mean):
            raise Bad(f'a step takes {length:g} s, a full battery lasts {lasts:g} s')
        rows.append(drain_row(mean, levels, noise))
    return Drain(*rows)


def drain_row(mean: float, levels: int, noise: float) -> Row:
    """P(d) of d = 0, 1, .. levels of a mean, with noise; levels - 1 stands for all above too."""
    row = [0.0] * levels
    for sign, probability in NOISE_PROBABILITIES:
        drained = min(mean * (1 + sign * noise), levels - 1)
        whole = math.floor(drained)
        row[whole] += probability * (1 - (drained - whole))
        if drained > whole:
            row[whole + 1] += probability * (drained - whole)
    while row[-1] == 0:
        row.pop()
    return tuple(row)
