"""The paper's Case I, epoch by epoch: one goal in cell 5, base in cell 0, service in cell 1.

Priorities, threats and the completion are scripted; location, commitment and mode follow from the
policy's own actions. In a state, c and m are what the action of the epoch before left: the UAV
flies an epoch in the mode that its action names.
"""

from __future__ import annotations

import pytest
import yaml
from brute_force import BruteForce
from strategies import case_study

from uav_mission_manager import build_policy, load_mission, load_policy
from uav_mission_manager.mdp import THREAT_LEVELS, action_name, mission_from_dict
from uav_mission_manager.onboard import Situation, decide, format_command
from uav_mission_manager.paths import share_directory

CASE_ONE = share_directory() / 'config' / 'case_one.yaml'
SHIPPED = share_directory() / 'policies' / 'case_one'
TIMEOUT = 3.0

# epoch: g, t and whether the goal is completed in this epoch.
EVENTS = {
    1: (0, 0, False),
    2: (0, 0, False),
    3: (2, 0, False),  # The base station raises goal 1 to high.
    4: (2, 0, False),
    5: (2, 0, True),  # In cell 5 the goal is achieved.
    6: (0, 0, False),
    7: (0, 2, False),  # The threat goes high on the way home ..
    8: (0, 0, False),  # .. and goes.
    9: (0, 0, False),
}
EXPECTED = [
    # epoch, [f r g l c t m], action
    (1, (1, 1, 0, 0, 0, 0, 0), 'none normal'),
    (2, (1, 1, 0, 0, 0, 0, 0), 'none normal'),
    (3, (1, 1, 2, 0, 0, 0, 0), 'commit goal1 normal'),
    (4, (1, 1, 2, 1, 1, 0, 0), 'commit goal1 normal'),  # Committed.
    (5, (1, 1, 2, 5, 1, 0, 0), 'commit goal1 normal'),  # On the goal's cell, and it stays there.
    (6, (1, 1, 0, 5, 0, 0, 0), 'none normal'),  # Flag and commitment are 0; it turns for base.
    (7, (1, 1, 0, 1, 0, 2, 0), 'none agile'),  # Agile in the epoch of the threat itself.
    (8, (1, 1, 0, 0, 0, 0, 1), 'none normal'),  # Home, in normal mode again.
    (9, (1, 1, 0, 0, 0, 0, 0), 'none normal'),
]


@pytest.fixture(scope='module')
def policy():
    """The shipped policy set."""
    return load_policy(SHIPPED)


def fly(policy, document):
    """Rows as in EXPECTED, and the epochs whose state cannot follow in the reference model."""
    model = BruteForce(document)
    location, commitment, mode = 0, 0, 0
    rows, impossible, reachable = [], [], None
    for epoch, (g, t, completed) in EVENTS.items():
        state = (1, 1, g, location, commitment, t, mode)
        if reachable is not None and state not in reachable:
            impossible.append(epoch)
        action = policy.decide(state).action
        reachable = {after for after, p in model.successors(state, action.number) if p > 0}
        rows.append((epoch, state, action_name(policy.mission, action)))
        location = model.next_cell(location, action.destination)
        commitment, mode = 0 if completed else action.commitment, int(action.agile)
    return rows, impossible


def test_the_mission_is_the_case_study_with_goal_1_alone():
    assert yaml.safe_load(CASE_ONE.read_text()) == case_study(1, name='case_one')


def test_the_policy_is_of_the_mission(policy):
    assert policy.mission == load_mission(CASE_ONE)


def test_case_one_of_the_shipped_mission(policy):
    """Its service cell is safe, and lies on the way home: a threat there is the script's alone."""
    assert fly(policy, case_study(1)) == (EXPECTED, [7])


def test_case_one_where_threats_arise_anywhere():
    """Every epoch of Case I is one that the model itself can bring about."""
    document = case_study(1)
    document['threat']['zones'] = {}
    policy = build_policy(mission_from_dict(document, 'test'))
    assert fly(policy, document) == (EXPECTED, [])


def observe(situation, cell, now, fault='nominal'):
    """The situation with every required input fresh, at the centre of a cell."""
    position = situation.mission.grid.position(cell)
    return situation.with_battery(0.9, now).with_fault(fault, now).with_position(*position, now)


def test_case_one_through_the_onboard_layer(policy):
    """The manager decides five times an epoch, on site until it hears of the completion."""
    situation, grid_model = Situation(policy.mission), BruteForce(case_study(1))
    now, cell, rows = 0.0, 0, []
    for epoch, (g, t, completed) in EVENTS.items():
        if epoch == 3:
            situation = situation.with_priorities([g], 'raised', now)
        situation = situation.with_threat(THREAT_LEVELS[t], now)
        decisions = []
        for _ in range(5):
            now += 1.0
            situation = observe(situation, cell, now)
            decisions.append(decide(policy, situation, now, TIMEOUT))
            situation = situation.after(decisions[-1].action)
        [command] = {format_command(policy.mission, decision.action) for decision in decisions}
        rows.append((epoch, decisions[0].state, command))
        if completed:
            situation = situation.with_completed('goal1')
        cell = grid_model.next_cell(cell, decisions[-1].action.destination)
    assert rows == EXPECTED


@pytest.mark.parametrize('fault', ['sensor', 'actuator', 'sensor_actuator'])
def test_a_goal_that_is_not_completed_at_first_is_stayed_at(policy, fault):
    """With these faults completion takes more than an epoch; only a threat changes the mode."""
    situation = Situation(policy.mission).with_priorities([2], 'raised', 0.0)
    for now in range(60):
        threat = THREAT_LEVELS[now // 10 % 3]
        situation = observe(situation, 5, float(now), fault).with_threat(threat, float(now))
        action = decide(policy, situation, float(now), TIMEOUT).action
        mode = 'agile' if threat == 'high' else 'normal'
        assert format_command(policy.mission, action) == f'commit goal1 {mode}'
        situation = situation.after(action)
    completed = situation.with_completed('goal1')
    assert decide(policy, completed, 60.0, TIMEOUT).action.goal is None


@pytest.mark.parametrize(
    ('event', 'command'),
    [({'f': 3}, 'repair'), ({'r': 0}, 'recharge'), ({'g': 0}, 'none normal')],
)
def test_what_ends_the_commitment_on_the_way(policy, event, command):
    """At epoch 4, on the way: a weak motor, no range or no wish for the goal."""
    state = {'f': 1, 'r': 1, 'g': 2, 'l': 1, 'c': 1, 't': 0, 'm': 0} | event
    assert action_name(policy.mission, policy.decide(list(state.values())).action) == command
