"""Areas where a mission may and may not be flown: no part of its decision process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TypeAlias

import numpy as np

from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray

Polygon: TypeAlias = tuple[tuple[float, float], ...]
"""Corners as (latitude, longitude) [deg], the first not repeated at the end."""

MAX_CORNERS = 1000
"""Corners of a polygon at most: a choice; all pairs of edges are looked at."""

LEAST_AREA = 1.0
"""Least area of a polygon [m2]: a choice, below any that a drone could tell from a line."""


@dataclass(frozen=True)
class NoFlyArea:
    """An area that must not be flown over."""

    name: str
    polygon: Polygon


@dataclass(frozen=True)
class Areas:
    """Where a mission may be flown.

    Attributes
    ----------
    fence : polygon or None
        The vehicle stays inside; None without one.
    no_fly : tuple of NoFlyArea
        It stays outside each of these.
    """

    fence: Polygon | None = None
    no_fly: tuple[NoFlyArea, ...] = ()


def fault_of_polygon(polygon: Polygon, origin: Origin) -> str:
    """Say why corners make no polygon on the plane of an origin, '' if they do.

    Edges must not cross or touch each other, but neighbours at their corner.
    """
    points = np.array([origin.to_local(*corner) for corner in polygon])
    steps = np.roll(points, -1, axis=0) - points
    for number, step in enumerate(steps, 1):
        if not step.any():
            return f'corner {number} is where corner {number % len(polygon) + 1} is'
    # For each two edges, on which side of the first the start of the second is.
    sides = np.sign(_cross(steps[:, None], points[None, :] - points[:, None]))
    apart = sides * np.roll(sides, -1, axis=1) > 0
    first, second = np.nonzero(~(apart | apart.T) & _boxes_meet(points))
    for one, other in islice(_not_neighbours(first, second, len(points)), 1):
        return f'the edges from corners {one + 1} and {other + 1} cross or touch'
    area = abs(_cross(points, np.roll(points, -1, axis=0)).sum()) / 2
    return '' if area >= LEAST_AREA else f'an area of {area:.2g} m2 is below {LEAST_AREA:g} m2'


def is_inside(polygon: Polygon, latitude: float, longitude: float) -> bool:
    """Whether a place [deg] is inside a polygon: a line from it to the east crosses it once more.

    An edge counts with its southern end alone, so a corner on that line counts once.
    """
    inside = False
    for (lat, lon), (next_lat, next_lon) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        if (lat <= latitude) != (next_lat <= latitude):
            share = (latitude - lat) / (next_lat - lat)
            inside ^= longitude < lon + share * (next_lon - lon)
    return inside


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def _boxes_meet(points: FloatArray) -> BoolArray:
    """Whether the boxes around each two edges meet: edges in one line have nothing else apart."""
    ends = np.stack([points, np.roll(points, -1, axis=0)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    return ((low[:, None] <= high[None, :]) & (low[None, :] <= high[:, None])).all(axis=2)


def _not_neighbours(first: IntArray, second: IntArray, count: int) -> Iterator[tuple[int, int]]:
    for one, other in zip(first.tolist(), second.tolist()):
        if one < other and other - one not in (1, count - 1):
            yield one, other
