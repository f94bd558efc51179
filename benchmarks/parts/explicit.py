"""The mission's MDP with its transition matrices written out, for solvers that need them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from uav_mission_manager.mdp import Action, Mission, global_actions
from uav_mission_manager.mdp.dynamics import (
    failure_matrices,
    on_ground,
    priority_matrices,
    range_matrix,
    threat_matrices,
)

RESET = np.array([[1.0, 0.0, 0.0]] * 3)


@dataclass(frozen=True)
class Explicit:
    """An MDP of n states and A actions.

    Attributes
    ----------
    states : int array (n, 2k+5)
        Ordered by l, c, m, t, f, r, g.
    cost : float array (n, A)
        J(s, a); inf where an action is not allowed.
    transitions : list of A csr_matrix (n, n)
    discount : float
    """

    states: NDArray[np.int64]
    cost: NDArray[np.float64]
    transitions: list[sparse.csr_matrix]
    discount: float


def explicit(mission: Mission) -> Explicit:
    """Write out a mission."""
    k, q = mission.k, mission.grid.q
    axes = (q, k + 1, 2, 3, 8, *(2,) * k, *(3,) * k)
    digits = np.indices(axes).reshape(len(axes), -1)
    cell, committed, mode, threat, fault = digits[:5]
    states = np.stack([fault + 1, *digits[5:], cell, committed, threat, mode], axis=1)
    actions = global_actions(mission)
    cost = np.stack([_cost(mission, states, action) for action in actions], axis=1)
    blocks = _Blocks(mission)
    transitions = [blocks.matrix(action) for action in actions]
    return Explicit(states, cost, transitions, mission.discount)


def _cost(mission: Mission, states: NDArray[np.int64], action: Action) -> NDArray[np.float64]:
    k, grid = mission.k, mission.grid
    f, r, g = states[:, 0], states[:, 1 : 1 + k], states[:, 1 + k : 1 + 2 * k]
    cell, committed, threat, mode = states[:, -4:].T
    eta = np.array([goal.eta for goal in mission.goals])
    delta = np.array([goal.delta for goal in mission.goals])
    cost = (eta * g * r * (committed[:, None] != np.arange(1, k + 1))).sum(axis=1)
    cost += (delta * g * (1 - r) + mission.range.cost / k * (1 - r)).sum(axis=1)
    cost += np.array(mission.faults.cost)[f - 1] + np.array(mission.threat.cost)[threat, mode]
    cost += mission.distance_weight * grid.distances()[cell, action.destination]
    allowed = np.ones(len(states), bool)
    if action.kind in ('recharge', 'repair'):
        cost[cell == grid.service] += getattr(mission.service_cost, action.kind)
        allowed = (r == 0).any(axis=1) if action.kind == 'recharge' else f > 1
    elif action.kind == 'commit':
        j = action.goal - 1
        able = np.array(mission.faults.completion)[f - 1] > 0
        allowed = (g[:, j] > 0) & (r[:, j] == 1) & able
    if mission.feasibility == 'strict':
        cost[~allowed] = np.inf
    return cost


class _Blocks:
    """Joint transitions of (t, f, r, g), one block for each (l, c, m) before and after."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.size = 3 * 8 * 6**mission.k
        self.hops = mission.grid.next_hops()
        self.threat = threat_matrices(mission)
        spread = 6**mission.k
        fault = np.repeat(np.array(mission.faults.completion), spread)
        self.completion = sparse.diags(np.tile(fault, 3), format='csr')
        self.rest = sparse.identity(self.size, format='csr') - self.completion
        self.known: dict[tuple[str, int, int], sparse.csr_matrix] = {}

    def matrix(self, action: Action) -> sparse.csr_matrix:
        q, k = self.mission.grid.q, self.mission.k
        parts = [self._rows(action, x, c) for x in range(q) for c in range(k + 1) for _ in '01']
        n = len(parts) * self.size
        lengths = np.concatenate([np.diff(part.indptr) for part in parts])
        indptr = np.concatenate([[0], np.cumsum(lengths)])
        data = np.concatenate([part.data for part in parts])
        indices = np.concatenate([part.indices for part in parts])
        return sparse.csr_matrix((data, indices, indptr), shape=(n, n))

    def _rows(self, action: Action, cell: int, committed: int) -> sparse.csr_matrix:
        """Rows of one (l, c, m)."""
        mission = self.mission
        landing = int(self.hops[cell, action.destination])
        if on_ground(mission, action, cell):
            how, landing = action.kind, cell
        else:
            how = 'agile' if action.agile else 'normal'
        onward = self._block(how, landing, 0), landing, action.goal, int(action.agile)
        if not committed or mission.goals[committed - 1].cell != cell:
            return self._placed([onward])
        done = self.completion @ self._block(how, landing, committed)
        block, *place = onward
        completed = done, landing, 0, int(action.agile)
        return self._placed([(self.rest @ block, *place), completed])

    def _placed(self, parts: list[tuple]) -> sparse.csr_matrix:
        k = self.mission.k
        n = self.mission.grid.q * (k + 1) * 2 * self.size
        total = None
        for block, cell, committed, mode in parts:
            offset = ((cell * (k + 1) + committed) * 2 + mode) * self.size
            moved = sparse.csr_matrix(
                (block.data, block.indices + offset, block.indptr), shape=(self.size, n)
            )
            total = moved if total is None else total + moved
        return total

    def _block(self, how: str, landing: int, completed: int) -> sparse.csr_matrix:
        key = how, landing, completed
        if key not in self.known:
            mission, k = self.mission, self.mission.k
            fault, flag = np.eye(8), [np.eye(2)] * k
            if how in ('normal', 'agile'):
                agile = how == 'agile'
                fault = reduce(np.kron, reversed(failure_matrices(mission, agile)))
                flag = [range_matrix(mission, agile)] * k
            elif how == 'recharge':
                flag = [np.array([[0.0, 1.0]] * 2)] * k
            elif how == 'repair':
                fault = fault * (1 - mission.faults.repair_success)
                fault[:, 0] += mission.faults.repair_success
            priority = [*priority_matrices(mission)]
            if completed:
                priority[completed - 1] = RESET
            factors = map(sparse.csr_matrix, [self.threat[landing], fault, *flag, *priority])
            self.known[key] = reduce(lambda a, b: sparse.kron(a, b, 'csr'), factors)
            self.known[key].eliminate_zeros()
        return self.known[key]
