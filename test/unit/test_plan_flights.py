"""The example plans, from a ground station's file to a vehicle that has flown them."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import pytest
from rounds_flown import RADIUS, require_flown_once, visits, waypoints_of
from simulated_chain import SETTINGS, SimulatedChain

from uav_mission_manager.autopilot.vehicle import FlightMode
from uav_mission_manager.cli import mission_check, mission_new, policy_build
from uav_mission_manager.cli.check import solving
from uav_mission_manager.cli.tasks import task_seconds
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import Policy, load_policy

PLANS = share_directory() / 'config' / 'plans'
PLACE = '--home=-35.363262,149.165237,584'
COMMANDS = {
    'field': ['field.plan'],
    'dam': ['dam.kml', '--no-fly', 'Horses', '--line', 'Crest', '--altitude', '25'],
    'zones': [
        *('zones.geojson', '--polygons', 'no_fly', '--speed', '6', '--cell', '40'),
        *(PLACE, '--service=-35.36375,149.16470', '--goal=mast,-35.3626,149.1663'),
        *('--goal=silo,-35.3635,149.1675', '--worth', 'silo=2'),
    ],
}
"""What a user types after `mission_new`, with the file in config/plans."""

HEIGHTS = {'field': 30.0, 'dam': 25.0, 'zones': 20.0}
"""The bridge's flight_altitude, as the made files say; or its default."""


@pytest.fixture(scope='module')
def built(tmp_path_factory) -> Callable[[str], Policy]:
    """Return what makes, checks and builds a mission, each one once."""
    folder = tmp_path_factory.mktemp('plans')

    @cache
    def build(name: str) -> Policy:
        file, *options = COMMANDS[name]
        mission, policy = folder / f'{name}.yaml', folder / name
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            assert mission_new.main([str(PLANS / file), *options, '--out', str(mission)]) == 0
            assert 'warning' not in said.getvalue()
            with pytest.MonkeyPatch.context() as patch:  # Sensitivities are of no interest here.
                patch.setattr(solving, 'MAX_SENSITIVITY_SECONDS', 0.0)
                patch.setattr(solving, 'DRAWN_EPOCHS', 2000)
                assert mission_check.main([str(mission), '--strict']) == 0
            assert policy_build.main([str(mission), '--out', str(policy)]) == 0
        return load_policy(policy)

    return build


@pytest.fixture(scope='module')
def flown(built) -> Callable[[str], SimulatedChain]:
    """Return what flies all goals of a mission, each mission once."""

    @cache
    def fly(name: str) -> SimulatedChain:
        chain = chain_of(built(name), HEIGHTS[name])
        chain.want(*[2] * chain.mission.k)
        chain.until(lambda: len({*chain.completed}) == chain.mission.k, 'all goals', 1500.0)
        chain.until(lambda: not chain.armed, 'landed', 300.0)
        return chain

    return fly


def chain_of(policy: Policy, height: float) -> SimulatedChain:
    energy = policy.mission.energy
    assert energy is not None
    settings = replace(SETTINGS, flight_altitude=height, cruise_speed=energy.speed)
    return SimulatedChain(policy, seed=3, settings=settings)


@pytest.mark.parametrize('name', COMMANDS)
def test_an_example_is_made_checked_built_and_flown(flown, name):
    chain = flown(name)
    assert not chain.refused
    assert all(chain.completed.count(goal.name) == 1 for goal in chain.mission.goals)
    for goal in chain.mission.goals:
        x, y = chain.mission.grid.position(goal.cell)
        assert min(math.hypot(at.east - x, at.north - y) for at in chain.track) < RADIUS
    assert chain.distance(chain.mission.grid.base) < 25.0


def until_done(chain, goal):
    """Return what was flown until a goal was given up for another one, or for home."""
    own = f'commit {goal} normal'
    last = max(n for n, (_, command) in enumerate(chain.commands) if command == own)
    end = chain.commands[last + 1][0]
    return [at for at in chain.track if at.time <= end]


@pytest.mark.parametrize(('name', 'goal'), [('field', 'survey_2'), ('dam', 'Crest')])
def test_each_waypoint_is_passed_once_and_legs_are_straight(flown, name, goal):
    """And once it has begun nothing else is commanded until the goal is done."""
    chain = flown(name)
    points, track = waypoints_of(chain.mission, goal, HEIGHTS[name]), until_done(chain, goal)
    require_flown_once(track, points)
    begun = track[visits(track, points)[0].first].time
    assert not [command for time, command in chain.commands if begun < time < track[-1].time]


def test_pictures_are_taken_as_the_plan_has_them(flown):
    chain = flown('field')
    assert [number for _, number in chain.pictures] == [1, 2, 3]
    times = [time for time, _ in chain.pictures]
    assert min(b - a for a, b in pairwise(times)) > 1.9  # 2 s, seen in steps of 0.05 s.
    place = chain.mission.grid.position(chain.mission.goals[1].cell)
    there = next(at for at in chain.track if at.time >= times[0])
    assert math.hypot(there.east - place[0], there.north - place[1]) < RADIUS


def test_a_round_takes_about_as_long_as_is_said_of_it(flown):
    chain = flown('field')
    grid, goal = chain.mission.grid, chain.mission.goals[2]
    seen = visits(until_done(chain, 'survey_2'), waypoints_of(chain.mission, 'survey_2', 30.0))
    x, y = grid.position(goal.cell)
    before = reversed(chain.track[: seen[0].first])
    arrived = next(at for at in before if math.hypot(at.east - x, at.north - y) < RADIUS)
    seconds = chain.track[seen[-1].first].time - arrived.time
    assert seconds == pytest.approx(task_seconds(goal.task, grid, goal.cell, 5.0, 30.0), rel=0.2)


def battery(chain):
    chain.set('SIM_BATT_PCT', 10.0)
    chain.until(lambda: chain.command == 'recharge', 'recharge')
    chain.until_down_at(chain.mission.grid.service)
    chain.set('SIM_BATT_PCT', 100.0)


def a_pilot(chain):
    chain.put_into(FlightMode.LOITER)
    chain.spend(20.0)
    chain.put_into(FlightMode.GUIDED)
    chain.until(lambda: chain.resume()[0], 'resume')


def a_hold(chain):
    assert chain.hold()[0]
    chain.spend(20.0)
    assert chain.resume()[0]


def a_killed_manager(chain):
    chain.kill_manager()
    chain.until(lambda: chain.mode == FlightMode.RTL, 'return')
    chain.spend(5.0)
    chain.start_manager()
    chain.want(*[2] * chain.mission.k)
    chain.until(lambda: chain.resume()[0], 'resume')


@pytest.mark.parametrize(
    ('interruption', 'left_after'),
    [(battery, 6), (a_pilot, 2), (a_hold, 14), (a_killed_manager, 10)],
)
def test_an_interrupted_survey_is_taken_up_where_it_was_left(built, interruption, left_after):
    """It is left on the long leg after a waypoint, far from all of them."""
    chain = chain_of(built('field'), HEIGHTS['field'])
    points = waypoints_of(chain.mission, 'survey_2', HEIGHTS['field'])
    chain.want(*[2 * (goal.name == 'survey_2') for goal in chain.mission.goals])
    east, north, _ = points[left_after - 1]

    def on_the_leg():
        here = chain.track[-1]
        return abs(here.north - north) < 1.0 and 40.0 < abs(here.east - east) < 50.0

    chain.until(lambda: chain.track and on_the_leg(), 'the leg', 600.0)
    interruption(chain)
    assert 'survey_2' not in chain.completed
    chain.until(lambda: 'survey_2' in chain.completed, 'the survey', 900.0)
    require_flown_once(until_done(chain, 'survey_2'), points, left_after)
