"""The states that are flown, against the occupancy by the enumeration's transition matrix."""

from __future__ import annotations

import numpy as np
from brute_force import BruteForce, matrices
from strategies import case_study

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.solver.evaluation import flown_states, starts_at_base

COUNT = 20_000


def test_flights_start_at_base_nominal_and_charged():
    mission = mission_from_dict(case_study(1, 2), 'test')
    states = starts_at_base(mission, 900, np.random.default_rng(0))
    assert {tuple(state) for state in states.tolist()} == {
        (1, 1, 1, g, h, 0, 0, 0, 0) for g in range(3) for h in range(3)
    }


def test_flown_states_are_drawn_from_the_discounted_occupancy():
    document = case_study(1)
    mission = mission_from_dict(document, 'test')
    policy, model = build_policy(mission, 'exact'), BruteForce(document)
    _, rows, row_of = matrices(model)
    actions = policy.act(model.states) - 1
    transition = rows[row_of[np.arange(len(actions)), actions]]
    position = {state: i for i, state in enumerate(model.states)}
    now, occupancy = np.zeros(len(actions)), np.zeros(len(actions))
    for g in range(3):
        now[position[1, 1, g, 0, 0, 0, 0]] = 1 / 3
    weight = 1 - mission.discount
    for _ in range(400):
        occupancy += weight * now
        now, weight = transition.T @ now, weight * mission.discount
    flown = flown_states(mission, policy.act, COUNT, np.random.default_rng(1))
    counts = np.bincount([position[tuple(s)] for s in flown.tolist()], minlength=len(actions))
    error = np.sqrt(occupancy * (1 - occupancy) / COUNT)
    assert abs(occupancy.sum() - 1) < 1e-6
    assert (np.abs(counts / COUNT - occupancy) < 5 * error + 1e-4).all()
    assert occupancy.max() > 0.1
