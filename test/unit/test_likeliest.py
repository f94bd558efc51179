"""The likeliest next state, against plain enumeration."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import BruteForce
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import case_study, missions, with_charge

from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.evaluation.likeliest import likeliest_next


def check(document, seed):
    model, rng = BruteForce(document), np.random.default_rng(seed)
    mission = mission_from_dict(document, 'test')
    for state in rng.permutation(model.states)[:20].tolist():
        action = int(rng.choice([a for a in model.actions if model.allowed(state, a)]))
        chances = dict[tuple[int, ...], float]()
        for after, probability in model.successors(tuple(state), action):
            chances[tuple(after)] = chances.get(tuple(after), 0.0) + probability
        found, probability = likeliest_next(mission, state, action)
        assert probability == pytest.approx(max(chances.values()), abs=1e-12)
        assert chances[found] == pytest.approx(probability, abs=1e-12)


@settings(max_examples=15, deadline=None)
@given(document=missions([(1, 1), (1, 2)], [1, 2]), seed=st.integers(0, 99))
def test_none_is_likelier(document, seed):
    check(document, seed)


def test_none_is_likelier_with_a_charge():
    check(with_charge(case_study(1, 2), levels=3), 0)
