"""`mission_new`: mission files from plans, KML, GeoJSON and positions."""

from __future__ import annotations

import copy
import json
import math
import os
import re
import warnings
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pymap3d.vincenty import vdist
from simulated_chain import SimulatedChain

from uav_mission_manager.cli.mission_new import main
from uav_mission_manager.cli.mission_new.found import MAX_FEATURES, Place
from uav_mission_manager.cli.mission_new.layout import (
    CELLS_ALONG,
    MOST_CHOSEN_CELLS,
    cell_of,
    chosen_size,
    fitted_bearing,
    laid_out,
)
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import Grid, MissionError, load_mission
from uav_mission_manager.onboard.range_model import FULL_CHARGE
from uav_mission_manager.policy import build_policy

PLANS = Path(__file__).parents[1] / 'missions' / 'plans'
PLAN = json.loads((PLANS / 'survey.plan').read_text())
SURVEY = [str(PLANS / 'survey.plan')]
HARBOUR = [str(PLANS / 'harbour.kml'), '--no-fly', 'Heliport']
DAM = [
    str(PLANS / 'no_fly.geojson'),
    '--polygons=no_fly',
    '--home=-35.363262,149.165237,584',
    '--service=-35.3632,149.1660',
    '--goal=dam wall,-35.3615,149.1665',
    '--goal=pump,-35.3622,149.1690',
    '--worth=dam wall=3',
    '--speed=8',
]
FLAGS = ['--home=47,8', '--goal=a,47.001,8.001', '--goal=b,47.002,8.004']


def made(tmp_path, *arguments):
    """Make a mission and load it."""
    out = tmp_path / 'made.yaml'
    assert main([*arguments, '--out', str(out), '--force']) == 0
    return load_mission(out)


def refusal(tmp_path, capsys, *arguments):
    """Return the one line with which the command refuses, having written nothing."""
    out = tmp_path / 'out'
    out.mkdir(exist_ok=True)
    with pytest.raises(SystemExit) as end:
        main([*arguments, '--out', str(out / 'made.yaml')])
    error = capsys.readouterr().err if isinstance(end.value.code, int) else end.value.code
    assert '\n' not in error.strip()
    assert end.value.code not in (0, None)
    assert list(out.iterdir()) == []
    return error


def file_of(tmp_path, content, name='given.json'):
    path = tmp_path / name
    text = content if isinstance(content, (str, bytes)) else json.dumps(content)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def changed(*path_and_value):
    """Return the plan with one value changed."""
    *path, last, value = path_and_value
    plan = copy.deepcopy(PLAN)
    inner = plan
    for key in path:
        inner = inner[key]
    inner[last] = value
    return plan


def cell_distance(mission, cell, latitude, longitude):
    """Distance [m] of a place from the centre of a cell, by Vincenty's formula."""
    there = mission.grid.origin.to_geodetic(*mission.grid.position(cell))
    return float(vdist(*there, latitude, longitude)[0])


# What becomes of each kind of file


def test_a_plan_becomes_a_mission(tmp_path, capsys):
    mission = made(tmp_path, *SURVEY)
    assert [goal.name for goal in mission.goals] == ['waypoint_3', 'loiter_5', 'survey_2']
    assert mission.grid.service == mission.grid.base
    assert mission.grid.origin.altitude == 488.2
    assert mission.energy.speed == 6.0  # hoverSpeed, not cruiseSpeed
    assert mission.areas.fence == tuple(map(tuple, PLAN['geoFence']['polygons'][0]['polygon']))
    assert [area.name for area in mission.areas.no_fly] == ['no_fly_circle_1']
    half = math.hypot(mission.grid.cell_size, mission.grid.cell_size) / 2 + 0.1
    assert cell_distance(mission, mission.grid.base, 47.3977, 8.5456) < half
    for goal, item in zip(mission.goals, (2, 4)):
        params = PLAN['mission']['items'][item]['params']
        assert cell_distance(mission, goal.cell, *params[4:6]) < half
    out = capsys.readouterr().out
    for part in ('take-off', 'change of speed', 'return to launch', 'rally point 1', 'hoverSpeed'):
        assert part in out
    assert 'flight_altitude:=40, item 2' in (tmp_path / 'made.yaml').read_text()


def test_the_polygon_of_a_circle_not_to_fly_over_is_around_it(tmp_path):
    [area] = made(tmp_path, *SURVEY).areas.no_fly
    plane = Origin(47.3990, 8.5490, 0.0)
    corners = [plane.to_local(*corner) for corner in area.polygon]
    middles = [
        math.hypot((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
        for a, b in zip(corners, [*corners[1:], corners[0]])
    ]
    assert middles == pytest.approx([40.0] * len(corners), abs=0.02)  # Seven decimals of degrees.


def test_the_polygon_of_a_circle_to_stay_in_is_within_it(tmp_path):
    plan = changed('geoFence', 'polygons', [])
    plan['geoFence']['circles'][0] |= {'inclusion': True}
    fence = made(tmp_path, file_of(tmp_path, plan)).areas.fence
    plane = Origin(47.3990, 8.5490, 0.0)
    radii = [math.hypot(*plane.to_local(*corner)) for corner in fence]
    assert radii == pytest.approx([40.0] * len(fence), abs=0.02)


def test_a_kml_becomes_a_mission(tmp_path, capsys):
    mission = made(tmp_path, *HARBOUR)
    names = ['Old_crane_&_quay', 'Old_crane_&_quay_2', 'Tank_farm']
    assert [goal.name for goal in mission.goals] == names
    assert [area.name for area in mission.areas.no_fly] == ['Heliport']
    half = mission.grid.cell_size / math.sqrt(2) + 0.1
    assert cell_distance(mission, mission.grid.base, 53.54, 9.96) < half
    assert cell_distance(mission, mission.goals[1].cell, 53.5402, 9.9652) < half
    assert 'ferry line' in capsys.readouterr().out


def test_a_goal_of_a_concave_area_lies_in_it(tmp_path):
    """Its centre of mass would lie outside."""
    ring = [(0, 0), (90, 0), (90, 90), (80, 90), (80, 10), (0, 10), (0, 0)]
    plane = Origin(47.0, 8.0, 0.0)
    corners = [list(reversed(plane.to_geodetic(*corner))) for corner in ring]
    name = file_of(tmp_path, {'type': 'Polygon', 'coordinates': [corners]})
    mission = made(tmp_path, name, '--home=47.0001,8.0', '--cell=5')
    east, north = plane.to_local(
        *mission.grid.origin.to_geodetic(*mission.grid.position(mission.goals[0].cell))
    )
    slack = 2.5 * math.sqrt(2) + 0.1
    along = -slack < east < 90 + slack and -slack < north < 10 + slack
    up = 80 - slack < east < 90 + slack and -slack < north < 90 + slack
    assert along or up


def test_a_geojson_of_no_fly_areas_and_flags_become_a_mission(tmp_path, capsys):
    mission = made(tmp_path, *DAM)
    assert [(goal.name, goal.cell == mission.grid.service) for goal in mission.goals] == [
        ('dam_wall', False),
        ('pump', False),
    ]
    assert mission.goals[0].eta == pytest.approx(3 * mission.goals[1].eta)
    names = ['Airfield', 'Hospital', 'Hospital_2']
    assert [area.name for area in mission.areas.no_fly] == names
    assert mission.grid.service != mission.grid.base
    assert mission.energy.speed == 8.0
    out = capsys.readouterr().out
    assert re.search(r'feature 3 +it is 30\d km from home', out)
    assert re.search(r'feature 4 +a line', out)
    assert re.search(r'feature 5 +it has no geometry', out)


def test_flags_alone_make_a_mission(tmp_path):
    mission = made(tmp_path, *FLAGS, '--name=field')
    assert mission.name == 'field'
    assert [goal.name for goal in mission.goals] == ['a', 'b']
    assert made(tmp_path, *FLAGS).name == 'made'


def test_a_mission_on_a_turned_grid_is_built_and_flown_to_the_end(tmp_path):
    mission = made(tmp_path, *DAM, '--turn=fit')
    assert mission.grid.bearing
    policy = build_policy(mission, method='exact')
    chain = SimulatedChain(policy, seed=1)
    chain.want(*[1] * mission.k)
    names = {goal.name for goal in mission.goals}
    chain.until(lambda: {*chain.completed} == names, 'all goals', 900.0)
    # The chain's goals stay done, as the base station's do.
    assert not any(chain.manager.situation.priorities)


def test_every_comment_of_a_made_mission_is_one(tmp_path):
    """What comes of a file cannot end its line."""
    feature = {
        'type': 'Feature',
        'properties': {'name': 'a"}\n- b: [\u2028x\x1b[31m\ud800 #'},
        'geometry': {'type': 'Point', 'coordinates': [8.001, 47.001]},
    }
    mission = made(tmp_path, file_of(tmp_path, feature), '--home=47,8')
    assert [goal.name for goal in mission.goals] == ['a"}_-_b:_[_x[31m_#']


# Names and places by options


def test_a_point_is_home_or_service_by_name(tmp_path):
    mission = made(tmp_path, *SURVEY, '--service=loiter_5', '--home=waypoint_3', '--cell=40')
    assert [goal.name for goal in mission.goals] == ['survey_2']
    half = 40 / math.sqrt(2) + 0.1
    assert cell_distance(mission, mission.grid.service, 47.3970, 8.5510) < half
    assert cell_distance(mission, mission.grid.base, 47.3990, 8.5505) < half


def test_an_area_is_the_fence_by_name(tmp_path):
    mission = made(tmp_path, *HARBOUR, '--fence', 'Tank farm')
    assert len(mission.areas.fence) == 6
    assert mission.k == 2


def test_skipped_is_left_out(tmp_path, capsys):
    mission = made(tmp_path, *SURVEY, '--skip=loiter_5')
    assert [goal.name for goal in mission.goals] == ['waypoint_3', 'survey_2']
    assert re.search(r'loiter_5 +--skip', capsys.readouterr().out)


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        (
            [*SURVEY, '--home=waypont_3'],
            "--home: nothing here is called 'waypont_3'; .*waypoint_3",
        ),
        ([*SURVEY, '--service=survey_2'], "'survey_2' is an area, not a point"),
        ([*SURVEY, '--skip=x'], "--skip: nothing here is called 'x'"),
        ([*SURVEY, '--no-fly=x'], "--no-fly: nothing here is called 'x'"),
        ([*SURVEY, '--worth=x=1'], "--worth: 'x' is no goal"),
        ([*SURVEY, '--worth=x'], "'x' is not NAME=WORTH"),
        ([*SURVEY, '--cell=nan'], 'nan is not finite'),
        ([*SURVEY, '--turn=fits'], "'fits' is not a number"),
        ([*SURVEY, '--turn=361'], r'361\.0 is outside -360'),
        ([*SURVEY, '--cell=1'], 'cells of 1 m are not within 5..5000 m'),
        ([*SURVEY, '--rows=3'], '--rows and --cols go together'),
        ([*SURVEY, '--rows=3', '--cols=4', '--cell=9'], 'in place of --cell'),
        ([*SURVEY, '--rows=1.5', '--cols=4'], "'1.5' is no whole number"),
        ([*SURVEY, '--speed=0.01'], 'a step takes .* s, more than 300'),
        ([*SURVEY, '--goal=x,1'], 'is not NAME,LATITUDE,LONGITUDE'),
        ([*SURVEY, '--goal=x,8.5,47.3'], 'are latitude and longitude in the right order'),
        ([*SURVEY, '--home=149.1,-35.3'], r'149\.1 is outside -89\.\.89; is the order right\?'),
        ([*SURVEY, '--name=a b'], 'is not a name'),
        (['--goal=a,47,8'], 'options: has no home'),
        (['--home=47,8'], 'options: has no goal; --goal NAME,LATITUDE,LONGITUDE adds one'),
        ([str(PLANS / 'none.plan')], r'none\.plan: cannot be read: No such file'),
        ([str(PLANS)], 'cannot be read: no regular file'),
    ],
)
def test_bad_options_are_refused(tmp_path, capsys, arguments, problem):
    assert re.search(problem, refusal(tmp_path, capsys, *arguments))


def test_a_file_is_not_overwritten_without_being_asked(tmp_path):
    out = tmp_path / 'kept.yaml'
    out.write_text('kept')
    with pytest.raises(SystemExit, match=r'kept\.yaml: exists; --force overwrites it'):
        main([*SURVEY, '--out', str(out)])
    assert out.read_text() == 'kept'
    main([*SURVEY, '--out', str(out), '--force'])
    assert load_mission(out).k == 3
    assert [path.name for path in tmp_path.iterdir()] == ['kept.yaml']


def test_there_must_be_a_folder(tmp_path):
    with pytest.raises(SystemExit, match='--out: there is no folder'):
        main([*SURVEY, '--out', str(tmp_path / 'none' / 'm.yaml')])


def test_without_its_libraries_it_says_what_to_install(tmp_path, monkeypatch):
    import uav_mission_manager.cli.mission_new as command

    monkeypatch.setattr(command, 'find_spec', lambda _: None)
    with pytest.raises(SystemExit, match='pip install shapely defusedxml'):
        main([*SURVEY, '--out', str(tmp_path / 'm.yaml')])


# The grid


def test_two_goals_in_one_cell_are_refused_with_the_size_that_separates_them(tmp_path, capsys):
    error = refusal(tmp_path, capsys, *FLAGS, '--goal=c,47.0013,8.0011', '--cell=100')
    found = re.search(r'a and c lie in one cell of 100 m: --cell (\d+) gives every', error)
    assert int(found[1]) == 30  # 0.0003 degrees of latitude are 33 m.
    assert made(tmp_path, *FLAGS, '--goal=c,47.0013,8.0011', f'--cell={found[1]}').k == 3


def test_goals_at_one_place_are_refused(tmp_path, capsys):
    error = refusal(tmp_path, capsys, *FLAGS, '--goal=c,47.001,8.00101')
    assert re.search(r'a \(--goal\) and c \(--goal\) are only 0\.8 m apart', error)


def test_goals_too_close_for_their_distance_are_refused(tmp_path, capsys):
    error = refusal(tmp_path, capsys, *FLAGS, '--goal=c,47.0011,8.001', '--goal=d,47.03,8')
    assert re.search(r'cells of 10 m which separate them would be [\d,]+, more than 2,500', error)


PLACES = st.lists(
    st.tuples(st.floats(-3000.0, 3000.0), st.floats(-3000.0, 3000.0)), min_size=2, max_size=7
)
HOMES = st.tuples(st.floats(-70.0, 70.0), st.sampled_from([-180.0, -71.3, 0.0, 8.5, 179.999]))


def placed(home, points):
    """Return places around a home, the first being the home."""
    plane = Origin(*home, 0.0)
    found = [Place('home', *home, 'test')]
    for number, point in enumerate(points):
        found.append(Place(f'goal{number}', *plane.to_geodetic(*point), 'test'))
    return found


def holds(grid, place):
    return grid.contains(*grid.origin.to_local(place.latitude, place.longitude))


BEARINGS = st.sampled_from([0.0, 30.0, -77.7])


@given(HOMES, PLACES, BEARINGS)
def test_the_chosen_grid_holds_all_places_and_separates_goals(home, points, bearing):
    home, *goals = placed(home, points)
    try:
        size, _ = chosen_size(home, goals, [], bearing)
    except MissionError:
        assume(False)
    grid = laid_out(home, [home, *goals], home, size, bearing)
    assert all(holds(grid, place) for place in (home, *goals))
    assert len({cell_of(grid, goal) for goal in goals}) == len(goals)
    assert max(grid.rows, grid.cols) > CELLS_ALONG or size == 5.0
    assert grid.q <= MOST_CHOSEN_CELLS * 1.05


@given(HOMES, PLACES, st.integers(1, 30), st.integers(1, 30), BEARINGS)
def test_a_grid_of_given_shape_holds_all_places(home, points, rows, cols, bearing):
    places = placed(home, points)
    try:
        grid = laid_out(places[0], places, places[0], (rows, cols), bearing)
    except MissionError:
        assume(False)
    assert (grid.rows, grid.cols) == (rows, cols)
    assert all(holds(grid, place) for place in places)


@given(HOMES, st.floats(-44.0, 44.0), st.floats(1.5, 6.0))
def test_a_grid_turned_to_fit_is_the_smallest_box(home, bearing, longer):
    axes = Grid(1, 1, 0, 0, 400.0, bearing=bearing)
    corners = [axes.at(col, row) for col in (0.0, longer) for row in (0.0, 1.0)]
    places = placed(home, corners[1:])
    assert fitted_bearing(places) == pytest.approx(bearing, abs=0.1)
    size, _ = chosen_size(places[0], places[1:], [], bearing)
    grid = laid_out(places[0], places, places[0], size, bearing)
    area = grid.q * size**2
    assert longer * 400.0**2 < area < (longer * 400.0 + 1.5 * size) * (400.0 + 1.5 * size)


@pytest.mark.parametrize(
    ('turn', 'bearing'), [((), 0.0), (('--turn=30',), 30.0), (('--turn=fit',), -29.9)]
)
def test_a_grid_is_turned_as_asked(tmp_path, capsys, turn, bearing):
    """Home and two goals on one line, which leads 29.9 degrees north of east, by Vincenty."""
    line = ['--home=47,8', '--goal=a,47.001,8.00255', '--goal=b,47.002,8.0051', *turn]
    azimuth = float(vdist(47.0, 8.0, 47.002, 8.0051)[1])
    assert azimuth - 90.0 == pytest.approx(-29.9, abs=0.1)
    mission = made(tmp_path, *line)
    assert mission.grid.bearing == pytest.approx(bearing, abs=0.1)
    assert ('their columns leading to' in capsys.readouterr().out) == bool(turn)
    assert min(mission.grid.rows, mission.grid.cols) == 1 or bearing >= 0.0


# Warnings


def warnings_for(tmp_path, capsys, *arguments):
    with warnings.catch_warnings():
        warnings.simplefilter('always')
        made(tmp_path, *arguments)
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith('mission_new: warning: ') for line in lines)
    return [line.removeprefix('mission_new: warning: ') for line in lines]


def box(south, west, north, east):
    """Return an area of GeoJSON, in thousandths of a degree from 47 N 8 E."""
    corners = [(west, south), (east, south), (east, north), (west, north), (west, south)]
    return [[[8 + x / 1000, 47 + y / 1000] for x, y in corners]]


def test_legs_and_goals_are_held_against_areas(tmp_path, capsys):
    """Home and goals a, b are on a line to the east."""
    goals = ['--home=47,8', '--goal=a,47,8.002', '--goal=b,47,8.006', '--polygons=no_fly']

    def of(area, *more):
        geometry = {'type': 'Polygon', 'coordinates': area}
        name = file_of(tmp_path, geometry)
        return warnings_for(tmp_path, capsys, name, *goals, *more)

    between = of(box(-1, 3.5, 1, 4.5))
    assert between == [
        'straight legs cross the no-fly area feature_1: goal a to goal b, goal b to base'
    ]
    assert of(box(1, 3, 2, 5)) == []
    on_goal = of(box(-1, 5.5, 1, 6.5))
    assert on_goal[0] == 'goal b is inside the no-fly area feature_1'
    assert on_goal[1].endswith('goal a to goal b, goal b to base')
    assert of(box(-1, -1, 1, 7), '--fence=feature_1') == []
    assert of(box(-1, -1, 1, 5), '--fence=feature_1') == [
        'goal b is outside the fence',
        'straight legs leave the fence: goal a to goal b, goal b to base',
    ]


def test_the_centre_of_a_cell_counts_too(tmp_path, capsys):
    mission = made(tmp_path, *SURVEY)
    place = PLAN['mission']['items'][2]['params'][4:6]
    centre = mission.grid.origin.to_geodetic(*mission.grid.position(mission.goals[0].cell))
    apart = float(vdist(*centre, *place)[0])
    assert apart > 1.0
    plan = changed('geoFence', 'polygons', [])
    plan['geoFence']['circles'][0]['circle'] = {'center': centre, 'radius': 0.8 * apart}
    capsys.readouterr()
    [first, _] = warnings_for(tmp_path, capsys, file_of(tmp_path, plan))
    assert first.startswith('the centre of the cell of goal waypoint_3, which is flown to, is in')


def test_goals_beyond_the_range_of_the_battery_are_told(tmp_path, capsys):
    [warning] = warnings_for(tmp_path, capsys, '--home=47,8', '--goal=far,47.05,8')
    found = re.fullmatch(r'goal far is (\d+) m of flight away, .*; energy gives (\d+) m', warning)
    # There and back: 0.1 degrees of latitude, less than two cells.
    assert int(found[1]) == pytest.approx(11_120, abs=1000)
    assert int(found[2]) == round(5 * 3600 * FULL_CHARGE * 5.0 * 14.8 / 250.0 - 5 * 50)


# Hostile files

KML = '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{}</Document></kml>'
POINT = '<Placemark><name>a</name><Point><coordinates>{}</coordinates></Point></Placemark>'
LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE kml [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>'
    '<kml><Document><name>&b;</name></Document></kml>'
)
OUTSIDE = '<!DOCTYPE kml [<!ENTITY a SYSTEM "file:///etc/passwd">]><kml><name>&a;</name></kml>'
HERE = ['--home=47,8']


@pytest.mark.parametrize(
    ('content', 'problem'),
    [
        (LAUGHS, 'has a document type or entities, which KML has not'),
        (OUTSIDE, 'has a document type or entities, which KML has not'),
        ('<kml><Document>', 'not valid XML'),
        ('<gpx></gpx>', 'is no KML: its root is gpx'),
        ('<a>' * 100_000, 'not valid XML'),
        (KML.format(POINT.format('8,x')), 'placemark a: coordinates: 8,x are no numbers'),
        (KML.format(POINT.format('8')), 'placemark a: .* is no position'),
        (KML.format(POINT.format('')), 'placemark a: 0 positions where a point has one'),
        (KML.format(POINT.format('nan,47')), 'placemark a: nan is not finite'),
        (KML.format(POINT.format('47,149')), r'placemark a: 149\.0 is outside .*longitude, lat'),
        (KML.format(POINT.format('181,47')), r'placemark a: 181\.0 is outside -180\.\.180'),
        (KML.format(POINT.format('8,47') * (MAX_FEATURES + 1)), 'more than 1000 points'),
        (b'PK\x03\x04', 'is an archive, KMZ perhaps'),
        (b'\xff\xfe\x00', 'is neither JSON nor KML'),
        ('', 'not valid JSON'),
        ('[' * 100_000, 'not valid JSON: .*recursion'),
        ('{"a":' * 100_000, 'not valid JSON: .*recursion'),
        ('{"type": NaN}', 'not valid JSON: NaN is no number'),
        ('{"type": ' + '9' * 5000 + '}', 'not valid JSON'),
        (' ' * 10_000_000, 'cannot be read: more than 8,000,000 bytes'),
        ([], r'file: \[\] is no object'),
        ({'type': 'Topology'}, 'type: Topology is no geometry of GeoJSON'),
        ({'type': 'FeatureCollection', 'features': 3}, 'features: 3 is no list'),
        ({'type': 'Point', 'coordinates': [1e400, 2]}, 'not valid JSON: Infinity is no'),
        ({'type': 'Point', 'coordinates': [8, True]}, 'coordinates: True is not a number'),
        ({'type': 'Point', 'coordinates': '8,47'}, 'coordinates: 8,47 is no position'),
        ({'type': 'Point', 'coordinates': [47, 149]}, r'149\.0 is outside .* order right'),
        ({'type': 'Point', 'coordinates': [47, 8]}, 'km from home, .*in the right order'),
        ({'type': 'Polygon', 'coordinates': [[[8, 47], [9, 47]]]}, '2 corners are none of an'),
        ({'type': 'Polygon', 'coordinates': []}, 'coordinates: has no ring'),
        (
            {'type': 'Polygon', 'coordinates': [[[8, 47], [8.1, 47.1], [8.1, 47], [8, 47.1]]]},
            'feature 1: the edges from corners 1 and 3 cross or touch',
        ),
        ({'type': 'Point', 'crs': {'properties': {'name': 'EPSG:2056'}}}, 'crs: EPSG:2056 is not'),
        (changed('mission', 'items', {}), r'mission\.items: \{\} is no list'),
        (changed('mission', 'items', 0, 7), r'mission\.items\[0\]: 7 is no object'),
        (changed('mission', 'plannedHomePosition', [1]), r'plannedHomePosition: \[1\] is no pos'),
        (changed('mission', 'plannedHomePosition', [147, 8, 0]), r'plannedHome.* order right'),
        (changed('mission', 'hoverSpeed', -1), r'mission\.hoverSpeed: -1 is not above 0'),
        (changed('mission', 'items', 2, 'params', 'x'), r"params: 'x' is no list"),
        (
            changed('mission', 'items', 2, 'params', [0] * 4 + ['a', 1]),
            r"params: 'a' is not a num",
        ),
        (changed('mission', 'items', 2, 'Altitude', 'x'), r"\[2\]\.Altitude: 'x' is not a number"),
        (changed('mission', 'items', 1, 'polygon', None), r'polygon: None is no list of corners'),
        (changed('geoFence', 'circles', 0, 'circle', 'radius', -4), r'radius: -4 is not above 0'),
        (changed('geoFence', 'circles', 0, 'circle', 'radius', 1e300), r'is above 100000 m'),
        (changed('geoFence', 'circles', 0, 'inclusion', 'no'), r'inclusion: no is neither'),
        (changed('geoFence', 'polygons', 0, 'polygon', [[1, 2]]), r'polygon: 1 corners are none'),
    ],
)
def test_hostile_files_are_refused_in_one_line(tmp_path, capsys, content, problem):
    name = file_of(tmp_path, content)
    home = [] if isinstance(content, dict) and 'mission' in content else HERE
    error = refusal(tmp_path, capsys, name, *home)
    assert re.search(problem, error)
    assert len(error) < 700


def test_a_deep_kml_is_read(tmp_path):
    deep = '<Folder>' * 50_000 + POINT.format('8.001,47.001') + '</Folder>' * 50_000
    mission = made(tmp_path, file_of(tmp_path, KML.format(deep)), *HERE)
    assert [goal.name for goal in mission.goals] == ['a']


def test_placemarks_within_each_other_are_read_in_no_time(tmp_path):
    nested = '<Placemark>' * 50_000 + '</Placemark>' * 50_000
    content = KML.format(nested + POINT.format('8.001,47.001'))
    assert made(tmp_path, file_of(tmp_path, content), *HERE).k == 1


def test_each_geometry_of_a_placemark_is_taken_once(tmp_path, capsys):
    point = '<Point><coordinates>{}</coordinates></Point>'
    line = '<LinearRing><coordinates>8,47 8.1,47 8,47.1</coordinates></LinearRing>'
    parts = point.format('8.001,47.001') + point.format('8.002,47.003') + line
    placemark = f'<Placemark><name>a</name><MultiGeometry>{parts}</MultiGeometry></Placemark>'
    mission = made(tmp_path, file_of(tmp_path, KML.format(placemark)), *HERE)
    assert [goal.name for goal in mission.goals] == ['a', 'a_2']
    assert 'a line is neither' in capsys.readouterr().out


def test_a_kml_in_another_encoding_is_read(tmp_path):
    text = '<?xml version="1.0" encoding="ISO-8859-1"?>' + KML.format(POINT.format('8.001,47.001'))
    content = text.replace('<name>a', '<name>Zürich').encode('latin-1')
    assert made(tmp_path, file_of(tmp_path, content), *HERE).goals[0].name == 'Zürich'


def test_a_mission_across_the_180th_meridian(tmp_path):
    goals = ['--goal=east,-17,-179.999', '--goal=west,-17,179.999']
    mission = made(tmp_path, '--home=-17.001,180', *goals)
    assert mission.grid.cols * mission.grid.cell_size < 400.0


def test_a_pipe_is_not_waited_for(tmp_path, capsys):
    os.mkfifo(tmp_path / 'pipe')
    assert 'no regular file' in refusal(tmp_path, capsys, str(tmp_path / 'pipe'))
