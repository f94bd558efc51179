"""A manager's trace: what is decided anew from it is what was decided, bit for bit."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from random_trace import STEPS, Recorded, take_over

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.onboard import Refusal
from uav_mission_manager.onboard.trace import STATE_PERIOD, Replay, ReplayedStep, outcome_values
from uav_mission_manager.policy import Decision, Policy

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')
SEEDS = range(8)


@pytest.fixture(scope='module')
def policy() -> Policy:
    return build_policy(MISSION)


@pytest.fixture(scope='module')
def other_policy() -> Policy:
    goals = tuple(replace(g, eta=20.0 - g.eta, delta=10.0 - g.delta) for g in MISSION.goals)
    return build_policy(replace(MISSION, goals=goals))


def replayed(entries: list[str], policy: Policy) -> Iterator[ReplayedStep]:
    replay = Replay(policy)
    for entry in entries:
        yield from replay.take(entry)


@pytest.mark.parametrize('seed', SEEDS)
def test_the_same_policy_decides_the_same_bit_for_bit(policy: Policy, seed: int) -> None:
    flight = Recorded(policy, seed)
    assert [step.replayed for step in replayed(flight.entries, policy)] == flight.outcomes
    assert len({type(outcome) for outcome in flight.outcomes}) == 2
    commands = {o.action for o in flight.outcomes if isinstance(o, Decision)}
    assert len(commands) > 3


@pytest.mark.parametrize('seed', SEEDS)
def test_what_was_decided_is_in_the_trace(policy: Policy, seed: int) -> None:
    flight = Recorded(policy, seed)
    told = [step.recorded for step in replayed(flight.entries, policy)]
    for recorded, outcome in zip(told, flight.outcomes, strict=True):
        if isinstance(outcome, Refusal):
            assert list(recorded) == ['refused']
        else:
            assert tuple(recorded['state']) == outcome.state
            assert recorded['action'] == outcome.action.number
            assert tuple(recorded['values']) == outcome.values
            assert recorded['margin'] == outcome.margin


@pytest.mark.parametrize('seed', SEEDS)
def test_a_recording_may_begin_and_have_gaps_anywhere(policy: Policy, seed: int) -> None:
    flight = Recorded(policy, seed)
    start = flight.rng.randrange(1, len(flight.entries) // 2)
    gap = flight.rng.randrange(start + 10, len(flight.entries) - 100)
    replay, last = Replay(policy), []
    for place, entry in enumerate(flight.entries):
        if start <= place != gap:
            last = [*last, *replay.take(entry)]
    assert replay.gaps >= 1
    there = [step.replayed for step in last]
    assert there[-50:] == flight.outcomes[-50:]
    assert 0 < replay.skipped < len(flight.outcomes)
    remaining = iter(flight.outcomes)
    assert all(outcome in remaining for outcome in there)  # In order, and none of its own.


def test_what_is_heard_twice_counts_once(policy: Policy) -> None:
    flight, replay = Recorded(policy, 1), Replay(policy)
    twice = [*flight.entries[:200], *flight.entries[150:200], *flight.entries[200:]]
    assert [s.replayed for entry in twice for s in replay.take(entry)] == flight.outcomes
    assert replay.gaps == 0


def test_two_managers_at_once_are_kept_apart(policy: Policy) -> None:
    flights = Recorded(policy, 1), Recorded(policy, 2)
    mixed = [entry for pair in zip(*(flight.entries for flight in flights)) for entry in pair]
    replay = Replay(policy)
    for entry in mixed:
        for step in replay.take(entry):
            if 'refused' in step.recorded:
                assert isinstance(step.replayed, Refusal)
            else:
                assert outcome_values(step.replayed) == step.recorded
    assert (replay.gaps, replay.skipped) == (0, 0)


def test_another_policy_decides_otherwise(policy: Policy, other_policy: Policy) -> None:
    flight = Recorded(policy, 1)
    steps = list(replayed(flight.entries, other_policy))
    differing = [
        step
        for step in steps
        if isinstance(step.replayed, Decision)
        and step.recorded.get('action') != step.replayed.action.number
    ]
    assert 0 < len(differing) < len(steps)


def test_the_policies_that_were_flown_are_told(policy: Policy, other_policy: Policy) -> None:
    policies = policy, other_policy
    for each, digest in zip(policies, 'ab', strict=True):
        each.digest = digest
    try:
        flight, replay = Recorded(*policies[:1], 3, other_policy), Replay(policy)
        for entry in flight.entries:
            list(replay.take(entry))
        assert set(replay.policies) == {'a', 'b'}
        assert replay.runs > 1
    finally:
        policy.digest = other_policy.digest = ''


@pytest.mark.parametrize('wanted', [True, False])
def test_a_take_over_with_other_goals_is_decided_anew_bit_for_bit(wanted: bool) -> None:
    entries, outcomes, policies = take_over(MISSION, wanted)
    for order in policies, policies[::-1]:
        replay = Replay(*order)
        steps = [step for entry in entries for step in replay.take(entry)]
        assert [step.replayed for step in steps] == outcomes
        missions = [policy.mission for policy in policies for _ in range(20)]
        assert [step.mission for step in steps] == missions
    states = [outcome.state for outcome in outcomes[20:] if isinstance(outcome, Decision)]
    assert [state[6] for state in states] == [2 * wanted] * 20
    begun_later = Replay(*policies)
    late = [step.replayed for entry in entries[22:] for step in begun_later.take(entry)]
    assert 10 < len(late) < 18
    assert late == outcomes[-len(late) :]


def test_a_take_over_without_its_policy_is_refused_in_one_line() -> None:
    entries, _, policies = take_over(MISSION)
    for policy, seconds in zip(policies, (20, 0), strict=True):
        replay, steps = Replay(policy), list[ReplayedStep]()
        decided = (step for entry in entries for step in replay.take(entry))
        with pytest.raises(ValueError, match=r'^recorded in a mission with other goals [^\n]+$'):
            steps.extend(decided)
        assert len(steps) == seconds


def test_two_policies_of_the_same_goals_are_refused(policy: Policy, other_policy: Policy) -> None:
    with pytest.raises(ValueError, match='have the same goals and grid: give one'):
        Replay(policy, other_policy)


def test_states_are_seldom_written(policy: Policy) -> None:
    flight = Recorded(policy, 0)
    events = [event for entry in flight.entries for event in json.loads(entry)['events']]
    states = sum(kind == 'state' for kind, *_ in events)
    assert 1 < states <= STEPS * 0.12 / STATE_PERIOD * 1.5 + 20
    told = sum(kind == 'step' and len(values) > 1 for kind, *values in events)
    assert told < len(flight.outcomes)


def test_another_mission_is_refused_in_one_line(policy: Policy) -> None:
    entries = Recorded(policy, 0).entries
    goals = tuple(replace(goal, name=f'{goal.name}x') for goal in MISSION.goals)
    renamed = replace(policy.mission, goals=goals)
    with pytest.raises(ValueError, match='recorded in a mission with other goals or another grid'):
        list(replayed(entries, build_policy(renamed)))


@pytest.mark.parametrize(
    'text',
    [
        '',
        'none',
        '[]',
        '{}',
        '[' * 100_000,
        '{"run": "a", "number": 0}',
        '{"run": "a", "number": 0, "events": [[]]}',
        '{"run": "a", "number": 0, "events": [["state"]]}',
        '{"run": "a", "number": 0, "events": [["state", {}]]}',
        '{"run": "a", "number": 0, "events": [["state", {"goals": 1}]]}',
    ],
)
def test_what_is_no_entry_is_refused_in_one_line(policy: Policy, text: str) -> None:
    with pytest.raises(ValueError, match=r'^[^\n]+$'):
        list(Replay(policy).take(text))


@pytest.mark.parametrize(
    'event',
    [
        ['hear', 'odom', 1.0, {'east': 1.0}],
        ['hear', 'odom', 1.0, {'east': 'far', 'north': 0.0}],
        ['hear', 'fault_mode', 1.0, {'name': 'tired'}],
        ['hear', 'no_topic', 1.0, {}],
        ['step'],
        ['dance'],
    ],
)
def test_what_is_no_event_is_refused_in_one_line(policy: Policy, event: list[object]) -> None:
    replay, [first] = Replay(policy), Recorded(policy, 0).entries[:1]
    list(replay.take(first))
    place = json.loads(first)
    entry = {'run': place['run'], 'number': place['number'] + 1, 'events': [event]}
    with pytest.raises(ValueError, match=r'^no entry of a trace: [^\n]+$'):
        list(replay.take(json.dumps(entry)))
