"""The grid turned: as one that is not, seen by somebody who is."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from shapely import Point, Polygon
from shapely.affinity import rotate
from strategies import case_study

from uav_mission_manager.drawing.places import corners, inner_lines, outline
from uav_mission_manager.mdp import Grid, MissionError, mission_from_dict
from uav_mission_manager.onboard.place import cell_with_margin, off_grid

GRID = Grid(rows=3, cols=4, base=0, service=1, cell_size=40.0)
BEARINGS = st.floats(-360.0, 360.0)
POINTS = st.tuples(st.floats(-200.0, 300.0), st.floats(-300.0, 200.0))


def turned(shape, bearing):
    """Turn a shape clockwise about cell 0."""
    return rotate(shape, -bearing, origin=(0.0, 0.0))


def place_of(point, bearing):
    return turned(Point(point), bearing).coords[0]


@given(BEARINGS, st.integers(0, GRID.q - 1))
def test_cells_turn_clockwise_about_the_first(bearing, cell):
    grid = replace(GRID, bearing=bearing)
    assert grid.position(cell) == pytest.approx(place_of(GRID.position(cell), bearing))
    square = turned(Polygon(corners(GRID, cell, cell)), bearing)
    assert Polygon(corners(grid, cell, cell)).symmetric_difference(square).area < 1e-6
    assert Polygon(corners(grid, cell, cell)).exterior.is_ccw
    assert grid.cell_at(*grid.position(cell)) == cell


@given(BEARINGS, POINTS, st.integers(0, GRID.q - 1))
def test_a_point_is_in_the_same_cell_when_all_is_turned(bearing, point, last):
    # Near a border rounding decides.
    assume(all(abs((x - 20.0) % 40.0 - 20.0) < 19.999 for x in point))
    assume(abs(max(map(abs, (a - b for a, b in zip(point, GRID.position(last))))) - 24.0) > 1e-3)
    grid, there = replace(GRID, bearing=bearing), place_of(point, bearing)
    assert grid.cell_at(*there) == GRID.cell_at(*point)
    assert grid.contains(*there) == GRID.contains(*point)
    assert cell_with_margin(grid, there, last) == cell_with_margin(GRID, point, last)


@given(BEARINGS, POINTS)
def test_how_far_off_the_grid_a_point_is(bearing, point):
    grid = replace(GRID, bearing=bearing)
    away = Polygon(outline(grid)).distance(Point(place_of(point, bearing)))
    assume(abs(away - 20.0) > 1e-6)  # Up to half a cell it is near enough.
    assert off_grid(grid, place_of(point, bearing)) == pytest.approx(away if away > 20.0 else 0.0)


def test_lines_are_those_that_cells_share():
    grid = replace(GRID, bearing=30.0)
    cells = [Polygon(corners(grid, cell, cell)) for cell in range(grid.q)]
    for start, end in inner_lines(grid):
        middle = Point((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        assert sum(cell.distance(middle) < 1e-9 for cell in cells) in (2, 4)
    assert len(inner_lines(grid)) == 2 + 3


def test_a_mission_file_turns_its_grid():
    document = case_study()
    plain = mission_from_dict(document, 'test')
    document['grid']['bearing'] = 30.0
    mission = mission_from_dict(document, 'test')
    assert mission.grid == replace(plain.grid, bearing=30.0)
    assert mission_from_dict(mission.to_dict(), 'test') == mission
    assert mission.digest() != plain.digest()
    assert 'bearing' not in plain.to_dict()['grid']
    document['grid']['bearing'] = 361
    with pytest.raises(MissionError, match=r'test: grid\.bearing: 361 .*-360'):
        mission_from_dict(document, 'test')
