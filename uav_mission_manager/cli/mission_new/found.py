"""What a plan, a KML or a GeoJSON file says that a mission can use, and what it cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NoReturn, TypeAlias, get_args

from uav_mission_manager.echo import shown
from uav_mission_manager.goal_task import GoalTask, Waypoint, Waypoints
from uav_mission_manager.mdp import MissionError
from uav_mission_manager.mdp.areas import Polygon
from uav_mission_manager.mdp.fields import MAX_NAME_LENGTH, Bad, latitude, longitude, number

Role: TypeAlias = Literal['goal', 'no_fly', 'fence']
"""What an outline is for."""

ROLES: tuple[Role, ...] = get_args(Role)

HOME_WORDS = ('home', 'base', 'launch')
"""What a point is called that is the home and no goal, in small letters."""

CLOSED = 4
"""Positions of the shortest closed ring: a triangle, its first corner repeated."""

MAX_FEATURES = 1000
"""Places and outlines that are taken at most, and lines: a choice, more than anybody flies to."""

ROOM_FOR_NUMBER = 10
"""Characters of a name left for what makes it unique."""


@dataclass(frozen=True)
class Place:
    """A point.

    Attributes
    ----------
    name : str
        Valid in a mission file.
    latitude, longitude : float
        WGS84 [deg].
    source : str
        Where it comes from, for people.
    altitude : float or None
        Above mean sea level [m], where it is known.
    task : GoalTask or None
        What is to be done there.
    """

    name: str
    latitude: float
    longitude: float
    source: str
    altitude: float | None = None
    task: GoalTask | None = None

    @property
    def waypoints(self) -> tuple[Waypoint, ...]:
        """Those of its task, none if it is of another kind."""
        return self.task.points if isinstance(self.task, Waypoints) else ()


@dataclass(frozen=True)
class Outline:
    """A polygon; `role` is None where the file does not say what it is for.

    A `task` is for the goal that it may become.
    """

    name: str
    polygon: Polygon
    source: str
    role: Role | None = None
    task: Waypoints | None = None


@dataclass(frozen=True)
class Line:
    """A line that may be flown along."""

    name: str
    points: Polygon
    source: str


@dataclass
class Found:
    """What was found, while a file is read.

    Attributes
    ----------
    source : str
        Name of the file.
    home : Place or None
    places : list of Place
        Points to fly to.
    outlines : list of Outline
    lines : list of Line
    left_out : list of (what, why)
    speed, height : (number, where it is from) or None
        Speed of flight [m/s]; height of flight above home [m].
    """

    source: str
    home: Place | None = None
    places: list[Place] = field(default_factory=list)
    outlines: list[Outline] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    speed: tuple[float, str] | None = None
    height: tuple[float, str] | None = None

    def fail(self, place: str, problem: str) -> NoReturn:
        """Raise a `MissionError` about one place of the file."""
        raise MissionError(f'{shown(self.source)}: {shown(place)}: {problem}')

    def leave_out(self, what: str, why: str) -> None:
        """Note that something is not used."""
        self.left_out.append((what, why))

    def add_place(
        self, name: str, point: tuple[float, float], source: str, task: GoalTask | None = None
    ) -> None:
        """Add a place to fly to."""
        self._no_more_than_enough(source)
        self.places.append(Place(self._unique(name), *point, source, task=task))

    def add_point(self, name: str, point: tuple[float, float], source: str) -> None:
        """Add a point of a map: the home if it is called so, else a place to fly to."""
        if self.home is None and name.lower() in HOME_WORDS:
            self.home = Place('home', *point, source)
        else:
            self.add_place(name, point, source)

    def add_outline(
        self,
        name: str,
        polygon: Polygon,
        source: str,
        role: Role | None = None,
        task: Waypoints | None = None,
    ) -> None:
        """Add an outline."""
        self._no_more_than_enough(source)
        self.outlines.append(Outline(self._unique(name), polygon, source, role, task))

    def add_line(self, name: str, points: Any, source: str) -> None:
        """Add a line, given as GeoJSON has it; leave it out if it is none."""
        try:
            line = line_of(points, longitude_first=True)
        except Bad as error:
            self.leave_out(source, str(error))
            return
        if len(self.lines) == MAX_FEATURES:
            self.leave_out(source, f'more than {MAX_FEATURES} lines')
            return
        self.lines.append(Line(self._unique(name), line, source))

    def features(self) -> list[Place | Outline | Line]:
        """Return places, outlines and lines."""
        return [*self.places, *self.outlines, *self.lines]

    def _no_more_than_enough(self, source: str) -> None:
        if len(self.places) + len(self.outlines) == MAX_FEATURES:
            self.fail(source, f'more than {MAX_FEATURES} points and areas')

    def _unique(self, name: str) -> str:
        valid = valid_name(name)
        used = {one.name for one in self.features()}
        names = (valid, *(f'{valid}_{number}' for number in range(2, 2 * MAX_FEATURES + 2)))
        return next(name for name in names if name not in used)


def valid_name(text: str) -> str:
    """Return a name for a mission file that is as like a text as can be."""
    name = ''.join(character for character in '_'.join(text.split()) if character.isprintable())
    return name[: MAX_NAME_LENGTH - ROOM_FOR_NUMBER] or 'unnamed'


def point_of(given: Sequence[Any], *, longitude_first: bool = False) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a position in a file.

    Raises
    ------
    Bad
        If it is none; it says so if the two look swapped.
    """
    if not isinstance(given, (list, tuple)) or len(given) < 2:
        raise Bad(f'{shown(given)} is no position of latitude and longitude')
    first, second = number(given[0]), number(given[1])
    north, east = (second, first) if longitude_first else (first, second)
    try:
        return latitude(north), longitude(east)
    except Bad as error:
        order = 'longitude, latitude' if longitude_first else 'latitude, longitude'
        hint = (
            f'; is the order right? It is {order} here' if abs(east) <= 90.0 < abs(north) else ''
        )
        raise Bad(f'{error}{hint}') from None


def ring_of(given: Any, *, longitude_first: bool = False) -> Polygon:
    """Return the corners of a ring in a file, without the first one repeated at its end.

    Raises
    ------
    Bad
        If it is none.
    """
    if not isinstance(given, (list, tuple)):
        raise Bad(f'{shown(given)} is no list of corners')
    corners = tuple(point_of(corner, longitude_first=longitude_first) for corner in given)
    if len(corners) >= CLOSED and corners[0] == corners[-1]:
        corners = corners[:-1]
    if len(corners) < CLOSED - 1:
        raise Bad(f'{len(corners)} corners are none of an area, which has at least 3')
    return corners


def line_of(given: Any, *, longitude_first: bool = False) -> Polygon:
    """Return the points of a line in a file.

    Raises
    ------
    Bad
        If it is none.
    """
    if not isinstance(given, (list, tuple)) or len(given) < 2:
        raise Bad(f'{shown(given)} is no line of two or more points')
    return tuple(point_of(point, longitude_first=longitude_first) for point in given)
