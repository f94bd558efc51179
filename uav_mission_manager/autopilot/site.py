"""What the mission file says of the places where the vehicle is, and should be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from uav_mission_manager.autopilot.task import FlightTask, Settings
from uav_mission_manager.autopilot.telemetry import Position


@dataclass
class Site:
    """Checks of positions against the mission.

    Attributes
    ----------
    settings : Settings
        May be replaced in flight.
    ground : callable
        Altitude of the ground above mean sea level [m] at a latitude and longitude [deg].
    """

    settings: Settings
    ground: Callable[[float, float], float]

    def there(self, task: FlightTask, position: Position) -> bool:
        """Whether a vehicle on the ground is where the task wants it to land."""
        distance = position.distance_to(task.latitude, task.longitude)
        return task.land and distance <= self.settings.landed_radius

    def may_stay(self, task: FlightTask, position: Position, goals_wanted: bool | None) -> str:
        """Say why a vehicle on the ground stays there, '' if it has a reason to fly.

        Where nobody says whether goals are wanted, a commitment says that its goal is.
        """
        if self.there(task, position) or not (task.land or task.goal):
            return task.text
        wanted = bool(task.goal) if goals_wanted is None else goals_wanted
        return '' if wanted else f'{task.text}: stays on the ground, for no goal is wanted'

    def too_far(self, task: FlightTask, position: Position) -> str:
        """Say so where the destination cannot be part of a mission flown here, '' where it can."""
        distance = position.distance_to(task.latitude, task.longitude)
        if distance <= self.settings.reach:
            return ''
        return f'{task.text}: {distance / 1000.0:.1f} km away; is it the right mission file?'

    def wrong_datum(self, position: Position, altitude: float, what: str) -> str:
        """Say so where an altitude on the ground [m] disagrees with the mission file, else ''.

        A disagreement as large as half the flight altitude is never accepted.
        """
        error = altitude - self.ground(position.latitude, position.longitude)
        if abs(error) <= min(self.settings.datum_tolerance, self.settings.flight_altitude / 2.0):
            return ''
        return (
            f'{what} is {abs(error):.0f} m {"above" if error > 0.0 else "below"} the mission '
            "file's ground; see grid.origin.altitude and grid.elevation"
        )
