"""Inputs to state and decision, with time as an argument."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_mission_manager import build_policy, load_mission
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, StateSpace, global_actions
from uav_mission_manager.mdp.routes import next_hops
from uav_mission_manager.onboard import InputError, Refusal, Situation, decide, format_command
from uav_mission_manager.onboard.deciding import without_refused
from uav_mission_manager.policy import Decision, Policy

MISSION = load_mission(Path(__file__).parents[2] / 'config' / 'case_study.yaml')
ACTIONS = global_actions(MISSION)
TIMEOUT = 3.0


@pytest.fixture(scope='module')
def policy() -> Policy:
    return build_policy(MISSION)


def at(cell: int, now: float = 0.0, **changes: Any) -> Situation:
    """Return a charged, healthy UAV over a cell with every input fresh."""
    start = replace(Situation(MISSION), **changes).with_threat('none', now)
    east, north = MISSION.grid.position(cell)
    return start.with_battery(0.9, now).with_fault('nominal', now).with_position(east, north, now)


def command(outcome: Decision | Refusal) -> str:
    assert isinstance(outcome, Decision), outcome
    return format_command(MISSION, outcome.action)


def test_state_row_order() -> None:
    situation = (
        at(6)
        .with_fault('actuator', 0.0)
        .with_threat('low', 0.0)
        .with_priorities([0, 1, 2], 'a', 0.0)
        .after(ACTIONS[6])
    )
    assert situation.state == (3, 1, 1, 1, 0, 1, 2, 6, 2, 1, 1)


def test_start_is_idle_nominal_and_unthreatened() -> None:
    assert Situation(MISSION).state == (1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0)


def test_mission_without_energy_is_refused() -> None:
    with pytest.raises(ValueError, match='mission case_study: no energy section'):
        Situation(replace(MISSION, energy=None))


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        (lambda s: s.with_battery(math.nan, 9.0), 'battery_state: percentage nan'),
        (lambda s: s.with_battery(-0.01, 9.0), 'battery_state: percentage -0.01'),
        (lambda s: s.with_battery(80.0, 9.0), 'battery_state: percentage 80.0'),
        (lambda s: s.with_position(math.nan, 0.0, 9.0), 'odom: position'),
        (lambda s: s.with_position(0.0, math.inf, 9.0), 'odom: position'),
        (lambda s: s.with_fault('engine', 9.0), "fault_mode: 'engine' is not one of nominal"),
        (lambda s: s.with_threat('HIGH', 9.0), "threat_level: 'HIGH' is not one of none"),
        (
            lambda s: s.with_priorities([2, 0], 'b', 9.0),
            'goal_priorities: data has 2 values, not 3',
        ),
        (lambda s: s.with_priorities([2, 0, 3], 'b', 9.0), 'goal_priorities: goal3 is 3'),
        (lambda s: s.with_completed('goal9'), "goal_completed: 'goal9' is not one of goal1"),
        (lambda s: s.with_refused('goal9'), "goal_refused: 'goal9' is not one of goal1"),
    ],
)
def test_bad_input_is_one_line_and_changes_nothing(
    change: Callable[[Situation], Situation],
    words: str,
) -> None:
    situation = at(4).with_priorities([1, 2, 0], 'a', 0.0)
    with pytest.raises(InputError) as error:
        change(situation)
    assert str(error.value).startswith(words)
    assert '\n' not in str(error.value)
    assert situation == at(4).with_priorities([1, 2, 0], 'a', 0.0)


def test_a_repeated_request_never_revives_a_completed_goal() -> None:
    situation = at(5).with_priorities([2, 1, 0], 'a', 0.0).with_completed('goal1')
    assert situation.with_priorities([2, 1, 0], 'a', 1.0).priorities == (0, 1, 0)
    assert situation.with_priorities([2, 1, 0], 'b', 1.0).priorities == (2, 1, 0)


def test_a_goal_that_a_repetition_asks_for_no_more_was_achieved_unheard() -> None:
    situation = at(5).with_priorities([2, 1, 0], 'a', 0.0).after(ACTIONS[1])
    repeated = situation.with_priorities([0, 1, 0], 'a', 1.0)
    assert (repeated.priorities, repeated.commitment) == ((0, 1, 0), 0)
    by_hand = repeated.with_priorities([2, 2, 2], '', 2.0)
    assert by_hand.with_priorities([0, 1, 0], 'a', 3.0).priorities == (2, 2, 2)
    assert by_hand.with_priorities([0, 0, 0], 'a', 3.0).priorities == (2, 0, 2)


def test_a_message_without_id_is_always_a_new_request() -> None:
    situation = at(5).with_priorities([2, 1, 0], 'a', 0.0).with_completed('goal1')
    by_hand = situation.with_priorities([2, 0, 0], '', 1.0)
    assert by_hand.priorities == (2, 0, 0)
    # The base station's repetition is still a repetition.
    assert by_hand.with_priorities([2, 1, 0], 'a', 2.0).priorities == (2, 0, 0)


def test_completion_is_idempotent_and_ends_its_own_commitment_only() -> None:
    situation = at(5).with_priorities([2, 1, 0], 'a', 0.0).after(ACTIONS[1])
    done = situation.with_completed('goal1')
    assert (done.priorities, done.commitment) == ((0, 1, 0), 0)
    assert done.with_completed('goal1') == done
    assert situation.with_completed('goal2').commitment == 1


def test_reset_drops_goals_but_not_the_request_id() -> None:
    situation = at(5).with_priorities([2, 1, 0], 'a', 0.0).after(ACTIONS[1]).without_goals()
    assert (situation.priorities, situation.commitment) == ((0, 0, 0), 0)
    assert situation.with_priorities([2, 1, 0], 'a', 1.0).priorities == (0, 0, 0)


def test_range_flags_follow_battery_and_come_back_with_a_margin() -> None:
    # goal1 and back is 121 m from the base: sigma = 5328 SoC - 1000 m.
    situation = at(0)
    empty = situation.with_battery(0.20, 1.0)
    assert empty.in_range == (0, 0, 0)
    assert empty.with_battery(0.234, 2.0).in_range == (0, 0, 0)
    assert empty.with_battery(0.236, 2.0).in_range == (1, 0, 0)
    assert situation.with_battery(0.212, 1.0).in_range == (1, 0, 0)


def test_a_refused_goal_is_out_of_range_until_priorities_are_asked_for_anew() -> None:
    situation = at(0).with_priorities([2, 1, 0], 'a', 0.0).after(ACTIONS[1])
    refused = situation.with_refused('goal1')
    assert refused.state == (1, 0, 1, 1, 2, 1, 0, 0, 1, 0, 0)
    assert refused.with_refused('goal1') == refused
    assert refused.refused_goals == ('goal1',)
    # Neither a full battery nor the repetition of the request brings it back.
    assert refused.with_battery(1.0, 1.0).state[1] == 0
    assert refused.with_priorities([2, 1, 0], 'a', 1.0).state[1] == 0
    for anew in (
        refused.with_priorities([2, 1, 0], 'b', 1.0),
        refused.with_priorities([1, 1, 0], '', 1.0),
        refused.without_goals(),
    ):
        assert (anew.state[1], anew.refused_goals, anew.warnings) == (1, (), ())
    repeated = refused.with_priorities([2, 0, 0], '', 1.0)
    assert repeated.refused_goals == ('goal1',)


def test_what_counts_as_worse_than_measured_is_said() -> None:
    situation = at(0)
    assert situation.warnings == ()
    assert situation.with_refused('goal3').with_refused('goal1').warnings == tuple(
        f'goal_refused: {name}, counted as out of range until priorities are asked for anew'
        for name in ('goal1', 'goal3')
    )
    assert situation.with_battery(0.9, 1.0, healthy=False).warnings == (
        'battery_state: reported unhealthy, counted as empty',
    )


def test_an_unhealthy_battery_counts_as_empty_whatever_it_holds() -> None:
    situation = at(0)
    for charge in (1.0, math.nan):
        bad = situation.with_battery(charge, 1.0, healthy=False)
        assert bad.in_range == (0, 0, 0)
        assert bad.with_position(50.0, 0.0, 2.0).in_range == (0, 0, 0)
    # 0.234 is enough to keep goal1, not to bring it back.
    assert bad.with_battery(0.234, 2.0).in_range == (0, 0, 0)
    assert bad.with_battery(0.236, 2.0).in_range == (1, 0, 0)
    assert bad.with_battery(0.236, 2.0).warnings == ()


def test_an_unhealthy_battery_reaches_not_even_a_goal_at_the_service_cell() -> None:
    grid = replace(MISSION.grid, service=MISSION.goals[0].cell)
    calm = replace(MISSION.energy, wind=0.0, payload=0.0)
    start = Situation(replace(MISSION, grid=grid, energy=calm))
    situation = start.with_position(*grid.position(grid.service), 0.0)
    assert situation.with_battery(0.0, 0.0).in_range[0] == 1
    assert situation.with_battery(1.0, 0.0, healthy=False).in_range[0] == 0


@pytest.mark.parametrize(('east', 'north'), [(-49.0, 0.0), (0.0, 49.0), (150.0, -99.0)])
def test_a_position_near_the_grid_counts_as_at_its_border(
    policy: Policy, east: float, north: float
) -> None:
    situation = at(0).with_position(east, north, 1.0)
    assert situation.cell == MISSION.grid.cell_at(east, north)
    assert isinstance(decide(policy, situation, 1.0, TIMEOUT), Decision)


@pytest.mark.parametrize(
    ('east', 'north', 'metres'),
    [(-52.0, 0.0, 27), (0.0, 51.0, 26), (175.0 + 30.0, -75.0 - 40.0, 50), (2500.0, 0.0, 2325)],
)
def test_off_the_grid_is_said(east: float, north: float, metres: int) -> None:
    situation = at(0).with_position(east, north, 1.0)
    assert situation.warnings == (situation.off_grid,) == (f'odom: {metres} m off the grid',)
    assert situation.with_position(0.0, 0.0, 2.0).warnings == ()


def test_only_stale_or_missing_required_inputs_are_named() -> None:
    assert Situation(MISSION).missing(0.0, TIMEOUT) == (
        'battery_state never received',
        'odom never received',
        'fault_mode never received',
    )
    situation = at(0, now=10.0).with_position(0.0, 0.0, 6.0)
    assert situation.missing(10.2, TIMEOUT) == ('odom 4.2 s old',)
    assert at(0, now=10.0).missing(13.0, TIMEOUT) == ()
    assert len(at(0, now=10.0).missing(5.0, TIMEOUT)) == 3  # the clock was set back


def test_decide_refuses_without_fresh_inputs_and_resumes(policy: Policy) -> None:
    situation = at(0, now=10.0)
    assert decide(policy, situation, 14.2, TIMEOUT) == Refusal(
        'link lost: battery_state 4.2 s old, odom 4.2 s old, fault_mode 4.2 s old'
    )
    assert command(decide(policy, at(0, now=14.2), 14.2, TIMEOUT)) == 'none normal'


def test_what_was_never_heard_is_waited_for_and_not_lost(policy: Policy) -> None:
    never = 'odom never received, fault_mode never received'
    assert decide(policy, Situation(MISSION), 1.0, TIMEOUT) == Refusal(
        f'waiting for data: battery_state never received, {never}'
    )
    heard = Situation(MISSION).with_battery(0.9, 1.0)
    assert decide(policy, heard, 2.0, TIMEOUT) == Refusal(f'waiting for data: {never}')
    assert decide(policy, heard, 9.0, TIMEOUT) == Refusal(
        f'link lost: battery_state 8.0 s old, {never}'
    )


def test_threat_and_priorities_hold_their_last_value(policy: Policy) -> None:
    situation = at(0, now=1000.0, priorities=(2, 0, 0)).with_threat('high', 0.0)
    assert isinstance(decide(policy, situation, 1000.0, TIMEOUT), Decision)
    assert situation.state[-2] == 2


@pytest.mark.parametrize(
    'change',
    [
        lambda s: s,
        lambda s: s.with_threat('high', 1.0),
        lambda s: s.with_fault('sensor', 1.0),
        lambda s: s.with_fault('camera', 1.0),
        lambda s: s.with_battery(0.1, 1.0),
        lambda s: s.with_priorities([0, 2, 2], 'b', 1.0),
        lambda s: s.with_position(0.0, 0.0, 1.0),
        lambda s: s.with_completed('goal1'),
    ],
)
def test_what_the_policy_says_is_commanded(
    policy: Policy,
    change: Callable[[Situation], Situation],
) -> None:
    situation = change(at(5, priorities=(2, 2, 2)).after(ACTIONS[1]))
    assert decide(policy, situation, 1.0, TIMEOUT) == policy.decide(situation.state)


def test_other_numbers_take_effect_at_once() -> None:
    thirsty = replace(MISSION, energy=replace(MISSION.energy, power=2500.0))
    assert at(0).with_mission(thirsty).in_range == (0, 0, 0)
    with pytest.raises(ValueError, match='no energy section'):
        at(0).with_mission(replace(MISSION, energy=None))


def test_a_refused_goal_is_not_committed_to(policy: Policy) -> None:
    for cell in range(MISSION.grid.q):
        situation = at(cell, priorities=(2, 2, 0)).with_refused('goal1')
        assert command(decide(policy, situation, 0.0, TIMEOUT)) == 'commit goal2 normal'


@pytest.mark.parametrize(
    ('priorities', 'expected'),
    [((2, 0, 0), 'none normal'), ((2, 1, 0), 'commit goal2 normal')],
)
def test_recharging_is_no_way_to_bring_a_refused_goal_back(
    policy: Policy,
    priorities: tuple[int, ...],
    expected: str,
) -> None:
    situation = at(MISSION.grid.service, priorities=priorities).with_refused('goal1')
    assert format_command(MISSION, policy.decide(situation.state).action) == 'recharge'
    outcome = decide(policy, situation, 0.0, TIMEOUT)
    assert command(outcome) == expected
    wanted = policy.decide(without_refused(situation).state)
    assert outcome.reason == f'as if goal1, refused, were not wanted: {wanted.reason}'
    assert (outcome.state, outcome.values) == (situation.state, wanted.values)
    # With a goal that is truly out of range, recharging has its use.
    empty = situation.with_battery(0.1, 1.0)
    assert command(decide(policy, empty, 1.0, TIMEOUT)) == 'recharge'


def last_command(policy: Policy, situation: Situation, cell: int) -> tuple[str, Situation]:
    """Fly cell by cell, without chance, until nothing more is to be done where the vehicle is."""
    for _ in range(60):
        situation = situation.with_position(*MISSION.grid.position(cell), 0.0)
        outcome = decide(policy, situation, 0.0, TIMEOUT)
        assert isinstance(outcome, Decision)
        action = outcome.action
        situation = situation.after(action)
        if cell != action.destination:
            cell = int(next_hops(MISSION.grid, action.destination)[cell])
        elif action.goal is not None:
            situation = situation.with_completed(MISSION.goals[action.goal].name)
        else:
            break
    return command(outcome), situation


@pytest.mark.parametrize('cell', range(MISSION.grid.q))
def test_with_a_goal_refused_the_others_are_completed_and_the_vehicle_goes_home(
    policy: Policy, cell: int
) -> None:
    for priorities in product((0, 1, 2), repeat=MISSION.k):
        for goal in MISSION.goals:
            start = at(cell, priorities=priorities).with_refused(goal.name)
            last, end = last_command(policy, start, cell)
            assert (last, without_refused(end).priorities) == ('none normal', (0,) * MISSION.k)


FLOATS = st.floats(allow_nan=True, allow_infinity=True)
WORDS = st.sampled_from([*FAULT_MODES, *THREAT_LEVELS, 'goal1', 'goal2', '', 'nonsense'])
EVENTS = st.one_of(
    st.builds(
        lambda x, h: lambda s, t: s.with_battery(x, t, h),
        FLOATS | st.floats(0.0, 1.0),
        st.booleans(),
    ),
    st.builds(
        lambda x, y: lambda s, t: s.with_position(x, y, t),
        FLOATS | st.floats(-200.0, 400.0),
        FLOATS | st.floats(-400.0, 200.0),
    ),
    st.builds(lambda w: lambda s, t: s.with_fault(w, t), WORDS),
    st.builds(lambda w: lambda s, t: s.with_threat(w, t), WORDS),
    st.builds(
        lambda v, w: lambda s, t: s.with_priorities(v, w, t),
        st.lists(st.integers(0, 3), min_size=2, max_size=4),
        WORDS,
    ),
    st.builds(lambda w: lambda s, t: s.with_completed(w), WORDS),
    st.builds(lambda w: lambda s, t: s.with_refused(w), WORDS),
    st.builds(lambda n: lambda s, t: s.after(ACTIONS[n]), st.integers(0, 9)),
    st.just(lambda s, t: s.without_goals()),
)


@given(events=st.lists(EVENTS, max_size=30))
def test_no_sequence_of_inputs_leaves_the_state_space(
    policy: Policy,
    events: list[Callable[[Situation, float], Situation]],
) -> None:
    space, situation = StateSpace(MISSION.k, MISSION.grid.q), at(0)
    for now, event in enumerate(events):
        with suppress(InputError):
            situation = event(situation, float(now))
        space.check(situation.state)
        outcome = decide(policy, situation, float(now), 1e9)
        assert isinstance(outcome, Decision)
        action = outcome.action
        assert action.goal is None or situation.priorities[action.goal] > 0
        assert action.goal is None or situation.reachable[action.goal]
