"""The mission's MDP with its transition matrices written out, for solvers that need them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from parts.epoch import Epoch
from uav_mission_manager.mdp import (
    Action,
    Mission,
    StateSpace,
    allowed_actions,
    stage_costs,
)
from uav_mission_manager.mdp.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Explicit:
    """An MDP of n states and A actions.

    Attributes
    ----------
    space : StateSpace
    states : int array (n, 2k+5)
        Ordered by l, c, m, f, r, g, t.
    cost : float array (n, A)
        J(s, a); inf where an action is not allowed.
    transitions : list of A csr_matrix (n, n)
    discount : float
    """

    space: StateSpace
    states: IntArray
    cost: FloatArray
    transitions: list[sparse.csr_matrix]
    discount: float


def explicit(mission: Mission) -> Explicit:
    """Write out a mission."""
    k, q, epoch = mission.k, mission.grid.q, Epoch(mission)
    axes = (q, k + 1, 2, 8, *(2,) * k, *(3,) * k, 3)
    cell, committed, mode, fault, *others = np.indices(axes).reshape(len(axes), -1)
    *ranges_and_goals, threat = others
    states = np.stack([fault + 1, *ranges_and_goals, cell, committed, threat, mode], axis=1)
    costs = [stage_costs(mission, states, np.full(len(states), a.number)) for a in epoch.actions]
    cost = np.where(allowed_actions(mission, states), np.stack(costs, axis=1), np.inf)
    transitions = [_transitions(epoch, action, q, k) for action in epoch.actions]
    return Explicit(StateSpace(k, q), states, cost, transitions, mission.discount)


def _transitions(epoch: Epoch, action: Action, q: int, k: int) -> sparse.csr_matrix:
    """P(s' | s) of one action; neither c nor m matters for it."""
    parts = []
    for cell in range(q):
        parts += [_rows(epoch, action, cell, q, k)] * (2 * (k + 1))
    data, indices = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ('data', 'indices')
    )
    starts = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(p.indptr) for p in parts]))])
    n = len(starts) - 1
    return sparse.csr_matrix((data, indices, starts), shape=(n, n))


def _rows(epoch: Epoch, action: Action, cell: int, q: int, k: int) -> sparse.csr_matrix:
    """Rows of one cell and any c and m, over all columns."""
    health = sparse.csr_matrix(epoch.faults_and_ranges(action, cell))
    landing, total = int(epoch.landings[action.number - 1, cell]), None
    for probability, commitment, goals_and_threat in epoch.outcomes(action, cell):
        weighted = health.multiply(probability[:, None])
        block = sparse.kron(weighted, goals_and_threat, 'csr')
        block.eliminate_zeros()
        size = block.shape[0]
        place = (landing * (k + 1) + commitment) * 2 + int(action.agile)
        moved = sparse.csr_matrix(
            (block.data, block.indices + place * size, block.indptr),
            shape=(size, q * (k + 1) * 2 * size),
        )
        total = moved if total is None else total + moved
    return total
