"""The paper's Case I, epoch by epoch: one goal in cell 5, base in cell 0, service in cell 1.

The outer events are scripted; location, commitment and mode follow from the policy's own
actions. The commitment and the mode of a state are those the previous epoch's action ordered.
In the completing epoch the UAV moves already, since completion asks only where it is: it is a
cell nearer to base at epoch 6 than in the paper's figure, and home at 7.
"""

from __future__ import annotations

import pytest
from brute_force import BruteForce
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import action_name, mission_from_dict

# epoch: g, t and whether the goal is completed in this epoch.
EVENTS = {
    1: (0, 0, False),
    2: (0, 0, False),
    3: (2, 0, False),  # The base station raises goal 1 to high.
    4: (2, 0, False),
    5: (2, 0, True),  # In cell 5 the goal is achieved.
    6: (0, 2, False),
    7: (0, 2, False),  # The threat goes high on the way home ..
    8: (0, 0, False),
    9: (0, 0, False),  # .. and goes.
}
EXPECTED = [
    # epoch, g, l, c, t, m, action
    (1, 0, 0, 0, 0, 0, 'none normal'),
    (2, 0, 0, 0, 0, 0, 'none normal'),
    (3, 2, 0, 0, 0, 0, 'commit goal1 normal'),
    (4, 2, 1, 1, 0, 0, 'commit goal1 normal'),
    (5, 2, 5, 1, 0, 0, 'none normal'),
    (6, 0, 1, 0, 2, 0, 'none agile'),
    (7, 0, 0, 0, 2, 1, 'none agile'),
    (8, 0, 0, 0, 0, 1, 'none normal'),
    (9, 0, 0, 0, 0, 0, 'none normal'),
]


def fly(document):
    """Rows as in EXPECTED, and the epochs whose successor the model gives no probability."""
    policy = build_policy(mission_from_dict(document, 'test'))
    model = BruteForce(document)
    location, commitment, mode = 0, 0, 0
    rows, impossible, reachable = [], [], None
    for epoch, (g, t, completed) in EVENTS.items():
        state = (1, 1, g, location, commitment, t, mode)
        if reachable is not None and state not in reachable:
            impossible.append(epoch)
        action = policy.decide(state).action
        reachable = {after for after, _ in model.successors(state, action.number)}
        rows.append((epoch, *state[2:], action_name(policy.mission, action)))
        location = model.next_cell(location, action.destination)
        commitment, mode = 0 if completed else action.goal, int(action.agile)
    return rows, impossible


def test_case_one_of_the_shipped_mission():
    """In the shipped mission no threat arises over the service cell: epoch 6 is a script's."""
    assert fly(case_study(1)) == (EXPECTED, [6])


def test_case_one_where_threats_arise_anywhere():
    """Without safe cells every epoch of Case I is one the model itself can bring about."""
    document = case_study(1)
    document['threat']['zones'] = {}
    assert fly(document) == (EXPECTED, [])


@pytest.mark.parametrize(
    'event',
    [
        {'f': 3},
        {'r': 0},
        {'g': 0},
    ],
    ids=str,
)
def test_what_ends_the_commitment_on_the_way(event):
    """At epoch 4, on the way: a weak motor, no range or no wish for the goal."""
    policy = build_policy(mission_from_dict(case_study(1), 'test'))
    state = {'f': 1, 'r': 1, 'g': 2, 'l': 1, 'c': 1, 't': 0, 'm': 0} | event
    expected = {'f': 'repair', 'r': 'recharge', 'g': 'none'}[next(iter(event))]
    assert policy.decide(list(state.values())).action.kind == expected
