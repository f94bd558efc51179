"""What the watch of benchmarks/kills.py sees: what must not be, and nothing else."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from ros_helpers import ROOT
from std_msgs.msg import MultiArrayDimension, String, UInt8MultiArray

sys.path.insert(0, str(ROOT / 'benchmarks'))

from parts.kills.chain import MISSION
from parts.kills.watch import EFFECT_TIME, REPEAT_TIME, Watch

from uav_mission_manager.mdp import load_mission


class Told:
    """A watch that is told what a vehicle does."""

    def __init__(self) -> None:
        self.now, self.heard = 100.0, {}
        self.chain = SimpleNamespace(
            mission=load_mission(MISSION),
            namespace='/uav1',
            given=(),
            threat='none',
            told_threat='none',
            armed=False,
            mode=4,
            aloft=False,
            position=(0.0, 0.0),
            ended=[],
            far_from=lambda cell: 100.0,
            listen=lambda topic, kind, profile, callback: self.heard.update({topic: callback}),
        )
        self.watch = Watch(self.chain, lambda: self.now)

    def pass_(self, seconds: float) -> None:
        self.now += seconds
        self.watch.step()

    def say(self, topic: str, text: str) -> None:
        self.heard[topic](String(data=text))

    def states(self, *values: int) -> None:
        self.heard['goal_states'](UInt8MultiArray(data=values))

    def request(self, label: str) -> None:
        message = UInt8MultiArray(data=[1, 0, 0])
        message.layout.dim = [MultiArrayDimension(label=label)]
        self.heard['goal_priorities'](message)

    def decide(self, command: str, state: str, reason: str = 'why') -> None:
        said = {'command': command, 'state': state, 'runner_up': 'commit goal3 normal'}
        values = [KeyValue(key=key, value=value) for key, value in said.items()]
        status = DiagnosticStatus(message=reason, values=values)
        self.say('mission_command', command)
        self.heard['manager/decision'](DiagnosticArray(status=[status]))


@pytest.fixture
def told() -> Told:
    return Told()


@pytest.mark.parametrize(
    ('before', 'why'),
    [
        (lambda watch: None, 'no goal is wanted'),
        (lambda watch: (watch.ask((1, 0, 0)), watch.hold()), 'told to hold'),
        (lambda watch: (watch.ask((1, 0, 0)), vars(watch).update(taken=True)), 'a pilot'),
    ],
)
def test_a_take_off_nobody_asked_for_is_seen(told, before, why):
    before(told.watch)
    told.pass_(EFFECT_TIME)
    told.chain.armed = True
    told.watch.step()
    assert why in told.watch.violations[0]


def test_a_take_off_that_was_asked_for_is_none(told):
    told.watch.ask((1, 0, 0))
    told.chain.armed = True
    told.watch.step()
    assert not told.watch.violations


def test_an_order_against_a_pilot_is_seen(told):
    told.watch.taken, told.chain.mode = True, 9
    told.watch.step()
    assert 'mode 4 becomes 9' in told.watch.violations[0]


def test_a_hold_that_is_not_kept_is_seen(told):
    told.watch.ask((1, 0, 0))
    told.chain.armed = told.chain.aloft = True
    told.watch.step()
    told.watch.hold()
    told.pass_(EFFECT_TIME + 1.0)
    assert not told.watch.violations
    told.chain.position = (50.0, 0.0)
    told.watch.step()
    assert told.watch.violations == ['moves though told to hold']


def test_a_goal_flown_again_is_seen(told):
    told.watch.ask((1, 0, 0))
    told.say('goal_completed', 'goal1')
    told.pass_(1.0)
    told.say('goal_completed', 'goal1')  # A repetition.
    assert not told.watch.violations
    told.pass_(REPEAT_TIME)
    told.say('mission_command', 'commit goal1 normal')
    told.say('goal_completed', 'goal1')
    assert len(told.watch.violations) == 2


def test_priorities_that_change_by_themselves_are_seen(told):
    told.states(1, 0, 0)
    told.states(1, 0, 1)
    told.pass_(EFFECT_TIME)
    assert 'nobody asked' in told.watch.violations[0]


def test_a_goal_that_the_manager_alone_heard_of_is_done(told):
    told.watch.ask((1, 0, 0))
    told.states(1, 0, 0)
    told.chain.far_from = lambda cell: 1.0
    told.states(0, 0, 0)
    told.pass_(EFFECT_TIME)
    assert not told.watch.violations
    assert told.watch.wanted == [0, 0, 0]


def test_a_request_that_nobody_made_is_seen(told):
    told.request('first')
    told.request('second')
    assert 'nobody asked' in told.watch.violations[0]


@pytest.mark.parametrize(
    ('command', 'state', 'wrong'),
    [
        ('commit goal1 normal', '1 1 1 1 1 1 0 0 1 0 0', False),
        ('commit goal2 normal', '1 1 1 1 1 1 0 0 0 0 0', True),
        ('commit goal2 normal', '2 1 1 1 1 1 0 0 0 0 0', False),  # A fault explains it.
        ('commit goal1 agile', '1 1 1 1 1 1 0 0 1 2 0', True),  # Nobody spoke of a threat.
    ],
)
def test_another_first_command_is_seen(told, command, state, wrong):
    told.watch.ask((1, 1, 0))
    told.decide('commit goal1 normal', '1 1 1 1 1 1 0 0 1 0 0')
    told.watch.killed('manager')
    told.decide(command, state)
    assert bool(told.watch.violations) == wrong


def test_a_threat_told_just_before_may_be_what_the_next_one_goes_on_from(told):
    told.watch.ask((1, 1, 0))
    told.decide('commit goal1 normal', '1 1 1 1 1 1 0 0 1 0 0')
    told.chain.told_threat = 'high'
    told.watch.killed('manager')
    told.decide('commit goal1 agile', '1 1 1 1 1 1 0 0 1 2 0')
    assert not told.watch.violations


def test_a_first_command_after_a_dwell_may_be_the_one_that_waited(told):
    told.watch.ask((1, 1, 1))
    told.decide('commit goal1 normal', '1 1 1 1 1 1 1 0 1 0 0', 'keeps commit goal1 normal')
    told.watch.killed('manager')
    told.decide('commit goal3 normal', '1 1 1 1 1 1 1 0 1 0 0')
    assert not told.watch.violations


def test_a_broken_part_that_is_forgotten_is_seen(told):
    told.say('fault_mode', 'actuator')
    told.watch.broken = 'motor'
    told.watch.killed('mavlink_bridge')
    told.say('fault_mode', 'nominal')
    assert 'actuator is nominal' in told.watch.violations[0]
