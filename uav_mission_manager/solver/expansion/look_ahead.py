"""Q values in a goal expansion: look-ups and sums, for one state or for many."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray, RealArray
from uav_mission_manager.solver.expansion.basis import Basis, Outcome
from uav_mission_manager.solver.expansion.fit import Expansion
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import whole_mission

FEATURE_ENTRIES = 1 << 22
"""Most features of an outcome computed at a time, of all states together: 16 MiB."""


@dataclass(frozen=True)
class _Departure:
    """What the actions do from one cell.

    Attributes
    ----------
    outcomes : list
        What the epoch may do to the goals: the regimes first, then the completions.
    actions : list of int array
        Actions of each regime, and the one that may lead to each completion.
    landings : list of int array
        Where those lead.
    """

    outcomes: list[Outcome]
    actions: list[IndexArray]
    landings: list[IndexArray]


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
        later = (reduced.threat @ theta.reshape(len(theta), 3, -1)).reshape(theta.shape)
        self.theta = _by_level(theta)
        faults = expansion.mission.discount * reduced.faults
        self.tables = [_by_level(matrix @ later) for matrix in faults]
        self._departures = [_departure(reduced, cell) for cell in range(reduced.q)]
        self._price = reduced.price[reduced.agile[:, None], reduced.landings]

    def values(self, states: IntArray) -> FloatArray:
        """V(s) of the expansion itself, shape (N,)."""
        x, s = self.reduced.x(states), self.reduced.split(states)
        out = self.reduced.mode_costs(states)
        for level, rows in _groups(s.t * 8 + s.f - 1, self.basis.size):
            values = self.theta[divmod(level, 8)] @ self.basis.now(x[rows], np.float32)
            out[rows] += values[s.l[rows], np.arange(len(rows))]
        return out

    def q_values(self, states: IntArray) -> FloatArray:
        """Q(s, a) of global states (N, 2k+5), shape (N, 2k+4); inf where not allowed."""
        x, s = self.reduced.x(states), self.reduced.split(states)
        q = np.empty((len(states), len(self.reduced.slots)))
        for group, rows in _groups((s.l * 3 + s.t) * 8 + s.f - 1, self.basis.size):
            cell, level = divmod(group, 24)
            q[rows] = self._look_ahead(cell, *divmod(level, 8), x[rows])
        return q + self.reduced.state_costs(states)[:, None]

    def _look_ahead(self, cell: int, t: int, f: int, x: IntArray) -> FloatArray:
        """Q less the costs that the action does not change, of one cell, t and f: (N, A)."""
        departure, completion = self._departures[cell], float(self.reduced.completion[f])
        features = self.basis.expected(x, departure.outcomes, np.float32)
        out = self.reduced.action_costs(cell, x, np.array([f]))[:, 0]
        out += self._price[:, cell, t, None]
        expected = np.empty(out.shape)
        for (regime, goal), actions, landings, feature in zip(
            departure.outcomes, departure.actions, departure.landings, features
        ):
            table = self.tables[regime][t, f]
            if goal is None:
                expected[actions] = (table @ feature)[landings]
            elif completion:
                done = table[landings] @ feature
                expected[actions] += completion * (done - expected[actions])
        return np.asarray((out + expected).T)


def _departure(reduced: ReducedMission, cell: int) -> _Departure:
    regimes, landings = reduced.regimes[:, cell], reduced.landings[:, cell]
    outcomes: list[Outcome] = [(regime, None) for regime in sorted(set(regimes.tolist()))]
    actions = [np.flatnonzero(regimes == regime) for regime, _ in outcomes]
    for action in np.flatnonzero(reduced.completes[:, cell]):
        outcomes.append((int(regimes[action]), int(reduced.slots[action])))
        actions.append(np.array([action]))
    return _Departure(outcomes, actions, [landings[chosen] for chosen in actions])


def _by_level(theta: RealArray) -> RealArray:
    """Coefficients (q, 3, 8, P) as (3, 8, q, P), in one piece."""
    return np.ascontiguousarray(theta.transpose(1, 2, 0, 3), np.float32)


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
