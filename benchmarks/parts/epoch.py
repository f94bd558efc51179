"""One epoch of a mission as matrices over two groups of variables, for MDPs written out.

Given the cell and the action, (f, r) move by one matrix and (g, t) by another; only completion
ties them together. The small matrices are those of `uav_mission_manager.mdp.dynamics`; nothing of
the solver is used, so what is built on this checks the solver.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np

from uav_mission_manager.mdp import Action, Mission, dynamics, global_actions
from uav_mission_manager.mdp.arrays import FloatArray

ACHIEVED = np.tile([1.0, 0.0, 0.0], (3, 1))
"""P(g_j' | g_j) of a goal that is completed."""


class Outcome(NamedTuple):
    """One of the ways in which an epoch may end.

    Attributes
    ----------
    probability : float array (8 * 2^k,)
        By the present (f, r).
    commitment : int
        c'.
    goals_and_threat : float array (3^k * 3, 3^k * 3)
        P(g', t' | g, t).
    """

    probability: FloatArray
    commitment: int
    goals_and_threat: FloatArray


class Epoch:
    """The matrices of a mission, axes f, r_1.. and g_1.., t, the last one fastest.

    Attributes
    ----------
    actions : tuple of Action
    landings : int array (2k+4, q)
        l' of each action in each cell.
    """

    def __init__(self, mission: Mission) -> None:
        k = mission.k
        self.actions, self.landings = global_actions(mission), dynamics.landings(mission)
        self._regimes, self._may_complete = (
            dynamics.regimes(mission),
            dynamics.may_complete(mission),
        )
        pairs = zip(dynamics.fault_matrices(mission), dynamics.range_matrices(mission))
        self._faults_and_ranges = [reduce(np.kron, [f, *[r] * k]) for f, r in pairs]
        completion = dynamics.completion_probabilities(mission)
        self._completion = np.repeat(completion, 2**k, axis=1)
        goals, threats = (
            list(dynamics.priority_matrices(mission)),
            dynamics.threat_matrices(mission),
        )
        self._open = [reduce(np.kron, [*goals, threat]) for threat in threats]
        self._completed = [
            reduce(np.kron, [*goals[:j], ACHIEVED, *goals[j + 1 :], threats[goal.cell]])
            for j, goal in enumerate(mission.goals)
        ]

    def faults_and_ranges(self, action: Action, cell: int) -> FloatArray:
        """P(f', r' | f, r), shape (8 * 2^k, 8 * 2^k)."""
        return self._faults_and_ranges[self._regimes[action.number - 1, cell]]

    def outcomes(self, action: Action, cell: int) -> list[Outcome]:
        """Return how an epoch may end: the goal completed where it can be, and not."""
        a = action.number - 1
        onward = self._open[self.landings[a, cell]]
        if not self._may_complete[a, cell]:
            certain = np.ones(self._completion.shape[1])
            return [Outcome(certain, action.commitment, onward)]
        goal = action.commitment - 1
        return [
            Outcome(1 - self._completion[goal], action.commitment, onward),
            Outcome(self._completion[goal], 0, self._completed[goal]),
        ]
