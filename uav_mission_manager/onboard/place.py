"""Where a position lies on the grid, with what it wanders by."""

from __future__ import annotations

import math

from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp import Grid, Mission
from uav_mission_manager.mdp.goal_tasks import WAYPOINT_REACH

CELL_MARGIN, CELL_MARGIN_SHARE = 2.0, 0.1
"""The vehicle is in its last cell until it is so far past the border [m], or such a share of the
cell's width if that is more: choices, above what a position wanders by."""

OFF_GRID_SHARE = 0.5
"""Share of a cell's width by which a position may lie off the grid and still count as in the cell
at its border: a choice, for noise and overshoot."""

MAX_DIAGONALS_OFF_GRID = 2.0
"""Distance off the grid, in grid diagonals, up to which a vehicle may have been carried by wind: a
choice. A position farther off comes in another frame, or from another origin."""


def present_cell(
    mission: Mission, position: tuple[float, float], last: int, commitment: int
) -> int:
    """Cell that a vehicle counts as in, by its position [m], the cell before and its commitment.

    On a round of waypoints it stays in its goal's cell: for the model it is there until the goal
    is done, or given up.
    """
    if commitment:
        goal = mission.goals[commitment - 1]
        limit = WAYPOINT_REACH * mission.grid.cell_size + _margin(mission.grid)
        near = math.dist(position, mission.grid.position(goal.cell)) <= limit
        if near and last == goal.cell and isinstance(goal.task, Waypoints):
            return last
    return cell_with_margin(mission.grid, position, last)


def cell_with_margin(grid: Grid, position: tuple[float, float], last: int) -> int:
    """Cell of a position [m]; `last`, the cell before, until it is left by a margin."""
    (col, row), (last_row, last_col) = grid.coordinates(*position), divmod(last, grid.cols)
    away = grid.cell_size * max(abs(col - last_col), abs(row - last_row))
    return last if away <= grid.cell_size / 2.0 + _margin(grid) else grid.cell_at(*position)


def _margin(grid: Grid) -> float:
    return min(max(CELL_MARGIN, CELL_MARGIN_SHARE * grid.cell_size), grid.cell_size / 2.0)


def off_grid(grid: Grid, position: tuple[float, float]) -> float:
    """Distance [m] of a position off the grid; 0 where it is on it, or near enough."""
    beyond = (
        max(-0.5 - along, along - (cells - 0.5), 0.0)
        for along, cells in zip(grid.coordinates(*position), (grid.cols, grid.rows))
    )
    away = grid.cell_size * math.hypot(*beyond)
    return away if away > OFF_GRID_SHARE * grid.cell_size else 0.0


def strayed(grid: Grid, position: tuple[float, float]) -> bool:
    """Whether a position that is off the grid may still be the vehicle's."""
    diagonal = grid.cell_size * math.hypot(grid.rows, grid.cols)
    return off_grid(grid, position) <= MAX_DIAGONALS_OFF_GRID * diagonal
