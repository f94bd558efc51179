"""What the console draws: the moving map, the timeline, bars and lists."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pytest
from strategies import case_study, with_charge

from uav_mission_manager.console.heard import (
    Heard,
    HeardDecision,
    HeardEpoch,
    LogLine,
    Noted,
    Pose,
    decision_from,
)
from uav_mission_manager.console.map_overlay import (
    Craft,
    base_layer,
    goal_layer,
    moving_layer,
    target_of,
)
from uav_mission_manager.console.markup import (
    bars_html,
    forecast_html,
    log_html,
    now_html,
    rest_html,
    tile_html,
    top_html,
)
from uav_mission_manager.console.timeline import BLOCK, COLUMN_WIDTH, block_svg, blocks, row_names
from uav_mission_manager.console.view import Bar, view_of
from uav_mission_manager.mdp import StateSpace, mission_from_dict
from uav_mission_manager.nodes.reporting import state_in_words

SVG = '{http://www.w3.org/2000/svg}'
HOSTILE = '<script>alert(1)</script>"onload="x'
MISSION = mission_from_dict(case_study(), 'test')
SPACE = StateSpace.of(MISSION)
STATE = (1, 1, 0, 1, 0, 2, 1, 5, 1, 0, 0)


def heard_of(state=STATE, command='commit goal2 normal', pose=(10.0, -20.0), charge=0.6):
    heard = Heard().with_decision(HeardDecision('why', state=state, command=command), 0.0, '')
    heard = heard.with_battery('', charge, 0.0)
    return heard.with_pose(Pose(*pose, 20.0, math.radians(90.0)), 0.0)


def drawn(heard, mission=MISSION, crafts=None):
    own = {'/uav1': Craft(heard.pose.value, False)} if heard.pose else {}
    tree = ElementTree.fromstring(goal_layer(mission, heard, False))
    moving = moving_layer(mission, heard, '/uav1', {**own, **(crafts or {})})
    tree.append(ElementTree.fromstring(moving))
    return tree


def of_class(tree, kind):
    return [e for e in tree.iter() if kind in (e.get('class') or '').split()]


def test_the_vehicle_is_where_it_is_and_points_where_it_heads():
    (craft,) = of_class(drawn(heard_of()), 'craft')
    assert craft.get('transform') == 'translate(10.0 20.0) rotate(90)'


def test_a_vehicle_without_heading_is_a_disc():
    heard = heard_of()
    heard = replace(heard, pose=Noted(Pose(10.0, -20.0, 20.0, math.nan), 0.0))
    (craft,) = of_class(drawn(heard), 'craft')
    assert (craft.tag, craft.get('cx'), craft.get('cy')) == (f'{SVG}circle', '10.0', '20.0')


def test_other_vehicles_have_their_names_and_an_old_one_is_grey():
    tree = drawn(heard_of(), crafts={'/uav2': Craft(Pose(0.0, 0.0, 0.0, 0.0), True)})
    (other,) = of_class(tree, 'other')
    assert len(of_class(other, 'old')) == 1
    assert '/uav2' in {e.text for e in other.iter(f'{SVG}text')}
    assert len(of_class(tree, 'craft')) == 2


def test_goals_are_drawn_by_priority_range_and_commitment():
    tree = drawn(heard_of())
    for j, (priority, lost) in enumerate([(0, False), (2, True), (1, False)]):
        (goal,) = of_class(tree, f'goal-{priority}')
        east, north = MISSION.grid.position(MISSION.goals[j].cell)
        assert (float(goal.get('cx')), -float(goal.get('cy'))) == (east, north)
        assert ('lost' in goal.get('class')) == lost
    (ring,) = of_class(tree, 'committed')
    east, north = MISSION.grid.position(MISSION.goals[0].cell)
    assert (float(ring.get('cx')), -float(ring.get('cy'))) == (east, north)


def test_the_range_ring_is_as_far_as_the_charge_reaches_and_on_to_service():
    energy = MISSION.energy
    had = energy.speed * 0.6 * energy.capacity * energy.voltage / energy.power * 3600
    had -= energy.wind_penalty * energy.wind + energy.payload_penalty * energy.payload
    (ring,) = of_class(drawn(heard_of(charge=0.6)), 'range')
    service = MISSION.grid.position(MISSION.grid.service)
    points = [tuple(map(float, point.split(','))) for point in ring.get('points').split()]
    assert len(points) > 100
    for x, y in points:
        there = math.dist((10.0, -20.0), (x, -y)) + math.dist((x, -y), service)
        assert there == pytest.approx(had, rel=1e-4)


def test_there_is_no_ring_where_service_is_out_of_range():
    assert of_class(drawn(heard_of(charge=0.1)), 'range') == []


@pytest.mark.parametrize(
    ('command', 'cell'),
    [
        ('commit goal2 agile', MISSION.goals[1].cell),
        ('none normal', MISSION.grid.base),
        ('repair', MISSION.grid.service),
    ],
)
def test_the_way_leads_to_where_the_command_does(command, cell):
    heard = heard_of(command=command)
    assert target_of(MISSION, heard) == MISSION.grid.position(cell)
    (way,) = of_class(drawn(heard), 'way')
    assert (float(way.get('x1')), -float(way.get('y1'))) == (10.0, -20.0)
    assert (float(way.get('x2')), -float(way.get('y2'))) == MISSION.grid.position(cell)


@pytest.mark.parametrize('command', ['', 'commit nobody normal'])
def test_without_a_command_of_this_mission_there_is_no_way(command):
    assert of_class(drawn(heard_of(command=command)), 'way') == []


def test_a_threatened_vehicles_cell_is_marked():
    assert of_class(drawn(heard_of()), 'threat-2') == []
    assert len(of_class(drawn(heard_of((*STATE[:-2], 2, 1))), 'threat-2')) == 1


def test_of_a_vehicle_never_heard_nothing_is_claimed():
    tree = drawn(Heard())
    assert len(of_class(tree, 'goal-0')) == 3
    words = [e.text for e in tree.iter(f'{SVG}text')]
    assert words.count('not known') == 2 * 3  # Each with its halo.
    assert 'not wanted' not in words
    assert of_class(tree, 'craft') == []


def test_of_a_silent_manager_the_goals_are_pale_and_as_they_were():
    heard = heard_of().with_decision(HeardDecision('link lost'), 1.0, '')
    tree = ElementTree.fromstring(goal_layer(MISSION, heard, True))
    (pale,) = of_class(tree, 'pale')
    assert len(of_class(pale, 'goal-2')) == len(of_class(pale, 'goal-1')) == 1


def test_the_base_layer_does_not_move():
    tree = ElementTree.fromstring(base_layer(MISSION))
    assert of_class(tree, 'base-sign')
    assert of_class(tree, 'zone')
    assert of_class(tree, 'goal-0') == []


def test_the_base_layer_has_areas_and_waypoints():
    ring = [[0.0, 0.0], [0.0, 0.001], [0.001, 0.001]]
    areas = {'fence': ring, 'no_fly': [{'name': 'dam', 'polygon': ring}]}
    document = case_study(areas=areas)
    document['grid']['origin'] = {'latitude': 0.0, 'longitude': 0.0, 'altitude': 0.0}
    document['goals'][0]['task'] = {'waypoints': [[-0.0004, 0.0004], [-0.0005, 0.0005]]}
    tree = ElementTree.fromstring(base_layer(mission_from_dict(document, 'test')))
    for kind in ('fence', 'no-fly', 'round', 'waypoint'):
        assert len(of_class(tree, kind)) == 1
        assert of_class(ElementTree.fromstring(base_layer(MISSION)), kind) == []


def epoch(number, state=STATE, command='commit goal1 normal', words=None):
    values = {'state': ' '.join(map(str, state)), 'command': command, **(words or {})}
    return HeardEpoch(number, '12:00:00', decision_from('', values))


def test_old_blocks_of_the_timeline_stay_as_they_are():
    epochs = [epoch(number) for number in range(7, 131)]
    before, after = blocks(epochs[:-1]), blocks(epochs)
    assert [len(block) for block in after] == [50 - 6, BLOCK, 30]
    assert before[:-1] == after[:-1]
    assert [e for block in after for e in block] == epochs


def runs(svg, kind):
    """Columns that bars of a class cover, from the first to the one after the last."""
    found = []
    for rect in of_class(ElementTree.fromstring(svg), kind):
        first = float(rect.get('x')) / COLUMN_WIDTH
        found.append((first, first + float(rect.get('width')) / COLUMN_WIDTH))
    return found


def test_a_bar_covers_the_epochs_of_its_value():
    calm, high = STATE, (*STATE[:-2], 2, 1)
    states = [calm, high, high, calm, high]
    svg = block_svg([epoch(number, state) for number, state in enumerate(states, 1)], SPACE)
    assert runs(svg, 't-2') == runs(svg, 'm-1') == [(1, 3), (4, 5)]
    assert runs(svg, 'c-1') == [(0, 5)]
    assert runs(svg, 'r-1') == [(0, 5)]  # goal2 is out of range.
    assert runs(svg, 'g-1') == [(0, 5)]


def test_goals_that_a_charge_does_not_reach_are_out_of_range():
    mission = mission_from_dict(with_charge(case_study(), levels=8), 'test')
    full, empty = ((1, level, 0, 2, 1, 5, 1, 0, 0) for level in (7, 0))
    epochs = [
        epoch(number, state, words=state_in_words(mission, state))
        for number, state in enumerate((full, empty), 1)
    ]
    svg = block_svg(epochs, StateSpace.of(mission))
    assert [text.text for text in of_class(ElementTree.fromstring(svg), 'head')] == ['1', '2']
    assert '>7</text>' in svg
    assert 'state f=1 b=7 g1=0 g2=2 g3=1 l=5 c=1 t=0 m=0' in svg
    assert runs(svg, 'g-2') == [(0, 1)]
    assert runs(svg, 'r-1') == [(1, 2), (1, 2)]
    lost = [len(of_class(drawn(heard_of(state), mission), 'lost')) for state in (full, empty)]
    assert lost == [0, 3]


def test_silence_is_marked_and_a_state_of_another_mission_is_not_drawn():
    svg = block_svg([epoch(1, (), ''), epoch(2, (1,) * 7)], SPACE)
    assert runs(svg, 'none-1') == [(0, 1)]
    assert runs(svg, 'c-1') == []


def test_rows_have_names():
    assert row_names(['a', 'b'])[:3] == ('a', 'b', 'commitment')
    assert len(row_names(['a'] * 100)) == 8 + 5
    assert row_names(['a'], levels=16)[:3] == ('a', 'charge', 'commitment')


def test_what_comes_from_outside_is_escaped_everywhere():
    document = case_study(name=HOSTILE)
    document['goals'][0]['name'] = 'A<b>"x'
    mission = mission_from_dict(document, 'test')
    said = HeardDecision(HOSTILE, state=STATE, command=HOSTILE, runner_up=HOSTILE, values=(1.0,))
    heard = replace(heard_of(), decision=Noted(said, 0.0)).with_share(HOSTILE, '')
    view = view_of(HOSTILE, heard, mission, (((0,), 1.0),), 0.0, 3.0)
    parts = [
        top_html(view),
        tile_html(view, True),
        now_html(view.now),
        bars_html(HOSTILE, (Bar(HOSTILE, HOSTILE, 0.5),)),
        rest_html([HOSTILE], 3),
        forecast_html({HOSTILE: {1: 0.5}}, HOSTILE),
        log_html([LogLine('12:00:00', HOSTILE)]),
        moving_layer(mission, heard, '', {HOSTILE: Craft(heard.pose.value, False)}),
        base_layer(mission),
        goal_layer(mission, heard, True),
        block_svg([epoch(1, STATE, HOSTILE)], SPACE),
    ]
    for part in parts:
        ElementTree.fromstring(f'<div>{part}</div>')  # Also that it is well-formed.
        assert '<script' not in part
        assert '"onload' not in part
        assert '<b>"' not in part


def test_a_probability_that_was_counted_is_never_certain():
    page = forecast_html({'a': {1: 0.0, 2: 0.5, 5: 1.0}}, '')
    assert [part for part in ('&lt; 1%', '50%', '&gt; 99%') if part not in page] == []


def test_the_log_has_the_newest_first():
    page = log_html([LogLine('12:00:00', 'old'), LogLine('12:00:01', 'new', 'danger')])
    assert page.index('new') < page.index('old')
