"""The base station's request: repeated by who comes after, and never raised again."""

from __future__ import annotations

import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_mission_manager.onboard.priority_request import PriorityRequest

GOALS = ('north', 'east', 'south')


def asked(*values, achieved=()):
    request = PriorityRequest(GOALS)
    request.ask(values, 'first')
    for name in achieved:
        assert request.complete(name)
    return request


def restarted(request):
    return PriorityRequest(GOALS, json.loads(json.dumps(request.memory)))


def test_nothing_is_asked_for_at_a_first_start():
    request = PriorityRequest(GOALS)
    assert not request.begin((0, 0, 0), 'new')
    assert (request.request, request.priorities) == ('', (0, 0, 0))


def test_a_first_start_with_priorities_asks_for_them():
    request = PriorityRequest(GOALS)
    assert request.begin((2, 0, 1), 'new')
    assert (request.request, request.priorities) == ('new', (2, 0, 1))


@pytest.mark.parametrize('values', [(2, 0, 1), (0, 0, 0)], ids=['as asked', 'none'])
def test_a_restart_repeats_and_revives_no_achieved_goal(values):
    request = restarted(asked(2, 0, 1, achieved=['north']))
    assert not request.begin(values, 'second')
    assert (request.request, request.asked) == ('first', (2, 0, 1))
    assert (request.priorities, request.achieved) == ((0, 0, 1), ['north'])


def test_a_restart_with_other_priorities_asks_anew():
    request = restarted(asked(2, 0, 1, achieved=['north']))
    assert request.begin((2, 0, 0), 'second')
    assert (request.request, request.priorities, request.achieved) == ('second', (2, 0, 0), [])


def test_what_a_person_asked_for_since_the_start_is_not_undone_by_a_restart():
    request = PriorityRequest(GOALS)
    request.begin((2, 0, 1), 'first')
    request.ask((0, 0, 0), 'cancelled')
    for _ in range(2):  # The second restart is like the first.
        request = restarted(request)
        assert not request.begin((2, 0, 1), 'third')
        assert (request.request, request.asked) == ('cancelled', (0, 0, 0))
    assert not restarted(request).begin((0, 0, 0), 'third')
    assert restarted(request).begin((2, 0, 0), 'third')


def test_what_is_left_of_a_request_is_another_request():
    request = restarted(asked(2, 0, 1, achieved=['north']))
    assert request.begin((0, 0, 1), 'second')


def test_asking_again_for_the_same_is_a_new_request():
    request = asked(2, 0, 1, achieved=['north'])
    request.ask((2, 0, 1), 'second')
    assert (request.request, request.priorities) == ('second', (2, 0, 1))


def test_only_a_wanted_goal_is_achieved():
    request = asked(2, 0, 1)
    assert [request.complete(name) for name in ('north', 'north', 'east', 'west')] == [
        True,
        False,
        False,
        False,
    ]
    assert request.priorities == (0, 0, 1)


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ((1, 2), '2 values, the mission has 3 goals (north, east, south)'),
        ((1, 2, 3), 'south is 3, not 0, 1 or 2'),
        ((-1, 2, 0), 'north is -1, not 0, 1 or 2'),
    ],
)
def test_what_cannot_be_asked_for_changes_nothing(values, words):
    request = asked(2, 0, 1)
    for way in (request.ask, request.begin):
        with pytest.raises(ValueError, match=re.escape(words)):
            way(values, 'second')
    assert (request.request, request.priorities) == ('first', (2, 0, 1))


STEPS = st.lists(
    st.one_of(st.tuples(*[st.integers(0, 2)] * 3), st.sampled_from(GOALS), st.just('restart'))
)


@given(STEPS)
def test_a_request_is_the_same_with_restarts_anywhere_and_without(steps):
    one, other = PriorityRequest(GOALS), PriorityRequest(GOALS)
    for number, step in enumerate(steps):
        if step == 'restart':
            other = restarted(other)
            assert not other.begin((0, 0, 0), 'never')
        elif isinstance(step, str):
            assert one.complete(step) == other.complete(step)
        else:
            for request in (one, other):
                request.ask(step, str(number))
        assert one.memory == other.memory
        assert one.priorities == other.priorities


def test_goals_added_in_flight_may_be_asked_for_and_left_out():
    request = asked(2, 0, 1)
    assert request.fault_in((2, 0, 1, 1))
    request.learn((*GOALS, 'tree'))
    assert request.priorities == (2, 0, 1), 'nothing was asked of it'
    assert not request.complete('tree')
    assert not request.fault_in((2, 0, 1))
    request.ask((2, 0, 1, 1), 'second')
    for count in 2, 5:
        assert request.fault_in((0,) * count) == (
            f'{count} values, the mission has 4 goals (north, east, south, tree), '
            '1 of them added in flight'
        )
    assert request.complete('tree')
    again = restarted(request)
    assert (again.priorities, again.achieved) == ((2, 0, 1, 0), ['tree'])
    again.learn(GOALS)
    assert again.priorities == (2, 0, 1), 'the vehicle has it no more'


def test_what_was_asked_of_a_goal_is_not_asked_of_the_one_in_its_place():
    request = asked(2, 2, 1, achieved=['east'])
    request.learn(('north', 'tree', 'south'))
    assert request.priorities == (2, 0, 1)
    request.ask((2, 1, 1), 'second')
    assert request.complete('tree')
    assert request.priorities == (2, 0, 1)


def test_fewer_goals_than_the_mission_file_has_are_not_believed():
    request = asked(2, 0, 1)
    request.learn(('north', 'east'))
    request.learn(())
    assert request.priorities == (2, 0, 1)
