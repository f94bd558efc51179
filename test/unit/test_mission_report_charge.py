"""`mission_report` of a flight with one battery: states have a level, and no range flags."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest
from brute_force import BruteForce
from strategies import case_study, with_charge
from test_mission_report import Message, Page, bag_of, decided, refusal, report, string

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.nodes.reporting import state_in_words
from uav_mission_manager.onboard import format_command
from uav_mission_manager.policy import Policy

LEVELS = 12
DOCUMENT = with_charge(case_study(), levels=LEVELS, reserve=0.2)
STATES = (
    (1, 11, 2, 0, 1, 0, 0, 0, 0),
    (1, 10, 2, 0, 1, 4, 1, 0, 0),
    (1, 10, 0, 0, 1, 5, 1, 0, 0),
    (1, 2, 0, 0, 1, 6, 3, 2, 0),
    (1, 11, 0, 0, 1, 1, 0, 0, 0),
)
"""Goal 1 is flown to and done, the battery falls, is charged; goal 3 is wanted all the time."""


@pytest.fixture(scope='module')
def policy() -> Policy:
    return build_policy(mission_from_dict(DOCUMENT, 'test'))


def flight(policy: Policy) -> list[Message]:
    """A decision of the policy in each state, an epoch of 10 s each."""
    messages = []
    for number, state in enumerate(STATES):
        decision = policy.decide(state)
        values = {
            'state': ' '.join(map(str, state)),
            'values': ' '.join(map(repr, decision.values)),
            **state_in_words(policy.mission, state),
        }
        command = format_command(policy.mission, decision.action)
        messages.append(decided(max(10.0 * number - 0.1, 0.0), command, **values))
    return [*messages, string(10.0 * len(STATES) - 9.0, '/uav1/fault_mode', 'nominal')]


def reach(state: tuple[int, ...]) -> tuple[int, ...]:
    """Range flags of a state, by the reference model."""
    return BruteForce(DOCUMENT).split(state)[1]


def lost_and_back() -> list[tuple[int, str]]:
    """What a story must tell of range, with the number of the state: by the reference model."""
    found = []
    for number, (before, after) in enumerate(pairwise(map(reach, STATES)), 1):
        for text, changed in (
            ('out of range', [j for j in range(3) if before[j] > after[j]]),
            ('in range again', [j for j in range(3) if before[j] < after[j]]),
        ):
            if changed:
                found.append((number, changed, text))
    return found


@pytest.fixture(scope='module')
def bag(policy: Policy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag_of(tmp_path_factory.mktemp('charge') / 'bag', flight(policy))


@pytest.fixture(scope='module')
def policy_set(policy: Policy, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp('sets') / 'charge'
    policy.save(folder)
    return str(folder)


@pytest.mark.parametrize('known', [True, False])
def test_what_falls_out_of_range_is_told_with_and_without_the_mission(
    tmp_path: Path, bag: Path, policy_set: str, known: bool
) -> None:
    options = ('--policy', policy_set) if known else ()
    page = Page(report(tmp_path / 'r.html', bag, *options))
    told = '\n'.join(row[3] for row in page.table('what', 'why') if len(row) > 3)
    expected = lost_and_back()
    assert {text for _, _, text in expected} == {'out of range', 'in range again'}
    for _, goals, text in expected:
        names = ', '.join(f'goal{j + 1}' if known else f'goal {j + 1}' for j in goals)
        assert f'{text}: {names}' in told


def test_the_timeline_has_the_level_and_what_is_out_of_range(
    tmp_path: Path, bag: Path, policy: Policy
) -> None:
    text = report(tmp_path / 'r.html', bag)
    [svg] = re.findall(r'<svg class="timeline".*?</svg>', text, re.S)
    for state in STATES:
        assert f'>{state[1]}</text>' in svg
        assert 'state ' + policy.space.text(state) in svg
    wanted_out = [any(g and not r for g, r in zip(state[2:5], reach(state))) for state in STATES]
    assert wanted_out.count(True) == svg.count('>out</text>') == 1
    assert f'level of the charge (0 to {LEVELS - 1})' in text


def test_the_cost_is_the_reference_models(
    tmp_path: Path, bag: Path, policy: Policy, policy_set: str
) -> None:
    page = Page(report(tmp_path / 'r.html', bag, '--policy', policy_set))
    model, discount = BruteForce(DOCUMENT), policy.mission.discount
    epochs = len(STATES) - 1
    numbers = [policy.decide(state).action.number for state in STATES]
    paid = sum(discount**n * model.cost(STATES[n], numbers[n]) for n in range(epochs))
    first, last = (min(policy.decide(state).values) for state in (STATES[0], STATES[-1]))
    left = discount**epochs * last
    rows = [float(row[1]) for row in page.tables[-2][1:]]
    assert rows == pytest.approx([first, paid, left, paid + left - first], abs=0.02)


def test_a_goal_is_asked_for_and_over(tmp_path: Path, bag: Path, policy_set: str) -> None:
    page = Page(report(tmp_path / 'r.html', bag, '--policy', policy_set))
    rows = [row[:5] for row in page.table('goal', 'priority')]
    assert rows == [
        ['goal1', 'high', '0:00', '0:00', 'no longer asked for at 0:20'],
        ['goal3', 'low', '0:00', '0:20', 'still open'],
    ]


def test_a_level_that_there_is_not_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = {'charge level': '12 of 0 to 11'}
    bag = bag_of(tmp_path / 'bag', [decided(0.0, state='1 12 2 2 0 0 0 0', **words)])
    line = refusal([str(bag), '--out', str(tmp_path / 'r.html')], capsys)
    assert (
        'at 0.00 s: manager/decision: state: (1, 12, 2, 2, 0, 0, 0, 0) has 12 where 0 to 11'
        in line
    )


def test_flags_and_charge_are_told_apart_where_their_states_are_as_long(tmp_path: Path) -> None:
    """Five goals with a charge have as many variables as three with range flags."""
    words = {'charge level': '9 of 0 to 15', **{f'g{j} in range': 'yes' for j in range(5)}}
    state = '1 9 2 0 2 0 1 7 1 0 0'
    charged = report(
        tmp_path / 'a.html', bag_of(tmp_path / 'a', [decided(0.0, state=state, **words)])
    )
    flags = report(tmp_path / 'b.html', bag_of(tmp_path / 'b', [decided(0.0)]))
    assert 'state f=1 b=9 g1=2 g2=0 g3=2 g4=0 g5=1 l=7 c=1 t=0 m=0' in charged
    assert 'state f=1 r1=1 r2=1 r3=1 g1=0 g2=0 g3=0 l=0 c=0 t=0 m=0' in flags


def test_a_turn_is_told_with_the_charge_at_which_it_would_have_been_otherwise(
    tmp_path: Path, policy: Policy, policy_set: str
) -> None:
    states = (1, 11, 2, 0, 1, 4, 0, 0, 0), (1, 10, 2, 0, 1, 5, 0, 0, 0)
    assert reach(states[0]) == reach(states[1])
    messages, values = [], []
    for number, (state, goal) in enumerate(zip(states, (1, 3))):
        decision = policy.decide(state)
        values.append([decision.values[j] for j in (3, 1)])  # Of goal 3, then of goal 1.
        told = {
            'state': ' '.join(map(str, state)),
            'values': ' '.join(map(repr, decision.values)),
            **state_in_words(policy.mission, state),
        }
        messages.append(decided(10.0 * number, f'commit goal{goal} normal', **told))
    bag = bag_of(tmp_path / 'bag', messages)
    page = Page(report(tmp_path / 'r.html', bag, '--policy', policy_set))
    [(new_then, old_then), (new, old)] = values
    assert (
        f'this costs {new:.4g} from there, GO TO goal1 {old:.4g}; from cell 4 at charge 11 it was '
        f'{new_then:.4g} and {old_then:.4g}'
    ) in page.table('what', 'why')[-1][3]
