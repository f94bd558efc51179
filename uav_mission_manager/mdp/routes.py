"""Distances and shortest ways to one destination: never a table of all pairs of cells."""

from __future__ import annotations

import math

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray
from uav_mission_manager.mdp.grid import Grid


def distances(grid: Grid, destination: int) -> FloatArray:
    """Euclidean distances of all cells to a destination, in cell widths, shape (q,)."""
    south, east = _offsets(grid, destination)
    return np.sqrt(south * south + east * east)


def epochs_of_flight(grid: Grid, destination: int) -> IntArray:
    """Epochs that a flight from each cell to a destination takes, shape (q,)."""
    south, east = _offsets(grid, destination)
    return (np.abs(south) + np.abs(east)).astype(np.int64)


def next_hops(grid: Grid, destination: int) -> IndexArray:
    """Cell after one epoch of flight to a destination from each cell, shape (q,).

    Among the 4-neighbours one step closer the lowest cell number; the destination itself on it.
    """
    south, east = _offsets(grid, destination)
    here = np.arange(grid.q)
    # Ascending cell numbers: north (-cols), west (-1), east (+1), south (+cols).
    return np.select(
        [south < 0, east < 0, east > 0, south > 0],
        [here - grid.cols, here - 1, here + 1, here + grid.cols],
        default=here,
    ).astype(np.intp)


def diameter(grid: Grid) -> float:
    """Largest distance between two cells, in cell widths."""
    return math.hypot(grid.rows - 1, grid.cols - 1)


def _offsets(grid: Grid, destination: int) -> tuple[FloatArray, FloatArray]:
    """How far south and how far east a destination is of each cell, in cells, each (q,)."""
    row, col = np.divmod(np.arange(grid.q), grid.cols)
    to_row, to_col = divmod(destination, grid.cols)
    return (to_row - row).astype(float), (to_col - col).astype(float)
