"""The grid of a mission, laid over its places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from shapely import MultiPoint, get_coordinates

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


def fitted_bearing(places: Sequence[Place]) -> float:
    """Return the `Grid.bearing` of the smallest box around places, from -45 to 45 [deg]."""
    plane = Origin(places[0].latitude, places[0].longitude, 0.0)
    points = [plane.to_local(place.latitude, place.longitude) for place in places]
    corners = get_coordinates(MultiPoint(points).minimum_rotated_rectangle)
    if len(corners) < 2:
        return 0.0
    east, north = corners[1] - corners[0]
    bearing = math.degrees(math.atan2(east, north))
    return round((bearing + 45.0) % 90.0 - 45.0, 1)


def chosen_size(
    home: Place, goals: Sequence[Place], others: Sequence[Place], bearing: float
) -> tuple[float, str]:
    """Return the width of a cell [m] of a grid with a bearing [deg], and why it is so.

    It is the largest of one digit by which there are at least `CELLS_ALONG` cells along the longer
    side of the ground that the places take up, and each goal has a cell of its own.

    Raises
    ------
    MissionError
        If the grid of the size that separates two goals had too many cells.
    """
    plane = Origin(home.latitude, home.longitude, 0.0)
    width, height = _extent(_points([home, *goals, *others], plane, bearing))
    size = _round_down(max(width, height) / CELLS_ALONG)
    why = f'at least {CELLS_ALONG} cells along the longer side'
    for one, other, apart in _closest(goals, plane, bearing):
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
    bearing: float,
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
    bearing : float
        Of the grid [deg].
    centred : Place or None
        One of the places, to lie in the centre of its cell; the room is then as it comes.

    Raises
    ------
    MissionError
        If the cells are too small or too large.
    """
    origin = Origin(home.latitude, home.longitude, home.altitude or 0.0)
    for _ in range(REFINEMENTS):
        points = _points(places, origin, bearing)
        size = _least_size(points, *by) if isinstance(by, tuple) else by
        if not SMALLEST <= size <= LARGEST:
            raise MissionError(f'cells of {size:g} m are not within {SMALLEST:g}..{LARGEST:g} m')
        given = by if isinstance(by, tuple) else (None, None)
        middle = _points([centred], origin, bearing)[0] if centred else (None, None)
        right, down = zip(*points)
        cols, first_right = _cells_along(right, size, given[1], middle[0])
        rows, first_down = _cells_along(down, size, given[0], middle[1])
        first = _axes(bearing).at(first_right, first_down)
        origin = Origin(*origin.to_geodetic(*first), origin.altitude)
    grid = Grid(rows, cols, 0, 0, size, origin, bearing=bearing)
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
            [(*_, apart)] = _closest(goals, grid.origin, grid.bearing)
            names = f'{shown(other.name)} and {shown(goal.name)}'
            raise MissionError(
                f'{names} lie in one cell of {grid.cell_size:g} m: --cell {_round_down(apart):g} '
                'gives every goal one of its own'
            )


def _closest(
    goals: Sequence[Place], plane: Origin, bearing: float
) -> list[tuple[Place, Place, float]]:
    """Return the two goals least apart, and how far [m] along the rows or columns of the grid.

    Cells of that width hold one of them only, wherever the grid begins. [] for one goal.
    """
    points = dict(zip((goal.name for goal in goals), _points(goals, plane, bearing)))
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


def _points(places: Sequence[Place], plane: Origin, bearing: float) -> list[tuple[float, float]]:
    """Return where places are [m] along the rows and down the columns of a grid."""
    axes = _axes(bearing)
    return [axes.coordinates(*plane.to_local(at.latitude, at.longitude)) for at in places]


def _axes(bearing: float) -> Grid:
    """Return a grid with cells of one metre."""
    return Grid(1, 1, 0, 0, 1.0, bearing=bearing)


def _extent(points: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return how far points [m] reach along the rows and columns of a grid [m]."""
    right, down = zip(*points)
    return max(right) - min(right), max(down) - min(down)


def _round_down(size: float) -> float:
    """Return the largest width of one digit that is clearly no larger."""
    size = max(CLEARLY * size, SMALLEST)
    power = 10.0 ** math.floor(math.log10(size))
    return math.floor(size / power) * power
