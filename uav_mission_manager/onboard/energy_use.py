"""Whether flight takes the power from the battery that the mission plans for.

It is told by how fast the charge falls, for that is what the policy plans with: over stretches of
flight in one mode, and only once the steps of the gauge do not matter any more.
"""

from __future__ import annotations

from dataclasses import dataclass

from uav_mission_manager.mdp import Energy
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR

DIFFERENCE = 0.2
"""Share of the planned power by which another one is told: a choice."""

GAUGE_STEP = 0.01
"""Charge (0 to 1) by which what a stretch drew may be off: a step of the usual gauge."""

MOST_OFF = 0.1
"""Share by which the gauge may have a power wrong that is told: a choice, for the figure to be of
use; after one stretch that takes a tenth of the battery."""

LEAST_SECONDS = 60.0
"""Time [s] of flight in a mode before its power is told: a choice, longer than a gust."""

LONGEST_PAUSE = 10.0
"""Time [s] between two reports, at most, for the flight between them to be known: a choice."""

GAUGE_JUMP = 0.025
"""Charge (0 to 1) that flight draws from one report to the next, at most: a choice, two steps of
the gauge; more is a gauge that corrects itself, or another battery."""

WATTS_PLACES = 10
"""Power [W] is told in multiples of this: a choice, it is not known better."""


@dataclass
class ModeUse:
    """What flight in a mode drew: charge (0 to 1), in a time [s], in a number of stretches."""

    drawn: float = 0.0
    seconds: float = 0.0
    stretches: int = 0


class EnergyUse:
    """The power that flight draws in each mode, by the charge.

    Parameters
    ----------
    energy : Energy
        What is planned.

    Attributes
    ----------
    warnings : dict of str to str
        By the field of the mission file: a line for each mode that draws another power, with what
        it was when that was sure.
    """

    def __init__(self, energy: Energy) -> None:
        self.warnings: dict[str, str] = {}
        self._full = energy.capacity * energy.voltage * SECONDS_PER_HOUR
        self._planned = {False: energy.power, True: energy.agile_power or energy.power}
        self._modes = {False: ModeUse(), True: ModeUse()}
        self._last: tuple[bool, float, float] | None = None

    def interrupt(self) -> None:
        """End a stretch: on the ground, say, or where somebody else flies."""
        self._last = None

    def note(self, charge: float, agile: bool, now: float) -> None:
        """Take the charge (0 to 1) at a time [s] of flight in a mode."""
        last, self._last = self._last, (agile, charge, now)
        use = self._modes[agile]
        if last is None or last[0] != agile or not _follows(last, charge, now):
            use.stretches += 1
            return
        use.drawn += last[1] - charge
        use.seconds += now - last[2]
        field = 'agile_power' if agile else 'power'
        if field not in self.warnings and self._differs(use, self._planned[agile]):
            mode = 'in agile flight ' if agile else ''
            found = round(self._full * use.drawn / use.seconds / WATTS_PLACES) * WATTS_PLACES
            self.warnings[field] = (
                f'battery {mode}drains at {found} W, mission says {self._planned[agile]:g} W: '
                f'set energy.{field} to {found}'
            )

    def _differs(self, use: ModeUse, planned: float) -> bool:
        """Whether what was drawn is not as planned, however the gauge rounded."""
        expected, off = planned * use.seconds / self._full, GAUGE_STEP * use.stretches
        if use.seconds < LEAST_SECONDS or off > MOST_OFF * use.drawn:
            return False
        least, most = use.drawn - off, use.drawn + off
        return least > (1 + DIFFERENCE) * expected or most < (1 - DIFFERENCE) * expected


def _follows(last: tuple[bool, float, float], charge: float, now: float) -> bool:
    """Whether flight alone led from one report to the next: nothing was charged or changed."""
    _, before, at = last
    return 0.0 <= before - charge <= GAUGE_JUMP and 0.0 <= now - at <= LONGEST_PAUSE
