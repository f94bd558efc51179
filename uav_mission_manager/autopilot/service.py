"""The stop at the service cell, where people repair the vehicle."""

from __future__ import annotations

from uav_mission_manager.autopilot.site import Site
from uav_mission_manager.autopilot.task import FlightTask
from uav_mission_manager.autopilot.telemetry import Position


class ServiceStop:
    """Counts the time on the ground there; an interruption begins it anew."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._arrived: float | None = None

    def interrupt(self) -> None:
        """Count anew."""
        self._arrived = None

    def done(self, task: FlightTask, position: Position, now: float) -> bool:
        """Whether a repair has just been done; while it is commanded, another one follows."""
        if not (task.service and self._site.there(task, position)):
            self._arrived = None
            return False
        if self._arrived is None:
            self._arrived = now
        done = now - self._arrived >= self._site.settings.service_time
        if done:
            self._arrived = now
        return done
