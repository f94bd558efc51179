"""Places amid areas and waypoints."""

from __future__ import annotations

from collections.abc import Sequence

from shapely import MultiPoint, Polygon, minimum_bounding_circle, minimum_bounding_radius

from uav_mission_manager.cli.mission_new.found import Outline, Place
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.goal_task import Waypoints

SAME_PLACE = 0.01
"""Radius [m] of points that are one place: what seven decimals of a degree tell apart."""


def inner_place(outline: Outline) -> Place:
    """Return a place for the goal of an outline: within it, or amid the waypoints of its task."""
    if outline.task is not None:
        return Place(outline.name, *task_middle(outline.task), outline.source, task=outline.task)
    plane = Origin(*outline.polygon[0], 0.0)
    inside = Polygon(
        [plane.to_local(*corner) for corner in outline.polygon]
    ).representative_point()
    return Place(outline.name, *plane.to_geodetic(inside.x, inside.y), outline.source)


def task_middle(task: Waypoints) -> tuple[float, float]:
    """Return the `middle` of the waypoints of a task."""
    return middle([(point.latitude, point.longitude) for point in task.points])


def middle(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the place [deg] from which the farthest of some is as near as can be."""
    plane = Origin(*points[0], 0.0)
    places = MultiPoint([plane.to_local(*point) for point in points])
    if minimum_bounding_radius(places) < SAME_PLACE:
        return points[0]  # A circle around them is empty.
    centre = minimum_bounding_circle(places).centroid
    return plane.to_geodetic(centre.x, centre.y)
