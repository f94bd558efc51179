"""Every scenario with the simulated autopilot, in simulated time."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scenarios import FLIGHT_ALTITUDE, SCENARIOS, TASK_SCENARIOS
from simulated_chain import SETTINGS, SimulatedChain

from uav_mission_manager.autopilot.simulator.frames import MOTOR_FRAMES
from uav_mission_manager.policy import load_policy

ROOT = Path(__file__).parents[2]
POLICY = load_policy(ROOT / 'policies' / 'case_study')


@pytest.mark.parametrize('frame', ['quad', 'hexa'])
@pytest.mark.parametrize('scenario', SCENARIOS, ids=lambda scenario: scenario.__name__)
def test_scenario(scenario, frame):
    chain = SimulatedChain(POLICY, frame=MOTOR_FRAMES[frame])
    scenario(chain)


def with_task(mission, task):
    """The mission with a task at goal 2."""
    goals = list(mission.goals)
    goals[1] = replace(goals[1], task=task)
    return replace(mission, goals=tuple(goals))


@pytest.mark.parametrize(
    ('scenario', 'task'), TASK_SCENARIOS, ids=lambda case: getattr(case, '__name__', '')
)
def test_task_scenario(scenario, task):
    mission = with_task(POLICY.mission, task(POLICY.mission))
    assert mission.digest() == POLICY.mission.digest()
    scenario(SimulatedChain(POLICY, mission=mission))


# What a real autopilot's harness cannot set up


def test_it_flies_at_the_missions_altitude_though_home_lies_lower():
    chain = SimulatedChain(POLICY, depth=8.0)
    chain.want(0, 2, 0)
    chain.until(lambda: chain.phase == 'on site', 'on site')
    chain.until(lambda: chain.completed, 'goal completed')
    assert abs(chain.height - FLIGHT_ALTITUDE) < 2.0
    away = [s for s in chain.track if min(abs(s.east), abs(s.north)) > 5.0]
    assert all(abs(s.height - FLIGHT_ALTITUDE) < 2.5 for s in away)
    chain.until(lambda: not chain.armed, 'landed', 180.0)


@pytest.mark.parametrize(('depth', 'word'), [(15.0, 'below'), (-15.0, 'above')])
def test_where_the_altitudes_disagree_it_stays_and_says_so(depth, word):
    chain = SimulatedChain(POLICY, depth=depth)
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    chain.want(0, 2, 0)
    chain.spend(30.0)
    assert (chain.armed, chain.orders) == (False, [])
    assert chain.report[0]
    assert f"15 m {word} the mission file's ground" in chain.report[1]


def test_refused_arming_is_said_in_its_words_and_asked_for_with_growing_pauses():
    chain = SimulatedChain(POLICY)
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    chain.set('SIM_RC3', 1500)
    chain.want(0, 2, 0)
    chain.until(lambda: 'Throttle (RC3) is not neutral' in chain.report[1], 'why')
    assert chain.report[0]
    chain.spend(120.0)
    times = [o.time for o in chain.orders if o.number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM]
    pauses = [later - sooner for sooner, later in pairwise(times)]
    assert pauses == sorted(pauses)
    assert (pauses[0] < 3.0, pauses[-1] > 25.0) == (True, True)
    chain.set('SIM_RC3', 1000)
    chain.until(lambda: chain.completed, 'goal completed', 180.0)
    assert not chain.report[0]


def test_what_keeps_it_from_arming_is_said_in_the_words_of_the_autopilot():
    chain = SimulatedChain(POLICY)
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    chain.set('SIM_MAG1_FAIL', 1)
    chain.spend(3.0)
    assert not chain.report[0], 'nothing is commanded that needs it'
    chain.want(1, 0, 0)
    chain.until(lambda: 'PreArm: Compass not healthy' in chain.report[1], 'why')
    assert chain.report[0]
    chain.spend(60.0)
    assert 'PreArm: Compass not healthy' in chain.report[1]
    chain.set('SIM_MAG1_FAIL', 0)
    chain.until(lambda: chain.completed, 'goal completed')
    assert not chain.report[0]


def test_without_allow_arming_the_operator_is_warned():
    chain = SimulatedChain(POLICY, settings=replace(SETTINGS, allow_arming=False))
    chain.until(lambda: chain.ready and chain.fault == 'nominal', 'ready')
    chain.want(1, 0, 0)
    chain.until(lambda: 'allow_arming is false' in chain.report[1], 'why')
    assert chain.report[0]
    assert chain.orders == []


def test_two_batteries_that_disagree_are_told_and_the_worse_one_counts():
    chain = SimulatedChain(POLICY)
    chain.want(0, 2, 0)
    chain.until_flying()
    assert not chain.report[0]
    second = mavlink.MAVLink_battery_status_message(
        1, 0, 0, 32767, [12000] + [65535] * 9, -1, -1, -1, 4, 0, 1
    )

    def recharges() -> bool:
        chain.forge(second)
        return chain.command == 'recharge'

    chain.until(recharges, 'recharge', 10.0)
    assert chain.report[0]
    assert 'batteries at 4% and 9' in chain.report[1]


def test_a_hold_that_cannot_begin_yet_says_so_and_begins():
    chain = SimulatedChain(POLICY)
    chain.want(0, 2, 0)
    chain.until_flying()
    chain.cut()
    chain.spend(5.0)
    chain.mend()
    chain.until(lambda: chain.phase == 'waiting', 'waiting')
    done, why = chain.hold()
    assert not done
    assert 'holds when there is one' in why
    chain.until(lambda: chain.phase == 'holding', 'holding', 5.0)
