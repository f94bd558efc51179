from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from uav_mission_manager import load_policy

CASE_STUDY = Path(__file__).parents[2] / 'policies' / 'case_study'
STATE = (1, 1, 1, 1, 2, 0, 1, 0, 0, 0, 0)


def test_a_state_is_looked_up_once(monkeypatch):
    policy = load_policy(CASE_STUDY)
    first = policy.decide(STATE)
    monkeypatch.setattr(policy, 'look_up', None)
    assert policy.decide(np.array(STATE)) is first


def test_a_command_does_not_wait_for_bounds(monkeypatch):
    policy = load_policy(CASE_STUDY)
    asked = []
    bounds = policy.own_lower_bound
    monkeypatch.setattr(policy, 'own_lower_bound', lambda rows: asked.append(1) or bounds(rows))
    decision = policy.decide(STATE)
    assert not asked
    assert decision.lower_bound == policy.lower_bound([STATE])[0]
    assert decision.upper_bound == policy.upper_bound([STATE])[0]


def test_policy_and_decision_can_be_sent_to_another_process():
    policy = load_policy(CASE_STUDY)
    decision = policy.decide(STATE)
    sent_policy, sent_decision = pickle.loads(pickle.dumps((policy, decision)))
    assert sent_policy.decide(STATE) == decision == sent_decision
    assert sent_decision.upper_bound == decision.upper_bound
