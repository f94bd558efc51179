"""What the pilot is told, and what it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from uav_mission_manager.autopilot.vehicle import Request
from uav_mission_manager.goal_task import GoalTask


class Phase(Enum):
    """What the pilot is doing."""

    NO_LINK = 'no link'
    GROUND = 'on the ground'
    ARMING = 'arming'
    TAKE_OFF = 'take-off'
    CLIMBING = 'climbing'
    EN_ROUTE = 'en route'
    ON_SITE = 'on site'
    LANDING = 'landing'
    HOLDING = 'holding'
    RETURNING = 'returning to launch'
    BLOCKED = 'blocked'
    WAITING = 'waiting'
    PILOT = 'pilot in command'


@dataclass(frozen=True)
class FlightTask:
    """A mission command with its destination [deg].

    Attributes
    ----------
    text : str
        The command as received.
    altitude, cruise_altitude : float
        Above mean sea level [m]: there, and on the way.
    goal : str
        Goal to complete there, '' for none.
    land : bool
        Land there and stay; otherwise hover, and take off only for a goal.
    service : bool
        Standing there repairs the vehicle.
    work : GoalTask or None
        What to do at the goal.
    points : tuple of (latitude, longitude, altitude)
        Its waypoints [deg], above mean sea level [m].
    """

    text: str
    latitude: float
    longitude: float
    altitude: float
    cruise_altitude: float
    agile: bool = False
    goal: str = ''
    land: bool = False
    service: bool = False
    work: GoalTask | None = None
    points: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True)
class Settings:
    """How to fly.

    Attributes
    ----------
    flight_altitude : float
        Above the ground of the mission file [m].
    cruise_speed, agile_speed : float
        In normal and agile mode [m/s].
    acceptance_radius : float
        Distance from a destination within which the vehicle is on site [m].
    landed_radius : float
        The same for a vehicle that stands on the ground [m].
    reach : float
        Distance from which a destination cannot be part of a mission flown here [m].
    goal_dwell : float
        Time on site until a goal without a task is completed [s].
    manager_timeout : float
        Time without mission command until the vehicle holds [s].
    rtl_delay : float
        Time of holding until it returns to launch [s].
    service_time : float
        Time landed in the service cell until a repair is done [s].
    progress_timeout : float
        Time without getting nearer to a destination until it counts as out of reach [s].
    datum_tolerance : float
        How far [m] the vehicle may stand above or below the ground of the mission file, to take
        off: beyond, one of the two altitudes is wrong.
    allow_arming : bool
        Whether it may be armed and take off.
    """

    flight_altitude: float = 20.0
    cruise_speed: float = 5.0
    agile_speed: float = 10.0
    acceptance_radius: float = 3.0
    landed_radius: float = 25.0
    reach: float = math.inf
    goal_dwell: float = 2.0
    manager_timeout: float = 3.0
    rtl_delay: float = 10.0
    service_time: float = 5.0
    progress_timeout: float = 30.0
    datum_tolerance: float = 10.0
    allow_arming: bool = False

    @property
    def height_tolerance(self) -> float:
        """How far [m] above or below its altitude the vehicle is still at it: a choice."""
        return min(2.0, self.flight_altitude / 4.0)


@dataclass(frozen=True)
class PilotOutput:
    """Outcome of one update.

    Attributes
    ----------
    phase : Phase
    status : str
        Why, in one line.
    requests : tuple of Request
        What to ask of the vehicle.
    completed : str
        The goal that has just been completed, '' for none.
    serviced : bool
        Whether a repair has just been done.
    refused : str
        The goal that has just been found out of reach, or whose task has failed, '' for none.
    losing_ground : bool
        Whether the vehicle is being carried away, so that no goal is within reach.
    active : str
        The goal at which another program is to do its work now, '' for none.
    """

    phase: Phase
    status: str
    requests: tuple[Request, ...] = ()
    completed: str = ''
    serviced: bool = False
    refused: str = ''
    losing_ground: bool = False
    active: str = ''


NO_POSITION_TO_HOLD = 'no position to hold; what happens is up to the autopilot and its failsafes'
"""What the pilot says where it should hold and cannot."""

NOT_ACTIVE = 'the bridge is not active'
"""Why the pilot obeys nobody while it is not."""

UNTIL_RESUME = 'until ~/resume'
"""For how long the pilot holds, where it was told to or something has gone wrong."""

NO_HEARTBEAT = PilotOutput(Phase.NO_LINK, 'no heartbeat of the autopilot')
"""Nothing to do, for nothing is heard: before the first heartbeat as after the last one."""
