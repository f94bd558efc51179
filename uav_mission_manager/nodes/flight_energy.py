"""The power that a vehicle draws while it flies as commanded, against the mission's."""

from __future__ import annotations

import math

from uav_mission_manager.autopilot.bridge import BridgeStep
from uav_mission_manager.autopilot.task import Phase
from uav_mission_manager.autopilot.telemetry import Telemetry
from uav_mission_manager.mdp import Action, Energy
from uav_mission_manager.onboard.energy_use import EnergyUse

FLYING = Phase.EN_ROUTE, Phase.ON_SITE
"""Phases that the mission's power is of: no climb, no landing, nobody else in command."""


class FlightEnergy:
    """Hears of each step of a bridge; without an energy model of the mission nothing is said."""

    def __init__(self, energy: Energy | None) -> None:
        self._use = None if energy is None else EnergyUse(energy)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is drawn otherwise than planned, a line for each mode."""
        return tuple(self._use.warnings.values()) if self._use else ()

    def note(
        self, step: BridgeStep, telemetry: Telemetry, action: Action | None
    ) -> tuple[str, ...]:
        """Take a step, and the action commanded in it, if any; return new warnings."""
        position, use = telemetry.position, self._use
        if use is None:
            return ()
        if position is None or action is None or step.pilot.phase not in FLYING:
            use.interrupt()
            return ()
        charges = [battery.charge for battery in step.batteries.values() if battery.healthy]
        if not charges or any(map(math.isnan, charges)):
            return ()
        before = self.warnings
        use.note(min(charges), action.agile, position.boot_time)
        return self.warnings[len(before) :]
