"""The shipped survey: its numbers are plausible, and its policy set is what is built from it."""

from __future__ import annotations

import numpy as np
import pytest

from uav_mission_manager import build_policy, load_mission, load_policy
from uav_mission_manager.cli.check.plausibility import findings
from uav_mission_manager.mdp import ActionKind
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.paths import share_directory

MISSION = load_mission(share_directory() / 'config' / 'survey.yaml')
SHIPPED = share_directory() / 'policies' / 'survey'
MOST_BYTES = 5_000_000


@pytest.fixture(scope='module')
def policy():
    return load_policy(SHIPPED, MISSION)


def test_the_mission_gets_no_warnings():
    assert list(findings(MISSION)) == []


def test_the_set_is_of_the_mission_and_small(policy):
    assert policy.mission == MISSION
    assert sum(file.stat().st_size for file in SHIPPED.iterdir()) < MOST_BYTES


def test_building_it_anew_gives_the_same_decisions(policy):
    """Not the same bytes: matrix products round differently on different processors."""
    anew = build_policy(MISSION, 'expansion', order=2, certificate=False)
    theta = policy.expansion.theta
    np.testing.assert_allclose(anew.expansion.theta, theta, atol=1e-2 * np.abs(theta).max())
    states = policy.space.draw(2_000, np.random.default_rng(3))
    same = anew.act(states) == policy.act(states)
    assert same.mean() > 0.99


def test_no_cost_is_expected_below_0(policy):
    states = policy.space.draw(2_000, np.random.default_rng(4))
    states[:, 2:7] = 0  # Nothing is wanted: what is left to pay is little.
    assert policy.q_values(states).min() >= 0.0
    assert policy.expansion.theta.min() < 0.0


def test_a_recharge_is_chosen_while_every_goal_is_in_range(policy):
    """On the way to the slope: enough to fly there, not to work there and return."""
    flags, chosen = RangeFlags(MISSION), {}
    for level in range(MISSION.range.levels):
        state = np.array([[1, level, 0, 0, 0, 0, 2, 18, 5, 0, 0]])
        decision = policy.decide(state[0].tolist())
        reach = flags(policy.space.split(state)).all()
        chosen[level] = decision.action.kind, bool(reach)
    assert (ActionKind.RECHARGE, True) in chosen.values()
    assert chosen[MISSION.range.levels - 1][0] is ActionKind.COMMIT
