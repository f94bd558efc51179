"""What the manager knows and decides, drawn as markers for RViz and Foxglove.

All of them are in `map`. Their namespaces begin with the vehicle's name, and they vanish by
themselves when the manager says nothing any more.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator
from itertools import pairwise

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point as PointMessage
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from uav_mission_manager.console.heard import Pose
from uav_mission_manager.drawing.places import (
    area_shapes,
    corners,
    ellipse,
    inner_lines,
    onsets,
    outline,
    rounds,
)
from uav_mission_manager.drawing.trail import longer_trail
from uav_mission_manager.echo import shown
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp import PRIORITY_LEVELS, Grid, Mission
from uav_mission_manager.mdp.range_model import flight_range
from uav_mission_manager.onboard import Refusal, Situation, format_command
from uav_mission_manager.policy import Decision

LIFETIME = 5
"""Time [s] after which a marker that is not repeated vanishes: a choice, five repetitions at the
lowest rate of the manager."""

LETTERS_A_LINE = 60
"""Letters in a line of the reason: a choice."""

SpacePoint = tuple[float, float, float]
"""East, north and height [m] in `map`."""

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

WHITE, GREY, BLUE = (1.0, 1.0, 1.0, 1.0), (0.6, 0.6, 0.6, 1.0), (0.1, 0.4, 1.0, 1.0)
"""Colours of texts, of the grid, and of the vehicle and its way."""

PALE_BLUE, VIOLET, GREEN = (0.1, 0.4, 1.0, 0.4), (0.6, 0.2, 0.8, 1.0), (0.2, 0.8, 0.4, 1.0)
"""Colours of the trail, of areas not to fly over, and of the range."""

BASE_COLOUR, SERVICE_COLOUR = (0.2, 0.4, 0.8, 0.3), (0.5, 0.3, 0.8, 0.3)
"""Colours of the cells of base and service."""

ZONE_COLOUR, CALM_COLOUR = (1.0, 0.4, 0.2, 0.3), (0.4, 0.8, 0.4, 0.2)
"""Colours of cells where threats come more, and less often than elsewhere."""

PRIORITY_COLOURS = (GREY, (1.0, 0.8, 0.1, 1.0), (1.0, 0.4, 0.0, 1.0))
"""Colour of a goal, by its priority."""

THREAT_COLOURS = ((0.0, 0.8, 0.2, 0.2), (1.0, 0.8, 0.0, 0.4), (1.0, 0.0, 0.0, 0.5))
"""Colour of the vehicle's cell, by the threat level t."""


class MarkerScene:
    """Draws one vehicle and its mission.

    What stands still is drawn once, and again with another policy set, which may have another
    mission file: then all that is there is deleted first.

    Parameters
    ----------
    vehicle : str
        Its name; '' without one.
    """

    def __init__(self, vehicle: str) -> None:
        self._vehicle = vehicle
        self._header = Header(frame_id=MAP_FRAME)  # Of all markers.
        self._digest: str | None = None
        self._still: list[Marker] = []
        self._pose: Pose | None = None
        self._trail: tuple[SpacePoint, ...] = ()

    def move(self, pose: Pose) -> None:
        """Take where the vehicle is; a height that is not known counts as 0."""
        height = pose.height if math.isfinite(pose.height) else 0.0
        self._pose = Pose(pose.east, pose.north, height, pose.heading)
        self._trail = longer_trail(self._trail, (pose.east, pose.north, height))

    def draw(
        self,
        outcome: Decision | Refusal,
        situation: Situation,
        charge: float | None,
        digest: str,
        stamp: Time,
    ) -> MarkerArray:
        """Return all markers.

        Parameters
        ----------
        outcome : Decision or Refusal
        situation : Situation
        charge : float or None
            Of the battery that counts, 0 to 1.
        digest : str
            Of the policy set.
        stamp : Time
        """
        self._header.stamp, mission = stamp, situation.mission
        first = []
        if digest != self._digest:
            self._digest, self._still = digest, list(self._standing(mission))
            first = [Marker(header=self._header, action=Marker.DELETEALL)]
        moving = (
            *self._goals(situation),
            *self._threat(situation),
            self._range(mission, charge),
            self._way(mission, outcome),
            *self._craft(mission, outcome),
        )
        return MarkerArray(markers=[*first, *self._still, *moving])

    def _marker(
        self,
        space: str,
        kind: int,
        colour: Colour,
        size: float,
        points: Iterable[SpacePoint] = (),
        number: int = 0,
    ) -> Marker:
        marker = Marker(
            header=self._header,
            ns=f'{self._vehicle}/{space}'.lstrip('/'),
            id=number,
            type=kind,
            color=ColorRGBA(**dict(zip('rgba', colour, strict=True))),
            lifetime=Duration(sec=LIFETIME),
            points=[PointMessage(x=x, y=y, z=z) for x, y, z in points],
        )
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = size
        return marker

    def _text(
        self, space: str, place: SpacePoint, text: str, size: float, number: int = 0
    ) -> Marker:
        marker = self._marker(space, Marker.TEXT_VIEW_FACING, WHITE, size, number=number)
        marker.text = text
        return _at(place, marker)

    def _cells(
        self,
        space: str,
        colour: Colour,
        grid: Grid,
        cells: Iterable[int],
        layer: int = 0,
    ) -> Marker:
        """Return whole cells on their ground; what is in a higher layer covers the others."""
        points: list[SpacePoint] = []
        lift = layer * grid.cell_size / 500.0  # Seen by nobody but the graphics card.
        for first, last, height in _runs(grid, cells):
            ring = [_raised(corner, height + lift) for corner in corners(grid, first, last)]
            points += (*ring[:3], *ring[2:])  # Two triangles.
        return self._marker(space, Marker.TRIANGLE_LIST, colour, 1.0, points)

    def _standing(self, mission: Mission) -> Iterator[Marker]:
        """Return what does not move: grid, stations, threat zones, areas, waypoints."""
        grid, width = mission.grid, mission.grid.cell_size / 50.0
        edge = outline(grid)
        lines = *inner_lines(grid), *pairwise(edge)
        ends = (_raised(point) for line in lines for point in line)
        yield self._marker('grid', Marker.LINE_LIST, GREY, width, ends)
        zones = onsets(mission)
        for space, colour, more in (('zone', ZONE_COLOUR, True), ('calm', CALM_COLOUR, False)):
            cells = [c for c, onset in zones.items() if (onset > mission.threat.onset) == more]
            if cells:
                yield self._cells(space, colour, grid, cells)
        stations = ('base', BASE_COLOUR, grid.base), ('service', SERVICE_COLOUR, grid.service)
        for number, (space, colour, cell) in enumerate(stations):
            yield self._cells(space, colour, grid, [cell], 1)
            row, col = divmod(cell, grid.cols)
            below = row + 0.25 + 0.15 * number  # A goal there, and each other.
            place = *grid.at(col, below), grid.ground(cell)
            yield self._text(f'{space} name', place, space, grid.cell_size / 8.0)
        yield from self._areas(mission, width)
        yield from self._waypoints(mission, width)

    def _areas(self, mission: Mission, width: float) -> Iterator[Marker]:
        for number, area in enumerate(area_shapes(mission)):
            space, colour = ('fence', WHITE) if area.stay_inside else ('no-fly', VIOLET)
            ring = map(_raised, area.ring)
            yield self._marker(space, Marker.LINE_STRIP, colour, 2.0 * width, ring, number)
            if not area.stay_inside:
                east, north = (sum(v) / len(v) for v in zip(*area.ring[:-1], strict=True))
                place, size = (east, north, 0.0), mission.grid.cell_size / 8.0
                yield self._text('no-fly name', place, shown(area.name), size, number)

    def _waypoints(self, mission: Mission, width: float) -> Iterator[Marker]:
        """Return the rounds of goals; a waypoint at flight height is drawn on the ground."""
        grid, ground = mission.grid, dict(mission.grid.elevation)
        for j, flat in rounds(mission).items():
            goal = mission.goals[j]
            assert isinstance(goal.task, Waypoints)
            points = [
                (*point, ground.get(grid.cell_at(*point), 0.0) + (waypoint.height or 0.0))
                for point, waypoint in zip(flat, goal.task.points, strict=True)
            ]
            colour = PRIORITY_COLOURS[-1]
            legs = ((*grid.position(goal.cell), ground.get(goal.cell, 0.0)), *points)
            yield self._marker('round', Marker.LINE_STRIP, colour, width / 2.0, legs, j)
            yield self._marker('waypoint', Marker.SPHERE_LIST, colour, 3.0 * width, points, j)

    def _goals(self, situation: Situation) -> Iterator[Marker]:
        grid, size = situation.mission.grid, situation.mission.grid.cell_size
        for j, goal in enumerate(situation.mission.goals):
            priority = situation.priorities[j]
            place = *grid.position(goal.cell), grid.ground(goal.cell)
            colour = PRIORITY_COLOURS[priority]
            yield _at(place, self._marker('goal', Marker.SPHERE, colour, size / 4.0, (), j))
            words = f'{shown(goal.name)}: {PRIORITY_LEVELS[priority]} priority'
            if not situation.reachable[j]:
                words += ', out of range'
            above = *place[:2], place[2] + size / 4.0
            yield self._text('name', above, words, size / 8.0, j)

    def _threat(self, situation: Situation) -> Iterator[Marker]:
        colour = THREAT_COLOURS[situation.threat]
        yield self._cells('threat', colour, situation.mission.grid, [situation.cell], 2)

    def _range(self, mission: Mission, charge: float | None) -> Marker:
        """Return where the vehicle may go and still reach the service cell, as a ring."""
        ring = self._marker('range', Marker.LINE_STRIP, GREEN, mission.grid.cell_size / 50.0)
        service, ring.action = mission.grid.position(mission.grid.service), Marker.DELETE
        if self._pose is not None and charge is not None and mission.energy is not None:
            here = self._pose.east, self._pose.north
            had = flight_range(mission.energy, charge)
            if had > math.dist(here, service):
                ring.action = Marker.ADD
                ring.points = [_message(_raised(p)) for p in ellipse(here, service, had)]
        return ring

    def _way(self, mission: Mission, outcome: Decision | Refusal) -> Marker:
        """Return the way to the destination: there at this height, then down."""
        grid = mission.grid
        way = self._marker('way', Marker.LINE_STRIP, BLUE, grid.cell_size / 25.0)
        if isinstance(outcome, Refusal) or self._pose is None:
            way.action = Marker.DELETE
            return way
        cell, height = outcome.action.destination, self._pose.height
        end = grid.position(cell)
        places = (self._pose.east, self._pose.north, height), (*end, height)
        way.points = [*map(_message, places), _message((*end, grid.ground(cell)))]
        return way

    def _craft(self, mission: Mission, outcome: Decision | Refusal) -> Iterator[Marker]:
        """Return the vehicle, its trail, and what it does and why above it."""
        if self._pose is None:
            return
        size, pose = mission.grid.cell_size, self._pose
        here = pose.east, pose.north, pose.height
        if len(self._trail) > 1:
            yield self._marker('trail', Marker.LINE_STRIP, PALE_BLUE, size / 50.0, self._trail)
        arrow = _at(here, self._marker('vehicle', Marker.ARROW, BLUE, size / 8.0))
        arrow.scale.x = size / 3.0
        if math.isfinite(pose.heading):
            half_turn = (math.pi / 2.0 - pose.heading) / 2.0
            turn = arrow.pose.orientation
            turn.z, turn.w = math.sin(half_turn), math.cos(half_turn)
        yield arrow
        above = *here[:2], pose.height + size / 3.0
        words = f'{self._vehicle}, {pose.height:.0f} m'.lstrip(', ')
        yield self._text('height', (*here[:2], pose.height - size / 5.0), words, size / 8.0)
        yield self._text('command', above, _said(mission, outcome), size / 8.0)


def _said(mission: Mission, outcome: Decision | Refusal) -> str:
    command = 'no command'
    if not isinstance(outcome, Refusal):
        command = shown(format_command(mission, outcome.action))
    return '\n'.join((command, *textwrap.wrap(shown(outcome.reason), LETTERS_A_LINE)))


def _at(place: SpacePoint, marker: Marker) -> Marker:
    position = marker.pose.position
    position.x, position.y, position.z = place
    return marker


def _runs(grid: Grid, cells: Iterable[int]) -> Iterator[tuple[int, int, float]]:
    """Yield first cell, last cell and ground [m] of cells side by side that are level."""
    ground = dict(grid.elevation)
    run: tuple[int, int, float] | None = None
    for cell in sorted(cells):
        height = ground.get(cell, 0.0)
        if run and cell % grid.cols and (cell - 1, height) == run[1:]:
            run = run[0], cell, height
            continue
        if run:
            yield run
        run = cell, cell, height
    if run:
        yield run


def _raised(point: tuple[float, float], height: float = 0.0) -> SpacePoint:
    return (*point, height)


def _message(place: SpacePoint) -> PointMessage:
    return PointMessage(x=place[0], y=place[1], z=place[2])
