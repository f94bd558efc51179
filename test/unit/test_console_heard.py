"""What the console has heard of a vehicle."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from uav_mission_manager.console.heard import (
    MOST_EPOCHS_KEPT,
    MOST_LINES_KEPT,
    Heard,
    HeardBridge,
    HeardDecision,
    LogLine,
    Pose,
    bridge_from,
    decision_from,
)
from uav_mission_manager.drawing.trail import MOST_TRAIL_POINTS, TRAIL_BREAK, TRAIL_STEP
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes.reporting import decision_status
from uav_mission_manager.onboard import Refusal, Situation, format_command
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import load_policy

STATE = (1, 1, 1, 1, 0, 2, 1, 5, 0, 0, 0)


def decided(state=STATE, command='commit goal2 normal'):
    return HeardDecision('goal2 has high priority', state=state, command=command)


def told(outcome):
    """What the manager itself would send of an outcome."""
    mission = load_mission(share_directory() / 'config' / 'case_study.yaml')
    status = decision_status('manager', outcome, Situation(mission), 0.0, 'digest')
    return decision_from(status.message, {pair.key: pair.value for pair in status.values})


@pytest.mark.parametrize('state', [STATE, (1, 0, 0, 0, 1, 1, 1, 0, 0, 2, 1)])
def test_a_decision_is_read_as_the_manager_writes_it(state):
    policy = load_policy(share_directory() / 'policies' / 'case_study')
    decision = policy.decide(state)
    read = told(decision)
    assert read.state == state
    assert read.command == format_command(policy.mission, decision.action)
    assert read.runner_up == format_command(policy.mission, decision.runner_up)
    assert read.goals == tuple(goal.name for goal in policy.mission.goals)
    assert read.values == pytest.approx(decision.values, rel=1e-5)
    assert read.margin == pytest.approx(decision.margin, rel=1e-5)
    assert (read.reason, read.digest) == (decision.reason, 'digest')
    assert read.lower_bound == pytest.approx(decision.lower_bound, rel=1e-5)
    assert read.upper_bound == pytest.approx(decision.upper_bound, rel=1e-5)


def test_a_refusal_has_neither_state_nor_command():
    read = told(Refusal('link lost: odom'))
    assert (read.state, read.command, read.reason) == ((), '', 'link lost: odom')


@pytest.mark.parametrize('state', ['1 2', '1 1 1 x 0 0 0', '1 1 1 0 0 9 0'])
def test_a_state_that_is_none_is_refused(state):
    with pytest.raises(ValueError, match=r'state|invalid literal'):
        decision_from('why', {'state': state})


def test_epochs_begin_with_a_new_state_or_command_only():
    heard = Heard()
    for decision in (
        decided(),
        decided(),
        decided(command='none normal'),
        decided((1, *STATE[1:-1], 1), 'none normal'),
        HeardDecision('link lost'),
        HeardDecision('link still lost'),
    ):
        heard = heard.with_decision(decision, 1.0, '12:00:00')
    assert [epoch.number for epoch in heard.epochs] == [1, 2, 3, 4]
    assert [epoch.command for epoch in heard.epochs][-2:] == ['none normal', '']
    assert [line.level for line in heard.log] == ['', '', 'warning']


def test_another_mission_begins_another_timeline():
    heard = Heard().with_decision(decided(), 1.0, '')
    heard = heard.with_decision(HeardDecision('silent'), 1.0, '')
    heard = heard.with_decision(decided((1, 1, 0, 0, 0, 0, 0), 'none normal'), 2.0, '')
    assert [(epoch.number, len(epoch.state)) for epoch in heard.epochs] == [(3, 7)]


def test_another_goal_in_a_slot_begins_another_timeline():
    heard = Heard().with_decision(replace(decided(), goals=('a', 'b', 'c')), 1.0, '')
    heard = heard.with_decision(HeardDecision('silent'), 2.0, '')
    assert [epoch.number for epoch in heard.epochs] == [1, 2]
    heard = heard.with_decision(replace(decided(), goals=('a', 'tree', 'c')), 3.0, '')
    assert [(epoch.number, epoch.decision.goals[1]) for epoch in heard.epochs] == [(3, 'tree')]


def test_a_share_of_the_fleet_is_told_once():
    heard = Heard().with_share('', '')
    assert heard.log == ()
    for words in ('to goal3: it gains most', 'to goal3: it gains most', 'has no goal: lost'):
        heard = heard.with_share(words, '12:00:00')
    assert heard.share == 'has no goal: lost'
    told = ['fleet: to goal3: it gains most', 'fleet: has no goal: lost']
    assert [line.text for line in heard.log] == told


def test_only_so_much_is_kept():
    heard = Heard()
    for number in range(MOST_EPOCHS_KEPT + 5):
        heard = heard.with_decision(decided((1, *STATE[1:7], number, *STATE[8:])), 1.0, '')
        heard = heard.with_line(LogLine('', 'x' * 10_000))
        heard = heard.with_pose(Pose(number * TRAIL_STEP, 0.0, 0.0, 0.0), 1.0)
    assert [epoch.number for epoch in heard.epochs] == list(range(6, MOST_EPOCHS_KEPT + 6))
    assert len(heard.log) == MOST_LINES_KEPT
    assert max(len(line.text) for line in heard.log) <= 300
    assert len(heard.trail) == MOST_TRAIL_POINTS
    assert heard.trail[-1] == ((MOST_EPOCHS_KEPT + 4) * TRAIL_STEP, 0.0)


def test_a_trail_has_no_point_for_a_hover_and_no_line_over_a_jump():
    heard = Heard()
    for east in (0.0, 0.5 * TRAIL_STEP, TRAIL_STEP, TRAIL_STEP + 1.01 * TRAIL_BREAK):
        heard = heard.with_pose(Pose(east, 0.0, 0.0, 0.0), 1.0)
        if east == TRAIL_STEP:
            assert heard.trail == ((0.0, 0.0), (TRAIL_STEP, 0.0))
    assert len(heard.trail) == 1


def test_what_is_no_number_is_not_known():
    nowhere = Pose(math.nan, 0.0, 0.0, 0.0)
    assert Heard().with_pose(nowhere, 1.0).pose is None
    for charge in (math.nan, -0.1, 1.1):
        assert Heard().with_battery('id0', charge, 1.0).batteries == {}


def test_each_battery_is_kept():
    heard = Heard().with_battery('id0', 0.5, 1.0).with_battery('id1', 0.4, 2.0)
    heard = heard.with_battery('id0', 0.3, 3.0)
    assert {name: (n.value, n.at) for name, n in heard.batteries.items()} == {
        'id0': (0.3, 3.0),
        'id1': (0.4, 2.0),
    }


def test_only_what_is_new_is_told():
    bridge = HeardBridge('en route', 'en route: x', True, 'GUIDED', True)
    heard = Heard()
    for at in (1.0, 2.0):
        heard = heard.with_fault('nominal', at, '').with_threat('low', at, '')
        heard = heard.with_asked((0, 1, 2), at, '').with_bridge(bridge, at, '')
    assert [line.text for line in heard.log] == [
        'fault mode nominal',
        'threat heard: low',
        'asked for: priorities 0 1 2',
        'bridge: en route: x',
    ]
    assert (heard.fault.at, heard.threat.at, heard.asked.at, heard.bridge.at) == (2.0,) * 4


def test_a_lost_link_is_danger():
    lost = HeardBridge('no link', 'no heartbeat', False, 'mode None', False)
    assert Heard().with_bridge(lost, 1.0, '').log[-1].level == 'danger'


def test_the_bridges_own_words_are_read():
    values = {'phase': 'en route', 'link': 'up', 'mode': 'GUIDED', 'armed': 'True'}
    assert bridge_from('why', values) == HeardBridge('en route', 'why', True, 'GUIDED', True)
    assert bridge_from('why', {}) == HeardBridge('', 'why', False, '', False)
