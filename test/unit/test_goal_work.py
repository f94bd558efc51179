"""What is done at a goal: each kind of task, and what interrupts it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scenarios import PICTURE
from simulated_chain import SETTINGS, SimulatedChain
from strategies import case_study

from uav_mission_manager.autopilot.goal_work import GoalWork
from uav_mission_manager.autopilot.task import FlightTask, Phase
from uav_mission_manager.autopilot.vehicle import FlightMode, TakePhoto, commands
from uav_mission_manager.goal_task import Dwell, External, Photo, Waypoint, Waypoints
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.nodes.flight_plan import FlightPlan
from uav_mission_manager.onboard import parse_command
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import load_policy

POLICY = load_policy(share_directory() / 'policies' / 'case_study')
GROUND = 584.0
GOAL = FlightTask('commit a normal', 1.0, 2.0, GROUND + 20.0, GROUND + 30.0, goal='a')
ROUND = ((1.0001, 2.0, GROUND + 20.0), (1.0001, 2.0001, GROUND + 40.0))


def flat(latitude, longitude):
    return GROUND


class Site:
    """A vehicle on site, with a step each 0.1 s."""

    def __init__(self, work, ground=flat, **task):
        self.work, self.now = GoalWork(ground), 100.0
        self.task = replace(GOAL, work=work, **task)

    def stay(self, seconds):
        """Steps on site; return how many of them asked for a picture."""
        asked = 0
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            self.work.watch(Phase.ON_SITE)
            self.work.step(self.task, self.now)
            asked += self.work.photo(self.task, self.now) is not None
        return asked

    def leave(self, phase, seconds=50.0):
        self.work.watch(phase)
        self.now += seconds


AWAY = [Phase.EN_ROUTE, Phase.HOLDING, Phase.PILOT, Phase.NO_LINK, Phase.WAITING, Phase.GROUND]


# Dwell, external


@pytest.mark.parametrize('phase', AWAY, ids=lambda phase: phase.name)
def test_time_on_site_counts_and_no_other(phase):
    site = Site(Dwell(10.0))
    site.stay(6.0)
    site.leave(phase)
    site.stay(3.9)  # The first step begins it.
    assert not site.work.done
    site.stay(0.5)
    assert site.work.done


def test_a_gap_is_no_time_on_site():
    site = Site(Dwell(10.0))
    site.stay(6.0)
    site.now += 50.0
    site.stay(3.0)
    assert not site.work.done


def test_a_goal_between_interrupts_and_a_completion_begins_anew():
    site = Site(Dwell(10.0))
    site.stay(6.0)
    site.work.retarget()
    site.task = replace(site.task, goal='b')
    site.stay(6.0)
    site.work.retarget()
    site.task = replace(site.task, goal='a')
    site.stay(4.3)
    assert site.work.done
    site.work.retarget()
    site.stay(9.0)
    assert not site.work.done


@pytest.mark.parametrize('change', [{'work': Dwell(11.0)}, {'latitude': 1.001}])
def test_another_task_or_place_of_the_same_name_begins_anew(change):
    site = Site(Dwell(10.0))
    site.stay(6.0)
    site.work.retarget()
    site.task = replace(site.task, **change)
    site.stay(9.0)
    assert not site.work.done


def test_an_external_task_waits_for_its_timeout_in_all():
    site = Site(External(10.0))
    site.stay(6.0)
    site.leave(Phase.HOLDING)
    site.stay(3.9)
    assert not site.work.failed
    site.stay(0.5)
    assert site.work.failed == 'nothing heard of it for 10 s'
    assert not site.work.done


def test_a_word_about_another_goal_changes_nothing():
    site = Site(External(10.0))
    site.stay(1.0)
    for goal in ('b', ''):
        site.work.completed(goal, site.now)
    assert not site.work.done
    site.work.completed('a', site.now)
    assert site.work.done
    assert not site.work.report(site.now + 9.0), 'whoever completed it has reported it'
    assert site.work.report(site.now + 10.0)


def test_a_word_about_nothing_completes_no_later_goal():
    site = Site(Dwell(10.0))
    site.work.completed('', site.now)
    site.stay(1.0)
    assert not site.work.done


# Pictures


def test_pictures_are_asked_for_one_by_one_and_as_often_as_wanted():
    site = Site(Photo(3, 2.0))
    asked = []
    for _ in range(200):
        site.now += 0.1
        site.work.step(site.task, site.now)
        if request := site.work.photo(site.task, site.now):
            asked.append((site.now, request.number))
            site.work.photo_answered(True, '')
    times, numbers = zip(*asked, strict=True)
    assert numbers == (1, 2, 3)
    assert [later - sooner for sooner, later in pairwise(times)] == pytest.approx(
        [2.0, 2.0], abs=0.11
    )
    assert site.work.done


def test_an_unanswered_picture_is_waited_for():
    site = Site(Photo(3, 0.0))
    assert site.stay(20.0) == 1
    assert not site.work.failed


@pytest.mark.parametrize('phase', AWAY, ids=lambda phase: phase.name)
def test_a_picture_broken_off_is_asked_for_again_and_one_taken_is_not(phase):
    site = Site(Photo(2, 0.0))
    site.stay(0.1)
    site.work.photo_answered(True, '')
    assert site.stay(1.0) == 1
    site.leave(phase)
    site.work.photo_answered(True, '')  # Late, and given up by then.
    assert site.stay(1.0) == 1
    assert not site.work.done
    site.work.photo_answered(True, '')
    site.stay(0.1)
    assert site.work.done


def test_a_refusal_fails_the_task_and_anew_it_begins_anew():
    site = Site(Photo(2, 0.0))
    site.stay(0.1)
    site.work.photo_answered(True, '')
    site.stay(0.1)
    site.work.photo_answered(False, 'FAILED')
    assert site.work.failed == 'no picture: FAILED'
    assert site.stay(1.0) == 0
    site.work.retarget()
    site.stay(0.1)
    site.work.photo_answered(True, '')
    site.stay(0.1)
    assert not site.work.done


def test_the_command_is_one_picture_of_the_component_asked_for():
    [command] = commands(TakePhoto(7), camera=100)
    message = command.message(3, 0)
    assert (message.target_system, message.target_component) == (3, 100)
    assert message.command == mavlink.MAV_CMD_IMAGE_START_CAPTURE
    assert (message.param3, message.param4) == (1, 7)


# Waypoints


def test_a_round_leads_from_the_goal_to_each_waypoint():
    site = Site(Waypoints(()), points=ROUND)
    assert site.work.target(site.task) is site.task
    site.stay(0.1)
    found = []
    while not site.work.done:
        target = site.work.target(site.task)
        found.append((target.latitude, target.longitude, target.altitude, target.cruise_altitude))
        assert target.goal == 'a'
        site.leave(Phase.EN_ROUTE)
        assert site.work.target(site.task) == target
        site.stay(0.1)
    assert found == [(*ROUND[0], GROUND + 20.0), (*ROUND[1], GROUND + 40.0)]


@pytest.mark.parametrize('phase', [Phase.HOLDING, Phase.PILOT, Phase.NO_LINK, Phase.TAKE_OFF])
def test_after_an_interruption_the_round_goes_on_from_the_goal(phase):
    site = Site(Waypoints(()), points=ROUND)
    site.stay(0.2)
    site.leave(phase)
    assert site.work.target(site.task) is site.task
    site.stay(0.1)
    target = site.work.target(site.task)
    assert (target.latitude, target.longitude) == ROUND[1][:2]


def test_a_leg_keeps_its_height_above_the_highest_ground_on_it():
    def hill(latitude, longitude):
        return GROUND + (15.0 if 1.00003 < latitude < 1.00007 else 0.0)

    site = Site(Waypoints(()), hill, points=((1.0001, 2.0, GROUND + 12.0),))
    site.stay(0.1)
    assert site.work.target(site.task).cruise_altitude == GROUND + 15.0 + 12.0


def test_the_plan_gives_waypoints_their_altitudes():
    document = case_study()
    document['grid']['elevation'] = {3: 7.0}
    mission = mission_from_dict(document, 'test')
    places = [mission.grid.origin.to_geodetic(*place) for place in ((150.0, 0.0), (110.0, 0.0))]
    work = Waypoints((Waypoint(*places[0]), Waypoint(*places[1], 33.0)))
    goals = list(mission.goals)
    goals[1] = replace(goals[1], task=work)
    mission = replace(mission, goals=tuple(goals))
    plan = FlightPlan(mission, 20.0)
    task = plan.task(parse_command(mission, 'commit goal2 normal'), 'commit goal2 normal')
    base = mission.grid.origin.altitude
    assert task.points == ((*places[0], base + 7.0 + 20.0), (*places[1], base + 33.0))
    assert task.work is work
    other = plan.task(parse_command(mission, 'commit goal1 normal'), 'commit goal1 normal')
    assert (other.work, other.points) == (None, ())


# Memory


def test_a_memory_is_json_and_what_was_done_is_done():
    site = Site(Photo(3, 0.0))
    for _ in range(2):
        site.stay(0.1)
        site.work.photo_answered(True, '')
    again = Site(Photo(3, 0.0))
    again.work.restore(json.loads(json.dumps(site.work.memory)))
    again.stay(0.1)
    again.work.photo_answered(True, '')
    again.stay(0.1)
    assert again.work.done
    assert again.work.memory == {}


@pytest.mark.parametrize(
    'bad',
    [
        *({'a': ['x', -1]}, {'a': ['x', math.nan]}, {'a': ['x', math.inf]}),
        *({'a': ['x', 'y']}, {'a': 1}, {'a': ['x']}, ['a'], 1, None),
    ],
    ids=str,
)
def test_what_is_no_memory_is_refused(bad):
    with pytest.raises(ValueError, match='no tasks at goals'):
        GoalWork(flat).restore(bad)


# In the chain


def chain_with(task, **options):
    goals = list(POLICY.mission.goals)
    goals[1] = replace(goals[1], task=task)
    mission = replace(POLICY.mission, goals=tuple(goals))
    chain = SimulatedChain(POLICY, mission=mission, **options)
    chain.want(0, 2, 0)
    return chain


@pytest.mark.parametrize('who', ['pilot', 'hold', 'link'])
def test_nobody_takes_pictures_or_works_for_a_vehicle_that_is_not_commanded(who):
    chain = chain_with(Photo(1000, 0.5))
    chain.until(lambda: len(chain.pictures) > 3, 'pictures')
    if who == 'pilot':
        chain.put_into(FlightMode.LOITER)
    elif who == 'hold':
        assert chain.hold()[0]
    else:
        chain.cut()
        chain.until(lambda: chain.phase == 'no link', 'no link')
    chain.spend(0.5)
    before = len(chain.pictures)
    chain.spend(20.0)
    assert len(chain.pictures) == before
    if who == 'link':
        chain.mend()
    else:
        assert chain.resume()[0]
    chain.until(lambda: len(chain.pictures) > before, 'pictures', 60.0)
    assert chain.pictures[-1][1] == before + 1


@pytest.mark.parametrize('who', ['pilot', 'hold', 'link', 'manager'])
def test_another_program_is_stopped_at_once(who):
    chain = chain_with(External(1000.0))
    chain.until(lambda: chain.active, 'active')
    stop = {
        'pilot': lambda: chain.put_into(FlightMode.LOITER),
        'hold': chain.hold,
        'link': chain.cut,
        'manager': lambda: chain.want(1, 0, 0),
    }
    stop[who]()
    chain.until(lambda: chain.active == '', 'stopped', 6.0)


def test_a_camera_that_is_heard_takes_the_pictures_and_answers_for_itself():
    chain = chain_with(Photo(3, 1.0))
    chain.autopilot._camera = True
    asked = []
    watch = chain.watch_bridge

    def watched(message):
        if getattr(message, 'command', None) == PICTURE:
            asked.append((message.target_component, int(message.param4)))
        watch(message)

    chain.watch_bridge = watched
    chain.until(lambda: chain.completed, 'goal completed')
    assert asked == [(100, 1), (100, 2), (100, 3)]
    assert chain.pictures == [], 'the autopilot answered in its place'


def test_a_camera_that_gives_no_answer_fails_the_goal():
    chain = chain_with(Photo(1, 0.0))
    chain.autopilot._camera = True
    chain.autopilot._is_for_camera = lambda message: False
    chain.until(lambda: 'goal2' in chain.refused, 'refused')
    assert chain.reasons == ['commit goal2 normal: no picture: no answer']
    assert chain.completed == []


def test_the_dwell_of_the_bridge_is_that_of_goals_without_a_task():
    chain = chain_with(None, settings=replace(SETTINGS, goal_dwell=7.0))
    chain.until(lambda: chain.phase == 'on site', 'on site')
    begin = chain.now
    chain.until(lambda: chain.completed, 'goal completed')
    assert chain.now - begin == pytest.approx(7.0, abs=0.3)
