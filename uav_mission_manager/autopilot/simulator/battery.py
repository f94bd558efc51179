"""The simulated battery, and the autopilot's watch over its voltage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_mission_manager.autopilot.simulator.parameters import Parameters

CELL_CHARGES = (0.0, 0.05, 0.1, 0.2, 1.0)
"""States of charge at which the voltage of a cell is given; linear in between."""

CELL_VOLTAGES = (3.2, 3.4, 3.53, 3.67, 4.2)
"""Voltage [V] of a cell without load at these charges: a choice, near lithium polymer's."""

LOW_CELL = 3.5
"""Voltage [V] of a cell at which the battery is low: ArduCopter's default, by three cells."""

PACK_RESISTANCE = 0.01
"""Internal resistance of the battery [ohm]: a choice."""


@dataclass(frozen=True)
class Pack:
    """A battery, and what hovering takes of it: cells in series, [Ah], [W]."""

    cells: int
    capacity: float
    hover_power: float


SMALL_PACK = Pack(3, 5.0, 200.0)
"""The simulated battery unless something else is asked for: a choice, 12.6 V when full."""


class SimulatedBattery:
    """A lithium polymer battery: charge 0-1, voltage under load [V], current [A]."""

    def __init__(self, cells: int) -> None:
        self._cells = cells
        self.charge = 1.0
        self.current = 0.0
        self.voltage = cells * CELL_VOLTAGES[-1]
        self.consumed = 0.0  # [Ah] since boot
        self.energy = 0.0  # [J] since boot

    def start_counting(self) -> None:
        """Count what is consumed from here on."""
        self.consumed = self.energy = 0.0

    def drain(self, power: float, dt: float, capacity: float, forced_voltage: float) -> None:
        """Take `power` [W] for `dt` seconds; a forced voltage (not 0) is only measured."""
        voltage = self._cells * float(np.interp(self.charge, CELL_CHARGES, CELL_VOLTAGES))
        self.current = power / voltage if self.charge else 0.0
        used = min(self.current * dt / 3600.0, self.charge * capacity)
        self.charge -= used / capacity
        self.consumed += used
        self.energy += power * dt
        self.voltage = forced_voltage or voltage - self.current * PACK_RESISTANCE


class BatteryMonitor:
    """Failsafe level 0 none, 1 low, 2 critical, after BATT_LOW_TIMER of such a voltage, armed.

    It never goes down by itself: `reset` does that, as a reboot or a new battery.
    """

    def __init__(self) -> None:
        self.level = 0
        self._below = [0.0, 0.0]  # [s] of low, of critical voltage

    def update(self, dt: float, voltage: float, parameters: Parameters) -> bool:
        """Return whether the level went up."""
        limits = (parameters['BATT_LOW_VOLT'], parameters['BATT_CRT_VOLT'])
        timer, before = parameters['BATT_LOW_TIMER'], self.level
        for index, limit in enumerate(limits):
            self._below[index] = self._below[index] + dt if voltage < limit else 0.0
            if 0.0 < timer <= self._below[index]:
                self.level = max(self.level, index + 1)
        return self.level > before

    def reset(self) -> None:
        """Begin anew."""
        self.level = 0
        self._below = [0.0, 0.0]
