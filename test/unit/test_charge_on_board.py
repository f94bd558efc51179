"""One battery on board: its level, what is in range, and flights by it."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from simulated_chain import SimulatedChain
from strategies import case_study, with_charge

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import ActionKind, StateSpace, mission_from_dict
from uav_mission_manager.mdp.charge import RangeFlags, flags_at, range_table
from uav_mission_manager.nodes.flight_plan import speed_differences
from uav_mission_manager.onboard import ManagerSettings, MissionManager, Situation

LEVELS = 16
MISSION = mission_from_dict(with_charge(case_study(), levels=LEVELS, rate=1), 'test')


@pytest.fixture(scope='module')
def policy():
    return build_policy(MISSION)


def at(charge, position=(0.0, 0.0), situation=None, now=0.0, **battery):
    situation = situation or Situation(MISSION)
    return situation.with_battery(charge, now, **battery).with_position(*position, now)


def test_level_and_flags_are_the_models_in_10_000_situations():
    rng, space, flags = random.Random(1), StateSpace.of(MISSION), RangeFlags(MISSION)
    seen = set()
    for _ in range(10_000):
        charge = rng.random()
        position = rng.uniform(-25.0, 175.0), rng.uniform(-75.0, 25.0)
        situation = at(charge, position)
        state = space.check(situation.state)
        s = space.split(state)
        assert (s.b[0, 0], s.l[0]) == (math.floor(LEVELS * charge), situation.cell)
        assert situation.in_range == tuple(flags(s)[0])
        seen.add(situation.in_range)
    assert len(seen) > 3


def test_flags_at_a_place_are_those_of_the_table():
    for (j, cell, level), flag in np.ndenumerate(range_table(MISSION)):
        assert flags_at(MISSION, cell, level)[j] == flag


def test_a_level_is_lost_at_once_and_comes_back_by_two_points():
    edge = 8 / LEVELS
    lower = at(edge - 0.001, situation=at(edge + 0.001))
    assert (at(edge + 0.001).level, lower.level) == (8, 7)
    assert at(edge + 0.019, situation=lower).level == 7
    assert at(edge + 0.021, situation=lower).level == 8
    assert at(1.0, situation=lower).level == LEVELS - 1


def test_an_unhealthy_battery_is_empty():
    situation = at(0.9, healthy=False)
    assert (situation.level, situation.in_range) == (0, (0, 0, 0))


def test_another_mission_has_levels_of_its_own():
    finer = mission_from_dict(with_charge(case_study(), levels=100), 'test')
    assert at(0.505).with_mission(finer).level == 50
    flagged = mission_from_dict(case_study(), 'test')
    assert at(0.505).with_mission(flagged).state[:4] == (1, 1, 1, 1)
    assert Situation(flagged).with_mission(MISSION).level == LEVELS - 1


def test_a_refused_goal_is_not_wanted():
    situation = replace(at(1.0), priorities=(2, 1, 2)).with_refused('goal1')
    assert situation.state[2:5] == (0, 1, 2)
    assert situation.priorities == (2, 1, 2)


def decided(policy, priorities, charge, **battery):
    """At the service cell."""
    manager = MissionManager(policy, ManagerSettings(settling_time=0.0, command_dwell=0.0))
    service = MISSION.grid.position(MISSION.grid.service)
    for change in (
        lambda s: at(charge, service, s, 1.0, **battery),
        lambda s: s.with_fault('nominal', 1.0),
        lambda s: s.with_threat('none', 1.0),
        lambda s: s.with_priorities(priorities, 'a', 1.0),
    ):
        manager.take(change)
    return manager.step(1.0)


@pytest.mark.parametrize(
    ('priorities', 'waiting', 'full', 'capacity', 'then'),
    [
        ((2, 2, 2), 0.7, 1.0, 0.7, ActionKind.COMMIT),  # The battery has grown old.
        ((0, 0, 0), 0.88, float(np.float32(0.9)), 1.0, ActionKind.NONE),  # A charger's 90 %.
    ],
)
def test_a_pack_that_is_as_full_as_it_gets_is_not_waited_for(
    priorities, waiting, full, capacity, then
):
    document = with_charge(case_study(), levels=LEVELS, reserve=0.4)
    policy = build_policy(mission_from_dict(document, 'test'))
    assert decided(policy, priorities, waiting).action.kind is ActionKind.RECHARGE
    decision = decided(policy, priorities, full, capacity=capacity)
    assert decision.action.kind is then
    assert decision.state[1] == math.floor(LEVELS * full * capacity)
    assert decision.reason.startswith('as if full, it holds no more: ')


def test_it_flies_a_mission_and_recharges(policy):
    chain = SimulatedChain(policy)
    chain.want(2, 2, 2)
    chain.until(lambda: len(chain.completed) == 3, 'three goals completed', 900.0)
    chain.until(lambda: not chain.armed, 'landed', 300.0)


def test_the_bridges_speeds_are_held_against_the_missions():
    """5 m/s and 50/9 m/s."""
    energy = MISSION.energy
    assert speed_differences(MISSION, energy.speed, energy.agile_speed) == []
    assert speed_differences(MISSION, 6.0, 10.0) == [
        'cruise_speed is 6 m/s, the mission plans for 5 m/s: make it the same as energy.speed',
        'agile_speed is 10 m/s, the mission plans for 5.55556 m/s: '
        'make it the same as energy.agile_speed',
    ]
    flagged = mission_from_dict(case_study(), 'test')
    assert speed_differences(flagged, 5.0, 10.0) == []
    assert len(speed_differences(flagged, 4.0, 10.0)) == 1
    assert speed_differences(replace(flagged, energy=None), 4.0, 10.0) == []
