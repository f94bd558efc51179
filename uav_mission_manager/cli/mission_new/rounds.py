"""Rounds of waypoints: as many as a task may have."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from shapely import LineString

from uav_mission_manager.geodesy import Origin
from uav_mission_manager.goal_task import Waypoint, Waypoints
from uav_mission_manager.mdp.goal_tasks import MAX_WAYPOINTS

STRAIGHT = 0.5
"""How far [m] beside a straight leg a waypoint on it may lie to be left out: a choice, below the
error of a position."""

Corner = tuple[float, float, float | None]
"""Of a round: latitude, longitude [deg], height above ground [m] if it is given."""


def waypoints_task(points: Iterable[Corner]) -> Waypoints | None:
    """Return the task of flying to some points in order, None if they are too many.

    Of more than a task may have, those on straight legs of one height are left out: the way is
    the same.
    """
    given = [Waypoint(*point) for point in points]
    if len(given) > MAX_WAYPOINTS:
        given = _corners(given)
    return Waypoints(tuple(given)) if 1 <= len(given) <= MAX_WAYPOINTS else None


def too_long(count: int) -> str:
    """Say why so many waypoints make no task."""
    return (
        f'{count} waypoints are more than the {MAX_WAYPOINTS} of a task, those on straight legs '
        'left out: divide it'
    )


def _corners(points: Sequence[Waypoint]) -> list[Waypoint]:
    """Return the waypoints but those on straight legs, if all are at one height."""
    if len({point.height for point in points}) > 1:
        return [*points]
    plane = Origin(points[0].latitude, points[0].longitude, 0.0)
    places = {plane.to_local(point.latitude, point.longitude): point for point in points}
    line = LineString([plane.to_local(point.latitude, point.longitude) for point in points])
    return [places[corner] for corner in line.simplify(STRAIGHT, preserve_topology=False).coords]
