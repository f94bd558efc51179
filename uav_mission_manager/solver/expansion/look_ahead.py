"""Q values in a goal expansion: look-ups and sums, for one state or for many."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray, RealArray
from uav_mission_manager.solver.expansion.basis import Basis, Outcome
from uav_mission_manager.solver.expansion.fit import Expansion
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import whole_mission

FEATURE_ENTRIES = 1 << 22
"""Most features of an outcome computed at a time, of all states together: 16 MiB."""


@dataclass(frozen=True)
class _Departure:
    """What may follow from one cell.

    Attributes
    ----------
    outcomes : list
        What an epoch may do to the goals: the regimes first, then the completions.
    functions : float array (outcomes, k, X, functions)
        E of the functions of the x_j' after each.
    actions : list of int array
        Actions of each outcome.
    landings : list of (int array, int array)
        The different cells that those lead to, and the position of each action's among them.
    """

    outcomes: list[Outcome]
    functions: RealArray
    actions: list[IndexArray]
    landings: list[tuple[IndexArray, IndexArray]]


class ExpansionLookAhead:
    """Q(s, a) one epoch ahead in an expansion, J(s, a) + discount E[V(s')].

    Parameters
    ----------
    expansion : Expansion
    """

    def __init__(self, expansion: Expansion) -> None:
        reduced = self.reduced = ReducedMission(whole_mission(expansion.mission))
        self.basis = Basis(reduced, expansion.clusters)
        theta = np.asarray(expansion.theta)
        later = (reduced.threat @ theta.reshape(*theta.shape[:2], -1)).reshape(theta.shape)
        self.theta = _by_level(theta, theta.dtype)
        conditions = expansion.mission.discount * reduced.conditions
        self.tables = [_by_level(matrix @ later, theta.dtype) for matrix in conditions]
        self._departures = [_departure(self.basis, cell, theta.dtype) for cell in range(reduced.q)]
        # An action looks at its own goal only, so all may be alike; recharging looks at whether
        # any range is lost, which the first two tell.
        alike = np.repeat(np.arange(reduced.x_values)[:, None], reduced.n, axis=1)
        costs = reduced.action_costs(np.arange(reduced.q), alike).transpose(1, 2, 0, 3)
        price = reduced.price[reduced.agile[:, None], reduced.landings].transpose(1, 2, 0)
        shared = reduced.fault_costs[:, None, None]
        self._costs = costs[:, None] + price[:, :, None, :, None] + shared
        self._actions, self._commits = np.arange(len(reduced.slots)), reduced.slots >= 0

    def values(self, states: IntArray) -> FloatArray:
        """V(s) of the expansion itself, shape (N,)."""
        x, s = self.reduced.x(states), self.reduced.split(states)
        out = self.reduced.mode_costs(states)
        z_values = self.reduced.z_values
        for level, rows in _groups(s.t * z_values + self.reduced.z(states), self.basis.size):
            table = self.theta[divmod(level, z_values)]
            values = table @ self.basis.now(x[rows], table.dtype)
            out[rows] += values[s.l[rows], np.arange(len(rows))]
        return out

    def q_values(self, states: IntArray) -> FloatArray:
        """Q(s, a) of global states (N, 2k+5), shape (N, 2k+4); inf where not allowed."""
        reduced, s = self.reduced, self.reduced.split(states)
        x, z = reduced.x(states), reduced.z(states)
        q = np.empty((len(states), len(reduced.slots)))
        threats, z_values = reduced.sub.threats, reduced.z_values
        for group, rows in _groups((s.l * threats + s.t) * z_values + z, self.basis.size):
            level, condition = divmod(group, z_values)
            q[rows] = self._expected(*divmod(level, threats), condition, x[rows]).T
        own = np.where(self._commits, x[:, reduced.slots], s.r.all(axis=1, keepdims=True))
        q += self._costs[s.l[:, None], s.t[:, None], z[:, None], self._actions, own]
        goals = np.arange(reduced.n)
        costs = reduced.goal_costs[goals, s.l[:, None], z[:, None], x].sum(axis=1)
        return q + (costs + reduced.mode_costs(states))[:, None]

    @property
    def rounding(self) -> float:
        """By how much Q of one state may differ between two look-ups, at most.

        The rounding of a sum of P products depends on what else is looked up with it. For
        missions of few goals only: all x are gone through.
        """
        n, size = self.reduced.n, self.basis.size
        x = np.indices((self.reduced.x_values,) * n).reshape(n, -1).T
        largest = np.abs(self.basis.now(x, np.float64)).max(axis=1)
        magnitude = float((np.abs(self.theta) * largest).sum(axis=-1).max())
        return (size + 8) * float(np.finfo(self.theta.dtype).eps) * magnitude

    def _expected(self, cell: int, t: int, z: int, x: IntArray) -> FloatArray:
        """Discounted E[W(s')] of each action from one cell, t and z: (A, N)."""
        departure, completion = self._departures[cell], self.reduced.completion[:, z]
        out = np.empty((len(self._actions), len(x)))
        features = self.basis.features(departure.functions, x)
        for (regime, goal), actions, (cells, back), feature in zip(
            departure.outcomes, departure.actions, departure.landings, features
        ):
            # Each cell once: equal rows of a matrix product need not be rounded alike.
            expected = (self.tables[regime][t, z].take(cells, axis=0) @ feature)[back]
            if goal is not None:
                before = out[actions]
                expected = before + float(completion[goal]) * (expected - before)
            out[actions] = expected
        return out


def _departure(basis: Basis, cell: int, dtype: DTypeLike) -> _Departure:
    reduced = basis.reduced
    regimes, landings = reduced.regimes[:, cell], reduced.landings[:, cell]
    outcomes: list[Outcome] = [(regime, None) for regime in sorted(set(regimes.tolist()))]
    actions = [np.flatnonzero(regimes == regime) for regime, _ in outcomes]
    for action in np.flatnonzero(reduced.completes[:, cell]):
        outcomes.append((int(regimes[action]), int(reduced.slots[action])))
        actions.append(np.array([action]))
    functions = basis.functions_after(outcomes).astype(dtype)
    different = [np.unique(landings[chosen], return_inverse=True) for chosen in actions]
    return _Departure(outcomes, functions, actions, different)


def _by_level(theta: RealArray, dtype: DTypeLike) -> RealArray:
    """Coefficients (q, T, Z, P) as (T, Z, q, P), in one piece."""
    return np.ascontiguousarray(theta.transpose(1, 2, 0, 3), dtype)


def _groups(keys: IntArray, size: int) -> Iterator[tuple[int, IndexArray]]:
    """Rows of each key, no more at a time than `FEATURE_ENTRIES` allows."""
    if len(keys) == 1:
        yield int(keys[0]), np.zeros(1, np.intp)
        return
    step = max(1, FEATURE_ENTRIES // size)
    order = np.argsort(keys, kind='stable')
    different, starts = np.unique(keys[order], return_index=True)
    for key, rows in zip(different.tolist(), np.split(order, starts[1:])):
        for first in range(0, len(rows), step):
            yield key, rows[first : first + step]
