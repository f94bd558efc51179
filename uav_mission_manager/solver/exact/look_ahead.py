"""Q values of single states, from tables of E[W] on every arrival or by sums over successors.

Tables answer at once and are kept where they are small. Otherwise a state's Q values are one
backup of that state: the sum over its successors, a look at the few cells it may arrive in.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.mdp.dynamics import ON_GROUND
from uav_mission_manager.solver.axes import run_steps
from uav_mission_manager.solver.exact.axis_model import AxisModel
from uav_mission_manager.solver.exact.expectations import (
    ArrivalExpectation,
    ExogenousExpectation,
    ExogenousTables,
)
from uav_mission_manager.solver.submdp import SubMdp

MAX_TABLED_ENTRIES = 1 << 19
"""Entries of W up to which tables of E[W], some three times as large, are kept: a choice."""


class LookAhead:
    """Q(s, a) in the value function W.

    Parameters
    ----------
    model : AxisModel
    values : float array (q, rows, columns)
        W; may be memory-mapped.
    expected : ExogenousTables, optional
        E of W over t' and g', of a `Sweeper`: what is in them is not summed again, state by state.
    """

    def __init__(
        self, model: AxisModel, values: RealArray, expected: ExogenousTables | None = None
    ) -> None:
        self.model, self.values, self.expected = model, values, expected
        choices = model.choices
        self.arrivals = np.stack([choice.arrivals for choice in choices])
        self.slots = np.array([0 if choice.slot is None else choice.slot for choice in choices])
        costs = [np.repeat(c.cost, 3 // c.cost.shape[1], axis=1) for c in choices]
        self.costs = np.stack(costs)
        self.table = self._table() if self.tabulates(model.sub) else None

    @staticmethod
    def tabulates(sub: SubMdp) -> bool:
        """Whether tables are kept for a sub-MDP."""
        return sub.entries <= MAX_TABLED_ENTRIES

    def q_values(self, states: IntArray) -> FloatArray:
        """Q(s, a) of global states (N, 2k+5), shape (N, actions); inf where not allowed."""
        model = self.model
        cell, row, column = model.locate(states)
        if self.table is None:
            expected: RealArray = np.stack([self._expected(*at) for at in zip(cell, row, column)])
        else:
            expected = self.table[self.arrivals[:, cell].T, row[:, None], column[:, None]]
        levels = np.zeros((len(states), len(self.slots)), dtype=np.intp)
        if model.sub.n:
            levels = model.sub.priorities(states)[:, self.slots]
        actions = np.arange(len(self.slots))
        costs = self.costs[actions, cell[:, None], levels, column[:, None]]
        return model.reduced.state_costs(states)[:, None] + (costs + expected)

    def _table(self) -> RealArray:
        model = self.model
        expected, arrivals = ExogenousTables.empty(model), ArrivalExpectation(model, model.rows)
        exogenous = ExogenousExpectation(model, model.q, model.columns)
        run_steps(exogenous.steps(self.values, expected, 0, 0))
        run_steps(arrivals.steps(expected, 0))
        return arrivals.table

    def _expected(self, cell: int, row: int, column: int) -> FloatArray:
        """Discounted E[W(s') + p(t', m')] of one state for each action, shape (actions,)."""
        successors = _Successors(self, row, column)
        arrivals = self.arrivals[:, cell].tolist()
        known = {arrival: successors.expected(arrival) for arrival in set(arrivals)}
        return np.array([known[arrival] for arrival in arrivals])


class _Successors:
    """Sums over the successors of one state."""

    def __init__(self, ahead: LookAhead, row: int, column: int) -> None:
        self.model, self.values, self.known = ahead.model, ahead.values, ahead.expected
        model, n, self.width = self.model, self.model.sub.n, self.model.columns // 8
        self.row, self.column = row, column
        self.fault, ranges = divmod(column, self.width)
        self.threat, levels = divmod(row, model.rows // model.sub.threats)
        self.priorities = [
            matrix[0, levels // 3**digit % 3]
            for matrix, digit in zip(model.priorities, range(n)[::-1])
        ]
        # Bits of f - 1 from the slowest: camera, actuator, sensor.
        bits = [self.fault >> bit & 1 for bit in (2, 1, 0)]
        self.flights = []
        for mode in (0, 1):
            risks = model.failures[:, mode]
            axes = [[1 - p, p] if not bit else [0, 1] for bit, p in zip(bits, risks)]
            self.flights.append(_product([*axes, *self._ranges(mode, ranges)]))
        self.by_column: dict[tuple[int, int | None], RealArray] = {}

    def _ranges(self, mode: int, ranges: int) -> list[ArrayLike]:
        """Probabilities of each r_j', or of b', in flight from the value of all r_j, or of b."""
        losses, drain = self.model.losses, self.model.drain[mode]
        if not drain.size:
            lost = [1 - (ranges >> digit & 1) for digit in range(len(losses))[::-1]]
            return [[1, 0] if gone else [p[mode], 1 - p[mode]] for gone, p in zip(lost, losses)]
        after = np.maximum(ranges - np.arange(drain.size), 0)
        return [np.bincount(after, drain, minlength=self.width)]

    def expected(self, arrival: int) -> float:
        """E on an arrival, numbered as in `AxisModel`."""
        model, ground = self.model, 2 * self.model.q
        if arrival < ground:
            return self._flown(*divmod(arrival, model.q), None)
        if arrival < ground + len(ON_GROUND):
            return self._grounded(arrival - ground)
        slot, mode = divmod(arrival - ground - len(ON_GROUND), 2)
        cell, completion = model.goal_cells[slot], float(model.completion[slot, self.fault])
        open_ = self._flown(mode, cell, None)
        return open_ + completion * (self._flown(mode, cell, slot) - open_)

    def _flown(self, mode: int, cell: int, completed: int | None) -> float:
        price = float(self.model.price[mode, cell, self.threat])
        return price + float(self._exogenous(cell, completed) @ self.flights[mode])

    def _grounded(self, position: int) -> float:
        model, grid = self.model, self.model.sub.mission.grid
        cell = grid.base if position == 0 else grid.service
        price, table = float(model.price[0, cell, self.threat]), self._exogenous(cell, None)
        if position == 1:
            ranges = self.model.recharged[self.column % self.width]
            return price + float(table[self.fault * self.width + ranges])
        here = float(table[self.column])
        if position == 2:
            repaired = float(table[self.column % self.width])
            here += float(model.repair) * (repaired - here)
        return price + here

    def _exogenous(self, cell: int, completed: int | None) -> RealArray:
        """E over t' and g' in a cell, shape (columns,)."""
        if self.known is not None:
            if completed is None:
                return self.known.open[cell, self.row]
            return self.known.completed[completed][self.model.row_without(completed, self.row)]
        if (cell, completed) not in self.by_column:
            axes = [self.model.threat[cell, self.threat], *self.priorities]
            if completed is not None:
                axes[completed + 1] = np.array([1.0, 0.0, 0.0])
            weights = _product(axes).astype(self.values.dtype)
            self.by_column[cell, completed] = np.asarray(weights @ self.values[cell])
        return self.by_column[cell, completed]


def _product(axes: Sequence[ArrayLike]) -> FloatArray:
    """Joint probabilities of independent variables, the first the slowest."""
    return reduce(np.kron, [np.asarray(axis) for axis in axes])
