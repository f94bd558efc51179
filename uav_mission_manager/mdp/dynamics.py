"""One epoch's transition probabilities, one small matrix a state variable.

Given the action the variables move independently, so P(s' | s, a) is the product of the matrices
here, with one exception: an action that commits to goal j on the cell of goal j completes the
goal with probability `completion_j(f)`, and then g_j' = 0 and c' = 0.

Rows of a matrix are the present value, columns the next. How f, r and the charge move depends on
the *regime* of the epoch: flight in one of two modes, or one of three stays on the ground.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from uav_mission_manager.mdp.actions import ActionKind, global_actions
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IndexArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.routes import next_hops


class Regime(IntEnum):
    """How an epoch is spent, as far as faults, ranges and the charge are concerned."""

    NORMAL_FLIGHT = 0
    AGILE_FLIGHT = 1
    PARKED = 2
    RECHARGED = 3
    REPAIRED = 4


ON_GROUND = (Regime.PARKED, Regime.RECHARGED, Regime.REPAIRED)
"""The regimes in which nothing fails and no range is lost."""


def regimes(mission: Mission) -> IndexArray:
    """Regime of each action in each cell, shape (2k+4, q)."""
    base, service = mission.grid.base, mission.grid.service
    out = np.empty((2 * mission.k + 4, mission.grid.q), np.intp)
    for row, action in zip(out, global_actions(mission)):
        row[:] = Regime.AGILE_FLIGHT if action.agile else Regime.NORMAL_FLIGHT
        if action.kind is ActionKind.NONE and not action.agile:
            row[base] = Regime.PARKED
        elif action.kind is ActionKind.RECHARGE:
            row[service] = Regime.RECHARGED
        elif action.kind is ActionKind.REPAIR:
            row[service] = Regime.REPAIRED
    return out


def landings(mission: Mission) -> IndexArray:
    """l': the cell after the epoch, for each action and cell, shape (2k+4, q)."""
    actions = global_actions(mission)
    return np.array([next_hops(mission.grid, action.destination) for action in actions])


def may_complete(mission: Mission) -> BoolArray:
    """Where an action may complete the goal that it commits to, shape (2k+4, q)."""
    out = np.zeros((2 * mission.k + 4, mission.grid.q), dtype=bool)
    for row, action in zip(out, global_actions(mission)):
        row[action.destination] = action.goal is not None
    return out


def completion_probabilities(mission: Mission) -> FloatArray:
    """completion_j(f) of each goal, shape (k, 8)."""
    shared = mission.faults.completion
    rows = [shared if goal.completion is None else goal.completion for goal in mission.goals]
    return np.array(rows)


def failure_probabilities(mission: Mission) -> FloatArray:
    """P(a healthy part fails) in normal and agile flight, of sensor, actuator, camera: (2, 3)."""
    rate = np.array(list(vars(mission.faults.rate).values()))
    factor = np.array(list(vars(mission.faults.agile_factor).values()))
    return np.array([rate, np.minimum(rate * factor, 1.0)])


def range_loss_probabilities(mission: Mission) -> FloatArray:
    """P(r_j: 1 -> 0) in normal and agile flight, (2,), or (0,) where the charge tells r_j."""
    loss = mission.range.loss
    return np.array([] if loss is None else [loss.normal, loss.agile])


def drain_probabilities(mission: Mission) -> FloatArray:
    """P(d levels of the charge are drained) in normal and agile flight, shape (2, levels).

    Without a charge it is always at its one level, shape (2, 1).
    """
    charge = mission.range.charge
    rows = (charge.drain.normal, charge.drain.agile) if charge else ((1.0,), (1.0,))
    out = np.zeros((2, mission.range.levels))
    for row, given in zip(out, rows):
        row[: len(given)] = given[: len(row)]
        row[-1] += sum(given[len(row) :])  # To drain more than there is leaves the lowest level.
    return out


def recharged_levels(mission: Mission) -> IndexArray:
    """B' after an epoch of recharging at each level b, shape (levels,)."""
    levels, charge = mission.range.levels, mission.range.charge
    rate = charge.rate if charge and charge.rate else levels
    return np.minimum(np.arange(levels) + rate, levels - 1)


def fault_matrices(mission: Mission) -> FloatArray:
    """P(f' | f) in each regime, shape (5, 8, 8)."""
    matrices = np.broadcast_to(np.eye(8), (len(Regime), 8, 8)).copy()
    for regime, parts in enumerate(failure_probabilities(mission)):
        sensor, actuator, camera = (np.array([[1 - p, p], [0.0, 1.0]]) for p in parts)
        # The bits of f - 1 are, from the highest, camera, actuator, sensor.
        matrices[regime] = np.kron(np.kron(camera, actuator), sensor)
    matrices[Regime.REPAIRED] *= 1 - mission.faults.repair_success
    matrices[Regime.REPAIRED, :, 0] += mission.faults.repair_success
    return matrices


def range_matrices(mission: Mission) -> FloatArray:
    """P(r_j' | r_j) in each regime, shape (5, 2, 2), or (5, 1, 1) where the charge tells r_j."""
    values = mission.range.flag_values
    matrices = np.broadcast_to(np.eye(values), (len(Regime), values, values)).copy()
    if values == 1:
        return matrices
    for regime, loss in enumerate(range_loss_probabilities(mission)):
        matrices[regime, 1] = loss, 1 - loss
    matrices[Regime.RECHARGED, 0] = 0.0, 1.0
    return matrices


def charge_matrices(mission: Mission) -> FloatArray:
    """P(b' | b) in each regime, shape (5, levels, levels)."""
    levels = mission.range.levels
    matrices = np.broadcast_to(np.eye(levels), (len(Regime), levels, levels)).copy()
    drain = drain_probabilities(mission)
    matrices[:2] = 0
    for level, drained in np.ndindex(levels, levels):
        matrices[:2, level, max(level - drained, 0)] += drain[:, drained]
    matrices[Regime.RECHARGED] = np.eye(levels)[recharged_levels(mission)]
    return matrices


def priority_matrices(mission: Mission) -> FloatArray:
    """P(g_j' | g_j) of each goal that is not completed in the epoch, shape (k, 3, 3)."""
    return np.array([goal.priority_transition for goal in mission.goals])


def threat_matrices(mission: Mission) -> FloatArray:
    """P(t' | t) for each cell l' and T threat levels, shape (q, T, T)."""
    threat = mission.threat
    onset = np.full(mission.grid.q, threat.onset)
    for cell, value in threat.zones:
        onset[cell] = value
    different, which = np.unique(onset, return_inverse=True)
    return np.array([threat.transition(value) for value in different.tolist()])[which]
