"""The grid of a mission, laid over its places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from uav_mission_manager.cli.mission_new.found import Place
from uav_mission_manager.echo import shown
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import Grid, MissionError

CELLS_ALONG = 10
"""Cells along the longer side of the grid, unless goals are closer together: a choice. With more,
a goal is nearer to the centre of its cell, and the mission takes longer to solve."""

MOST_CHOSEN_CELLS = 2500
"""Cells of a grid whose size is chosen here: a choice, some seconds for three goals."""

SMALLEST, LARGEST = 5.0, 5000.0
"""Width of a cell [m]: position and landing err by metres; an epoch is one step."""

CLEARLY = 0.999
"""What rounding of positions does not make up for: a millimetre in a metre."""

REFINEMENTS = 3
"""Times that the grid is laid, each in the plane of the origin before: planes lean a little."""


def chosen_size(home: Place, goals: Sequence[Place], others: Sequence[Place]) -> tuple[float, str]:
    """Return the width of a cell [m], and why it is so.

    It is the largest of one digit by which there are at least `CELLS_ALONG` cells along the longer
    side of the ground that the places take up, and each goal has a cell of its own.

    Raises
    ------
    MissionError
        If the grid of the size that separates two goals had too many cells.
    """
    plane = Origin(home.latitude, home.longitude, 0.0)
    width, height = _extent(_points([home, *goals, *others], plane))
    size = _round_down(max(width, height) / CELLS_ALONG)
    why = f'at least {CELLS_ALONG} cells along the longer side'
    for one, other, apart in _closest(goals, plane):
        if apart < size:
            size = _round_down(apart)
            why = f'{shown(one.name)} and {shown(other.name)} are {apart:.0f} m apart'
    cells = (width // size + 1) * (height // size + 1)
    if cells > MOST_CHOSEN_CELLS:
        raise MissionError(
            f'{why}: cells of {size:g} m which separate them would be {cells:,.0f}, more than '
            f'{MOST_CHOSEN_CELLS:,}; leave one out, or give --cell'
        )
    return size, why


def laid_out(
    home: Place,
    places: Sequence[Place],
    service: Place,
    by: float | tuple[int, int],
    centred: Place | None = None,
) -> Grid:
    """Return the grid of square cells around places, which has as much room on all sides.

    Parameters
    ----------
    home : Place
        Its altitude, 0 if it has none, is the grid's.
    places : sequence of Place
        All that must be on it.
    service : Place
    by : float or (rows, cols)
        Width of a cell [m], then there are as few as can be; or how many, then they are as small
        as can be.
    centred : Place or None
        One of the places, to lie in the centre of its cell; the room is then as it comes.

    Raises
    ------
    MissionError
        If the cells are too small or too large.
    """
    origin = Origin(home.latitude, home.longitude, home.altitude or 0.0)
    for _ in range(REFINEMENTS):
        points = _points(places, origin)
        size = _least_size(points, *by) if isinstance(by, tuple) else by
        if not SMALLEST <= size <= LARGEST:
            raise MissionError(f'cells of {size:g} m are not within {SMALLEST:g}..{LARGEST:g} m')
        given = by if isinstance(by, tuple) else (None, None)
        east, north = _points([centred], origin)[0] if centred else (None, None)
        south = None if north is None else -north
        rows, first_south = _cells_along([-y for _, y in points], size, given[0], south)
        cols, first_east = _cells_along([x for x, _ in points], size, given[1], east)
        origin = Origin(*origin.to_geodetic(first_east, -first_south), origin.altitude)
    grid = Grid(rows, cols, 0, 0, size, origin)
    return replace(grid, base=cell_of(grid, home), service=cell_of(grid, service))


def _least_size(points: Sequence[tuple[float, float]], rows: int, cols: int) -> float:
    """Return the width of a cell [m] by which so many hold all points."""
    width, height = _extent(points)
    size = max(width / cols, height / rows) / CLEARLY
    return max(math.ceil(100.0 * size) / 100.0, SMALLEST)


def _cells_along(
    points: Sequence[float], size: float, count: int | None, centre: float | None
) -> tuple[int, float]:
    """Return how many cells there are along one axis, and the centre of the first [m].

    With `centre`, which is then that of a cell, there are as many as it takes.
    """
    low, length = min(points), max(points) - min(points)
    if centre is None:
        count = count or int(length / CLEARLY // size) + 1
        return count, low - (count * size - length) / 2 + size / 2
    before, after = (
        max(math.ceil(room / CLEARLY / size - 0.5), 0)
        for room in (centre - low, low + length - centre)
    )
    return before + 1 + after, centre - before * size


def cell_of(grid: Grid, place: Place) -> int:
    """Return the cell in which a place lies."""
    assert grid.origin is not None
    return grid.cell_at(*grid.origin.to_local(place.latitude, place.longitude))


def require_separate_cells(grid: Grid, goals: Sequence[Place]) -> None:
    """Check that each goal has a cell of its own.

    Raises
    ------
    MissionError
        It names two goals that have not, and the size of cells that separates them.
    """
    seen: dict[int, Place] = {}
    for goal in goals:
        other = seen.setdefault(cell_of(grid, goal), goal)
        if other is not goal:
            assert grid.origin is not None
            [(*_, apart)] = _closest(goals, grid.origin)
            names = f'{shown(other.name)} and {shown(goal.name)}'
            raise MissionError(
                f'{names} lie in one cell of {grid.cell_size:g} m: --cell {_round_down(apart):g} '
                'gives every goal one of its own'
            )


def _closest(goals: Sequence[Place], plane: Origin) -> list[tuple[Place, Place, float]]:
    """Return the two goals least apart, and how far [m] to the east or north; [] for one goal.

    Cells of that width hold one of them only, wherever the grid begins.
    """
    points = dict(zip((goal.name for goal in goals), _points(goals, plane)))
    pairs = [
        (one, other, max(map(abs, _difference(points[one.name], points[other.name]))))
        for one, other in combinations(goals, 2)
    ]
    closest = min(pairs, key=lambda pair: pair[2], default=None)
    if closest and closest[2] < SMALLEST:
        one, other, apart = closest
        raise MissionError(
            f'{shown(one.name)} ({shown(one.source)}) and {shown(other.name)} '
            f'({shown(other.source)}) are only {apart:.1f} m apart: no cells of {SMALLEST:g} m or '
            'more separate them; leave one out'
        )
    return [closest] if closest else []


def _difference(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return one[0] - other[0], one[1] - other[1]


def _points(places: Sequence[Place], plane: Origin) -> list[tuple[float, float]]:
    return [plane.to_local(place.latitude, place.longitude) for place in places]


def _extent(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return how far points [m] reach from west to east and from south to north [m]."""
    east, north = zip(*points)
    return max(east) - min(east), max(north) - min(north)


def _round_down(size: float) -> float:
    """Return the largest width of one digit that is clearly no larger."""
    size = max(CLEARLY * size, SMALLEST)
    power = 10.0 ** math.floor(math.log10(size))
    return math.floor(size / power) * power
