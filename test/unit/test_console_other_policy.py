"""What another policy would have done in a flight: at each moment, by epoch, on the page."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pytest
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.console.heard import Heard, HeardDecision, HeardEpoch
from uav_mission_manager.console.markup import other_html
from uav_mission_manager.console.other_policy import OtherDecision, OtherPolicy
from uav_mission_manager.console.playback import FLIGHT_STEP, Playback, RecordedFlight
from uav_mission_manager.console.timeline import block_svg, row_names
from uav_mission_manager.mdp import StateSpace, global_actions, mission_from_dict
from uav_mission_manager.onboard import Refusal, format_command
from uav_mission_manager.onboard.trace import ReplayedStep, outcome_values

MISSION = mission_from_dict(case_study(), 'test')
FLOWN = build_policy(MISSION)
OTHER = build_policy(replace(MISSION, distance_weight=5.0))
STATES = [
    (1, 1, 1, 1, g, 2, 0, cell, 0, t, 0) for g in (0, 1) for t in (0, 2) for cell in range(8)
]
PERIOD = 0.5


def command(policy, state):
    number = int(policy.q_values([state]).argmin()) + 1
    return format_command(MISSION, global_actions(MISSION)[number - 1])


def steps(states=STATES):
    """Each state decided in three times, by both."""
    outcomes = [(outcome_values(FLOWN.decide(s)), OTHER.decide(s)) for s in states for _ in '123']
    return [
        (PERIOD * n, ReplayedStep(0.0, recorded, replayed, OTHER.mission))
        for n, (recorded, replayed) in enumerate(outcomes, 1)
    ]


@pytest.fixture(scope='module')
def other():
    return OtherPolicy('other', OTHER.mission, steps())


def test_at_each_moment_it_says_what_the_other_policy_does_and_what_that_is_worth(other):
    assert other.at(PERIOD - 0.01) is None
    for n, state in enumerate(STATES):
        for late in (0.0, 2.9 * PERIOD):
            found = other.at(PERIOD * (3 * n + 1) + late)
            assert (found.state, found.flown) == (state, command(FLOWN, state))
            assert found.command == command(OTHER, state)
            a, b = (p.q_values([state])[0].argmin() for p in (FLOWN, OTHER))
            by_other, by_flown = OTHER.q_values([state])[0], FLOWN.q_values([state])[0]
            assert found.flown_costs == pytest.approx(by_other[a] - by_other[b])
            assert found.other_costs == pytest.approx(by_flown[b] - by_flown[a])


def test_stretches_in_which_it_differs_are_whole_and_all(other):
    inside = [
        PERIOD * (3 * n + 1) <= at < PERIOD * (3 * n + 4)
        for n, state in enumerate(STATES)
        if command(FLOWN, state) != command(OTHER, state)
        for at in [PERIOD * (3 * n + 2)]
    ]
    assert 0 < len(inside) < len(STATES)
    for n, state in enumerate(STATES):
        middle = PERIOD * (3 * n + 2)
        differs = command(FLOWN, state) != command(OTHER, state)
        assert any(start < middle < end for start, end in other.differences) == differs
    ends = [bound for stretch in other.differences for bound in stretch]
    assert ends == sorted(set(ends)), 'stretches that touch are one'


@pytest.mark.parametrize('jitter', [-0.004, 0.004])
def test_epochs_are_marked_although_their_topic_was_recorded_before_or_after(other, jitter):
    epochs = [
        (
            PERIOD * (3 * n + 1) + jitter,
            HeardEpoch(n + 1, '', HeardDecision('', state=state, command=command(FLOWN, state))),
        )
        for n, state in enumerate(STATES)
    ]
    assert other.by_epoch(epochs) == {
        n: command(OTHER, state)
        for n, state in enumerate(STATES, 1)
        if command(FLOWN, state) != command(OTHER, state)
    }


def test_who_decides_nothing_is_told_without_values():
    decision, refusal = FLOWN.decide(STATES[0]), Refusal('link lost')
    recorded = [outcome_values(refusal), outcome_values(decision)]
    both = [(1.0, ReplayedStep(0.0, recorded[0], decision, MISSION))]
    both += [(2.0, ReplayedStep(0.0, recorded[1], refusal, MISSION))]
    other = OtherPolicy('other', MISSION, both)
    assert (other.at(1.0).flown, other.at(1.0).state) == ('', ())
    assert (other.at(2.0).command, other.at(2.0).reason) == ('', 'link lost')
    assert other.at(2.0).flown_costs is None
    assert 'NO COMMAND' in other_html('other', other.at(2.0), False)
    assert OtherPolicy('other', MISSION, []).at(3.0) is None


def test_the_flown_policy_itself_never_differs():
    same = [(at, replace(s, replayed=FLOWN.decide(s.recorded['state']))) for at, s in steps()]
    assert OtherPolicy('flown', MISSION, same).differences == []


def test_the_page_goes_from_difference_to_difference(other):
    flight = RecordedFlight('', (0.0, 100.0), (Heard(), Heard()))
    playback = Playback(flight, lambda: 0.0, other)
    starts = [start for start, _ in other.differences]
    for start in (*starts, starts[0]):
        playback.seek_difference()
        assert playback.position == pytest.approx(start + FLIGHT_STEP)


def test_the_timeline_has_a_row_for_it():
    decision = HeardDecision('', state=STATES[0], command='none normal')
    epochs = [HeardEpoch(n, '', decision) for n in (1, 2, 3, 4)]
    commands = {2: 'commit goal2 agile', 3: 'recharge', 4: ''}
    plain, marked = (
        ElementTree.fromstring(block_svg(epochs, StateSpace.of(MISSION), others, MISSION))
        for others in (None, commands)
    )
    words = [e.text for e in marked.iter('text')]
    assert words[-3:] == ['2!', 'C', 'no']
    assert len([e for e in marked.iter('rect') if e.get('class') == 'd-1']) == 3
    assert float(marked.get('height')) > float(plain.get('height'))
    titles = [e.text for e in marked.iter('title')]
    assert 'other policy' not in titles[0]
    assert titles[1].endswith('other policy: commit goal2 agile')
    assert row_names(['a'], other=True)[-1] == 'other policy'
    assert 'other policy' not in row_names(['a'])


def test_a_difference_is_told_in_words_and_escaped():
    found = OtherDecision((1,), 'recharge', 'commit <b> agile', 'why <i>', math.inf, 1.25)
    text = other_html('x & y', found, False)
    assert 'GO TO &lt;b&gt;, EVADING' in text
    assert 'what was flown is not allowed' in text
    assert 'this costs 1.25 more' in text
    assert 'x &amp; y' in text
    assert '<i>' not in text
    same = other_html('x', replace(found, command='recharge'), False)
    assert 'the same' in same
    assert 'differs' not in same
