"""Q values of single states, from tables of E[W] on every arrival or by sums over successors.

Tables answer at once and are kept where they are small. Otherwise a state's Q values are one
backup of that state: the sum over its successors, a look at the few places it may arrive in.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.solver.axes import FloatArray, run
from uav_mission_manager.solver.exact.expectations import Arrivals, Expected, FirstHalf
from uav_mission_manager.solver.reduced import GROUND, BellmanOperator
from uav_mission_manager.solver.submdp import SubMdp

TABLES = 1 << 19
"""Entries of W up to which tables are kept, some five times as large."""


class LookAhead:
    """Q(s, a) in the value function W.

    Parameters
    ----------
    operator : BellmanOperator
    values : float array (places, rows, columns)
        W; may be memory-mapped.
    """

    def __init__(self, operator: BellmanOperator, values: FloatArray) -> None:
        self.operator, self.values = operator, values
        choices = operator.choices
        self.arrivals = np.stack([choice.arrivals for choice in choices])
        self.slots = np.array([0 if choice.slot is None else choice.slot for choice in choices])
        costs = [np.repeat(c.cost, 3 // c.cost.shape[1], axis=1) for c in choices]
        self.costs = np.stack(costs)
        self.sites = [site for sites in operator.sites for site in sites]
        self.table: FloatArray | None = None
        if self.tabulates(operator.sub):
            self.table = self._table()

    @staticmethod
    def tabulates(sub: SubMdp) -> bool:
        """Whether tables are kept for a sub-MDP."""
        return sub.entries <= TABLES

    def q_values(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """Q(s, a) of global states (N, 2k+5), shape (N, actions); inf where not allowed."""
        operator = self.operator
        place, row, column = operator.locate(states)
        if self.table is None:
            sums = [self._expected(*at) for at in zip(place, row, column)]
            expected: FloatArray = np.stack(sums)
        else:
            arrivals = self.arrivals[:, place].T
            expected = self.table[arrivals, row[:, None], column[:, None]]
        levels = np.zeros((len(states), len(self.slots)), dtype=np.intp)
        if operator.sub.n:
            levels = operator.sub.columns(states)[1][:, self.slots]
        actions = np.arange(len(self.slots))
        costs = self.costs[actions, place[:, None], levels, column[:, None]]
        return operator.stage_cost(states)[:, None] + (costs + expected)

    def _table(self) -> FloatArray:
        operator = self.operator
        expected, arrivals = Expected.empty(operator), Arrivals(operator, operator.rows)
        first_half = FirstHalf(operator, operator.places, operator.columns)
        run(first_half.steps(self.values, expected, 0, 0))
        run(arrivals.steps(expected, 0))
        return arrivals.table

    def _expected(self, place: int, row: int, column: int) -> NDArray[np.float64]:
        """Discounted E[W(x') + p(t', m')] of one state for each action, shape (actions,)."""
        operator = self.operator
        successors = _Successors(operator, self.values, place, row, column)
        ways = 2 * operator.places + len(GROUND)
        completion = float(operator.completion[successors.fault])

        def expected(arrival: int) -> float:
            if arrival < ways:
                return successors.expected(arrival, range(operator.places), None)
            open_, completed = self.sites[arrival - ways]
            slot = place - operator.q
            achieved = successors.expected(completed, operator.landings[slot], slot)
            not_yet = successors.expected(open_, range(operator.places), None)
            return not_yet + completion * (achieved - not_yet)

        known = {arrival: expected(arrival) for arrival in set(self.arrivals[:, place].tolist())}
        return np.array([known[arrival] for arrival in self.arrivals[:, place].tolist()])


class _Successors:
    """Sums over the successors of one state."""

    def __init__(
        self, operator: BellmanOperator, values: FloatArray, place: int, row: int, column: int
    ) -> None:
        n, self.width = operator.sub.n, operator.columns // 8
        self.operator, self.values, self.cell = operator, values, operator.cells[place]
        self.column, (self.fault, flags) = column, divmod(column, self.width)
        self.threat, levels = divmod(row, operator.rows // 3)
        self.priorities = [
            matrix[0, levels // 3**digit % 3]
            for matrix, digit in zip(operator.priorities, range(n)[::-1])
        ]
        # Bits of f - 1 from the slowest: camera, actuator, sensor.
        bits = [self.fault >> bit & 1 for bit in (2, 1, 0)]
        lost = [1 - (flags >> digit & 1) for digit in range(n)[::-1]]
        self.flights = []
        for mode, loss in enumerate(operator.loss):
            risks = operator.failures[:, mode]
            axes = [[1 - p, p] if not bit else [0, 1] for bit, p in zip(bits, risks)]
            axes += [[1, 0] if gone else [loss, 1 - loss] for gone in lost]
            self.flights.append(_product(axes))
        self.by_column: dict[tuple[int, int | None], FloatArray] = {}

    def expected(self, arrival: int, places: Sequence[int], completed: int | None) -> float:
        """E on an arrival, where no goal is completed or the one given."""
        operator, way = self.operator, arrival // len(places)
        place = places[arrival % len(places)] if way < 2 else self.cell
        if (place, completed) not in self.by_column:
            self.by_column[place, completed] = self._exogenous(place, completed)
        table = self.by_column[place, completed]
        price = float(operator.price[1 if way == 1 else 0, place, self.threat])
        if way < 2:
            return price + float(table @ self.flights[way])
        kind = GROUND[arrival - 2 * len(places)]
        if kind == 'recharge':
            return price + float(table[(self.fault + 1) * self.width - 1])
        here = float(table[self.column])
        if kind == 'repair':
            repaired = float(table[self.column % self.width])
            here += float(operator.repair) * (repaired - here)
        return price + here

    def _exogenous(self, place: int, completed: int | None) -> FloatArray:
        """E over t' and g', shape (columns,)."""
        axes = [self.operator.threat[place, self.threat], *self.priorities]
        if completed is not None:
            axes[completed + 1] = np.array([1.0, 0.0, 0.0])
        return np.asarray(_product(axes).astype(self.values.dtype) @ self.values[place])


def _product(axes: Sequence[ArrayLike]) -> FloatArray:
    """Joint probabilities of independent variables, the first the slowest."""
    return reduce(np.kron, [np.asarray(axis) for axis in axes])
