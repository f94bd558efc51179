"""Mission commands as flight tasks: where the mission file says to go, and how high."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_mission_manager.autopilot.task import FlightTask
from uav_mission_manager.goal_task import Waypoint, Waypoints
from uav_mission_manager.mdp import Action, ActionKind, Mission, Origin

SPEED_TOLERANCE = 0.05
"""By how much of itself a speed may differ from the planned one untold: a choice."""


def speed_differences(mission: Mission, cruise_speed: float, agile_speed: float) -> list[str]:
    """Say which speeds [m/s] of a bridge are not those that the mission plans for, a line each.

    Agile flight counts where the mission knows what it draws from the battery.
    """
    energy = mission.energy
    if energy is None:
        return []
    planned = {'cruise_speed': ('speed', energy.speed, cruise_speed)}
    if mission.range.charge is not None or energy.agile_speed is not None:
        faster = energy.agile_speed or energy.speed
        planned['agile_speed'] = ('agile_speed', faster, agile_speed)
    return [
        f'{name} is {flown:g} m/s, the mission plans for {speed:g} m/s: '
        f'make it the same as energy.{field}'
        for name, (field, speed, flown) in planned.items()
        if not math.isclose(flown, speed, rel_tol=SPEED_TOLERANCE)
    ]


class FlightPlan:
    """Destinations and altitudes of a mission.

    Parameters
    ----------
    mission : Mission
        With a `grid.origin`; ValueError otherwise.
    flight_altitude : float
        Above the ground [m]; on the way, above that of the highest cell.

    source : str
        Path of the policy set that the mission is from, '' for the mission file.

    Attributes
    ----------
    mission : Mission
    origin : Origin
    flight_altitude : float
    source : str
    """

    def __init__(self, mission: Mission, flight_altitude: float, source: str = '') -> None:
        if mission.grid.origin is None:
            raise ValueError('grid.origin is missing; the bridge needs it to fly')
        self.origin: Origin = mission.grid.origin
        self.mission, self.source = mission, source
        self.flight_altitude = flight_altitude
        self._above = self.origin.altitude + flight_altitude
        cells = range(mission.grid.rows * mission.grid.cols)
        self._places = [self.origin.to_geodetic(*mission.grid.position(cell)) for cell in cells]
        self._highest = max(mission.grid.ground(cell) for cell in cells)

    def task(self, action: Action, text: str) -> FlightTask:
        """Return the task of an action; `text` is its command."""
        goal = None if action.goal is None else self.mission.goals[action.goal]
        work = goal.task if goal else None
        points = work.points if isinstance(work, Waypoints) else ()
        return FlightTask(
            text,
            *self._places[action.destination],
            altitude=self._above + self.mission.grid.ground(action.destination),
            cruise_altitude=self._above + self._highest,
            agile=action.agile,
            goal=goal.name if goal else '',
            land=goal is None and not action.agile,
            service=action.kind is ActionKind.REPAIR,
            work=work,
            points=tuple(map(self._point, points)),
        )

    def _point(self, point: Waypoint) -> tuple[float, float, float]:
        """Return latitude, longitude [deg] and altitude above mean sea level [m]."""
        height = self.flight_altitude if point.height is None else point.height
        ground = self.ground(point.latitude, point.longitude)
        return point.latitude, point.longitude, ground + height

    def ground(self, latitude: float, longitude: float) -> float:
        """Altitude of the ground above mean sea level [m] at a place [deg], by the mission."""
        grid = self.mission.grid
        cell = grid.cell_at(*self.origin.to_local(latitude, longitude))
        return self.origin.altitude + grid.ground(cell)


@dataclass
class Plans:
    """What is flown by, and what the manager may command by any time; None for nothing else."""

    present: FlightPlan
    next: FlightPlan | None = None

    @property
    def latest(self) -> FlightPlan:
        """The plan of the latest policy set."""
        return self.next or self.present

    def goals(self) -> list[str]:
        """Names of the goals that are flown to."""
        return [goal.name for goal in self.present.mission.goals]
