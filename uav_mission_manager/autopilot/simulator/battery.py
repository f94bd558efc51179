"""The simulated battery, and the autopilot's watch over its voltage."""

from __future__ import annotations

import numpy as np

from uav_mission_manager.autopilot.simulator.parameters import Parameters

CELL_COUNT = 3
"""Cells in series: a choice, 12.6 V when full."""

CELL_CHARGES = (0.0, 0.05, 0.1, 0.2, 1.0)
"""States of charge at which the voltage of a cell is given; linear in between."""

CELL_VOLTAGES = (3.2, 3.4, 3.53, 3.67, 4.2)
"""Voltage [V] of a cell without load at these charges: a choice, near lithium polymer's."""

PACK_RESISTANCE = 0.01
"""Internal resistance of the battery [ohm]: a choice."""


class SimulatedBattery:
    """A lithium polymer battery: charge 0-1, voltage under load [V], current [A]."""

    def __init__(self) -> None:
        self.charge = 1.0
        self.current = 0.0
        self.voltage = CELL_COUNT * CELL_VOLTAGES[-1]
        self.consumed = 0.0  # [Ah] since power-up
        self.energy = 0.0  # [J] since power-up

    def drain(self, power: float, dt: float, capacity: float, forced_voltage: float) -> None:
        """Take `power` [W] for `dt` seconds; a forced voltage (not 0) is only measured."""
        voltage = CELL_COUNT * float(np.interp(self.charge, CELL_CHARGES, CELL_VOLTAGES))
        self.current = power / voltage if self.charge else 0.0
        used = min(self.current * dt / 3600.0, self.charge * capacity)
        self.charge -= used / capacity
        self.consumed += used
        self.energy += power * dt
        self.voltage = forced_voltage or voltage - self.current * PACK_RESISTANCE


class BatteryMonitor:
    """Failsafe level 0 none, 1 low, 2 critical; one up after BATT_LOW_TIMER of low voltage."""

    def __init__(self) -> None:
        self.level = 0
        self._below = 0.0

    def update(self, dt: float, voltage: float, parameters: Parameters, armed: bool) -> bool:
        """Return whether the level went up; it goes down only with a good battery, disarmed."""
        limits = (parameters['BATT_LOW_VOLT'], parameters['BATT_CRT_VOLT'])
        if not armed and voltage >= limits[0]:
            self.level = 0
        low = self.level < len(limits) and voltage < limits[self.level]
        self._below = self._below + dt if low else 0.0
        if not low or self._below < parameters['BATT_LOW_TIMER']:
            return False
        self.level += 1
        self._below = 0.0
        return True
