"""The manager's decision in words, for people who read it on the topic."""

from __future__ import annotations

import pytest
from strategies import case_study, with_charge

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.nodes.reporting import charge_left, decision_status
from uav_mission_manager.onboard import Refusal, Situation

STATE = (3, 1, 0, 1, 0, 2, 1, 6, 2, 1, 1)
MISSION = mission_from_dict(case_study(), 'test')


@pytest.fixture(scope='module')
def policy():
    return build_policy(MISSION)


def told(outcome, situation):
    status = decision_status('uav1: decision', outcome, situation, 1.0, 'digest')
    keys = [pair.key for pair in status.values]
    assert len(set(keys)) == len(keys)
    return {pair.key: pair.value for pair in status.values}


def test_every_variable_of_the_state_is_there_by_name(policy):
    values = told(policy.decide(STATE), Situation(MISSION))
    expected = {
        'fault mode': 'actuator',
        'goal1 in range': 'yes',
        'goal2 in range': 'no',
        'goal3 in range': 'yes',
        'goal1 priority': 'no',
        'goal2 priority': 'high',
        'goal3 priority': 'low',
        'cell': '6, column 2 and row 1 from 0',
        'committed to': 'goal2',
        'threat': 'low',
        'flight mode': 'agile',
    }
    assert {key: values[key] for key in expected} == expected
    assert len(expected) == len(STATE)


def test_a_charge_and_what_it_reaches_are_there_by_name():
    mission = mission_from_dict(with_charge(case_study(), levels=8), 'test')
    policy = build_policy(mission)
    for level, flag in ((7, 'yes'), (0, 'no')):
        values = told(policy.decide((1, level, 0, 2, 1, 6, 2, 1, 1)), Situation(mission))
        assert values['charge level'] == f'{level} of 0 to 7'
        assert [values[f'goal{j} in range'] for j in (1, 2, 3)] == [flag] * 3
        assert [values[f'goal{j} priority'] for j in (1, 2, 3)] == ['no', 'high', 'low']
        assert values['committed to'] == 'goal2'


def test_every_action_has_its_cost_by_name(policy):
    decision = policy.decide(STATE)
    values = told(decision, Situation(MISSION))
    costs = {key: value for key, value in values.items() if key.startswith('cost of ')}
    names = ['none', 'commit goal1', 'commit goal2', 'commit goal3']
    assert list(costs) == [
        *(f'cost of {name} {mode}' for mode in ('normal', 'agile') for name in names),
        'cost of recharge',
        'cost of repair',
    ]
    numbers = [float('inf' if text == 'not allowed' else text) for text in costs.values()]
    assert numbers == pytest.approx(decision.values, rel=1e-5)
    assert 'not allowed' in costs.values()
    assert min(numbers) == pytest.approx(float(costs[f'cost of {values["command"]}']))


def test_what_the_range_follows_from_has_its_units(policy):
    situation = Situation(MISSION).with_battery(0.5, 0.0).with_position(12.34, -5.0, 0.0)
    values = told(policy.decide(STATE), situation)
    assert (values['charge [%]'], values['range [m]']) == ('50.0', '1664')
    assert (values['east [m]'], values['north [m]']) == ('12.3', '-5.0')
    assert values['age odom [s]'] == '1.00'
    assert not {'charge [%]', 'range [m]', 'east [m]'} & set(
        told(policy.decide(STATE), Situation(MISSION))
    )


def test_an_unhealthy_battery_counts_as_empty():
    assert charge_left(Situation(MISSION)) is None
    assert charge_left(Situation(MISSION).with_battery(0.5, 0.0)) == 0.5
    assert charge_left(Situation(MISSION).with_battery(0.5, 0.0, healthy=False)) == 0.0


def test_without_a_decision_nothing_is_made_up():
    assert set(told(Refusal('link lost'), Situation(MISSION))) == {'refused_goals', 'policy'}
