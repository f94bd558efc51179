"""Within which limits a mission is plausible, and why: the table of all thresholds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlausibleRange:
    """What a number may be from, and up to, before it is warned of.

    Attributes
    ----------
    low, high : float
        Both are plausible themselves.
    unit : str
    reason : str
        Why beyond them hardly anybody means it.
    """

    low: float
    high: float
    unit: str
    reason: str

    def hold(self, value: float) -> bool:
        """Whether a value is plausible."""
        return self.low <= value <= self.high


LIMITS = {
    'energy.capacity': PlausibleRange(
        0.1, 500.0, 'Ah', 'from a palm-sized quadcopter to the largest lifters; above it is mAh'
    ),
    'energy.voltage': PlausibleRange(
        3.0, 120.0, 'V', 'one lithium cell nearly empty to 28 in series'
    ),
    'energy.power': PlausibleRange(
        5.0, 50_000.0, 'W', 'a palm-sized quadcopter to one that lifts a person; below it is kW'
    ),
    'energy.speed': PlausibleRange(
        0.5, 35.0, 'm/s', 'a multirotor cruises at 3 to 20 m/s; above it is km/h'
    ),
    'energy.wind': PlausibleRange(
        0.0, 30.0, 'm/s', 'no multirotor flies in a storm; above it is km/h'
    ),
    'energy.payload': PlausibleRange(
        0.0, 200.0, 'kg', 'the largest multirotors lift that; above it is g'
    ),
    'endurance': PlausibleRange(
        60.0, 4 * 3600.0, 's', 'shorter is no flight; longer no battery carries a multirotor'
    ),
    'grid.cell_size': PlausibleRange(
        2.0, 1000.0, 'm', 'satellite navigation is off by 2 m; a kilometre is no place any more'
    ),
    'faults.agile_factor': PlausibleRange(
        1.0, 10.0, '', 'agile flight spares no part, and wears none out ten times as fast'
    ),
    'task time': PlausibleRange(
        0.5, 2.0, '', 'the model takes a goal for done far too soon, or too late'
    ),
    'horizon': PlausibleRange(
        2.0, 1e5, 'epochs', 'shorter looks no flight ahead; longer counts days and solves slowly'
    ),
    'cost ratio': PlausibleRange(
        0.0, 1e3, '', 'what is a thousandth of another cost changes no decision of a person'
    ),
}
"""By field; `endurance` is that of a full battery, `horizon` 1 / (1 - discount), and `cost ratio`
that of the largest cost to all others together. `task time` is that of a goal's task over its
`done_in`."""

DRAWN_EPOCHS = 20_000
"""Epochs of flight that are drawn to see whether a goal is ever committed to: what is done in one
of 5,000 is seen with 98 % (1 - exp(-4)); a choice, a tenth of a second."""

MAX_SOLVE_SECONDS = 30.0
"""Longest exact solution, as predicted, that a check waits for [s]: a choice."""

MAX_SENSITIVITY_SECONDS = 20.0
"""Longest time, as predicted, for solving a mission anew for each of its numbers [s]: a choice.
Above it one backup of each has to do."""
