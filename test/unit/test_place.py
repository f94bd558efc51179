"""The cell of a position, and how far one may lie off the grid."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import case_study

from uav_mission_manager.goal_task import Dwell, Waypoint, Waypoints
from uav_mission_manager.mdp import Grid, mission_from_dict
from uav_mission_manager.onboard.place import cell_with_margin, off_grid, present_cell, strayed

GRID = Grid(rows=2, cols=4, base=0, service=1)
CELLS = st.integers(0, GRID.q - 1)


@pytest.mark.parametrize(
    ('east', 'north', 'cell'),
    [
        (25.0, 0.0, 0),
        (29.9, 0.0, 0),  # 5 m, a tenth of a cell, past the border
        (30.1, 0.0, 1),
        (0.0, -29.9, 0),
        (0.0, -30.1, 4),
        (29.9, -29.9, 0),
        (-40.0, 0.0, 0),
        (150.0, -50.0, 7),
    ],
)
def test_a_cell_is_left_by_a_margin(east, north, cell):
    assert cell_with_margin(GRID, (east, north), 0) == cell


@pytest.mark.parametrize(('size', 'margin'), [(10.0, 2.0), (3.0, 1.5), (200.0, 20.0)])
def test_the_margin_suits_the_cell(size, margin):
    grid = replace(GRID, cell_size=size)
    for past, cell in ((margin - 0.01, 0), (margin + 0.01, 1)):
        assert cell_with_margin(grid, (size / 2.0 + past, 0.0), 0) == cell


ROUND = Waypoints((Waypoint(0.0, 0.0),))


@pytest.mark.parametrize(
    ('task', 'commitment', 'last', 'east', 'cell'),
    [
        (ROUND, 1, 5, 54.9, 5),  # The width of a cell, and the margin of 5 m.
        (ROUND, 1, 5, 55.1, 6),
        (ROUND, 1, 4, 54.9, 6),  # It has not been there yet.
        (ROUND, 2, 5, 54.9, 6),  # It is committed to another goal,
        (ROUND, 0, 5, 54.9, 6),  # or to none,
        (Dwell(5.0), 1, 5, 54.9, 6),  # or there is no round to fly.
        (None, 1, 5, 54.9, 6),
    ],
)
def test_on_a_round_of_waypoints_it_stays_in_its_goals_cell(task, commitment, last, east, cell):
    plain = mission_from_dict(case_study(), 'test')
    first = replace(plain.goals[0], task=task)
    mission = replace(plain, goals=(first, *plain.goals[1:]))
    x, y = mission.grid.position(first.cell)
    assert first.cell == 5
    assert present_cell(mission, (x + east, y), last, commitment) == cell


@given(last=CELLS, cell=CELLS, east=st.floats(-0.39, 0.39), north=st.floats(-0.39, 0.39))
def test_well_inside_a_cell_it_is_that_cell_wherever_the_vehicle_was(last, cell, east, north):
    centre = GRID.position(cell)
    place = centre[0] + east * GRID.cell_size, centre[1] + north * GRID.cell_size
    assert cell_with_margin(GRID, place, last) == cell


@given(cell=CELLS, east=st.floats(-25.0, 25.0), noise=st.lists(st.floats(-2.0, 2.0), max_size=20))
def test_noise_changes_the_cell_once_at_most(cell, east, noise):
    x, y = GRID.position(cell)
    seen = [cell]
    for wander in noise:
        seen.append(cell_with_margin(GRID, (x + east + wander, y), seen[-1]))
    assert sum(a != b for a, b in pairwise(seen)) <= 1


@pytest.mark.parametrize(
    ('place', 'away', 'own'),
    [
        ((0.0, 0.0), 0.0, True),
        ((-49.0, 0.0), 0.0, True),
        ((-51.0, 0.0), 26.0, True),
        ((205.0, -115.0), 50.0, True),
        ((0.0, 25.0 + 447.0), 447.0, True),
        ((0.0, 25.0 + 448.0), 448.0, False),
        ((-2525.0, 0.0), 2500.0, False),
    ],
)
def test_off_the_grid(place, away, own):
    assert off_grid(GRID, place) == pytest.approx(away)
    assert strayed(GRID, place) is own
