"""The Bellman backup on the mission's Kronecker structure.

The stage cost splits into a part that the state's c and m decide and a part they do not:

    J(s, a) = p(t, m) - [c > 0] eta_c g_c r_c + b(f, r, g) + h(a, l)

with b the paper's cost of all goals as if uncommitted. c and m touch the future only where c = j
on the cell of goal j, where the goal may be completed. Hence, exactly,

    V(s) = p(t, m) - [c > 0] eta_c g_c r_c + W,
    W = C_c(t, f, r, g) where c > 0 and l is the cell of goal c, else U(l, t, f, r, g),

and U and C_1..C_n are all there is to compute. Given a, the variables move independently, so
the expectation of V(s') is one small matrix a variable, applied along its axis; a transition
matrix over states never exists. Only correctly rounded elementwise operations in a fixed order
are used, so that every machine computes the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.actions import Action
from uav_mission_manager.mdp.dynamics import (
    failure_matrices,
    on_ground,
    priority_matrices,
    range_matrix,
    threat_matrices,
)
from uav_mission_manager.solver.submdp import SubMdp

FloatArray = NDArray[np.float64]
Where = EllipsisType | tuple[NDArray[np.int64], ...]
"""Everything, or index arrays into the axes (t, f, r, g)."""

RESET = np.array([[1.0, 0.0, 0.0]] * 3)
"""P(g_j' | g_j) of a goal just completed."""


@dataclass(frozen=True)
class Value:
    """The value function without its terms in c and m (see the module's docstring).

    Attributes
    ----------
    free : float array (q, 3, 8, 2^n, 3^n)
        U over l, t, f - 1, joint range flag, joint priority; goal 1 is the slowest digit.
    on_site : float array (n, 3, 8, 2^n, 3^n)
        C_j over goal, t, f - 1, r, g: committed to a goal, on its cell.
    """

    free: FloatArray
    on_site: FloatArray


def mix(values: FloatArray, before: int, matrix: FloatArray) -> FloatArray:
    """Expectation along one axis, sum_j matrix[i, j] values[.., j, ..], elementwise.

    `before` is the product of the axes before it. `matrix` has shape (n, n), or (before, n, n)
    for a matrix of its own for each index before.
    """
    n = matrix.shape[-1]
    source = values.reshape(before, n, -1)
    result = np.empty_like(source)
    weights = matrix.reshape(-1, n, n, 1)
    for i in range(n):
        total = weights[:, i, 0] * source[:, 0]
        for j in range(1, n):
            if weights[:, i, j].any():
                total += weights[:, i, j] * source[:, j]
        result[:, i] = total
    return result.reshape(values.shape)


class _Arrivals:
    """E[V(s')] on arrival in some cells with c' = 0, over the present (t, f, r, g).

    Built from W on those cells, (cells, 3, 8, 2^n, 3^n), and P(g_j' | g_j) of each goal.
    """

    def __init__(
        self,
        operator: BellmanOperator,
        values: FloatArray,
        cells: Sequence[int],
        priorities: Sequence[FloatArray],
    ) -> None:
        self.operator = operator
        self.row = {cell: row for row, cell in enumerate(cells)}
        self.expected = operator.expect_exogenous(values, cells, priorities)
        self.threat_cost = operator.threat_cost[:, list(cells)]
        self.flight = [
            operator.expect_flight(self.expected, bool(mode)) + self.threat_cost[mode]
            for mode in (0, 1)
        ]

    def in_flight(self, agile: bool, cell: int) -> FloatArray:
        return self.flight[agile][self.row[cell]]

    def on_ground(self, kind: str, cell: int) -> FloatArray:
        expected = self.expected[self.row[cell]]
        if kind == 'recharge':  # Every r_j' = 1: the last joint flag.
            expected = np.broadcast_to(expected[:, :, -1:, :], expected.shape)
        elif kind == 'repair':
            expected = mix(expected, 3, self.operator.repair)
        return expected + self.threat_cost[0, self.row[cell]]


class BellmanOperator:
    """Q(s, a) = J(s, a) + discount E[V(s')] of a sub-MDP, for whole value functions and states."""

    def __init__(self, sub: SubMdp) -> None:
        mission, n = sub.mission, sub.n
        self.sub = sub
        self.shape = (3, 8, 2**n, 3**n)
        self.cells = tuple(mission.goals[j].cell for j in sub.goals)
        self.hops = mission.grid.next_hops()
        self.distance = sub.share * mission.distance_weight * mission.grid.distances()
        self.threat = threat_matrices(mission)
        self.failures = [failure_matrices(mission, agile=bool(mode)) for mode in (0, 1)]
        self.loss = [range_matrix(mission, agile=bool(mode)) for mode in (0, 1)]
        self.priorities = [priority_matrices(mission)[j] for j in sub.goals]
        success = mission.faults.repair_success
        self.repair = np.eye(8) * (1 - success)
        self.repair[:, 0] += success
        self.completion = np.array(mission.faults.completion)[:, None, None]
        self.base_cost = self._base_cost()
        self.bonus = [self._expected_bonus(bool(mode)) for mode in (0, 1)]
        self.allowed = [sub.allowed(action) for action in sub.actions]
        self.threat_price = sub.share * np.array(mission.threat.cost)
        # E[p(t', m) | t, l'], over (m, l', t): sum over t' in a fixed order.
        price = self.threat_price.T[:, None, None, :] * self.threat[None]
        self.threat_cost = (price[..., 0] + price[..., 1] + price[..., 2])[..., None, None, None]

    def _base_cost(self) -> FloatArray:
        """b(f, r, g), shape (8, 2^n, 3^n): the stage cost less its terms in a, c and m."""
        mission, sub = self.sub.mission, self.sub
        cost = np.zeros(self.shape[1:])
        cost += sub.share * np.array(mission.faults.cost)[:, None, None]
        for j, r, g in zip(sub.goals, sub.flags(), sub.priorities()):
            goal, r = mission.goals[j], r[:, None]
            cost += goal.eta * g * r + goal.delta * g * (1 - r)
            cost += mission.range.cost / mission.k * (1 - r)
        return cost

    def _expected_bonus(self, agile: bool) -> list[FloatArray]:
        """E[eta_j g_j' r_j'] in flight for each goal, as views of shape (3, 8, 2^n, 3^n)."""
        sub = self.sub
        bonus = []
        for slot, j in enumerate(sub.goals):
            matrix = self.priorities[slot]
            g = (matrix[:, 1] + 2 * matrix[:, 2])[sub.priorities()[slot]]
            r = self.loss[agile][:, 1][sub.flags()[slot]]
            bonus.append(np.broadcast_to(sub.mission.goals[j].eta * r[:, None] * g, self.shape))
        return bonus

    def zero(self) -> Value:
        """Return the value function that is 0 in U and C."""
        q = self.sub.mission.grid.q
        return Value(np.zeros((q, *self.shape)), np.zeros((self.sub.n, *self.shape)))

    def expect_exogenous(
        self, values: FloatArray, cells: Sequence[int], priorities: Sequence[FloatArray]
    ) -> FloatArray:
        """Expectation over t' and g', which no action touches."""
        values = mix(values, len(cells), self.threat[list(cells)])
        before = len(cells) * 24 * 2**self.sub.n
        for slot, matrix in enumerate(priorities):
            values = mix(values, before * 3**slot, matrix)
        return values

    def expect_flight(self, values: FloatArray, agile: bool) -> FloatArray:
        """Expectation over f' and r' in flight."""
        before = len(values) * 3
        # f - 1 in binary digits: camera, actuator, sensor, the sensor's the fastest.
        for bit, matrix in enumerate(reversed(self.failures[agile])):
            values = mix(values, before * 2**bit, matrix)
        for slot in range(self.sub.n):
            values = mix(values, before * 8 * 2**slot, self.loss[agile])
        return values

    def where(self, states: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
        """Indices (t, f - 1, joint r, joint g) of global states, each of shape (N,)."""
        k, goals = self.sub.mission.k, np.array(self.sub.goals, dtype=np.intp)
        r = states[:, 1 + goals] @ (2 ** np.arange(self.sub.n)[::-1])
        g = states[:, 1 + k + goals] @ (3 ** np.arange(self.sub.n)[::-1])
        return states[:, -2], states[:, 0] - 1, r, g

    def slot_on_site(self, states: NDArray[np.int64]) -> NDArray[np.int64]:
        """Position of the goal committed to where the UAV is on its cell, -1 elsewhere; (N,)."""
        slots = np.full(len(states), -1)
        for slot, (j, cell) in enumerate(zip(self.sub.goals, self.cells)):
            slots[(states[:, -3] == j + 1) & (states[:, -4] == cell)] = slot
        return slots

    def mode_cost(self, states: NDArray[np.int64]) -> FloatArray:
        """p(t, m) - [c > 0] eta_c g_c r_c of global states, shape (N,)."""
        k = self.sub.mission.k
        cost = self.threat_price[states[:, -2], states[:, -1]]
        for j in self.sub.goals:
            reward = self.sub.mission.goals[j].eta * states[:, 1 + j] * states[:, 1 + k + j]
            cost -= reward * (states[:, -3] == j + 1)
        return cost

    def allowed_in(self, states: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether each action is allowed in global states, shape (N, actions)."""
        where = self.where(states)[1:]
        return np.stack([allowed[where] for allowed in self.allowed], axis=1)

    def state_values(self, value: Value, states: NDArray[np.int64]) -> FloatArray:
        """V(s) of global states, shape (N,)."""
        where, slots = self.where(states), self.slot_on_site(states)
        values = np.where(
            slots < 0,
            value.free[(states[:, -4], *where)],
            value.on_site[(np.maximum(slots, 0), *where)],
        )
        return values + self.mode_cost(states)

    def look_ahead(self, value: Value) -> LookAhead:
        """Return the tables of E[V(s')] from which Q is looked up."""
        return LookAhead(self, value)


class LookAhead:
    """E[V(s')] of every action in every state, as sums of look-ups."""

    def __init__(self, operator: BellmanOperator, value: Value) -> None:
        self.operator = operator
        sub = operator.sub
        self.arrivals = _Arrivals(
            operator, value.free, range(sub.mission.grid.q), operator.priorities
        )
        self.on_site = [
            _Arrivals(operator, value.on_site[slot : slot + 1], (cell,), operator.priorities)
            for slot, cell in enumerate(operator.cells)
        ]
        self.completed = [self._completed(value, slot) for slot in range(sub.n)]

    def _completed(self, value: Value, slot: int) -> _Arrivals:
        operator = self.operator
        cell = operator.cells[slot]
        destinations = [action.destination for action in operator.sub.actions]
        cells = np.unique(operator.hops[cell, destinations])
        priorities = list(operator.priorities)
        priorities[slot] = RESET
        return _Arrivals(operator, value.free[cells], cells.tolist(), priorities)

    def expected(self, action: Action, cell: int, where: Where = ...) -> FloatArray:
        """E[V(s')] in a cell where no goal is completed, over (t, f, r, g)."""
        operator = self.operator
        if on_ground(operator.sub.mission, action, cell):
            return self.arrivals.on_ground(action.kind, cell)[where]
        landing = int(operator.hops[cell, action.destination])
        slot = operator.sub.slot(action)
        if slot is None:
            return self.arrivals.in_flight(action.agile, landing)[where]
        bonus = operator.bonus[action.agile][slot][where]
        if landing == operator.cells[slot]:
            return self.on_site[slot].in_flight(action.agile, landing)[where] - bonus
        return self.arrivals.in_flight(action.agile, landing)[where] - bonus

    def expected_on_site(self, action: Action, slot: int, where: Where = ...) -> FloatArray:
        """E[V(s')] where the UAV is committed to a goal and on its cell."""
        operator = self.operator
        cell = operator.cells[slot]
        arrivals = self.completed[slot]
        if on_ground(operator.sub.mission, action, cell):
            done = arrivals.on_ground(action.kind, cell)[where]
        else:
            landing = int(operator.hops[cell, action.destination])
            done = arrivals.in_flight(action.agile, landing)[where]
        p = np.broadcast_to(operator.completion, operator.shape)[where]
        return (1 - p) * self.expected(action, cell, where) + p * done

    def action_cost(self, action: Action, cell: int) -> float:
        """h(a, l), the share of this sub-MDP."""
        sub = self.operator.sub
        cost = float(self.operator.distance[cell, action.destination])
        if cell == sub.mission.grid.service and action.kind in ('recharge', 'repair'):
            cost += sub.share * getattr(sub.mission.service_cost, action.kind)
        return cost

    def backup(self) -> Value:
        """One Bellman backup: the minimum of Q over the allowed actions, everywhere."""
        operator = self.operator
        free = [
            self._minimum(cell, [self.expected(action, cell) for action in operator.sub.actions])
            for cell in range(operator.sub.mission.grid.q)
        ]
        on_site = [
            self._minimum(
                cell, [self.expected_on_site(action, slot) for action in operator.sub.actions]
            )
            for slot, cell in enumerate(operator.cells)
        ]
        return Value(np.stack(free), np.stack(on_site))

    def _minimum(self, cell: int, expected: list[FloatArray]) -> FloatArray:
        operator = self.operator
        discount = operator.sub.mission.discount
        best = np.full(operator.shape, np.inf)
        for action, allowed, table in zip(operator.sub.actions, operator.allowed, expected):
            q = self.action_cost(action, cell) + discount * table
            np.minimum(best, q, out=best, where=allowed)
        return operator.base_cost + best

    def q_values(self, states: NDArray[np.int64]) -> FloatArray:
        """Q(s, a) of global states (N, 2k+5), shape (N, actions); inf where not allowed."""
        operator, sub = self.operator, self.operator.sub
        mission = sub.mission
        q = np.full((len(states), len(sub.actions)), np.inf)
        location, mode_cost = states[:, -4], operator.mode_cost(states)
        committed = operator.slot_on_site(states)
        where = operator.where(states)
        for cell, slot in np.unique(np.stack([location, committed]), axis=1).T:
            rows = np.flatnonzero((location == cell) & (committed == slot))
            at = tuple(index[rows] for index in where)
            fixed = mode_cost[rows] + operator.base_cost[at[1:]]
            for column, action in enumerate(sub.actions):
                if slot < 0:
                    expected = self.expected(action, cell, at)
                else:
                    expected = self.expected_on_site(action, slot, at)
                cost = fixed + self.action_cost(action, cell) + mission.discount * expected
                q[rows, column] = np.where(operator.allowed[column][at[1:]], cost, np.inf)
        return q
