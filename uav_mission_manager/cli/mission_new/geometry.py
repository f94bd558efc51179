"""Areas of a mission against where it flies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from shapely import LineString, MultiPoint, Point, STRtree, minimum_bounding_circle
from shapely import Polygon as Shape

from uav_mission_manager.cli.mission_new.found import Outline, Place
from uav_mission_manager.echo import shown
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.areas import Polygon

MAX_NAMED = 6
"""Legs that are named in one warning: a choice."""


def inner_place(outline: Outline) -> Place:
    """Return a place for the goal of an outline: within it, or amid the waypoints of its task."""
    if outline.task is not None:
        return Place(outline.name, *task_middle(outline.task), outline.source, task=outline.task)
    plane = Origin(*outline.polygon[0], 0.0)
    inside = _shape(outline.polygon, plane).representative_point()
    return Place(outline.name, *plane.to_geodetic(inside.x, inside.y), outline.source)


def task_middle(task: Waypoints) -> tuple[float, float]:
    """Return the `middle` of the waypoints of a task."""
    return middle([(point.latitude, point.longitude) for point in task.points])


def middle(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the place [deg] from which the farthest of some is as near as can be."""
    plane = Origin(*points[0], 0.0)
    around = minimum_bounding_circle(MultiPoint([plane.to_local(*point) for point in points]))
    return plane.to_geodetic(around.centroid.x, around.centroid.y)


def warnings_of(mission: Mission, goals: Sequence[Place]) -> Iterator[str]:
    """Yield what is wrong between a mission's areas and its goals, cells and straight legs."""
    origin, grid = mission.grid.origin, mission.grid
    assert origin is not None
    cells = {f'goal {goal.name}': goal.cell for goal in mission.goals}
    cells |= {'base': grid.base} | ({'service': grid.service} if grid.service != grid.base else {})
    centres = {name: grid.position(cell) for name, cell in cells.items()}
    legs = list(combinations(centres, 2))
    lines = [LineString([centres[one], centres[other]]) for one, other in legs]
    points = {
        f'goal {goal.name}': origin.to_local(goal.latitude, goal.longitude) for goal in goals
    }
    tree = STRtree(lines)
    for area in mission.areas.no_fly:
        shape, name = _shape(area.polygon, origin), shown(area.name)
        yield from _places_warned(points, centres, shape, f'inside the no-fly area {name}', True)
        crossed = [legs[index] for index in sorted(tree.query(shape, predicate='intersects'))]
        yield from _legs_warned(crossed, f'cross the no-fly area {name}')
    if mission.areas.fence is not None:
        shape = _shape(mission.areas.fence, origin)
        yield from _places_warned(points, centres, shape, 'outside the fence', False)
        inside = set(tree.query(shape, predicate='covers').tolist())
        left = [leg for index, leg in enumerate(legs) if index not in inside]
        yield from _legs_warned(left, 'leave the fence')


def _places_warned(
    points: dict[str, tuple[float, float]],
    centres: dict[str, tuple[float, float]],
    shape: Shape,
    where: str,
    inside: bool,
) -> Iterator[str]:
    """Warn of goals, and of the centres of cells, which are what is flown to."""
    for name, centre in centres.items():
        if name in points and shape.covers(Point(points[name])) == inside:
            yield f'{shown(name)} is {where}'
        elif shape.covers(Point(centre)) == inside:
            yield f'the centre of the cell of {shown(name)}, which is flown to, is {where}'


def _legs_warned(legs: Sequence[tuple[str, str]], what: str) -> Iterator[str]:
    if legs:
        named = ', '.join(f'{shown(one)} to {shown(other)}' for one, other in legs[:MAX_NAMED])
        more = f', and {len(legs) - MAX_NAMED} more' if len(legs) > MAX_NAMED else ''
        yield f'straight legs {what}: {named}{more}'


def _shape(polygon: Polygon, plane: Origin) -> Shape:
    return Shape([plane.to_local(*corner) for corner in polygon])
