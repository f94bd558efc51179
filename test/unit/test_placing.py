"""Goals that are requested in flight: what is asked, the mission that follows, what is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, Polygon

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.mdp import Mission, MissionError, mission_from_dict
from uav_mission_manager.mdp.areas import Areas, NoFlyArea, is_inside
from uav_mission_manager.mdp.placing import (
    MAX_CHARACTERS,
    changed_goals,
    place_goal,
    with_places_of,
)
from uav_mission_manager.onboard import ManagerSettings, MissionManager, parse_command
from uav_mission_manager.onboard.situation import Situation
from uav_mission_manager.policy.store import read_digest, read_mission

CASE_STUDY = Path(__file__).parents[2] / 'config' / 'case_study.yaml'
PLAIN = load_mission(CASE_STUDY)
GRID = PLAIN.grid


def with_slots(mission: Mission, *slots: int) -> Mission:
    goals = (replace(goal, slot=j in slots) for j, goal in enumerate(mission.goals))
    return replace(mission, goals=tuple(goals))


MISSION = with_slots(PLAIN, 1, 2)


def around(cell: int, size: float) -> tuple[tuple[float, float], ...]:
    east, north = GRID.position(cell)
    corners = ((-size, -size), (size, -size), (size, size), (-size, size))
    return tuple(GRID.origin.to_geodetic(east + x, north + y) for x, y in corners)


def placed(
    mission: Mission = MISSION, free: tuple[int, ...] = (1, 2), **fields: object
) -> Mission:
    return place_goal(mission, json.dumps(fields), free)[0]


def goals(mission: Mission) -> list[tuple[str, int]]:
    return [(goal.name, goal.cell) for goal in mission.goals]


def test_a_request_takes_the_first_free_slot_and_leaves_all_else():
    mission, slot = place_goal(MISSION, '{"cell": 7}', [2, 1])
    assert slot == 1
    assert goals(mission) == [('goal1', 5), ('placed1', 7), ('goal3', 6)]
    assert replace(mission, goals=MISSION.goals) == MISSION
    goal, was = mission.goals[1], MISSION.goals[1]
    assert (goal.requested, goal.slot) == (2, True)
    assert replace(goal, name=was.name, cell=was.cell) == was


def test_a_request_may_have_priority_worth_and_name():
    goal = placed(cell=7, priority=1, worth=12, name='tree').goals[1]
    # An epoch is 50 m at 5 m/s, so a sixth of a minute.
    assert (goal.name, goal.requested, goal.eta, goal.delta) == ('tree', 1, 2.0, 2.0)


@pytest.mark.parametrize('cell', range(GRID.q))
def test_all_ways_to_say_where_are_one(cell):
    east, north = GRID.position(cell)
    latitude, longitude = GRID.origin.to_geodetic(east + 20.0, north - 20.0)
    assert placed(east=east + 20.0, north=north - 20.0).goals[1].cell == cell
    assert placed(latitude=latitude, longitude=longitude).goals[1].cell == cell
    assert placed(cell=cell).goals[1].cell == cell


def test_names_are_new_for_each_goal():
    first = placed(cell=7)
    second = place_goal(first, '{"cell": 4}', [2])[0]
    third = place_goal(second, '{"cell": 2}', [1])[0]
    assert [name for name, _ in goals(third)] == ['goal1', 'placed3', 'placed2']


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('', 'is not valid JSON'),
        ('{"cell": 6', 'is not valid JSON'),
        ('[' * MAX_CHARACTERS, 'is not valid JSON'),
        ('"' + 'x' * MAX_CHARACTERS + '"', 'has more than 10000 characters'),
        ('[6]', "'[6]' is not a JSON object"),
        ('{}', 'cell: is missing'),
        ('{"cell": "6"}', "cell: '6' is not a whole number"),
        ('{"cell": 8}', 'cell: 8 is no cell of the 2x4 grid'),
        ('{"cell": -1}', 'cell: -1 is outside 0..'),
        ('{"cell": 6, "east": 1, "north": 1}', 'east: is given besides cell: keep one of them'),
        ('{"east": 1}', 'north: is missing'),
        ('{"east": NaN, "north": 0}', 'east: nan is not finite'),
        ('{"east": 1e300, "north": 0}', 'east: 1e+300 is outside'),
        ('{"east": 176, "north": 0}', '176 m east, 0 m north of cell 0 is off the 2x4 grid'),
        ('{"latitude": 0, "longitude": 0}', 'is off the 2x4 grid'),
        ('{"latitude": 91, "longitude": 0}', 'latitude: 91 is outside'),
        ('{"cell": 6, "priority": 0}', 'priority: 0 is outside 1..2'),
        ('{"cell": 6, "worth": -1}', 'worth: -1 is negative'),
        ('{"cell": 6, "name": "a b"}', "name: 'a b' is not a name"),
        ('{"cell": 6, "name": "goal1"}', "name: 'goal1' is, or was last, the name of a goal"),
        ('{"cell": 6, "prio": 1}', "prio: is unknown; the nearest known key is 'priority'"),
    ],
)
def test_a_bad_request_is_refused_in_one_line(text, words):
    with pytest.raises(MissionError) as caught:
        place_goal(MISSION, text, [1])
    said = str(caught.value)
    assert said.startswith('goal_requests: ')
    assert words in said
    assert '\n' not in said
    assert len(said) < 500


def test_a_request_without_a_free_slot_is_refused_where_there_are_goals_enough():
    limit = 'and for a further goal it has too many, 3 of 3 at most'
    with pytest.raises(MissionError, match=f'requests: no slot is free of goal2, goal3, {limit}'):
        place_goal(MISSION, '{"cell": 6}', [], 3)
    with pytest.raises(MissionError, match=f'goal_requests: the mission has no slots, {limit}'):
        place_goal(PLAIN, '{"cell": 6}', [], 3)


def added(mission: Mission = MISSION, **fields: object) -> Mission:
    return place_goal(mission, json.dumps(fields), (), mission.k + 1)[0]


def test_where_no_slot_is_free_a_goal_is_added_that_is_as_the_last_one_without_its_task():
    data = yaml.safe_load(CASE_STUDY.read_text())
    data['goals'][2] |= {'task': {'dwell': 30.0}, 'done_in': 60.0}
    plain = mission_from_dict(data, 'file')
    mission, slot = place_goal(plain, '{"cell": 7, "priority": 1}', [], 4)
    assert (slot, mission.k, mission.goals[:3]) == (3, 4, plain.goals)
    goal, last = mission.goals[3], plain.goals[2]
    assert (goal.name, goal.cell, goal.requested) == ('placed1', 7, 1)
    assert (goal.slot, goal.added, goal.task, goal.completion) == (True, True, None, None)
    for field in 'eta', 'delta', 'priority_transition':
        assert getattr(goal, field) == getattr(last, field)
    assert place_goal(mission, '{"cell": 4}', [3], 4)[1] == 3
    read = mission_from_dict(yaml.safe_load(yaml.safe_dump(mission.to_dict())), 'copy')
    assert (read, read.goals[3].added) == (mission, True)


def test_no_goal_is_placed_in_a_no_fly_area_or_outside_the_fence():
    nest = replace(MISSION, areas=Areas(None, (NoFlyArea('nest', around(6, 10.0)),)))
    east, north = GRID.position(6)
    assert placed(nest, cell=7).goals[1].cell == 7
    with pytest.raises(MissionError, match='cell 6 is in the no-fly area nest'):
        placed(nest, cell=6)
    with pytest.raises(MissionError, match='cell 6 is in the no-fly area nest'):
        placed(nest, east=east + 20.0, north=north)  # The centre is what is flown to.
    fenced = replace(MISSION, areas=Areas(around(6, 15.0)))
    assert placed(fenced, cell=6).goals[1].cell == 6
    with pytest.raises(MissionError, match='cell 7 is outside the fence'):
        placed(fenced, cell=7)
    with pytest.raises(MissionError, match='cell 6 is outside the fence'):
        placed(fenced, east=east + 20.0, north=north)


NUMBERS = st.integers(-5, 5)


@given(corners=st.lists(st.tuples(NUMBERS, NUMBERS), min_size=3, max_size=7), x=NUMBERS, y=NUMBERS)
def test_inside_a_polygon_is_where_shapely_says(corners, x, y):
    polygon, spot = Polygon(corners), Point(x + 0.5, y + 0.25)
    if polygon.is_valid and not polygon.boundary.intersects(spot.buffer(1e-9)):
        assert is_inside(tuple(corners), spot.x, spot.y) == polygon.contains(spot)


def test_a_mission_with_slots_is_written_and_read_and_has_the_same_digest():
    mission = placed(cell=7, priority=1)
    read = mission_from_dict(yaml.safe_load(yaml.safe_dump(mission.to_dict())), 'copy')
    assert read == mission
    assert [(goal.slot, goal.requested) for goal in read.goals] == [
        (False, 0),
        (True, 1),
        (True, 0),
    ]
    assert MISSION.digest() == PLAIN.digest() != mission.digest()
    assert MISSION == PLAIN


@pytest.mark.parametrize(
    ('fields', 'words'),
    [
        ({'slot': 1}, 'goals[0].slot: 1 is neither true nor false'),
        ({'requested': 2}, 'goals[0].requested: only a slot has one'),
        ({'slot': True, 'requested': 3}, 'goals[0].requested: 3 is outside 0..2'),
        ({'added': True}, 'goals[0].added: only a slot can be'),
        (
            {'slot': True, 'added': True},
            'goals[1].added: the goal before it is, so this one must be too',
        ),
        (
            {'slot': True, 'task': {'waypoints': [[*GRID.origin.to_geodetic(50.0, -50.0)]]}},
            'goals[0].slot: has no place yet, so its task cannot be waypoints',
        ),
    ],
)
def test_a_bad_slot_is_refused(fields, words):
    data = yaml.safe_load(CASE_STUDY.read_text())
    data['goals'][0] |= fields
    with pytest.raises(MissionError) as caught:
        mission_from_dict(data, 'file')
    assert str(caught.value) == f'file: {words}'


def test_only_goals_in_slots_may_change():
    assert changed_goals(MISSION, MISSION) == ()
    assert changed_goals(MISSION, placed(cell=7)) == (1,)
    assert changed_goals(MISSION, added(placed(cell=7), cell=4)) == (1, 3)
    moved = replace(MISSION.goals[0], cell=7)
    further = added(cell=7)
    with pytest.raises(ValueError, match='the policy is for other goals'):
        changed_goals(further, MISSION)
    for other in (
        replace(further, goals=(*MISSION.goals, replace(further.goals[3], added=False))),
        replace(MISSION, goals=(moved, *MISSION.goals[1:])),
        replace(MISSION, goals=MISSION.goals[:2]),
        with_slots(placed(cell=7), 2),
    ):
        with pytest.raises(ValueError, match='the policy is for other goals: goal1 in cell'):
            changed_goals(MISSION, other)
    grid = replace(MISSION, grid=replace(GRID, cell_size=60.0))
    with pytest.raises(ValueError, match='the policy is for another grid'):
        changed_goals(MISSION, grid)


def test_slots_stay_where_they_are_in_another_version_of_the_file():
    flown = place_goal(placed(cell=7, worth=12), '{"cell": 4}', [2])[0]
    edited = replace(MISSION, discount=0.9)
    kept = with_places_of(edited, flown, [2])
    assert goals(kept) == goals(flown)
    assert kept.discount == 0.9
    assert (kept.goals[1].eta, kept.goals[2].eta) == (2.0, MISSION.goals[2].eta)
    assert [goal.requested for goal in kept.goals] == [0, 0, 2]


def test_added_goals_stay_in_another_version_of_the_file():
    flown = added(added(cell=7), cell=4)
    for open_slots, requested in (([3], [2, 0]), ([3, 4], [2, 2])):
        kept = with_places_of(replace(MISSION, discount=0.9), flown, open_slots)
        assert (kept.discount, goals(kept)) == (0.9, goals(flown))
        assert [goal.requested for goal in kept.goals[3:]] == requested


# On board


def aloft(**known: object) -> Situation:
    there = Situation(MISSION).with_priorities([1, 2, 1], 'a', 0.0).with_battery(0.9, 0.0)
    return replace(there.with_position(0.0, 0.0, 0.0).with_fault('nominal', 0.0), **known)


def test_goals_keep_their_state_and_a_new_one_begins_as_requested():
    before = aloft(refused=(True, True, True), commitment=3, agile=True)
    after = before.with_mission(placed(cell=7, priority=1))
    assert after.priorities == (1, 1, 1)
    assert after.refused == (True, False, True)
    assert (after.commitment, after.agile, after.cell) == (3, True, before.cell)
    assert after.said == (1, 0, 1)
    assert before.with_mission(placed(cell=7), wanted=False).priorities == (1, 0, 1)


def test_a_commitment_to_a_goal_that_is_gone_ends():
    assert aloft(commitment=2).with_mission(placed(cell=7)).commitment == 0


def test_the_range_of_a_goal_that_is_gone_is_no_danger():
    low = aloft().with_battery(0.2, 1.0)
    names = {f'range {goal.name}' for goal in MISSION.goals}
    assert low.dangers.counted == names  # It does not reach any of them.
    near = low.with_mission(placed(cell=0, name='near'))
    assert near.dangers.counted == {'range goal1', 'range goal3'}
    assert near.in_range == (0, 1, 0)


def test_a_wish_from_before_wants_the_new_goal_too():
    waiting = replace(aloft(), settling_time=5.0).with_priorities([2, 2, 2], 'b', 1.0)
    assert waiting.wish.pending is not None
    after = waiting.with_mission(placed(cell=7, priority=1)).settled(20.0)
    assert after.priorities == (2, 1, 2)


def test_the_base_station_repeats_itself_and_the_new_goal_stays():
    after = aloft().with_mission(placed(cell=7))
    assert after.with_priorities([1, 2, 1], 'a', 1.0).priorities == (1, 2, 1)
    assert after.with_priorities([0, 0, 1], 'a', 1.0).priorities == (0, 2, 1)
    assert after.with_completed('placed1').priorities == (1, 0, 1)
    with pytest.raises(ValueError, match="goal_completed: 'goal2' is not one of"):
        after.with_completed('goal2')


def test_an_added_goal_is_wanted_and_the_base_station_need_not_know_of_it():
    before = aloft(refused=(True, False, False), commitment=1)
    after = before.with_mission(added(cell=7, priority=1))
    assert after.priorities == (1, 2, 1, 1)
    assert (after.refused, after.in_range) == ((True, False, False, False), (1, 1, 1, 1))
    assert (after.commitment, after.said) == (1, (1, 2, 1))
    assert before.with_mission(added(cell=7), wanted=False).priorities == (1, 2, 1, 0)
    many = MISSION
    for cell in range(MISSION.k + 1):
        many = added(many, cell=cell)
    late = before.with_mission(many)
    assert late.priorities == (1, 2, 1, 2, 2, 2, 2)
    assert late.refused == (True, *(False,) * 6)
    assert after.with_priorities([1, 2, 1], 'a', 1.0).priorities == (1, 2, 1, 1)
    assert after.with_priorities([0, 2, 1], 'a', 1.0).priorities == (0, 2, 1, 1)
    assert after.with_priorities([2, 0, 0], 'b', 1.0).priorities == (2, 0, 0, 1)
    assert after.with_priorities([2, 0, 0], '', 1.0).priorities == (2, 0, 0, 1)
    assert after.with_priorities([2, 0, 0, 0], 'b', 1.0).priorities == (2, 0, 0, 0)
    for count in 2, 5:
        words = f'goal_priorities: data has {count} values, not 3 to 4'
        with pytest.raises(ValueError, match=words):
            after.with_priorities([1] * count, 'b', 1.0)
    with pytest.raises(ValueError, match='goal_priorities: data has 2 values, not 3'):
        before.with_priorities([1, 1], 'b', 1.0)


def test_a_wish_that_waits_wants_an_added_goal_too():
    waiting = replace(aloft(), settling_time=5.0).with_priorities([2, 2, 2], 'b', 1.0)
    after = waiting.with_mission(added(cell=7, priority=1))
    assert after.settled(20.0).priorities == (2, 2, 2, 1)
    anew = after.with_priorities([0, 1, 2], 'c', 2.0)
    assert anew.settled(20.0).priorities == (0, 1, 2, 1)


@pytest.fixture(scope='module')
def policies():
    return build_policy(MISSION), build_policy(placed(cell=7))


@pytest.fixture(scope='module')
def larger():
    return build_policy(added(cell=7), 'split')


@pytest.mark.parametrize('standing', ['recharge', 'none agile', 'commit goal3 agile'])
def test_the_command_in_force_stays_it_where_a_goal_is_added(policies, larger, standing):
    manager = MissionManager(policies[0], ManagerSettings(command_dwell=5.0))
    manager.situation = replace(aloft(), priorities=(0, 0, 2))
    manager.step(0.0)
    memory = manager.memory
    memory['command']['action'] = parse_command(MISSION, standing).number
    manager = MissionManager(policies[0], ManagerSettings(command_dwell=5.0), memory)
    assert manager.adopt(larger) == ('placed1',)
    number = manager.memory['command']['action']
    assert number == parse_command(larger.mission, standing).number
    assert MissionManager(larger, memory=manager.memory).memory == manager.memory


def test_a_manager_takes_over_and_commands_no_goal_that_is_gone(policies):
    manager = MissionManager(policies[0])
    manager.situation = replace(aloft(), priorities=(0, 2, 0))
    assert manager.step(0.0).action.goal == 1
    assert manager.adopt(policies[0]) == ()
    assert manager.adopt(policies[1]) == ('placed1',)
    assert manager.situation.commitment == 0
    command = manager.step(0.1).action
    assert (command.goal, command.destination) == (1, 7)
    memory = manager.memory
    assert MissionManager(policies[1], memory=memory).memory == memory


def test_a_policy_set_tells_its_mission_without_its_arrays(policies, tmp_path):
    policies[1].save(tmp_path / 'set')
    for array in (tmp_path / 'set').glob('*.npy'):
        array.unlink()
    assert read_mission(tmp_path / 'set').goals[1].requested == 2
    assert read_digest(tmp_path / 'set') == policies[1].digest
