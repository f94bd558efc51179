"""What must hold of where the vehicle is, in truth."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from parts.soak.chain import SETTINGS
from uav_mission_manager.autopilot.simulator.physics import MAX_ACCELERATION

if TYPE_CHECKING:
    from parts.soak.day import Day

BLOWN_SPEED = 9.0
"""Wind [m/s] from which a vehicle may be blown off: at twice its gusts it leaves no more than the
5 m/s it flies with."""

BLOWN_TIME = 30.0
"""Time [s] after such a wind, or without a position, in which the vehicle may have been carried: a
choice."""

GRID_MARGIN = 20.0
"""How far [m] off the grid a vehicle in no wind may be: a choice, to turn around."""

RETURN_CLIMB = 16.0
"""How much higher [m] than in flight a vehicle may be: ArduCopter returns at 15 m, or higher where
it is."""

FENCE_MARGIN = 1.0
"""How far [m] outside the fence a vehicle may be beyond the way it needs to stop: a choice."""

ON_SITE = 6.0
"""How far [m] from a goal it can be completed: twice what the bridge is told, for wind."""

AT_HEIGHT = 4.0
"""The same for its height [m]: twice the bridge's tolerance."""

LEFT = 25.0
"""How far [m] from a goal a vehicle has left it."""


class Violated(Exception):
    """What must hold did not."""


def fail(invariant: str, text: str) -> None:
    """Say what was violated."""
    raise Violated(f'{invariant}: {text}')


class Whereabouts:
    """Checks place and height of a vehicle in the air.

    Attributes
    ----------
    away : dict of str to bool
        Whether it has left each goal since the last completion there.
    """

    def __init__(self, day: Day, checked: Counter[str]) -> None:
        self._day, self._checked = day, checked
        self._goals = {goal.name: goal.cell for goal in day.mission.goals}
        self.away = dict.fromkeys(self._goals, False)
        self._blown_at = -math.inf
        self._off_grid = self._was_blown = False
        self._inside: tuple[complex, float] | None = None  # the fence that it was inside of
        self._way_to_stop = 0.0  # from where it was inside last [m]

    def at(self, goal: str) -> bool:
        """Whether it is where a goal can be completed."""
        vehicle = self._day.vehicle
        near = vehicle.distance(self._day.mission.grid, self._goals[goal]) <= ON_SITE
        height = vehicle.flight.body.altitude - SETTINGS.flight_altitude
        return near and abs(height) <= AT_HEIGHT

    def check(self) -> None:
        """Check what is true now."""
        vehicle, grid = self._day.vehicle, self._day.mission.grid
        if abs(vehicle.flight.wind) > BLOWN_SPEED or not vehicle.flight.position_ok:
            self._blown_at = self._day.now
        outside = vehicle.off_grid(grid) > GRID_MARGIN
        if not vehicle.airborne:  # It may take off from where it was blown.
            self._off_grid = self._was_blown = outside
            return
        self._checked['steps in the air'] += 1
        for goal, cell in self._goals.items():
            self.away[goal] = self.away[goal] or vehicle.distance(grid, cell) > LEFT
        if outside and not self._off_grid:
            self._was_blown = self._blown
        self._off_grid = outside
        if outside and not self._was_blown:
            fail('on the grid', 'at {:.0f} m east, {:.0f} m north'.format(*vehicle.place))
        self._check_fence()
        if self._empty and not vehicle.piloted:
            fail('reserve', 'the battery is empty in the air')

    @property
    def drained(self) -> bool:
        """Whether the battery is empty after a flight in which a person kept it in the air."""
        return self._empty and self._day.vehicle.piloted

    @property
    def _empty(self) -> bool:
        return self._day.vehicle.flight.body.battery.charge <= 0.0

    @property
    def _blown(self) -> bool:
        return self._day.now - self._blown_at < BLOWN_TIME

    def _check_fence(self) -> None:
        """It does not leave the fence, and is never higher than a return to launch asks for."""
        flight = self._day.vehicle.flight
        if flight.body.altitude > SETTINGS.flight_altitude + RETURN_CLIMB:
            fail('inside the fence', f'{flight.body.altitude:.0f} m high')
        fence = flight.home.position, flight.parameters['FENCE_RADIUS']
        beyond = abs(flight.body.position - fence[0]) - fence[1]
        if beyond <= 0.0:
            self._way_to_stop = abs(flight.body.velocity) ** 2 / (2.0 * MAX_ACCELERATION)
        outside = beyond > self._way_to_stop + FENCE_MARGIN
        if outside and self._inside == fence and not self._blown:
            fail('inside the fence', f'{fence[1]:.0f} m around home')
        self._inside = None if outside else fence
