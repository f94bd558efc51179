"""Q values in a goal expansion: look-ups and sums, for one state or for many."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.expansion.basis import Basis
from uav_mission_manager.solver.expansion.fit import Expansion
from uav_mission_manager.solver.factors import FLAGS, STAKES, Factors

ENTRIES = 1 << 22
"""Features at a time."""


class ExpansionLookAhead:
    """Q(s, a) one epoch ahead in an expansion, J(s, a) + discount E[V(s')].

    Parameters
    ----------
    expansion : Expansion
    """

    def __init__(self, expansion: Expansion) -> None:
        self.factors = factors = Factors(expansion.mission)
        self.basis = Basis(factors, expansion.clusters)
        theta = np.asarray(expansion.theta)
        later = (factors.threat @ theta.reshape(len(theta), 3, -1)).reshape(theta.shape)
        self.theta = _by_level(theta)
        self.tables = [_by_level(faults @ later) for faults in factors.faults]
        self._commits = np.array([a.kind == 'commit' for a in factors.actions])
        self._goals = np.array([max(a.goal - 1, 0) for a in factors.actions])
        self._agile = np.array([int(a.agile) for a in factors.actions])
        kinds = [a.kind for a in factors.actions]
        self._recharge, self._repair = kinds.index('recharge'), kinds.index('repair')
        self._ways = [_ways(way) for way in factors.way.T]
        self._faults = np.array(factors.mission.faults.cost)
        self._threat = np.array(factors.mission.threat.cost)
        self._eta = np.array([goal.eta for goal in factors.mission.goals])

    def values(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """V(s) of the expansion itself, shape (N,)."""
        x, place, t, f = self._split(states)
        out = self._mode_cost(states, x)
        for level, rows in _groups(t * 8 + f, self.basis.size):
            values = self.theta[divmod(level, 8)] @ self.basis.now(x[rows], np.float32)
            out[rows] += values[place[rows], np.arange(len(rows))]
        return out

    def q_values(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """Q(s, a) of global states (N, 2k+5), shape (N, 2k+4); inf where not allowed."""
        x, place, t, f = self._split(states)
        q = np.empty((len(states), len(self.factors.actions)))
        for group, rows in _groups((place * 3 + t) * 8 + f, self.basis.size):
            here, level = divmod(group, 24)
            q[rows] = self._look_ahead(here, *divmod(level, 8), x[rows])
        costs = self.factors.cost[np.arange(self.factors.k), x].sum(axis=1)
        costs += self._faults[f] + self._mode_cost(states, x)
        return q + costs[:, None]

    def _look_ahead(
        self, place: int, t: int, f: int, x: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Q less the costs that the action does not change, of one place, t and f."""
        factors, kept = self.factors, 1.0
        landing = factors.landing[:, place]
        expected = self._expected(place, landing, t, f, x, None)
        if place >= factors.q:
            completion = float(factors.completion[f])
            if completion:
                goal, cells = place - factors.q, factors.cells[landing]
                done = self._expected(place, cells, t, f, x, goal)
                expected += completion * (done - expected)
                kept -= completion
        expected *= factors.mission.discount
        expected += factors.price[self._agile, landing, t] + factors.distance[:, place]
        saving = factors.saving[self._agile, self._goals, x[:, self._goals]]
        expected -= kept * self._commits * saving
        if factors.strict:
            expected[self._forbidden(x, f)] = np.inf
        return expected

    def _forbidden(self, x: NDArray[np.int64], f: int) -> NDArray[np.bool_]:
        wanted = (STAKES[x] > 0) & (self.factors.completion[f] > 0)
        forbidden = self._commits & ~wanted[:, self._goals]
        forbidden[:, self._recharge] = FLAGS[x].all(axis=1)
        forbidden[:, self._repair] = f == 0
        return np.asarray(forbidden)

    def _expected(
        self,
        place: int,
        landing: NDArray[np.intp],
        t: int,
        f: int,
        x: NDArray[np.int64],
        achieved: int | None,
    ) -> NDArray[np.float64]:
        """E[W(x')] of each action, shape (N, A)."""
        ways = self._ways[place]
        features = self.basis.expected(x, list(ways), achieved, np.float32)
        out = np.empty((len(x), len(landing)))
        for position, (way, actions) in enumerate(ways.items()):
            values = self.tables[way][t, f] @ features[position]
            out[:, actions] = values[landing[actions]].T
        return out

    def _split(self, states: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
        """X (N, k), place, t and f from 0, each (N,)."""
        factors, k = self.factors, self.factors.k
        x = 2 * states[:, 1 + k : 1 + 2 * k] + states[:, 1 : 1 + k]
        cell, c = states[:, -4], states[:, -3]
        site = factors.q + np.maximum(c - 1, 0)
        place = np.where((c > 0) & (factors.cells[site] == cell), site, cell)
        return x, place, states[:, -2], states[:, 0] - 1

    def _mode_cost(
        self, states: NDArray[np.int64], x: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """p(t, m) - [c > 0] eta_c g_c r_c, shape (N,)."""
        goal = np.maximum(states[:, -3] - 1, 0)
        wanted = STAKES[x[np.arange(len(x)), goal]]
        saved = (states[:, -3] > 0) * self._eta[goal] * wanted
        return np.asarray(self._threat[states[:, -2], states[:, -1]] - saved)


def _by_level(theta: FloatArray) -> FloatArray:
    """Coefficients (places, 3, 8, P) as (3, 8, places, P), in one piece."""
    return np.ascontiguousarray(theta.transpose(1, 2, 0, 3), np.float32)


def _ways(way: NDArray[np.intp]) -> dict[int, NDArray[np.intp]]:
    """Actions that lead each way."""
    return {w: np.flatnonzero(way == w) for w in sorted(set(way.tolist()))}


def _groups(keys: NDArray[np.int64], size: int) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Rows of each key, no more at a time than features (rows, 4, size) fit."""
    if len(keys) == 1:
        yield int(keys[0]), np.zeros(1, np.intp)
        return
    step = max(1, ENTRIES // size)
    order = np.argsort(keys, kind='stable')
    different, starts = np.unique(keys[order], return_index=True)
    for key, rows in zip(different.tolist(), np.split(order, starts[1:])):
        for first in range(0, len(rows), step):
            yield key, rows[first : first + step]
