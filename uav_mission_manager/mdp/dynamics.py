"""One epoch's transition probabilities, one small matrix a state variable.

Given the action, the variables move independently, so P(s' | s, a) is the product of the
matrices here; rows are the present value, columns the next.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.actions import Action
from uav_mission_manager.mdp.mission import Mission

FloatArray = NDArray[np.float64]


def failure_matrices(mission: Mission, agile: bool) -> tuple[FloatArray, ...]:
    """P(bit' | bit) of each part in flight, 0 healthy and 1 failed: sensor, actuator, camera."""
    rates = vars(mission.faults.rate).values()
    factors = vars(mission.faults.agile_factor).values()
    matrices = []
    for rate, factor in zip(rates, factors):
        p = min(rate * factor, 1.0) if agile else rate
        matrices.append(np.array([[1 - p, p], [0.0, 1.0]]))
    return tuple(matrices)


def range_matrix(mission: Mission, agile: bool) -> FloatArray:
    """P(r_j' | r_j) in flight."""
    loss = mission.range.loss.agile if agile else mission.range.loss.normal
    return np.array([[1.0, 0.0], [loss, 1 - loss]])


def priority_matrices(mission: Mission) -> tuple[FloatArray, ...]:
    """P(g_j' | g_j) of each goal that is not just completed."""
    return tuple(np.array(goal.priority_transition) for goal in mission.goals)


def threat_matrices(mission: Mission) -> FloatArray:
    """P(t' | t) for each cell l', shape (q, 3, 3)."""
    threat = mission.threat
    onset = np.full(mission.grid.q, threat.onset)
    for cell, value in threat.zones:
        onset[cell] = value
    matrices = np.empty((mission.grid.q, 3, 3))
    matrices[:, 0, 0] = 1 - onset
    matrices[:, 0, 1] = onset * (1 - threat.high_share)
    matrices[:, 0, 2] = onset * threat.high_share
    matrices[:, 1] = threat.from_low
    matrices[:, 2] = threat.from_high
    return matrices


def on_ground(mission: Mission, action: Action, cell: int) -> bool:
    """Whether an action keeps the UAV on the ground: nothing fails, no range is lost."""
    if action.kind == 'none':
        return not action.agile and cell == mission.grid.base
    return action.kind in ('recharge', 'repair') and cell == mission.grid.service
