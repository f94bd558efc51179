"""What was heard of a vehicle last, and what part it has in the fleet by that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

FRESH_TIME = 3.0
"""Age [s] up to which a vehicle counts as heard: a choice, three repetitions of what it says."""


class FleetRole(Enum):
    """What a vehicle can be given: goals; the one that it has, for a while; nothing."""

    READY = 'ready'
    AWAITED = 'awaited'
    OUT = 'out'


@dataclass(frozen=True)
class FleetSettings:
    """How goals are shared out.

    Attributes
    ----------
    lost_after : float
        Time [s] for which a vehicle that is not heard, or does not obey its manager, keeps its
        goal.
    separation : float
        Least difference of two vehicles' flight heights [m].
    assignment : {'optimal', 'queue'}
        See `uav_mission_manager.solver.recombination.assignment`.
    """

    lost_after: float = 10.0
    separation: float = 5.0
    assignment: str = 'optimal'


@dataclass(frozen=True)
class VehicleReport:
    """What was heard of a vehicle. Times are of one clock, and -inf for never.

    Attributes
    ----------
    state : tuple of int
        The state in which its manager decided last.
    decided_at : float
        When that was [s].
    silence : str
        Why the manager decides nothing now, '' where it does.
    obeyed_at : float
        When the autopilot last obeyed the manager [s].
    disobedience : str
        Who or what is in command now in place of the manager, '' where it is.
    altitude : float
        Height at which it flies [m]; nan while it is not known.
    refused : set of int
        Goals that it could not fly to, counted from 0.
    """

    state: tuple[int, ...] = ()
    decided_at: float = -math.inf
    silence: str = ''
    obeyed_at: float = -math.inf
    disobedience: str = ''
    altitude: float = math.nan
    refused: frozenset[int] = frozenset()

    @classmethod
    def awaited(cls, state: tuple[int, ...], now: float) -> VehicleReport:
        """Return what is known of a vehicle that was heard by the station before this one."""
        return cls(state, decided_at=now, silence='not heard yet', obeyed_at=now)

    def with_decision(self, state: tuple[int, ...], silence: str, now: float) -> VehicleReport:
        """Return what is known with a word of its manager; no state is no decision."""
        if not state:
            return replace(self, silence=silence or 'no decision')
        return replace(self, state=state, decided_at=now, silence='')

    def with_bridge(self, disobedience: str, altitude: float, now: float) -> VehicleReport:
        """Return what is known with a word of its bridge."""
        obeyed_at = self.obeyed_at if disobedience else now
        return replace(self, disobedience=disobedience, altitude=altitude, obeyed_at=obeyed_at)

    def with_refused(self, goal: int) -> VehicleReport:
        """Return what is known with a goal that it could not fly to."""
        return replace(self, refused=self.refused | {goal})

    @property
    def ready_at(self) -> float:
        """When the manager last decided and was obeyed, both of them [s]."""
        return min(self.decided_at, self.obeyed_at)

    def trouble(self, now: float) -> str:
        """Why it can be given nothing new, '' where it can."""
        for what, at in (('manager', self.decided_at), ('bridge', self.obeyed_at)):
            said = self.silence if what == 'manager' else self.disobedience
            if said:
                return said
            if now - at > FRESH_TIME:
                return f'{what} not heard' + ('' if at == -math.inf else ' any more')
        return '' if math.isfinite(self.altitude) else 'its flight height is not known'


def roles(
    reports: Mapping[str, VehicleReport], settings: FleetSettings, now: float
) -> dict[str, tuple[FleetRole, str]]:
    """Return the part of each vehicle, and why where it is not ready."""
    heights = {name: report.altitude for name, report in reports.items()}
    conflicts = height_conflicts(heights, settings.separation)
    found = {}
    for name, report in reports.items():
        trouble = report.trouble(now)
        if name in conflicts:
            found[name] = FleetRole.OUT, conflicts[name]
        elif not trouble:
            found[name] = FleetRole.READY, ''
        else:
            lost = now - report.ready_at > settings.lost_after
            found[name] = FleetRole.OUT if lost else FleetRole.AWAITED, trouble
    return found


def height_conflicts(heights: Mapping[str, float], separation: float) -> dict[str, str]:
    """Say which vehicles fly too near the height [m] of one before them, which goes on."""
    found: dict[str, str] = {}
    for name, height in heights.items():
        for other, taken in heights.items():
            if other == name:
                break
            if other not in found and abs(height - taken) < separation:
                found[name] = (
                    f'flight_altitude {height:g} m is within {separation:g} m of the '
                    f'{taken:g} m of {other}: they could meet'
                )
                break
    return found
