"""The crew: looks after the vehicle, takes it over now and then, and gives it back."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from parts.soak.agenda import Agenda
from parts.soak.day import Day
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode

CARE_PERIOD = 1.0
"""Time [s] between two looks at the vehicle."""

LOW_CHARGE = 0.2
"""Charge below which the battery is changed wherever the vehicle stands, and in flight nobody
interferes with a landing."""

NEAR = 25.0
"""How far [m] from a cell's centre the vehicle stands in it."""


class Crew:
    """People beside the vehicle."""

    def __init__(self, day: Day, agenda: Agenda) -> None:
        self._day, self._agenda, self._rng = day, agenda, day.rng
        self._care_at = 0.0
        self._down_since: float | None = None
        self._patience = 10.0
        self._meddling = False  # someone is flying, or has called ~/hold, and means it
        self._gives_back = False  # and calls ~/resume until it is taken

    def take_over(self) -> None:
        """Change the mode in flight, and give command back later."""
        if not self._day.vehicle.airborne or self._meddling or self._battery_low:
            return
        modes = (SimulatedMode.LOITER, SimulatedMode.BRAKE, SimulatedMode.RTL, SimulatedMode.LAND)
        self._put_into(self._rng.choice(modes))
        self._meddling = True

        def give_back() -> None:
            if self._rng.random() < 0.3 and self._day.vehicle.flight.armed:
                self._put_into(SimulatedMode.GUIDED)
            self._gives_back = True

        self._agenda.after(0.5, 60.0, give_back)

    def hold(self) -> None:
        """Call ~/hold, and ~/resume later."""
        if not self._meddling:
            self._day.hold()
            self._give_back_after(60.0)

    def reboot(self) -> None:
        """Reboot the autopilot, if it stands on the ground."""
        if not self._day.vehicle.flight.armed:
            self._day.vehicle.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
            self._day.invariants.rebooted()

    def care(self) -> None:
        """Look after the vehicle, as people do."""
        day = self._day
        if day.now < self._care_at:
            return
        self._care_at = day.now + CARE_PERIOD
        if self._gives_back and day.resume():
            self._meddling = self._gives_back = False
        if day.vehicle.flight.armed or day.vehicle.airborne:
            self._down_since = None
            taken = day.phase == 'pilot in command' and not self._battery_low
            if taken and not self._meddling:  # by a failsafe
                self._give_back_after(20.0)
            return
        if self._down_since is None:
            self._down_since, self._patience = day.now, self._rng.uniform(3.0, 15.0)
        self._mend()
        patient = day.now - self._down_since < self._patience
        if not patient and day.vehicle.off_grid(day.mission.grid) > 0.0:
            self._carry_home()
        if not (patient or self._meddling) and day.phase in ('pilot in command', 'holding'):
            day.resume()
            self._down_since = None

    @property
    def _battery_low(self) -> bool:
        return self._day.vehicle.flight.body.battery.charge < LOW_CHARGE

    def _put_into(self, mode: SimulatedMode) -> None:
        self._day.note('people', mode.name)
        self._day.vehicle.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)

    def _give_back_after(self, longest: float) -> None:
        self._meddling = True

        def give_back() -> None:
            self._gives_back = True

        self._agenda.after(1.0, longest, give_back)

    def _mend(self) -> None:
        """Change the battery, mend motors and camera."""
        day, flight, grid = self._day, self._day.vehicle.flight, self._day.mission.grid
        at_service = day.vehicle.distance(grid, grid.service) < NEAR
        values, not_full = flight.parameters, flight.body.battery.charge < 0.9
        if (at_service and not_full) or self._battery_low or values['SIM_BATT_VOLTAGE']:
            values['SIM_BATT_VOLTAGE'] = 0.0
            flight.set_charge(self._rng.uniform(85.0, 100.0))
            day.counts['batteries changed'] += 1
        if at_service and day.invariants.command == 'repair':
            day.counts['motors mended'] += values['SIM_ENGINE_FAIL'] > 0.0
            values['SIM_ENGINE_FAIL'] = values['SIM_CAM_FAIL'] = 0.0

    def _carry_home(self) -> None:
        """Fetch the vehicle: off the grid nothing is decided."""
        east, north = self._day.mission.grid.position(self._day.mission.grid.base)
        self._day.vehicle.flight.body.position = complex(north, east)
        self._day.counts['carried home'] += 1
        self._day.note('people', 'carry it home')
