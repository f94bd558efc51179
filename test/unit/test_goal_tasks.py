"""`goals[].task` in mission files."""

from __future__ import annotations

import json

import pytest
from strategies import case_study

from uav_mission_manager.goal_task import Dwell, External, Photo, Waypoint, Waypoints
from uav_mission_manager.mdp import MissionError, mission_from_dict
from uav_mission_manager.mdp.goal_tasks import WAYPOINT_REACH

PLAIN = mission_from_dict(case_study(), 'test')
GRID = PLAIN.grid
HERE = GRID.position(PLAIN.goals[1].cell)


def place(east=0.0, north=0.0):
    return list(GRID.origin.to_geodetic(HERE[0] + east, HERE[1] + north))


def with_task(task, **changes):
    document = case_study(**changes)
    document['goals'][1]['task'] = task
    return document


@pytest.mark.parametrize(
    ('given', 'task'),
    [
        ({'dwell': 5}, Dwell(5.0)),
        ({'dwell': 0.0}, Dwell(0.0)),
        ({'photo': {'count': 3, 'interval': 1.5}}, Photo(3, 1.5)),
        ({'photo': {'count': 1}}, Photo(1, 0.0)),
        ({'external': {'timeout': 60}}, External(60.0)),
        (
            {'waypoints': [place(20.0), [*place(0.0, 20.0), 30]]},
            Waypoints((Waypoint(*place(20.0)), Waypoint(*place(0.0, 20.0), 30.0))),
        ),
    ],
)
def test_each_kind_is_read_written_and_no_part_of_the_model(given, task):
    mission = mission_from_dict(with_task(given), 'test')
    assert [goal.task for goal in mission.goals] == [None, task, None]
    again = mission_from_dict(json.loads(json.dumps(mission.to_dict())), 'test')
    assert again == mission
    assert mission.digest() == PLAIN.digest()
    assert mission.geography() == PLAIN.geography()


LIMIT = WAYPOINT_REACH * GRID.cell_size


@pytest.mark.parametrize(
    ('task', 'field', 'problem'),
    [
        ({}, 'task', 'has none of dwell, photo, waypoints, external'),
        (None, 'task', 'None is not a mapping'),
        ({'dwel': 1}, 'task.dwel', "is unknown; the nearest known key is 'dwell'"),
        ({'dwell': -1}, 'task.dwell', '-1 is outside 0..86400'),
        (
            {'dwell': 1, 'photo': {'count': 1}},
            'task.photo',
            'is given besides goals[1].task.dwell: keep one of them',
        ),
        ({'photo': {}}, 'task.photo.count', 'is missing'),
        ({'photo': {'count': 0}}, 'task.photo.count', '0 is outside 1..1000'),
        ({'photo': {'count': 1.5}}, 'task.photo.count', '1.5 is not a whole number'),
        ({'external': {}}, 'task.external.timeout', 'is missing'),
        ({'waypoints': []}, 'task.waypoints', '[] is not a list of 1 to 100 waypoints'),
        (
            {'waypoints': [[1.0]]},
            'task.waypoints',
            '[1.0] is not [latitude, longitude] or [latitude, longitude, height]',
        ),
        ({'waypoints': [[*place(), 2.0]]}, 'task.waypoints', '2.0 is outside 5..500'),
        ({'waypoints': [[91.0, 0.0]]}, 'task.waypoints', '91.0 is outside -90..90'),
    ],
)
def test_what_is_wrong_is_said_in_one_line(task, field, problem):
    with pytest.raises(MissionError) as error:
        mission_from_dict(with_task(task), 'test')
    assert str(error.value) == f'test: goals[1].{field}: {problem}'


def test_waypoints_lie_on_the_grid_and_near_their_goal():
    far, off = place(-LIMIT - 1.0), place(30.0)
    mission_from_dict(with_task({'waypoints': [place(-LIMIT + 1.0)]}), 'test')
    for points, problem in (
        ([place(), far], f'is {LIMIT + 1:.0f} m from the centre of cell 3, over {LIMIT:g} m'),
        ([place(), off], f'is off the {GRID.rows}x{GRID.cols} grid'),
    ):
        with pytest.raises(MissionError) as error:
            mission_from_dict(with_task({'waypoints': points}), 'test')
        where = f'waypoint 2, {points[1][0]:.7f} {points[1][1]:.7f}'
        assert str(error.value) == f'test: goals[1].task.waypoints: {where}, {problem}'


def test_waypoints_need_an_origin():
    document = with_task({'waypoints': [place()]})
    del document['grid']['origin']
    with pytest.raises(MissionError, match=r'goals\[1\]\.task\.waypoints: needs grid\.origin'):
        mission_from_dict(document, 'test')
