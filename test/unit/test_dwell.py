"""How long a command stays, and what is never waited for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.mdp import FAULT_MODES, global_actions
from uav_mission_manager.onboard import (
    Situation,
    StandingCommand,
    decide,
    dwell,
    format_command,
)
from uav_mission_manager.policy import Decision, Policy

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')
ACTIONS = {format_command(MISSION, action): action for action in global_actions(MISSION)}
DWELL = 5.0
SERVICE, BESIDE = 1, 2
"""With a sensor failed the policy says `repair` in the service cell, `commit goal1` beside it."""


@pytest.fixture(scope='module')
def policy() -> Policy:
    return build_policy(MISSION)


def at(cell: int, fault: str = 'sensor', priorities: tuple[int, ...] = (2, 0, 1)) -> Situation:
    start = Situation(MISSION, priorities=priorities, request='a')
    east, north = MISSION.grid.position(cell)
    return start.with_battery(0.9, 0.0).with_fault(fault, 0.0).with_position(east, north, 0.0)


def step(
    policy: Policy,
    situation: Situation,
    standing: StandingCommand | None,
    now: float,
    seconds: float = DWELL,
) -> tuple[Decision, StandingCommand]:
    """Return what is commanded at a time, with inputs that are never too old."""
    decision = decide(policy, situation, now, math.inf)
    assert isinstance(decision, Decision)
    return dwell(decision, situation, standing, seconds, now)


def command(decision: Decision) -> str:
    return format_command(MISSION, decision.action)


@pytest.fixture
def standing(policy: Policy) -> StandingCommand:
    """Repair, given at time 0 on the border of the service cell."""
    decision, standing = step(policy, at(SERVICE), None, 0.0)
    assert command(decision) == 'repair'
    return standing


def test_a_command_is_kept_over_the_border_of_a_cell(
    policy: Policy, standing: StandingCommand
) -> None:
    commands = []
    for tenth in range(2, 60):
        decision, standing = step(policy, at(BESIDE), standing, tenth / 10)
        commands.append(command(decision))
    assert commands == ['repair'] * 48 + ['commit goal1 normal'] * 10
    # The next change of mind waits for as long.
    decision, standing = step(policy, at(SERVICE), standing, 9.9)
    assert (command(decision), standing.until) == ('commit goal1 normal', 10.0)
    assert command(step(policy, at(SERVICE), standing, 10.0)[0]) == 'repair'


def test_a_kept_command_says_so(policy: Policy, standing: StandingCommand) -> None:
    said, wanted = (
        step(policy, at(BESIDE), standing, 1.9)[0],
        policy.decide(at(BESIDE).state),
    )
    assert said.reason == (
        'keeps repair for 3.1 s more; the policy now says commit goal1 normal: ' + wanted.reason
    )
    assert (said.runner_up, said.state) == (wanted.action, wanted.state)
    values = said.values
    assert said.margin == values[wanted.action.number - 1] - values[said.action.number - 1] < 0


def test_without_dwell_the_policy_is_followed(policy: Policy, standing: StandingCommand) -> None:
    decision, _ = step(policy, at(BESIDE), standing, 0.1, seconds=0.0)
    assert decision == policy.decide(at(BESIDE).state)


def test_a_first_command_waits_for_nothing(policy: Policy) -> None:
    assert command(step(policy, at(BESIDE), None, 0.1)[0]) == 'commit goal1 normal'


def test_what_the_policy_says_again_is_no_change(
    policy: Policy, standing: StandingCommand
) -> None:
    decision, later = step(policy, at(SERVICE), standing, 4.0)
    assert decision == policy.decide(at(SERVICE).state)
    assert later.until == DWELL


@pytest.mark.parametrize(
    'change',
    [
        lambda s: s.with_fault('sensor_actuator', 1.0),
        lambda s: s.with_fault('actuator', 1.0),  # One bit less, and one more.
        lambda s: s.with_threat('low', 1.0),
        lambda s: s.with_battery(0.2125, 1.0),  # goal2 falls out of range.
        lambda s: s.with_fault('nominal', 1.0),  # There is nothing to repair.
    ],
)
def test_danger_and_a_senseless_command_do_not_wait(
    policy: Policy,
    standing: StandingCommand,
    change: Callable[[Situation], Situation],
) -> None:
    situation = change(at(BESIDE))
    decision, _ = step(policy, situation, standing, 1.0)
    assert command(decision) != 'repair'
    assert decision == decide(policy, situation, 1.0, math.inf)


@pytest.mark.parametrize(
    'change',
    [
        lambda s: s.with_refused('goal3'),
        lambda s: s.with_completed('goal3'),
        lambda s: s.with_priorities([2, 0, 1], 'b', 1.0),
        lambda s: s.with_priorities([0, 1, 0], 'c', 1.0),
    ],
)
def test_a_new_task_waits(
    policy: Policy, standing: StandingCommand, change: Callable[[Situation], Situation]
) -> None:
    situation = change(at(BESIDE))
    assert command(decide(policy, situation, 1.0, math.inf)) != 'repair'
    assert command(step(policy, situation, standing, 1.0)[0]) == 'repair'


def test_when_nothing_is_wanted_any_more_it_does_not_wait(policy: Policy) -> None:
    situation = at(BESIDE, 'nominal', (0, 0, 0))
    for wanted, said in ((True, 'none normal'), (False, 'none agile')):
        standing = StandingCommand(ACTIONS['none agile'], DWELL, frozenset(), wanted)
        assert command(step(policy, situation, standing, 1.0)[0]) == said


def test_a_first_wish_does_not_wait(policy: Policy) -> None:
    situation = at(BESIDE, 'nominal', (2, 0, 1))
    for wanted, said in ((False, 'commit goal1 normal'), (True, 'none normal')):
        standing = StandingCommand(ACTIONS['none normal'], DWELL, frozenset(), wanted)
        assert command(step(policy, situation, standing, 1.0)[0]) == said


def test_a_danger_that_comes_whenever_it_hurts_changes_the_command_no_more_often(
    policy: Policy,
) -> None:
    """It comes when the command has gone back to normal, and goes as soon as it is heeded."""
    calm, danger = at(BESIDE), at(BESIDE).with_threat('high', 0.0)
    standing, changes, agile = None, [], True
    for tenth in range(3000):
        decision, standing = step(policy, calm if agile else danger, standing, tenth / 10.0)
        if decision.action.agile != agile:
            agile = decision.action.agile
            changes.append(tenth / 10.0)
    assert len(changes) > 50
    assert max(sum(t <= time < t + 60.0 for time in changes) for t in changes) <= 13


def test_danger_that_was_there_before_is_no_reason(
    policy: Policy, standing: StandingCommand
) -> None:
    harmless = replace(standing, dangers=at(SERVICE).with_threat('low', 0.0).dangers.counted)
    assert command(step(policy, at(BESIDE), harmless, 1.0)[0]) == 'repair'
    worse = replace(standing, dangers=at(SERVICE, fault='all').dangers.counted)
    assert command(step(policy, at(BESIDE), worse, 1.0)[0]) == 'repair'


@pytest.mark.parametrize(
    'change',
    [lambda s: s.with_completed('goal1'), lambda s: s.with_refused('goal1')],
)
def test_a_goal_that_is_done_or_refused_is_left_at_once(
    policy: Policy, change: Callable[[Situation], Situation]
) -> None:
    # The task has been changed a step before: what is left is a commitment without sense, which
    # `paper` missions allow.
    paper = replace(MISSION, feasibility='paper')
    free, situation = build_policy(paper), change(at(BESIDE))
    counted = situation.dangers.counted
    standing = StandingCommand(ACTIONS['commit goal1 normal'], DWELL, counted, wanted=True)
    decision, _ = step(free, situation, standing, 1.0)
    assert 'keeps' not in decision.reason


def test_after_a_clock_set_back_it_waits_for_the_longest_wait_at_most(
    policy: Policy, standing: StandingCommand
) -> None:
    decision, standing = step(policy, at(BESIDE), standing, -100.0)
    assert (command(decision), standing.until) == ('repair', -90.0)
    assert command(step(policy, at(BESIDE), standing, -90.1)[0]) == 'repair'
    assert command(step(policy, at(BESIDE), standing, -90.0)[0]) == 'commit goal1 normal'


STEPS = st.lists(
    st.tuples(
        st.integers(0, MISSION.grid.q - 1),
        st.sampled_from(FAULT_MODES),
        st.sampled_from([(2, 0, 1), (0, 1, 2), (0, 0, 0)]),
        st.floats(0.0, 3.0),
    ),
    max_size=30,
)


@given(steps=STEPS)
def test_what_is_commanded_is_always_allowed_and_late_by_the_dwell_at_most(
    policy: Policy, steps: list[tuple[int, str, tuple[int, ...], float]]
) -> None:
    standing, now, agreed = None, 0.0, 0.0
    for cell, fault, priorities, pause in steps:
        now += pause
        situation = at(cell, fault, priorities)
        decision, standing = step(policy, situation, standing, now)
        assert math.isfinite(decision.values[decision.action.number - 1])
        if decision.action == policy.decide(situation.state).action:
            agreed = now
        assert now - agreed < DWELL or now < standing.until <= now + 2.0 * DWELL
