"""What the page says of a vehicle: words, tones and ages."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from strategies import case_study

from uav_mission_manager.autopilot.task import Phase
from uav_mission_manager.console.heard import Heard, HeardBridge, HeardDecision, Noted, Pose
from uav_mission_manager.console.view import MOST_BARS, Bar, action_bars, part_bars, view_of
from uav_mission_manager.console.words import (
    Fact,
    age_text,
    authority,
    battery,
    closeness,
    fault,
    headline,
    link,
    threat,
)
from uav_mission_manager.mdp import load_mission, mission_from_dict
from uav_mission_manager.paths import share_directory

MISSION = load_mission(share_directory() / 'config' / 'case_study.yaml')
NOW, TIMEOUT = 100.0, 3.0
STATE = (1, 1, 1, 1, 0, 2, 1, 5, 0, 0, 0)


def bridge(phase=Phase.EN_ROUTE, status='why', link_up=True, at=NOW):
    return Noted(HeardBridge(phase.value, status, link_up, 'GUIDED', True), at)


def decision(at=NOW, **changes):
    values = tuple(np.linspace(110.0, 100.0, 10))
    said = HeardDecision(
        'goal2 has high priority; expected cost 100, 1.1 below recharge',
        state=STATE,
        command='repair',
        runner_up='recharge',
        values=values,
        margin=1.111,
        lower_bound=100.0,
        upper_bound=102.3,
    )
    return Noted(replace(said, **changes), at)


def complete(at=NOW):
    return Heard(
        pose=Noted(Pose(50.0, -50.0, 20.0, 0.0), at),
        batteries={'id0': Noted(0.9, at)},
        fault=Noted('nominal', at),
        threat=Noted('none', at),
        decision=decision(at),
        bridge=bridge(at=at),
    )


@pytest.mark.parametrize(
    ('phase', 'status', 'word'),
    [
        (Phase.PILOT, 'LOITER was not ordered from here; ~/resume gives command back', 'PILOT'),
        (
            Phase.PILOT,
            'RTL was not ordered from here, the autopilot is in a failsafe',
            'AUTOPILOT',
        ),
        (Phase.HOLDING, 'on the ground until ~/resume', 'ON HOLD'),
        (Phase.RETURNING, 'the manager is silent', 'RETURNING'),
        (Phase.BLOCKED, 'not ready to arm', 'BLOCKED'),
        (Phase.EN_ROUTE, 'commit goal1 normal', 'MANAGER'),
        (Phase.GROUND, 'none normal', 'MANAGER'),
    ],
)
def test_who_is_in_command(phase, status, word):
    said = authority(Heard(bridge=bridge(phase, status)), NOW, TIMEOUT)
    assert said.word == word
    assert said.why == status.replace('; ~/resume gives command back', '')  # As `way_back` says.
    resumes = word in ('PILOT', 'AUTOPILOT', 'ON HOLD', 'RETURNING')
    assert ('Resume' in said.way_back) == resumes


def test_every_phase_has_a_word_and_only_the_managers_is_good():
    for phase in Phase:
        said = authority(Heard(bridge=bridge(phase, link_up=phase is not Phase.NO_LINK)), NOW, 3.0)
        assert said.word
        assert (said.tone == 'good') == (said.word == 'MANAGER')


def test_an_old_bridge_leaves_the_command_unknown_and_says_how_old():
    said = authority(Heard(bridge=bridge(at=NOW - 12.0)), NOW, TIMEOUT)
    assert (said.word, said.tone) == ('UNKNOWN', 'stale')
    assert said.why == 'MANAGER when last heard, 12 s old'
    assert authority(Heard(), NOW, TIMEOUT).tone == 'stale'


def test_minutes_left_are_energy_over_power():
    energy = MISSION.energy
    hours = 0.5 * energy.capacity * energy.voltage / energy.power
    heard = Heard(batteries={'id0': Noted(0.5, NOW), 'id1': Noted(0.8, NOW)})
    fact = battery(heard, MISSION, NOW, TIMEOUT)
    assert (fact.text, fact.note) == ('50%', f'{60 * hours:.1f} min left')


@pytest.mark.parametrize(('share', 'tone'), [(0.9, 'danger'), (1.5, 'warning'), (2.5, '')])
def test_the_battery_warns_by_the_way_to_service(share, tone):
    """The range is speed times time less wind and payload, as in MODEL's section on range."""
    energy, way = MISSION.energy, 100.0
    east, north = MISSION.grid.position(MISSION.grid.service)
    lost = energy.wind_penalty * energy.wind + energy.payload_penalty * energy.payload
    seconds = (share * way + lost) / energy.speed
    charge = seconds * energy.power / (energy.capacity * energy.voltage * 3600)
    heard = Heard(
        pose=Noted(Pose(east, north - way, 20.0, 0.0), NOW),
        batteries={'id0': Noted(charge, NOW)},
    )
    assert battery(heard, MISSION, NOW, TIMEOUT).tone == tone


@pytest.mark.parametrize('age', [4.0, 300.0])
def test_what_is_old_is_grey_and_says_how_old(age):
    view = view_of('/uav1', complete(NOW - age), MISSION, (), NOW, TIMEOUT)
    words = f'{age_text(age)} old'
    for name in ('battery', 'fault', 'link', 'threat'):
        fact = view.facts[name]
        assert fact.tone == 'stale'
        assert words in (fact.text, fact.note)
    assert (view.now.headline.tone, view.now.headline.note) == ('stale', words)
    assert view.authority.tone == 'stale'
    assert words in view.obstacle


def test_what_is_fresh_is_not_grey_and_can_be_ordered():
    view = view_of('/uav1', complete(), MISSION, (), NOW, TIMEOUT)
    tones = {fact.tone for fact in view.facts.values()} | {view.now.headline.tone}
    assert 'stale' not in tones
    assert view.obstacle == ''


def test_of_nothing_nothing_is_claimed():
    view = view_of('/uav1', Heard(), None, (), NOW, TIMEOUT)
    assert {fact.tone for fact in view.facts.values()} == {'stale'}
    assert (view.now.headline.tone, view.now.actions) == ('stale', ())
    assert view.obstacle


@pytest.mark.parametrize(
    ('bridge_says', 'tone', 'words'),
    [
        (bridge(), '', 'repair'),
        (bridge(Phase.PILOT), 'idle', 'repair: not flown, PILOT'),
        (bridge(Phase.HOLDING), 'idle', 'repair: not flown, ON HOLD'),
        (bridge(Phase.NO_LINK, link_up=False), 'idle', 'repair: not flown, NO LINK'),
        (bridge(at=NOW - 10.0), 'idle', 'repair: whether it is flown is not known'),
    ],
)
def test_a_command_that_is_not_flown_says_so(bridge_says, tone, words):
    heard = replace(complete(), bridge=bridge_says)
    head = view_of('/uav1', heard, MISSION, (), NOW, TIMEOUT).now.headline
    assert (head.text, head.tone, head.note) == ('GO FOR REPAIR', tone, words)


@pytest.mark.parametrize(
    ('command', 'goal', 'phase', 'words'),
    [
        ('commit goal1 normal', 'goal1', Phase.ON_SITE, 'AT WORK AT goal1'),
        ('commit goal1 agile', 'goal1', Phase.EN_ROUTE, 'AT WORK AT goal1'),
        ('commit goal1 normal', '', Phase.ON_SITE, 'GO TO goal1'),
        ('commit goal1 normal', 'goal', Phase.ON_SITE, 'GO TO goal1'),
        ('commit goal1 normal', 'goal1', Phase.HOLDING, 'GO TO goal1'),
        ('repair', 'goal1', Phase.EN_ROUTE, 'GO FOR REPAIR'),
    ],
)
def test_at_work_the_vehicle_is_where_it_is_told_to_be_and_is_not_held(
    command, goal, phase, words
):
    noted = bridge(phase)
    noted = replace(noted, value=replace(noted.value, goal_at_work=goal))
    heard = replace(complete(), decision=decision(command=command), bridge=noted)
    assert view_of('/uav1', heard, MISSION, (), NOW, TIMEOUT).now.headline.text == words


def test_a_link_that_was_lost_is_so_when_last_heard():
    heard = Heard(bridge=bridge(Phase.NO_LINK, link_up=False, at=NOW - 5.0))
    assert authority(heard, NOW, TIMEOUT).why == 'NO LINK when last heard, 5 s old'


def test_a_lost_link_is_an_obstacle_and_danger():
    heard = replace(complete(), bridge=bridge(Phase.NO_LINK, link_up=False))
    assert 'lost' in view_of('/uav1', heard, MISSION, (), NOW, TIMEOUT).obstacle
    assert link(heard, NOW, TIMEOUT).tone == 'danger'


def test_a_silent_manager_is_told_in_large_words():
    heard = replace(complete(), decision=Noted(HeardDecision('link lost: odom 4.0 s old'), NOW))
    now = view_of('/uav1', heard, MISSION, (), NOW, TIMEOUT).now
    assert (now.headline.text, now.headline.tone) == ('NO COMMAND', 'danger')
    assert now.reason == 'link lost: odom 4.0 s old'


def test_why_in_one_sentence_with_the_second_best():
    now = view_of('/uav1', complete(), MISSION, (), NOW, TIMEOUT).now
    assert now.headline.text == 'GO FOR REPAIR'
    assert now.reason == 'goal2 has high priority'
    assert now.second == 'second best: recharge, costs +1.11'
    assert now.closeness == Fact('within 2.3% of the best possible', 'good')


@pytest.mark.parametrize(
    ('command', 'words'),
    [
        ('commit goal2 normal', 'GO TO goal2'),
        ('commit two words agile', 'GO TO two words, EVADING'),
        ('none normal', 'RETURN TO BASE'),
        ('none agile', 'EVADE TO BASE'),
        ('recharge', 'RECHARGE'),
    ],
)
def test_commands_in_large_words(command, words):
    assert headline(command) == words


@pytest.mark.parametrize(
    ('lower', 'upper', 'cost', 'words', 'tone'),
    [
        (100.0, 100.01, 100.0, 'the best possible, proved', 'good'),
        (100.0, 102.3, 101.0, 'within 2.3% of the best possible', 'good'),
        (100.0, math.inf, 105.0, 'within 5.0% of the best possible by its own estimate', ''),
        (math.nan, math.inf, 105.0, 'how good it is at best is not known', 'idle'),
        (0.0, 10.0, 5.0, 'how good it is at best is not known', 'idle'),
    ],
)
def test_how_close_to_the_best(lower, upper, cost, words, tone):
    assert closeness(lower, upper, cost) == Fact(words, tone)


def test_bars_are_extra_costs_and_the_choice_has_none():
    values = (110.0, math.inf, 105.0, 100.0, *(math.inf,) * 4, 104.0, math.inf)
    said = decision(values=values, command='commit goal3 normal', runner_up='recharge').value
    assert action_bars(said, MISSION) == (
        Bar('none normal', '+10', 1.0),
        Bar('commit goal2 normal', '+5', 0.5),
        Bar('commit goal3 normal', '100', 0.0, 'choice'),
        Bar('recharge', '+4', 0.4, 'second'),
    )
    heard = replace(complete(), decision=Noted(said, NOW))
    forbidden = view_of('/uav1', heard, MISSION, (), NOW, TIMEOUT).now.forbidden
    assert forbidden[:2] == ('commit goal1 normal', 'none agile')
    assert len(forbidden) == 6


def test_of_many_actions_the_best_have_bars_and_a_choice_that_is_kept():
    document = case_study()
    document['goals'] = [
        {'name': f'g{j}', 'cell': 5, 'eta': 1.0, 'delta': 1.0} for j in range(1, 51)
    ]
    mission = mission_from_dict(document, 'test')
    values = tuple(float(value) for value in range(100, 204))
    state = (1, *(1,) * 50, *(1,) * 50, 0, 0, 0, 0)
    said = decision(state=state, values=values, command='repair', runner_up='none normal')
    now = view_of('', replace(complete(), decision=said), mission, (), NOW, TIMEOUT).now
    best = ['none normal', *(f'commit g{j} normal' for j in range(1, MOST_BARS))]
    assert [bar.name for bar in now.actions] == [*best, 'repair']
    assert now.dearer == len(values) - MOST_BARS - 1
    assert max(bar.length for bar in now.actions) == 1.0
    parts = [((j,), float(j)) for j in range(50)]
    assert len(part_bars(parts, mission)) == MOST_BARS


def test_bars_without_a_mission_have_numbers():
    assert action_bars(decision().value, None)[0].name == 'action 1'


def test_sub_mdps_are_named_by_their_goals():
    parts = (((0, 1), 50.0), ((2,), 100.0))
    bars = view_of('/uav1', complete(), MISSION, parts, NOW, TIMEOUT).now.parts
    assert bars == (Bar('goal1 + goal2', '50', 0.5), Bar('goal3', '100', 1.0))


def test_threat_is_what_the_manager_reckons_with():
    heard = replace(complete(), decision=decision(state=(*STATE[:-2], 2, 1)))
    assert threat(heard, NOW, TIMEOUT) == Fact('high', 'danger', 'heard: none')
    never = replace(complete(), threat=None)
    assert threat(never, NOW, TIMEOUT) == Fact('none', 'stale', 'assumed: never heard')


def test_the_threat_of_a_manager_that_is_silent_is_old():
    heard = replace(complete(), decision=decision(NOW - 12.0))
    assert threat(heard, NOW, TIMEOUT) == Fact('none', 'stale', '12 s old')
    refused = replace(complete(), decision=Noted(HeardDecision('link lost'), NOW))
    assert threat(refused, NOW, TIMEOUT).tone == 'stale'


def test_faults_in_words():
    heard = replace(complete(), fault=Noted('sensor_actuator', NOW))
    assert fault(heard, NOW, TIMEOUT).text == 'sensor, actuator'
