"""`mission_check` of areas, waypoints and the time that tasks take."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ElementTree

import pytest
from shapely.geometry import LineString, Polygon, shape
from strategies import case_study

from uav_mission_manager.cli.check import solving, tasks_and_areas
from uav_mission_manager.cli.check.facts import goal_facts
from uav_mission_manager.cli.check.geojson import geojson
from uav_mission_manager.cli.check.html_page import html_page
from uav_mission_manager.cli.check.plausibility import findings
from uav_mission_manager.cli.mission_check import main
from uav_mission_manager.geodesy import Origin
from uav_mission_manager.mdp import mission_from_dict

GRID = mission_from_dict(case_study(), 'test').grid
"""2 x 4 cells of 50 m: base in cell 0, service in 1, goals in cells 5, 3 and 6."""

SVG = '{http://www.w3.org/2000/svg}'
CLEAR = [(-30, 30), (180, 30), (180, -80), (-30, -80)]
BESIDE = [(90, 30), (110, 30), (110, 12), (90, 12)]
"""Around everything, and beside all cells' centres and the ways between them."""


def deg(east, north):
    return list(GRID.origin.to_geodetic(east, north))


def with_areas(no_fly=(), fence=None, task=None, **changes):
    document = case_study(**changes)
    areas = [
        {'name': f'area{n}', 'polygon': [deg(*corner) for corner in ring]}
        for n, ring in enumerate(no_fly)
    ]
    document['areas'] = {'no_fly': areas} if areas else {}
    if fence:
        document['areas']['fence'] = [deg(*corner) for corner in fence]
    if task is not None:
        document['goals'][1]['task'] = task
    return mission_from_dict(document, 'test')


def round_of(*points):
    """Return a task at goal2, in cell 3 at (150, 0)."""
    return {'waypoints': [deg(*point) for point in points]}


def breaches(mission):
    return [(f.field, f.value, f.text) for f in findings(mission) if f.field.startswith('areas')]


def test_a_mission_clear_of_its_areas_gets_no_warning():
    assert breaches(with_areas([BESIDE], CLEAR, round_of((140, -10), (160, 10)))) == []


def test_legs_between_cells_are_held_against_areas():
    [(field, value, text)] = breaches(with_areas([[(120, 5), (130, 5), (130, -5), (120, -5)]]))
    assert (field, value) == ('areas.no_fly.0', 'area0')
    assert text.startswith('straight legs cross the no-fly area area0: ')
    named = {frozenset(leg.split(' to ')) for leg in text.split(': ')[1].split(', ')}
    # Along the northern row: from goal2 to base and to the service cell.
    assert {frozenset(('goal goal2', 'base')), frozenset(('goal goal2', 'service'))} <= named


def test_waypoints_legs_are_held_against_areas():
    """Out to the north-east, over an area, and back beside it."""
    corner = [(165, 24), (172, 24), (172, 18), (165, 18)]
    over = with_areas([corner], None, round_of((160, 21), (174, 21), (174, 10)))
    [(_, _, text)] = breaches(over)
    said = 'straight legs cross the no-fly area area0: waypoint 1 of goal goal2 to waypoint 2'
    assert text == f'{said} of goal goal2'
    assert breaches(with_areas([corner], None, round_of((160, 10), (174, 10)))) == []


def test_the_way_home_from_the_last_waypoint_counts():
    beside = [(100, 12), (110, 12), (110, 8), (100, 8)]
    [(_, _, text)] = breaches(with_areas([beside], None, round_of((150, 15))))
    assert 'waypoint 1 of goal goal2 to base' in text
    assert 'goal goal2 to base' not in text.replace('waypoint 1 of goal goal2 to base', '')


def test_waypoints_beyond_the_fence_are_told():
    narrow = [(-30, 12), (180, 12), (180, -80), (-30, -80)]
    assert breaches(with_areas(fence=narrow)) == []
    [(field, value, text)] = breaches(with_areas([], narrow, round_of((150, 10), (150, 15))))
    assert (field, value) == ('areas.fence', 'fence')
    assert 'waypoint 1 of goal goal2 to waypoint 2 of goal goal2' in text


def test_cells_in_an_area_are_told():
    found = breaches(with_areas([[(140, 10), (160, 10), (160, -10), (140, -10)]]))
    assert found[0][2].startswith('the centre of the cell of goal goal2, which is flown to, is in')


def test_without_shapely_it_says_that_it_did_not_look(monkeypatch):
    mission = with_areas([BESIDE])
    monkeypatch.setattr(tasks_and_areas, 'find_spec', lambda _: None)
    [note] = [finding for finding in findings(mission) if finding.field == 'areas']
    assert note.note
    assert "pip install '.[plan]'" in note.text
    assert [f for f in findings(with_areas()) if f.field == 'areas'] == []


# Times


def tasks(done_in, *given, **changes):
    """Findings about the tasks of the case study's goals, an epoch of 10 s."""
    document = case_study(**changes)
    document['faults']['completion'] = [10.0 / done_in] * 4 + [0.0] * 4
    for goal, task in zip(document['goals'], given, strict=False):
        goal['task'] = task
    mission = mission_from_dict(document, 'test')
    return [finding for finding in findings(mission) if finding.field.endswith('.task')]


@pytest.mark.parametrize(
    ('done_in', 'stay', 'warned'),
    [(30.0, 16.0, 0), (30.0, 14.0, 1), (30.0, 59.0, 0), (30.0, 61.0, 1), (12.0, 0.0, 0)],
)
def test_a_task_of_half_or_twice_the_time_is_told(done_in, stay, warned):
    """An epoch is the least that the model knows."""
    found = tasks(done_in, *[{'dwell': stay}] * 3)
    assert len(found) == 3 * warned
    assert not any(finding.note for finding in found)


def test_the_warning_says_what_to_write():
    [first, *_] = tasks(30.0, *[{'dwell': 100.0}] * 3)
    assert str(first) == (
        'goals.0.task: goal1: takes about 100 s, faults.done_in (completion) says 30 s: give the '
        'goal done_in: 100'
    )


def test_a_task_is_compared_with_the_time_of_its_own_goal():
    """A stay of 100 s, of which the faults say 20 s, and the goal itself something else."""
    goals = case_study()['goals']
    goals[0]['done_in'] = 90.0
    assert tasks(20.0, {'dwell': 100.0}, goals=goals) == []
    goals[0]['done_in'] = 300.0
    [found] = tasks(20.0, {'dwell': 100.0}, goals=goals)
    assert 'takes about 100 s, goals.0.done_in (completion) says 300 s' in str(found)


def test_where_a_goal_is_never_done_no_time_is_compared():
    goals = case_study()['goals']
    goals[0] |= {'completion': [0.0] * 8, 'task': {'dwell': 500.0}}
    found = findings(mission_from_dict(case_study(goals=goals), 'test'))
    assert [finding.field for finding in found if 'goals.0' in finding.field] == [
        'goals.0.completion (done_in)'
    ]


def test_goals_that_outlast_the_battery_are_told():
    """A full battery lasts 1,066 s; a task that is broken off is taken up again."""
    goals = case_study()['goals']
    goals[0]['done_in'], goals[1]['done_in'] = 1060.0, 1070.0
    mission = mission_from_dict(case_study(goals=goals), 'test')
    [note] = [finding for finding in findings(mission) if 'done_in' in finding.field]
    assert note.note
    assert (note.field, note.value) == ('goals.1.done_in (completion)', '1070 s')
    assert note.text.startswith('a full battery lasts 18 min')
    goals[1]['done_in'] = 1060.0
    document = case_study(goals=[*goals, goals[2] | {'name': 'goal4'}])
    document['faults']['completion'] = [0.005] * 8
    [note] = [
        finding
        for finding in findings(mission_from_dict(document, 'test'))
        if 'done_in' in finding.field
    ]
    assert (note.field, note.value) == ('faults.done_in (completion)', '2000 s')


@pytest.mark.parametrize(
    'task', [{'external': {'timeout': 900.0}}, None], ids=['another program', 'no task']
)
def test_of_what_nobody_knows_nothing_is_said(task):
    assert tasks(30.0, *[task] if task else []) == []


def test_without_energy_no_time_is_known():
    document = case_study()
    del document['energy']
    document['goals'][0]['task'] = {'dwell': 500.0}
    mission = mission_from_dict(document, 'test')
    assert [finding for finding in findings(mission) if finding.field.endswith('.task')] == []
    assert goal_facts(mission)[0].task_seconds is None


# Pictures and files


def svg_of(mission):
    page = html_page(mission, [])
    return ElementTree.fromstring(page[page.index('<svg') : page.index('</svg>') + 6])


def points_of(polygon):
    return [tuple(map(float, point.split(','))) for point in polygon.get('points').split()]


def of_kind(svg, tag, kind):
    return [element for element in svg.iter(f'{SVG}{tag}') if element.get('class') == kind]


def test_the_map_draws_areas_where_they_are():
    mission = with_areas([BESIDE], CLEAR, round_of((140, -10), (160, 10)))
    svg = svg_of(mission)
    [no_fly], [fence] = (of_kind(svg, 'polygon', kind) for kind in ('no-fly', 'fence'))
    for drawn, ring in ((no_fly, BESIDE), (fence, CLEAR)):
        south_down = Polygon([(east, -north) for east, north in ring])
        assert Polygon(points_of(drawn)).symmetric_difference(south_down).area < 0.1
    names = [text.text for text in svg.iter(f'{SVG}text') if text.get('class') == 'area-name']
    assert names == ['area0']


def test_the_map_draws_waypoints_from_their_goal_on():
    svg = svg_of(with_areas(task=round_of((140, -10), (160, 10))))
    [line] = of_kind(svg, 'path', 'round')
    steps = [tuple(map(float, step.split())) for step in line.get('d').strip('M').split('L')]
    for drawn, point in zip(steps, [(150, 0), (140, 10), (160, -10)], strict=True):
        assert drawn == pytest.approx(point, abs=0.01)
    assert of_kind(svg, 'path', 'waypoint')[0].get('d').count('M') == 2


def test_the_legend_has_what_there_is():
    page = html_page(with_areas([BESIDE], CLEAR, round_of((150, 10))), [])
    bare = html_page(with_areas(), [])
    for text in ('fence, to stay inside', 'area not to fly over', '</svg>waypoints'):
        assert text in page
        assert text not in bare
    assert '<td>1 waypoint, about' in page


@pytest.mark.parametrize('ring', [BESIDE, BESIDE[::-1]])
def test_geojson_has_the_areas(ring):
    features = geojson(with_areas([ring], CLEAR))['features']
    kinds = {f['properties']['kind']: f for f in features}
    assert kinds['no_fly']['properties']['name'] == 'area0'
    for kind, own in (('no_fly', ring), ('fence', CLEAR)):
        area = shape(kinds[kind]['geometry'])
        assert area.exterior.is_ccw
        there = Polygon([GRID.origin.to_local(y, x) for x, y in area.exterior.coords])
        assert there.symmetric_difference(Polygon(own)).area < 0.1


def test_geojson_has_the_waypoints():
    task = {'waypoints': [[*deg(140, -10), 35.0], deg(160, 10)]}
    mission = with_areas(task=task)
    [feature] = [f for f in geojson(mission)['features'] if f['properties']['kind'] == 'waypoints']
    assert feature['properties'] == {
        'kind': 'waypoints',
        'goal': 'goal2',
        'heights_m': [35.0, None],
    }
    line = LineString([GRID.origin.to_local(y, x) for x, y in feature['geometry']['coordinates']])
    assert line.hausdorff_distance(LineString([(140, -10), (160, 10)])) < 0.01


def test_across_the_180th_meridian_waypoints_are_points():
    origin = Origin(10.0, 179.9999, 0.0)
    grid = {'rows': 2, 'cols': 4, 'base': 0, 'service': 1}
    grid['origin'] = {'latitude': 10.0, 'longitude': 179.9999, 'altitude': 0.0}
    document = case_study(grid=grid)
    document['goals'][0] |= {'cell': 1}
    places = [origin.to_geodetic(east, 0.0) for east in (5.0, 60.0)]
    document['goals'][0]['task'] = {'waypoints': [list(place) for place in places]}
    features = geojson(mission_from_dict(document, 'test'))['features']
    [feature] = [f for f in features if f['properties']['kind'] == 'waypoints']
    assert feature['geometry']['type'] == 'MultiPoint'
    east, west = (longitude for longitude, _ in feature['geometry']['coordinates'])
    assert east > 179.9
    assert west < -179.9


def test_the_terminal_and_json_name_tasks_and_areas(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(solving, 'MAX_SENSITIVITY_SECONDS', 0.0)  # Nobody looks at them here.
    monkeypatch.setattr(solving, 'DRAWN_EPOCHS', 2000)
    mission = with_areas([BESIDE], CLEAR, round_of((140, -10), (160, 10)))
    path = tmp_path / 'mission.yaml'
    path.write_text(json.dumps(mission.to_dict()))
    assert main([str(path)]) == 0
    out = capsys.readouterr().out
    # 14.1 m and 28.3 m at 5 m/s, and 2 s at each.
    seconds = round(math.hypot(10, 10) * 3 / 5 + 4)
    assert f'task at goal2: 2 waypoints, about {seconds} s' in out
    assert 'no-fly area area0: 4 corners' in out
    assert 'fence: 4 corners' in out
    assert main([str(path), '--json']) == 0
    goal = json.loads(capsys.readouterr().out)['goals'][1]
    assert goal['task'] == '2 waypoints'
    assert goal['task_seconds'] == pytest.approx(math.hypot(10, 10) * 3 / 5 + 4, rel=1e-3)
