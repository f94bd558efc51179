"""What `mission_new` makes of surveys, lines, stays and pictures: tasks at goals."""

from __future__ import annotations

import copy
import itertools
import json
import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPoint, Point
from test_mission_new import HERE, KML, PLAN, POINT, SURVEY, file_of, made, refusal, warnings_for

from uav_mission_manager.cli.mission_new.fitting import fitting, misfit, with_waypoints
from uav_mission_manager.cli.mission_new.found import Place
from uav_mission_manager.cli.mission_new.geometry import middle
from uav_mission_manager.cli.mission_new.layout import cell_of, laid_out
from uav_mission_manager.cli.mission_new.rounds import waypoints_task
from uav_mission_manager.cli.tasks import task_seconds
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.goal_task import Dwell, External, Photo, Waypoint, Waypoints
from uav_mission_manager.mdp import Grid, load_mission
from uav_mission_manager.mdp.dynamics import completion_probabilities
from uav_mission_manager.mdp.goal_tasks import MAX_WAYPOINTS, WAYPOINT_REACH

PLANE = Origin(47.0, 8.0, 0.0)


def deg(east, north):
    return list(PLANE.to_geodetic(east, north))


def item(command, *params, **more):
    known = {'type': 'SimpleItem', 'command': command, 'frame': 3, 'autoContinue': True}
    return known | {'params': [*params, *[None] * (7 - len(params))]} | more


def place(east, north, hold=0, command=16, height=30):
    return item(command, hold, 0, 0, None, *deg(east, north), height)


def survey(points, corners=None, items=(), height=30, kind='survey', **more):
    west, south, east, north = MultiPoint(points).bounds
    corners = corners or [(west, south), (east, south), (east, north + 1), (west, north + 1)]
    shape = 'polyline' if kind == 'CorridorScan' else 'polygon'
    return {
        'type': 'ComplexItem',
        'complexItemType': kind,
        shape: [deg(*corner) for corner in corners],
        'TransectStyleComplexItem': {
            'CameraCalc': {'DistanceToSurface': height, 'DistanceMode': 1},
            'VisualTransectPoints': [deg(*point) for point in points],
            'Items': [*items],
        },
    } | more


LEGS = [(100, 100), (180, 100), (180, 120), (100, 120)]


def plan_of(*items, home=(47.0, 8.0, 400.0)):
    mission = {'items': [*items], 'plannedHomePosition': [*home], 'hoverSpeed': 5}
    return {'fileType': 'Plan', 'mission': mission, 'geoFence': None, 'rallyPoints': None}


def of_plan(tmp_path, *items, options=(), **more):
    return made(tmp_path, file_of(tmp_path, plan_of(*items, **more), 'a.plan'), *options)


def metres(task):
    return [PLANE.to_local(point.latitude, point.longitude) for point in task.points]


def heights(task):
    return [point.height for point in task.points]


# Surveys


@pytest.mark.parametrize('kind', ['survey', 'CorridorScan'])
def test_legs_become_waypoints_of_the_goal_in_their_order(tmp_path, kind):
    mission = of_plan(tmp_path, survey(LEGS, kind=kind), place(0, 200))
    [goal] = [goal for goal in mission.goals if isinstance(goal.task, Waypoints)]
    for flown, given_ in zip(metres(goal.task), LEGS, strict=True):
        assert flown == pytest.approx(given_, abs=0.02)  # Seven decimals of degrees.
    assert heights(goal.task) == [30.0] * 4
    assert 'flight_altitude:=30' in (tmp_path / 'made.yaml').read_text()


def test_what_is_flown_counts_before_what_is_drawn(tmp_path):
    """Items have their heights; above sea level, the home's is known."""
    items = [
        item(16, 0, 0, 0, None, *deg(100, 100), 25),
        item(206, 12, 0, 1, 0, 0, 0, 0, frame=2),
        item(16, 0, 0, 0, None, *deg(180, 100), 435, frame=0),
        item(16, 0, 0, 0, None, *deg(180, 120), None),
    ]
    [goal] = of_plan(tmp_path, survey(LEGS, items=items)).goals
    assert len(metres(goal.task)) == 3
    assert heights(goal.task) == [25.0, 35.0, 30.0]


def test_a_survey_above_sea_level_is_as_high_above_home(tmp_path):
    high = survey(LEGS, height=440)
    high['TransectStyleComplexItem']['CameraCalc']['DistanceMode'] = 2
    [goal] = of_plan(tmp_path, high).goals
    assert heights(goal.task) == [40.0] * 4
    assert 'flight_altitude:=40' in (tmp_path / 'made.yaml').read_text()


def test_the_shipped_survey_has_its_legs(tmp_path, capsys):
    goal = made(tmp_path, *SURVEY).goals[2]
    points = PLAN['mission']['items'][1]['TransectStyleComplexItem']['VisualTransectPoints']
    assert [[point.latitude, point.longitude] for point in goal.task.points] == points
    assert heights(goal.task) == [40.0, 40.0]
    assert re.search(r'item 2 +its pictures', capsys.readouterr().out)


@pytest.mark.parametrize('height', [4.0, 501.0])
def test_legs_too_low_or_too_high_are_refused(tmp_path, capsys, height):
    name = file_of(tmp_path, plan_of(survey(LEGS, height=height)), 'a.plan')
    error = refusal(tmp_path, capsys, name)
    assert re.search(r'VisualTransectPoints\[0\]: .* is outside 5\.\.500', error)


def test_a_survey_without_legs_stays_a_goal(tmp_path, capsys):
    bare = survey(LEGS)
    bare['TransectStyleComplexItem']['VisualTransectPoints'] = []
    [goal] = of_plan(tmp_path, bare).goals
    assert goal.task is None
    assert re.search(r'item 1 +its legs: the plan has none', capsys.readouterr().out)


def test_the_rounds_of_a_structure_are_left_out(tmp_path, capsys):
    structure = survey(LEGS, kind='StructureScan')
    del structure['TransectStyleComplexItem']
    [goal] = of_plan(tmp_path, structure).goals
    assert goal.task is None
    assert re.search(r'item 1 +its rounds', capsys.readouterr().out)


def zigzag(lines, between):
    """Return a survey's points: so many lines, with points between the ends of each."""
    ends = ((0, 80), (80, 0))
    return [
        (100 + start + (end - start) * n / (between + 1), 100 + 2 * line)
        for line, (start, end) in zip(range(lines), itertools.cycle(ends))
        for n in range(between + 2)
    ]


def test_of_too_many_waypoints_those_on_straight_legs_are_left_out(tmp_path):
    [goal] = of_plan(tmp_path, survey(zigzag(30, 3))).goals
    corners = [point for point in zigzag(30, 3) if point[0] in (100, 180)]
    assert len(zigzag(30, 3)) > MAX_WAYPOINTS >= len(corners)
    for flown, corner in zip(metres(goal.task), corners, strict=True):
        assert flown == pytest.approx(corner, abs=0.02)


def test_of_a_few_waypoints_none_is_left_out(tmp_path):
    [goal] = of_plan(tmp_path, survey(zigzag(10, 3))).goals
    assert len(goal.task.points) == len(zigzag(10, 3))


def test_legs_with_too_many_corners_are_left_out(tmp_path, capsys):
    [goal] = of_plan(tmp_path, survey(zigzag(60, 0))).goals
    assert goal.task is None
    assert re.search(
        r'item 1 +its legs: 120 waypoints are more than the 100', capsys.readouterr().out
    )


def test_a_survey_that_is_no_goal_has_no_task(tmp_path):
    mission = of_plan(tmp_path, survey(LEGS), place(0, 200), options=['--no-fly=survey_1'])
    assert [goal.task for goal in mission.goals] == [None]
    assert [area.name for area in mission.areas.no_fly] == ['survey_1']


# Lines


LINE = (
    '<Placemark><name>{}</name><LineString><coordinates>{}</coordinates></LineString></Placemark>'
)


def kml_line(name, points):
    places = ' '.join('{1:.9f},{0:.9f},0'.format(*deg(*point)) for point in points)
    return LINE.format(name, places)


def test_a_line_of_kml_is_flown_along_if_it_is_asked_for(tmp_path, capsys):
    content = KML.format(kml_line('wall', LEGS) + kml_line('road', LEGS[:2]))
    [goal] = made(tmp_path, file_of(tmp_path, content), *HERE, '--line=wall').goals
    assert goal.name == 'wall'
    for flown, given_ in zip(metres(goal.task), LEGS, strict=True):
        assert flown == pytest.approx(given_, abs=0.02)
    assert heights(goal.task) == [None] * 4
    assert re.search(r'placemark road +a line is neither', capsys.readouterr().out)


def test_a_line_of_geojson_is_flown_along_if_it_is_asked_for(tmp_path):
    lines = [[deg(*point)[::-1] for point in points] for points in (LEGS, [(0, 300), (80, 300)])]
    feature = {'type': 'MultiLineString', 'coordinates': lines}
    name = file_of(tmp_path, feature)
    mission = made(tmp_path, name, *HERE, '--line=feature_1_2', '--line=feature_1')
    assert [(g.name, len(g.task.points)) for g in mission.goals] == [
        ('feature_1_2', 2),
        ('feature_1', 4),
    ]


@pytest.mark.parametrize(
    ('option', 'problem'),
    [
        ('--line=x', "--line: nothing here is called 'x'"),
        ('--line=a', "--line: 'a' is no line"),
        ('--service=wall', "--service: 'wall' is a line, not a point"),
        ('--line=long', "--line: 'long': 120 waypoints are more than the 100"),
    ],
)
def test_bad_lines_are_refused(tmp_path, capsys, option, problem):
    point = POINT.format('8.001,47.001')
    content = KML.format(point + kml_line('wall', LEGS) + kml_line('long', zigzag(60, 0)))
    error = refusal(tmp_path, capsys, file_of(tmp_path, content), *HERE, option)
    assert problem in error


def test_a_line_that_is_none_is_left_out(tmp_path, capsys):
    content = KML.format(LINE.format('dot', '8,47') + kml_line('wall', LEGS))
    made(tmp_path, file_of(tmp_path, content), *HERE, '--line=wall')
    assert re.search(r'placemark dot +.*is no line', capsys.readouterr().out)


# Stays and pictures


@pytest.mark.parametrize(
    ('items', 'task'),
    [
        ([place(100, 0)], None),
        ([place(100, 0, hold=12)], Dwell(12.0)),
        ([place(100, 0, hold=None)], None),
        ([place(100, 0, hold=25, command=19)], Dwell(25.0)),
        ([place(100, 0, hold=3, command=18)], None),  # Turns, not seconds.
        ([place(100, 0), item(93, 8)], Dwell(8.0)),
        ([place(100, 0), item(19, 15, 0, 0, None, 0, 0, 30)], Dwell(15.0)),
        ([place(100, 0, hold=2), item(93, 8)], Dwell(10.0)),
        ([place(100, 0), item(203, 0, 0, 0, 0, 1)], Photo(1, 0.0)),
        ([place(100, 0), item(2000, 0, 0, 1)], Photo(1, 0.0)),
        ([place(100, 0), item(2000, 0, 1.5, 4)], Photo(4, 1.5)),
        ([place(100, 0), item(178, 1, 5), item(2000, 0, 0, 1)], Photo(1, 0.0)),
        ([place(100, 0), item(2000, 0, 2, 3), item(203)], Photo(4, 2.0)),
        ([place(100, 0, hold=5), item(2000, 0, 0, 1)], Photo(1, 0.0)),
    ],
)
def test_what_is_done_at_a_waypoint_is_its_task(tmp_path, items, task):
    [goal] = of_plan(tmp_path, *items).goals
    assert goal.task == task


@pytest.mark.parametrize(
    ('items', 'said'),
    [
        ([item(203), place(100, 0)], r'item 1 +it is not done at a waypoint'),
        ([place(100, 0), item(20), item(203)], r'item 3 +it is not done at a waypoint'),
        ([place(100, 0), survey(LEGS), item(203)], r'item 3 +it is not done at a waypoint'),
        ([place(100, 0), item(2000, 0, 2, 0)], r'item 2 +pictures without end'),
        ([place(100, 0, hold=5), item(203)], r'item 1 +its stay of 5 s: pictures'),
        ([place(100, 0), item(203), item(93, 5)], r'item 3 +a stay beside pictures'),
        ([place(100, 0), item(93, -1, 12, 0, 0)], r'item 2 +a stay beside pictures, or until'),
        ([place(100, 0), item(206, 25)], r'item 2 +pictures by distance'),
    ],
)
def test_what_is_left_out_is_said(tmp_path, capsys, items, said):
    of_plan(tmp_path, *items)
    assert re.search(said, capsys.readouterr().out)


@pytest.mark.parametrize(
    ('items', 'problem'),
    [
        ([place(100, 0, hold=-3)], r'items\[0\]\.params\[0\]: -3 is outside 0\.\.86400'),
        ([place(100, 0, hold='x')], r"items\[0\]\.params\[0\]: 'x' is not a number"),
        (
            [place(100, 0), item(2000, 0, 0, 5000)],
            r'\[1\]\.params\[2\]: 5000 is outside 0\.\.1000',
        ),
    ],
)
def test_bad_parameters_are_refused(tmp_path, capsys, items, problem):
    error = refusal(tmp_path, capsys, file_of(tmp_path, plan_of(*items), 'a.plan'))
    assert re.search(problem, error)


def test_home_and_service_have_no_task(tmp_path, capsys):
    items = place(100, 0, hold=12), place(0, 100)
    mission = of_plan(tmp_path, *items, options=['--service=waypoint_1'])
    assert [goal.name for goal in mission.goals] == ['waypoint_2']
    assert re.search(r'item 1 +its task: it is no goal', capsys.readouterr().out)


# Cells


def test_cells_too_small_are_told_with_the_size_that_fits(tmp_path, capsys):
    name = file_of(tmp_path, plan_of(survey(LEGS), place(0, 300)), 'a.plan')
    [warning] = warnings_for(tmp_path, capsys, name, '--cell=20')
    found = re.fullmatch(
        r'survey_1 has no task: .* over 20; --cell (\d+) is large enough', warning
    )
    assert load_mission(tmp_path / 'made.yaml').goals[1].task is None
    size = float(found[1])
    # The legs' ends are 41.2 m from their middle.
    assert size == 42.0
    assert warnings_for(tmp_path, capsys, name, f'--cell={size}') == []
    assert load_mission(tmp_path / 'made.yaml').goals[1].task is not None


def test_cells_that_cannot_fit_are_told_too(tmp_path, capsys):
    """Waypoints 200 m wide, and three goals in 14 m: no two cells hold one each."""
    wide = survey([(100, 0), (300, 0)])
    name = file_of(tmp_path, plan_of(wide, *(place(0, north) for north in (60, 67, 74))), 'a.plan')
    [warning] = warnings_for(tmp_path, capsys, name)
    assert warning.endswith('do not give every goal one of its own: --skip one')
    mission = made(tmp_path, name, '--skip=waypoint_2', '--skip=waypoint_3')
    assert [goal.task is None for goal in mission.goals] == [True, False]


def test_rows_and_columns_are_as_they_are_given(tmp_path, capsys):
    name = file_of(tmp_path, plan_of(survey(LEGS), place(0, 300)), 'a.plan')
    [warning] = warnings_for(tmp_path, capsys, name, '--rows=12', '--cols=12')
    assert '--cell 42 is large enough' in warning


POINTS = st.lists(
    st.tuples(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0)), min_size=1, max_size=6
)
MIDDLES = st.lists(
    st.tuples(st.floats(-2500.0, 2500.0), st.floats(-2500.0, 2500.0)), min_size=1, max_size=3
)


BEARINGS = st.sampled_from([0.0, 30.0])


def rounds_at(middles, points):
    found = []
    for number, (x, y) in enumerate(middles):
        places = [deg(x + east, y + north) for east, north in points]
        task = Waypoints(tuple(Waypoint(*place) for place in places))
        found.append(Place(f'goal{number}', *middle(places), 'test', task=task))
    return found


@settings(max_examples=40)
@given(POINTS, MIDDLES, st.floats(5.0, 300.0), BEARINGS)
def test_a_grid_that_fits_does(points, middles, size, bearing):
    goals, home = rounds_at(middles, points), Place('home', 47.0, 8.0, 'test')
    grid = fitting(home, home, goals, size, bearing, larger=True)
    if grid is None:  # Two goals are closer than any cells that fit.
        needed = max(radius_of(points) / (1.0 - math.sqrt(0.5)) * 1.1 + 1.0, size * 1.1)
        axes = Grid(1, 1, 0, 0, 1.0, bearing=bearing)
        places = [axes.coordinates(*middle) for middle in middles]
        assert any(
            max(abs(a - b) for a, b in zip(one, other)) < needed
            for one, other in itertools.combinations(places, 2)
        )
        return
    assert grid.cell_size >= size
    assert len({cell_of(grid, goal) for goal in goals}) == len(goals)
    for goal in goals:
        centre = grid.position(cell_of(grid, goal))
        for point in goal.waypoints:
            there = grid.origin.to_local(point.latitude, point.longitude)
            assert grid.contains(*there)
            assert math.dist(centre, there) <= WAYPOINT_REACH * grid.cell_size


def radius_of(points):
    centre = Point(PLANE.to_local(*middle([deg(*point) for point in points])))
    return max(centre.distance(Point(point)) for point in points)


@given(POINTS, BEARINGS)
def test_one_round_is_fitted_with_the_least_cells(points, bearing):
    """Two digits of its radius, and no more."""
    [goal], home = rounds_at([(900.0, 700.0)], points), Place('home', 47.0, 8.0, 'test')
    grid = fitting(home, home, [goal], 5.0, bearing, larger=True)
    radius = radius_of(points)
    assert radius * 0.999 <= grid.cell_size <= max(1.12 * radius, 5.0)
    if radius > 5.5:
        smaller = laid_out(home, with_waypoints([home, goal]), home, radius * 0.99, bearing, goal)
        assert misfit(smaller, goal)


@given(POINTS)
def test_no_place_is_nearer_to_all_points_than_their_middle(points):
    radius = radius_of(points)
    centre = Point(PLANE.to_local(*middle([deg(*point) for point in points])))
    for east, north in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
        beside = Point(centre.x + east, centre.y + north)
        assert max(beside.distance(Point(point)) for point in points) >= radius - 1e-3


def test_the_base_has_a_cell_of_its_own_if_that_can_be(tmp_path):
    """The survey's middle is 50 m from home, its ends are 41 m from its middle."""
    near = [(x - 90, y - 110) for x, y in LEGS]
    mission = of_plan(tmp_path, survey(near))
    assert mission.goals[0].cell != mission.grid.base


# The time that tasks take

GRID = Grid(4, 4, 0, 0, 50.0, Origin(47.0, 8.0, 0.0), ((0, 10.0),))


@pytest.mark.parametrize(
    ('task', 'seconds'),
    [
        (None, 2.0),
        (Dwell(7.5), 7.5),
        (Photo(1, 3.0), 0.0),
        (Photo(4, 3.0), 9.0),
        # 30 m at 5 m/s, 40 m at 5 m/s, 2 s at each; down 10 m at 1.5 m/s from the first cell's
        # hill to the plain, and up 25 m at 2.5 m/s.
        (
            Waypoints((Waypoint(*deg(30, 0)), Waypoint(*deg(30, -40), 45.0))),
            30 / 5 + 40 / 5 + 4 + 10 / 1.5 + 25 / 2.5,
        ),
    ],
)
def test_a_task_takes_as_long_as_the_documentation_says(task, seconds):
    assert task_seconds(task, GRID, 0, 5.0, 20.0) == pytest.approx(seconds, rel=1e-4)


def test_how_long_another_program_works_nobody_knows():
    assert task_seconds(External(60.0), GRID, 0, 5.0) is None


def test_the_file_says_how_long_each_goal_takes(tmp_path):
    """A stay of 100 s, a round, a stay that is shorter than an epoch, and no task."""
    mission = of_plan(
        tmp_path,
        place(200, 0, hold=100),
        survey(LEGS),
        place(0, 200, hold=3),
        place(0, 0, hold=0),
        options=['--cell', '90'],
    )
    epoch = mission.grid.cell_size / 5.0
    times = {
        goal.name: task_seconds(goal.task, mission.grid, goal.cell, 5.0, 30.0)
        for goal in mission.goals
    }
    assert len(times) == 4
    assert {2.0, 3.0, 100.0} < set(times.values())
    assert epoch == 18.0
    done = epoch / completion_probabilities(mission)
    for goal, (nominal, sensor, _, both, *_) in zip(mission.goals, done):
        expected = 30.0 if goal.task is None else max(times[goal.name], epoch)
        assert expected <= nominal < expected + 1
        assert (sensor / nominal, both / nominal) == pytest.approx((2.0, 3.0))
    text = (tmp_path / 'made.yaml').read_text()
    assert 'done_in: 100.0' in text
    assert 'about 100 s' in text
    assert 'of goals with their own only the ratios count' in text


def test_without_tasks_the_file_is_as_it_was(tmp_path):
    plan = copy.deepcopy(PLAN)
    del plan['mission']['items'][1]
    made(tmp_path, file_of(tmp_path, json.dumps(plan), 'a.plan'))
    text = (tmp_path / 'made.yaml').read_text()
    assert 'done_in: [30.0, 60.0, 60.0, 90.0, never' in text
    assert 'task' not in text


def test_as_many_waypoints_as_a_task_may_have_are_taken():
    points = [(*deg(n, n % 2), 20.0) for n in range(MAX_WAYPOINTS + 1)]
    assert len(waypoints_task(points[:-1]).points) == MAX_WAYPOINTS
    assert waypoints_task([(*deg(n, 20 * (n % 2)), None) for n in range(101)]) is None
    assert waypoints_task([]) is None
