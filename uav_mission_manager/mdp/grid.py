"""The grid of cells, its place on the earth and its ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_mission_manager.geodesy import Origin


@dataclass(frozen=True)
class Grid:
    """A grid of square cells, numbered row by row from 0.

    Columns run east and rows south, unless the grid is turned.

    Attributes
    ----------
    rows, cols : int
        Size of the grid.
    base, service : int
        Home cell, and the cell where the UAV is recharged and repaired.
    cell_size : float
        Width of a cell [m].
    origin : Origin or None
        Centre of cell 0; needed to fly, not to plan.
    elevation : tuple of (cell, elevation)
        Ground above the origin's altitude [m], where it differs from it.
    bearing : float
        Which way the first row lies from the last one [deg], clockwise from north.
    """

    rows: int
    cols: int
    base: int
    service: int
    cell_size: float = 50.0
    origin: Origin | None = None
    elevation: tuple[tuple[int, float], ...] = ()
    bearing: float = 0.0

    @property
    def q(self) -> int:
        """Number of cells."""
        return self.rows * self.cols

    def position(self, cell: int) -> tuple[float, float]:
        """East and north [m] of a cell's centre from the centre of cell 0."""
        row, col = divmod(cell, self.cols)
        return self.at(col, row)

    def at(self, col: float, row: float) -> tuple[float, float]:
        """East and north [m] of a point given in columns and rows from the centre of cell 0."""
        turn = math.radians(self.bearing)
        right, up = col * self.cell_size, -row * self.cell_size
        return (
            right * math.cos(turn) + up * math.sin(turn),
            up * math.cos(turn) - right * math.sin(turn),
        )

    def coordinates(self, east: float, north: float) -> tuple[float, float]:
        """Columns and rows of a point [m] from the centre of cell 0; the inverse of `at`."""
        turn = math.radians(self.bearing)
        right = east * math.cos(turn) - north * math.sin(turn)
        up = north * math.cos(turn) + east * math.sin(turn)
        return right / self.cell_size, -up / self.cell_size

    def ground(self, cell: int) -> float:
        """Elevation of a cell's ground above the origin's altitude [m]."""
        return dict(self.elevation).get(cell, 0.0)

    def contains(self, east: float, north: float) -> bool:
        """Whether a point [m] lies on the grid."""
        col, row = self.coordinates(east, north)
        return -0.5 <= col <= self.cols - 0.5 and -0.5 <= row <= self.rows - 0.5

    def cell_at(self, east: float, north: float) -> int:
        """Cell nearest to a point [m]: the one it lies in, on the border where it lies outside."""
        col, row = map(round, self.coordinates(east, north))
        return min(max(row, 0), self.rows - 1) * self.cols + min(max(col, 0), self.cols - 1)
