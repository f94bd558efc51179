"""What the pilot is told, and what it answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from uav_mission_manager.autopilot.vehicle import Request


class Phase(Enum):
    """What the pilot is doing."""

    NO_LINK = 'no link'
    GROUND = 'on the ground'
    ARMING = 'arming'
    TAKE_OFF = 'take-off'
    EN_ROUTE = 'en route'
    ON_SITE = 'on site'
    LANDING = 'landing'
    HOLDING = 'holding'
    RETURNING = 'returning to launch'
    WAITING = 'waiting'
    PILOT = 'pilot in command'


@dataclass(frozen=True)
class Task:
    """A mission command with its destination [deg].

    Attributes
    ----------
    text : str
        The command as received.
    goal : str
        Goal to complete there, '' for none.
    land : bool
        Land there and stay; otherwise hover, and take off only for a goal.
    service : bool
        Standing there repairs the vehicle.
    """

    text: str
    latitude: float
    longitude: float
    agile: bool = False
    goal: str = ''
    land: bool = False
    service: bool = False


@dataclass(frozen=True)
class Settings:
    """How to fly: [m], [m/s], [s]; a destination farther than `reach` belongs to no mission."""

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
    allow_arming: bool = False


@dataclass(frozen=True)
class Step:
    """Outcome of one update: phase, why in one line, requests, goal completed, repair done."""

    phase: Phase
    status: str
    requests: tuple[Request, ...] = ()
    completed: str = ''
    serviced: bool = False
