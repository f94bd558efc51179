"""The charge of a battery that counts: the worst of what is said of it.

Percentages are often counted by the current from 100 % at power-on, whatever the battery holds
then, or of a capacity that it once had.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import Energy
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR
from uav_mission_manager.onboard.inputs import InputError

NOMINAL_CELL = 3.7
"""Nominal voltage [V] of a lithium polymer cell."""

EMPTY = 0.9
"""Share of its nominal voltage at and below which a battery counts as empty, while at 1 and above
the percentage is believed: a choice, 3.33 V and 3.7 V a cell."""

FULL_CELL = 4.25
"""Highest voltage [V] of a cell: 4.2 when full, and tolerance."""

DEAD_CELL = 3.2
"""Voltage [V] below which no cell is charged in flight: a choice."""

BELIEVED_FACTOR = 10.0
"""A voltage, or a capacity, more times above or below the mission's is unknown: a choice, for
millivolts, single cells and zeros."""

STANDSTILL = 0.05
"""Share of the capacity drawn while the percentage stands still, from which on the current counts:
a choice, five steps of the usual gauge."""

SILENCE, FORGOTTEN = 10.0, 60.0
"""Times [s] after which a battery that is silent, while others are not, is told, and counts no
more: choices, longer than any pause in flight, and no longer than it takes to change it."""

MAX_BATTERIES = 16
"""Most batteries of one vehicle: a choice, against senders that give each message a new id."""

DRAW_STEP = 0.05
"""Steps [Ah] in which the charge drawn is remembered: a choice, so that it seldom changes."""

LONGEST_DRAW = 10.0
"""Time [s] for which a current is taken to flow on until the next one is known, at most: a
choice."""

DISAGREEMENT = 0.05
"""How much less [0 to 1] the voltage must say for that to be told: a choice."""


@dataclass(frozen=True)
class BatteryReport:
    """What is said of a battery; NaN is unknown.

    Attributes
    ----------
    percentage : float
        State of charge, 0 to 1.
    voltage, current, capacity : float
        [V]; [A], negative while discharging; [Ah] when full, as it is today.
    healthy : bool
        Whether the sender does not call it unhealthy.
    """

    percentage: float
    voltage: float = math.nan
    current: float = math.nan
    capacity: float = math.nan
    healthy: bool = True


@dataclass(frozen=True)
class Battery:
    """A battery as last reported, and what its reports add up to.

    Attributes
    ----------
    report : BatteryReport
    time : float
        When reported [s]; infinite for one that only an earlier process has heard of.
    whole : bool
        Whether it has shown a voltage that it can have only with all the cells of the mission's.
    drawn : float
        Charge [Ah] drawn since the percentage changed.
    """

    report: BatteryReport
    time: float = math.inf
    whole: bool = False
    drawn: float = 0.0

    def next(self, report: BatteryReport, energy: Energy, now: float) -> Battery:
        """Take the next report. Raises `InputError` where nothing follows from it."""
        if report.healthy and not 0.0 <= report.percentage <= 1.0:
            raise InputError(
                f'battery_state: percentage {report.percentage} is unknown (not in 0..1)'
            )
        voltage = _believed(report.voltage, energy.voltage)
        drawn = 0.0
        if report.percentage == self.report.percentage:
            elapsed = min(max(now - self.time, 0.0), LONGEST_DRAW)
            flow = -self.report.current if self.report.current < 0.0 else 0.0
            drawn = self.drawn + flow * elapsed / SECONDS_PER_HOUR
        return Battery(
            replace(report, voltage=voltage, capacity=_believed(report.capacity, energy.capacity)),
            now,
            self.whole or voltage >= _limit_of_fewer(energy),
            drawn,
        )

    def charge(self, energy: Energy) -> float:
        """State of charge (0 to 1) of the mission's capacity that counts."""
        report = self.report
        if not report.healthy:
            return 0.0
        drawn = self.drawn / energy.capacity if self.stands_still(energy) else 0.0
        charge = min(report.percentage - drawn, self.charge_by_voltage(energy))
        return max(charge, 0.0) * self.share(energy)

    def share(self, energy: Energy) -> float:
        """Share of the mission's capacity that the battery holds when it is full."""
        capacity = self.report.capacity
        return 1.0 if math.isnan(capacity) else min(capacity / energy.capacity, 1.0)

    def charge_by_voltage(self, energy: Energy) -> float:
        """Charge that the voltage allows for: 0 for empty, 1 where it says nothing against 1."""
        if math.isnan(self.report.voltage):
            return 1.0
        share = self.report.voltage / self.nominal_voltage(energy)
        return min(max((share - EMPTY) / (1.0 - EMPTY), 0.0), 1.0)

    def nominal_voltage(self, energy: Energy) -> float:
        """Nominal voltage [V]: that of the mission's battery, or of one with a cell less.

        Simulators fly missions for batteries of four cells with three. Such a one is taken for
        what it is until it shows a voltage that three cells cannot have, or four empty ones have.
        """
        count = cells(energy)
        return energy.voltage * (count if self.whole else count - 1) / count

    def stands_still(self, energy: Energy) -> bool:
        """Whether the percentage has not changed for long, though current flows."""
        return self.drawn >= STANDSTILL * energy.capacity

    def doubts(self, energy: Energy) -> tuple[str, ...]:
        """What is said against the percentage, a line each."""
        report, doubts = self.report, []
        if not report.healthy:
            return ('reported unhealthy, counted as empty',)
        if self.charge_by_voltage(energy) < report.percentage - DISAGREEMENT:
            enough = self.nominal_voltage(energy)
            doubts.append(
                f'below {enough:.1f} V, too low for its percentage: counted by its voltage'
            )
        if self.stands_still(energy):
            doubts.append(
                'its percentage stands still while current flows: counted by the current'
            )
        if self.share(energy) < 1.0:
            doubts.append(
                f'a capacity of {report.capacity:.3g} Ah, less than the '
                f"mission's {energy.capacity:.3g} Ah: counted in part"
            )
        return tuple(doubts)


@dataclass(frozen=True)
class Batteries:
    """All batteries by id. The one with the least charge counts."""

    by_id: Mapping[str, Battery] = field(default_factory=dict)

    def report(self, battery: str, report: BatteryReport, energy: Energy, now: float) -> Batteries:
        """Take what is said of one of them. Raises `InputError`."""
        known = self.by_id.get(battery)
        if known is None and len(self.by_id) >= MAX_BATTERIES:
            raise InputError(f'battery_state: {quoted(battery)} is one battery too many')
        known = known or Battery(report)
        return Batteries({**self.by_id, battery: known.next(report, energy, now)})

    def settle(self, now: float) -> Batteries:
        """Forget those that have been silent for long."""
        kept = {name: b for name, b in self.by_id.items() if not now - b.time > FORGOTTEN}
        return self if len(kept) == len(self.by_id) else Batteries(kept)

    @property
    def memory(self) -> dict[str, dict[str, float]]:
        """What their next reports do not say again, in JSON values that seldom change."""
        known = {}
        for name, b in self.by_id.items():
            drawn = math.floor(b.drawn / DRAW_STEP) * DRAW_STEP
            if drawn or b.whole:
                percentage = b.report.percentage if drawn else 0.0  # Else it need not be known.
                known[name] = {'percentage': percentage, 'drawn': drawn, 'whole': b.whole}
        return known

    @classmethod
    def remembered(cls, memory: Mapping[str, Mapping[str, Any]]) -> Batteries:
        """Return batteries that only their next reports make count."""
        by_id = {}
        for name, known in memory.items():
            report = BatteryReport(float(known['percentage']))
            by_id[name] = Battery(report, math.inf, bool(known['whole']), float(known['drawn']))
        return cls(by_id)

    def worst(self, energy: Energy) -> Battery | None:
        """Return the one that counts, None before any was heard of."""
        heard = (battery for battery in self.by_id.values() if battery.time < math.inf)
        return min(heard, key=lambda b: (b.charge(energy), b.report.healthy), default=None)

    def doubts(self, energy: Energy, now: float) -> tuple[str, ...]:
        """What is said against the percentages, a line each."""
        lines: list[str] = []
        for name, battery in self.by_id.items():
            if math.isinf(battery.time):
                continue
            which = f'battery_state: battery {shown(name)}' if name else 'battery_state'
            lines += (f'{which}: {doubt}' for doubt in battery.doubts(energy))
            if now - battery.time > SILENCE and len(self.by_id) > 1:
                lines.append(f'{which}: silent, its last charge counts for {FORGOTTEN:.0f} s')
        return tuple(lines)


def cells(energy: Energy) -> int:
    """Return the number of cells in series of the mission's battery."""
    return max(round(energy.voltage / NOMINAL_CELL), 1)


def _limit_of_fewer(energy: Energy) -> float:
    """Voltage [V] from which on a battery has as many cells as the mission's, and not one less."""
    count = cells(energy)
    return min(FULL_CELL * (count - 1), DEAD_CELL * count)


def _believed(value: float, usual: float) -> float:
    """Return a value that can be, else NaN."""
    return value if usual / BELIEVED_FACTOR <= value <= usual * BELIEVED_FACTOR else math.nan
