"""The grid of cells, its place on the earth and its ground."""

from __future__ import annotations

from dataclasses import dataclass

from uav_mission_manager.geodesy import Origin


@dataclass(frozen=True)
class Grid:
    """A grid of square cells, numbered row by row from 0; columns run east, rows south.

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
    """

    rows: int
    cols: int
    base: int
    service: int
    cell_size: float = 50.0
    origin: Origin | None = None
    elevation: tuple[tuple[int, float], ...] = ()

    @property
    def q(self) -> int:
        """Number of cells."""
        return self.rows * self.cols

    def position(self, cell: int) -> tuple[float, float]:
        """East and north [m] of a cell's centre from the centre of cell 0."""
        row, col = divmod(cell, self.cols)
        return col * self.cell_size, -row * self.cell_size

    def ground(self, cell: int) -> float:
        """Elevation of a cell's ground above the origin's altitude [m]."""
        return dict(self.elevation).get(cell, 0.0)

    def contains(self, east: float, north: float) -> bool:
        """Whether a point [m] lies on the grid."""
        half = self.cell_size / 2
        return (
            -half <= east <= (self.cols - 1) * self.cell_size + half
            and -half <= -north <= (self.rows - 1) * self.cell_size + half
        )

    def cell_at(self, east: float, north: float) -> int:
        """Cell nearest to a point [m]: the one it lies in, on the border where it lies outside."""
        col = min(max(round(east / self.cell_size), 0), self.cols - 1)
        row = min(max(round(-north / self.cell_size), 0), self.rows - 1)
        return row * self.cols + col
