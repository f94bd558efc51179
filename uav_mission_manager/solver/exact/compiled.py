"""The sweep of `uav_mission_manager.solver.exact.sweep` by compiled kernels.

First the expectation over t' and the g' of the outer goals is taken, some columns at a time; then,
block of rows by block, that over the g' of the inner goals and the rest of the backup.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from uav_mission_manager.mdp.arrays import RealArray
from uav_mission_manager.solver.exact.axis_model import AxisModel, hull
from uav_mission_manager.solver.exact.expectations import ExogenousTables
from uav_mission_manager.solver.exact.kernels import back_up, mix_axes
from uav_mission_manager.solver.threads import share

LANES = 16
"""Columns that a processor takes at once, at most: spans of columns are widened to these."""


class CompiledSweep:
    """Sweeps of W, of a mission with three threat levels.

    Parameters
    ----------
    model : AxisModel
    values : float array (cells, rows, columns)
        W, overwritten by each backup.
    expected : ExogenousTables
        Room to work in; afterwards the tables of the W before.
    inner : int
        Inner goals: a block has 3^inner rows.
    """

    def __init__(
        self, model: AxisModel, values: RealArray, expected: ExogenousTables, inner: int
    ) -> None:
        self.values, self.expected = values, expected
        self.n, self.outer = model.sub.n, model.sub.n - inner
        self.priorities = [matrix[0] for matrix in model.priorities]
        self.tables = Tables.of(model)
        self.inner = self._stack(self.priorities[self.outer :])
        self.row_blocks = range(0, model.rows, 3**inner)

    def backup(self, further: float, threads: int) -> tuple[float, float]:
        """Replace W by its Bellman backup, then change it by `further` times that change.

        Returns
        -------
        float, float
            Least and largest change that the backup makes.
        """
        factor = self.values.dtype.type(further)

        def work(_: int, first: int) -> tuple[float, float]:
            tables = self.expected.open, self.expected.completed, self.inner, self.tables
            return back_up(self.values, first, factor, *tables)

        share(self._expect_open, range(len(self.values)), threads)
        share(self._expect_completed, range(self.n), threads)
        lows, highs = zip(*share(work, self.row_blocks, threads))
        return float(min(lows)), float(max(highs))

    def _expect_open(self, _: int, cell: int) -> None:
        """Expectation over t' and the outer g' in a cell."""
        matrices = self._stack([self.tables.threat[cell], *self.priorities[: self.outer]])
        axes = 1, 3 ** len(matrices), -1
        mix_axes(self.values[cell].reshape(axes), self.expected.open[cell].reshape(axes), matrices)

    def _expect_completed(self, _: int, slot: int) -> None:
        """Expectation over t' and all other g' where a goal is completed."""
        cell, out = self.tables.goal_cells[slot], self.expected.completed[slot]
        achieved = self.values[cell].reshape(3 ** (1 + slot), 3, -1)[:, 0]
        np.copyto(out.reshape(achieved.shape), achieved)
        outer = [self.tables.threat[cell], *self.priorities[: self.outer]]
        inner = self.priorities[self.outer :]
        if slot < self.outer:
            del outer[1 + slot]
        else:
            del inner[slot - self.outer]
        table = out.reshape(1, 3 ** len(outer), -1)
        mix_axes(table, table, self._stack(outer))
        table = out.reshape(3 ** len(outer), 3 ** len(inner), -1)
        mix_axes(table, table, self._stack(inner))

    def _stack(self, matrices: list[RealArray]) -> RealArray:
        return np.array(matrices, self.values.dtype).reshape(-1, 3, 3)


class Tables(NamedTuple):
    """What a backup is made of: q cells, n goals, A actions, Z columns, and see `AxisModel`.

    Attributes
    ----------
    changes : int array (c, 2)
        Changes in flight in their order: columns from one value to the next, and which value, 0
        or 1, is left; (0, 0) is the drain.
    chances : float array (2, c, Z)
        Their probabilities in both modes, 0 in the columns that none leaves.
    alike : int
        How many changes, from the first, are the same in both modes.
    completion : float array (n, Z)
    arrivals : int array (q, A)
    slots : int array (A,)
        Of the goal that an action commits to, -1 for none.
    spans : int array (A, 3, 2)
        Columns outside which an action is allowed nowhere, by the priority of its goal.
    costs : float array (q, A, 3, Z)
    """

    threat: Any
    price: Any
    goal_cells: Any
    changes: Any
    chances: Any
    alike: int
    drain: Any
    recharged: Any
    repair: Any
    completion: Any
    arrivals: Any
    slots: Any
    spans: Any
    costs: Any
    base_cost: Any
    base: int
    service: int

    @classmethod
    def of(cls, model: AxisModel) -> Tables:
        """Tables of a model."""
        n, columns, choices = model.sub.n, model.columns, model.choices
        axes = [(0, p) for p in model.failures] + [(1, p) for p in model.losses]
        changes = [(columns >> i, left, p) for i, (left, p) in enumerate(axes, 1)]
        if model.drain.size:
            changes.append((0, 0, model.drain))
        alike = [change for change in changes if np.array_equal(*change[2])]
        changes = alike + [change for change in changes if not np.array_equal(*change[2])]
        chances = np.zeros((2, len(changes), columns), model.dtype)
        for step, (after, left, p) in enumerate(changes):
            if after:
                chances[:, step, np.arange(columns) // after % 2 == left] = p[:, None]
        costs = model.action_costs
        # Unsigned: an index below 0 would count from the end, which numba would look for.
        spans = np.zeros((len(choices), 3, 2), np.uint64)
        for a in range(len(choices)):
            for level, allowed in enumerate(np.asarray(np.isfinite(costs[:, a]).any(axis=0))):
                span = hull(allowed)
                ends = span.start // LANES * LANES, min(-(-span.stop // LANES) * LANES, columns)
                spans[a, level] = ends if allowed.any() else (0, 0)
        grid, completion = model.sub.mission.grid, np.broadcast_to(model.completion, (n, 8))
        return cls(
            threat=model.threat,
            price=model.price,
            goal_cells=np.array(model.goal_cells, np.int64),
            changes=np.array([change[:2] for change in changes]),
            chances=chances,
            alike=len(alike),
            drain=model.drain,
            recharged=model.recharged,
            repair=model.repair[()],
            completion=np.repeat(completion, columns // 8, axis=1),
            arrivals=model.action_arrivals.astype(np.uint64),
            slots=np.array([-1 if choice.slot is None else choice.slot for choice in choices]),
            spans=spans,
            costs=costs,
            base_cost=model.base_cost,
            base=grid.base,
            service=grid.service,
        )
