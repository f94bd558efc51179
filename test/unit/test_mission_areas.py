"""Fence and no-fly areas of a mission file."""

from __future__ import annotations

import json
import random

import pytest
from shapely import Polygon as Shape
from strategies import case_study

from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import MissionError, mission_from_dict
from uav_mission_manager.mdp.areas import MAX_CORNERS, NoFlyArea, fault_of_polygon

SQUARE = [[-35.36, 149.16], [-35.36, 149.17], [-35.37, 149.17], [-35.37, 149.16]]
CROSSED = [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]


def with_areas(areas):
    return {**case_study(), 'areas': areas}


def test_a_mission_has_its_areas():
    areas = {'fence': SQUARE, 'no_fly': [{'name': 'dam', 'polygon': SQUARE[:3]}]}
    mission = mission_from_dict(with_areas(areas), 'test')
    assert mission.areas.fence == tuple(map(tuple, SQUARE))
    assert mission.areas.no_fly == (NoFlyArea('dam', tuple(map(tuple, SQUARE[:3]))),)


def test_areas_change_neither_the_mission_nor_its_digest():
    bare = mission_from_dict(case_study(), 'test')
    mission = mission_from_dict(with_areas({'fence': SQUARE}), 'test')
    assert mission.areas != bare.areas
    assert (mission, mission.digest()) == (bare, bare.digest())
    assert mission.geography() == bare.geography()
    assert bare.areas.fence is None
    assert 'areas' not in bare.to_dict()


@pytest.mark.parametrize(
    'areas',
    [
        {'fence': SQUARE},
        {'no_fly': [{'name': 'dam', 'polygon': SQUARE}]},
        {'fence': SQUARE, 'no_fly': [{'name': 'dam', 'polygon': SQUARE[:3]}]},
        {},
    ],
)
def test_areas_survive_being_written(areas):
    mission = mission_from_dict(with_areas(areas), 'test')
    again = mission_from_dict(json.loads(json.dumps(mission.to_dict())), 'test')
    assert again.areas == mission.areas


@pytest.mark.parametrize(
    ('areas', 'problem'),
    [
        ({'fence': SQUARE[:2]}, r'areas\.fence: .* is not a list of 3 to 1000 corners'),
        ({'fence': SQUARE * 300}, r'areas\.fence: .* is not a list of 3 to 1000 corners'),
        ({'fence': CROSSED}, r'areas\.fence: the edges from corners 1 and 3 cross or touch'),
        ({'fence': [*SQUARE, SQUARE[0]]}, r'areas\.fence: corner 5 is where corner 1 is'),
        ({'fence': [[0, 0], [0, 0], [1, 1]]}, r'areas\.fence: corner 1 is where corner 2 is'),
        (
            {'fence': [[-35.3, 149.1], [-35.3000001, 149.1], [-35.3, 149.1000001]]},
            r'areas\.fence: an area of 5e-05 m2 is below 1 m2',
        ),
        ({'fence': [[149.1, -35.3], *SQUARE]}, r'areas\.fence: 149\.1 is outside -89\.\.89'),
        ({'fence': [[1, 2, 3], *SQUARE]}, r'areas\.fence: \[1, 2, 3\] is not a corner'),
        ({'fence': [[1, '2'], *SQUARE]}, r"areas\.fence: '2' is not a number"),
        ({'fense': SQUARE}, r"areas\.fense: is unknown; the nearest known key is 'fence'"),
        ({'no_fly': SQUARE}, r'areas\.no_fly\[0\]: .* is not a mapping'),
        ({'no_fly': [{'name': 'a'}]}, r'areas\.no_fly\[0\]\.polygon: is missing'),
        (
            {'no_fly': [{'name': 'a', 'polygon': SQUARE}] * 2},
            r"areas\.no_fly\[1\]\.name: 'a' is the name of another no-fly area",
        ),
        (
            {'no_fly': [{'name': 'a', 'polygon': CROSSED}]},
            r'areas\.no_fly\[0\]\.polygon: the edges from corners 1 and 3',
        ),
    ],
)
def test_bad_areas_are_refused(areas, problem):
    with pytest.raises(MissionError, match=f'^test: {problem}'):
        mission_from_dict(with_areas(areas), 'test')


def test_areas_need_an_origin():
    document = with_areas({'fence': SQUARE})
    del document['grid']['origin']
    with pytest.raises(MissionError, match=r'^test: areas: need grid\.origin, which is missing$'):
        mission_from_dict(document, 'test')


def test_crossing_edges_are_found_as_shapely_finds_them():
    draw, plane, found = random.Random(5), Origin(47.0, 8.0, 0.0), []
    for _ in range(400):
        points = [
            (draw.uniform(-500.0, 500.0), draw.uniform(-500.0, 500.0))
            for _ in range(draw.randint(3, 6))
        ]
        polygon = tuple(plane.to_geodetic(*point) for point in points)
        found.append(fault_of_polygon(polygon, plane) == '')
        assert found[-1] == Shape(points).is_valid
    assert {*found} == {True, False}


def test_a_fence_may_lie_across_the_180th_meridian():
    polygon = ((-17.0, 179.99), (-17.0, -179.99), (-17.01, -179.99), (-17.01, 179.99))
    assert fault_of_polygon(polygon, Origin(-17.0, 179.99, 0.0)) == ''


def test_a_polygon_of_the_most_corners_is_checked():
    plane = Origin(47.0, 8.0, 0.0)
    zigzag = [(x, 10.0 * (x % 2)) for x in range(MAX_CORNERS - 1)]
    polygon = [plane.to_geodetic(3.0 * x, y) for x, y in [*zigzag, (500, -2000.0)]]
    assert fault_of_polygon(tuple(polygon), plane) == ''
    polygon[400], polygon[402] = polygon[402], polygon[400]
    assert 'cross or touch' in fault_of_polygon(tuple(polygon), plane)
