"""What RViz and Foxglove are shown, held against the mission."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace

import pytest
from builtin_interfaces.msg import Time
from shapely import MultiPoint, Polygon, union_all
from strategies import case_study
from visualization_msgs.msg import Marker

from uav_mission_manager.console.heard import Pose
from uav_mission_manager.drawing.trail import TRAIL_BREAK, TRAIL_STEP
from uav_mission_manager.mdp import global_actions, mission_from_dict
from uav_mission_manager.nodes.markers import LIFETIME, MarkerScene
from uav_mission_manager.onboard import Refusal, Situation
from uav_mission_manager.policy import Decision

REFUSAL = Refusal('link lost: odom 4.0 s old')
LINES = Marker.LINE_LIST, Marker.LINE_STRIP, Marker.TRIANGLE_LIST, Marker.SPHERE_LIST


def mission(bearing=0.0, **changes):
    document = case_study(**changes)
    document['grid']['bearing'] = bearing
    document['grid']['elevation'] = {5: 7.0}
    return mission_from_dict(document, 'test')


def decision(mission, number):
    """The command of an action; commit to goal j is number j + 1."""
    action = global_actions(mission)[number - 1]
    return Decision((), action, None, (), math.inf, f'why {number}', lambda: (None, None))


def drawn(scene, situation, outcome=REFUSAL, charge=None, digest='a'):
    """Return the markers by their namespaces, as a viewer has them afterwards."""
    shown = defaultdict(list)
    for marker in scene.draw(outcome, situation, charge, digest, Time(sec=7)).markers:
        assert marker.header.frame_id == 'map'
        assert marker.header.stamp == Time(sec=7)
        if marker.action == Marker.ADD:
            assert marker.lifetime.sec == LIFETIME
            assert bool(marker.points) == (marker.type in LINES)
            assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0.0
            shown[marker.ns].append(marker)
    return shown


def flat(marker):
    return [(point.x, point.y) for point in marker.points]


def triangles(marker):
    corners = flat(marker)
    return union_all([Polygon(corners[i : i + 3]) for i in range(0, len(corners), 3)])


def position(marker):
    place = marker.pose.position
    return place.x, place.y, place.z


def cell_square(grid, cell):
    """Four corners by hand, half a cell from its centre along the turned axes."""
    east, north = grid.position(cell)
    turn, half = math.radians(grid.bearing), grid.cell_size / 2.0
    right = half * math.cos(turn), -half * math.sin(turn)
    up = half * math.sin(turn), half * math.cos(turn)
    return Polygon(
        [
            (east + a * right[0] + b * up[0], north + a * right[1] + b * up[1])
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
    )


def same(one, other):
    return one.symmetric_difference(other).area < 1e-6


@pytest.mark.parametrize('bearing', [0.0, 30.0, -100.0])
def test_cells_lie_as_the_mission_has_them(bearing):
    m = mission(bearing)
    grid, shown = m.grid, drawn(MarkerScene('uav1'), Situation(m).with_threat('high', 0.0))
    squares = [cell_square(grid, cell) for cell in range(grid.q)]
    [lines] = shown['uav1/grid']
    assert same(MultiPoint(flat(lines)).convex_hull, union_all(squares).convex_hull)
    assert len(lines.points) == 2 * (3 + 1 + 4)  # Inner lines, and the edge.
    for space, cells in (
        ('base', [0]),
        ('service', [1]),
        ('zone', [2, 6]),
        ('calm', [0, 1]),
        ('threat', [0]),
    ):
        [marker] = shown[f'uav1/{space}']
        assert same(triangles(marker), union_all([squares[cell] for cell in cells]))
    heights = [shown[f'uav1/{space}'][0].points[0].z for space in ('calm', 'base', 'threat')]
    assert heights == sorted(set(heights))  # Else they flicker where they overlap.
    assert {marker.text for marker in shown['uav1/base name']} == {'base'}
    assert squares[1].contains(MultiPoint([position(shown['uav1/service name'][0])]))


def test_goals_are_where_and_as_they_are_wanted():
    m = mission()
    situation = Situation(m).with_priorities([2, 1, 0], 'a', 0.0).with_refused('goal2')
    shown = drawn(MarkerScene('uav1'), situation)
    assert [position(marker) for marker in shown['uav1/goal']] == [
        (50.0, -50.0, 7.0),  # On its ground.
        (150.0, 0.0, 0.0),
        (100.0, -50.0, 0.0),
    ]
    assert [marker.text for marker in shown['uav1/name']] == [
        'goal1: high priority',
        'goal2: low priority, out of range',
        'goal3: no priority',
    ]
    colours = {(marker.color.r, marker.color.g, marker.color.b) for marker in shown['uav1/goal']}
    assert len(colours) == 3


def test_areas_and_waypoints_of_the_mission_file():
    document = case_study()
    origin = document['grid']['origin'] = {'latitude': 0.0, 'longitude': 0.0, 'altitude': 0.0}
    ring = [[0.0, 0.0], [0.0, 0.001], [0.001, 0.001]]
    document['areas'] = {'fence': ring, 'no_fly': [{'name': 'dam', 'polygon': ring}]}
    document['goals'][0]['task'] = {'waypoints': [[-0.0004, 0.0004], [-0.0005, 0.0005, 12.0]]}
    m = mission_from_dict(document, 'test')
    shown = drawn(MarkerScene(''), Situation(m))
    degree = 6378137.0 * math.pi / 180.0  # At the equator, to half a percent to the north.
    assert origin['latitude'] == 0.0
    for space in 'fence', 'no-fly':
        [marker] = shown[space]
        assert flat(marker)[0] == flat(marker)[-1]
        corners = {(round(x, 6), round(y, 6)) for x, y in flat(marker)}
        assert len(corners) == 3
        assert max(x for x, _ in corners) == pytest.approx(0.001 * degree, rel=1e-3)
        assert max(y for _, y in corners) == pytest.approx(0.001 * degree, rel=1e-2)
    assert [marker.text for marker in shown['no-fly name']] == ['dam']
    [points], [legs] = shown['waypoint'], shown['round']
    assert [point.z for point in points.points] == [0.0, 12.0]
    assert flat(points)[0] == pytest.approx((0.0004 * degree, -0.0004 * degree), rel=1e-2)
    assert flat(legs) == [(50.0, -50.0), *flat(points)]
    assert not {'fence', 'no-fly', 'waypoint', 'round'} & set(
        drawn(MarkerScene(''), Situation(mission()))
    )


def test_the_vehicle_with_its_way_and_why():
    m, scene = mission(), MarkerScene('uav1')
    shown = drawn(scene, Situation(m), decision(m, 2), 0.9)
    assert not {'uav1/vehicle', 'uav1/way', 'uav1/range', 'uav1/command'} & set(shown)
    scene.move(Pose(10.0, -20.0, 21.0, math.radians(90.0)))
    shown = drawn(scene, Situation(m), decision(m, 2), 0.9)
    [arrow] = shown['uav1/vehicle']
    assert position(arrow) == (10.0, -20.0, 21.0)
    turn = arrow.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((0.0, 0.0, 0.0, 1.0))  # To the east.
    assert arrow.scale.x > arrow.scale.y
    [way] = shown['uav1/way']
    assert [(p.x, p.y, p.z) for p in way.points] == [
        (10.0, -20.0, 21.0),
        (50.0, -50.0, 21.0),
        (50.0, -50.0, 7.0),
    ]
    assert shown['uav1/command'][0].text == 'commit goal1 normal\nwhy 2'
    assert shown['uav1/height'][0].text == 'uav1, 21 m'
    assert 'uav1/trail' not in shown
    scene.move(Pose(10.0, -20.0, 21.0, math.nan))
    [arrow] = drawn(scene, Situation(m))['uav1/vehicle']
    assert arrow.pose.orientation.w == 1.0


def test_without_a_command_it_says_so_and_shows_no_way():
    m, scene = mission(), MarkerScene('')
    scene.move(Pose(0.0, 0.0, math.nan, 0.0))
    array = scene.draw(REFUSAL, Situation(m), None, 'a', Time())
    [way] = [marker for marker in array.markers if marker.ns == 'way']
    assert way.action == Marker.DELETE
    shown = drawn(scene, Situation(m))
    assert shown['command'][0].text == 'no command\nlink lost: odom 4.0 s old'
    assert shown['height'][0].text == '0 m'
    assert position(shown['vehicle'][0]) == (0.0, 0.0, 0.0)


def test_the_ring_is_as_far_as_the_charge_goes_and_on_to_the_service_cell():
    m, scene = mission(), MarkerScene('')
    scene.move(Pose(100.0, 30.0, 20.0, 0.0))
    [ring] = drawn(scene, Situation(m), charge=0.5)['range']
    # 5 m/s * 0.5 * 5 Ah * 14.8 V / 250 W, less 100 * 8 and 400 * 0.5.
    far = 5.0 * 0.5 * 5.0 * 14.8 / 250.0 * 3600.0 - 800.0 - 200.0
    for point in flat(ring):
        assert math.dist(point, (100.0, 30.0)) + math.dist(point, (50.0, 0.0)) == pytest.approx(
            far
        )
    assert 'range' not in drawn(scene, Situation(m), charge=0.0)
    assert 'range' not in drawn(scene, Situation(m), charge=None)


def test_the_trail_follows_the_vehicle_in_height_too_and_breaks_where_it_jumps():
    m, scene = mission(), MarkerScene('')
    for number in range(4):
        scene.move(Pose(0.0, 0.0, number * TRAIL_STEP, 0.0))
        scene.move(Pose(0.0, 0.0, number * TRAIL_STEP + 0.1, 0.0))
    [trail] = drawn(scene, Situation(m))['trail']
    assert [point.z for point in trail.points] == [0.0, 2.0, 4.0, 6.0]
    scene.move(Pose(0.0, TRAIL_BREAK * 1.2, 0.0, 0.0))
    assert 'trail' not in drawn(scene, Situation(m))


def test_all_is_deleted_before_another_policy_set_is_drawn_and_never_else():
    m, scene = mission(), MarkerScene('uav1')

    def deletions(digest, mission=m):
        array = scene.draw(REFUSAL, Situation(mission), None, digest, Time())
        places = [i for i, each in enumerate(array.markers) if each.action == Marker.DELETEALL]
        zones = [len(each.points) for each in array.markers if each.ns == 'uav1/zone']
        return places, zones

    assert deletions('a') == ([0], [2 * 6])
    assert deletions('a') == ([], [2 * 6])
    calm = replace(m, threat=replace(m.threat, zones=()))
    assert deletions('b', calm) == ([0], [])


def test_cells_side_by_side_are_one_rectangle_unless_their_ground_differs():
    document = case_study()
    document['threat']['zones'] = dict.fromkeys((1, 2, 3, 4, 6, 7), 0.5)
    document['grid']['elevation'] = {7: 3.0}
    m = mission_from_dict(document, 'test')
    [zone] = drawn(MarkerScene(''), Situation(m))['zone']
    squares = [cell_square(m.grid, cell) for cell in (1, 2, 3, 4, 6, 7)]
    assert same(triangles(zone), union_all(squares))
    assert len(zone.points) == 6 * 4  # 1 to 3, 4, 6, and 7, which is higher.
    assert [point.z for point in zone.points].count(3.0) == 6
