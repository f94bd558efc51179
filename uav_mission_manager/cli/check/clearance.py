"""Fence and no-fly areas of a mission against where it flies: goals, cells and straight legs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, pairwise

from shapely import LineString, Polygon, STRtree
from shapely import Point as Spot

from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.drawing.places import Point, area_shapes, rounds
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission

MAX_NAMED = 6
"""Legs that are named in one warning: a choice."""


def breaches(mission: Mission, places: Mapping[str, Point]) -> Iterator[Finding]:
    """Yield what is wrong between a mission's areas and its goals, cells and straight legs.

    Parameters
    ----------
    mission : Mission
    places : mapping
        Where goals really lie [m], by name; what is flown to are the centres of their cells.
    """
    centres = _centres(mission)
    points = {f'goal {name}': place for name, place in places.items()}
    legs = _legs(mission, centres)
    tree = STRtree([LineString(ends) for ends in legs.values()])
    for area in area_shapes(mission):
        shape, name = Polygon(area.ring), shown(area.name)
        where = 'outside the fence' if area.stay_inside else f'inside the no-fly area {name}'
        what = 'leave the fence' if area.stay_inside else f'cross the no-fly area {name}'
        met = {*tree.query(shape, 'covers' if area.stay_inside else 'intersects').tolist()}
        bad = [leg for n, leg in enumerate(legs) if (n in met) != area.stay_inside]
        texts = [*_places_warned(points, centres, shape, where, not area.stay_inside)]
        texts += [_legs_warned(bad, what)] if bad else []
        yield from (Finding(area.field, area.name, text) for text in texts)


def _centres(mission: Mission) -> dict[str, Point]:
    """Return where the vehicle flies to, by what it is called."""
    grid = mission.grid
    cells = {f'goal {goal.name}': goal.cell for goal in mission.goals} | {'base': grid.base}
    if grid.service != grid.base:
        cells['service'] = grid.service
    return {name: grid.position(cell) for name, cell in cells.items()}


def _legs(
    mission: Mission, centres: Mapping[str, Point]
) -> dict[tuple[str, str], tuple[Point, Point]]:
    """Return the straight legs by their ends: between cells, and on rounds of waypoints.

    The last waypoint of a round is left for any other cell.
    """
    places = dict(centres)
    legs = [*combinations(centres, 2)]
    for number, points in rounds(mission).items():
        goal = f'goal {mission.goals[number].name}'
        names = {f'waypoint {n} of {goal}': point for n, point in enumerate(points, 1)}
        places |= names
        legs += pairwise([goal, *names])
        legs += [([*names][-1], other) for other in centres if other != goal]
    return {leg: (places[leg[0]], places[leg[1]]) for leg in legs}


def _places_warned(
    points: Mapping[str, Point],
    centres: Mapping[str, Point],
    shape: Polygon,
    where: str,
    inside: bool,
) -> Iterator[str]:
    """Warn of goals, and of the centres of cells, which are what is flown to."""
    for name, centre in centres.items():
        if name in points and shape.covers(Spot(points[name])) == inside:
            yield f'{shown(name)} is {where}'
        elif shape.covers(Spot(centre)) == inside:
            yield f'the centre of the cell of {shown(name)}, which is flown to, is {where}'


def _legs_warned(legs: Sequence[tuple[str, str]], what: str) -> str:
    named = ', '.join(f'{shown(one)} to {shown(other)}' for one, other in legs[:MAX_NAMED])
    more = f', and {len(legs) - MAX_NAMED} more' if len(legs) > MAX_NAMED else ''
    return f'straight legs {what}: {named}{more}'
