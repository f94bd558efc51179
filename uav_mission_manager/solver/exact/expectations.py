"""E[W(s') + p(t', m')] on every arrival, in blocks that fit the caches.

First the expectation over t' and g', which no action touches, is taken axis by axis in blocks of
cells and columns (f, r). Then that over f' and r' in both modes, and over whether a goal is
completed, in blocks of rows (t, g) of all cells, along the outer axis of the transposed block.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uav_mission_manager.mdp.arrays import RealArray
from uav_mission_manager.mdp.dynamics import ON_GROUND
from uav_mission_manager.solver.axes import ArrayStep, drift, fall, mix
from uav_mission_manager.solver.exact.axis_model import AxisModel, hull


@dataclass(frozen=True)
class ExogenousTables:
    """Discounted E over t' and g' of W on arrival in each cell, given the present t and g.

    Attributes
    ----------
    open : float array (q, T * 3^n, 8 * 2^n)
        Where no goal is completed.
    completed : float array (n, T * 3^(n-1), 8 * 2^n)
        For each goal tracked that on its cell where it is completed, g_j' = 0, over the present t
        and the other goals' g.
    """

    open: RealArray
    completed: RealArray

    @classmethod
    def empty(cls, model: AxisModel) -> ExogenousTables:
        """Tables yet to be filled."""
        completed = model.sub.n, model.rows // 3, model.columns
        return cls(model.empty(model.shape), model.empty(completed))


class ExogenousExpectation:
    """E over t' and g' in blocks of cells and columns; holds the scratch of one thread."""

    def __init__(self, model: AxisModel, cells: int, columns: int) -> None:
        self.model, self.cells, self.columns = model, cells, columns
        self.scratch = model.empty((3, cells * model.rows * columns))
        self.threat = model.device.put(model.threat)
        self.priorities = [model.device.put(matrix) for matrix in model.priorities]

    def steps(
        self, values: RealArray, expected: ExogenousTables, cell: int, column: int
    ) -> list[ArrayStep]:
        """Steps that fill `expected` for some cells and columns, from the given ones on."""
        model, n, count = self.model, self.model.sub.n, min(self.cells, self.model.q - cell)
        cells, columns = slice(cell, cell + count), slice(column, column + self.columns)
        source = values[cells, :, columns].reshape(count, model.sub.threats, -1, self.columns)
        x, y, scratch = (part[: source.size].reshape(source.shape) for part in self.scratch)
        steps = mix(source, self.threat[cells], x, scratch)
        completed: dict[int, tuple[RealArray, RealArray]] = {}  # With room for the next axis.
        for slot, matrix in enumerate(self.priorities):
            axes = -1, 3, 3 ** (n - 1 - slot) * self.columns
            x, y, scratch = x.reshape(axes), y.reshape(axes), scratch.reshape(axes)
            for other, pair in completed.items():
                table, mixed = (part.reshape(axes) for part in pair)
                steps += mix(table, matrix, mixed, scratch[: len(table)])
                completed[other] = mixed, table
            offset = model.goal_cells[slot] - cell
            if 0 <= offset < count:
                achieved = x.reshape(count, -1, *axes[1:])[offset, :, 0]
                table, mixed = model.empty((2, *achieved.shape))
                completed[slot] = table, mixed
                steps.append((np.copyto, (completed[slot][0], achieved)))
            steps += mix(x, matrix, y, scratch)
            x, y = y, x
        into = expected.open[cells, :, columns]
        steps.append((np.copyto, (into, x.reshape(into.shape))))
        for slot, (table, _) in completed.items():
            into = expected.completed[slot][:, columns]
            steps.append((np.copyto, (into, table.reshape(into.shape))))
        return steps


class ArrivalExpectation:
    """Takes the rest of the expectation, some rows (t, g) at a time; scratch of one thread.

    Attributes
    ----------
    rows : int
        A power of 3, or all.
    table : float array (arrivals, rows, columns)
        Discounted E[W(s') + p(t', m')], in the order of `AxisModel`'s arrivals.
    """

    def __init__(self, model: AxisModel, rows: int) -> None:
        n, q, columns, put = model.sub.n, model.q, model.columns, model.device.put
        self.model, self.rows = model, rows
        heights = [rows // 3 if self.varies(slot) else rows for slot in range(n)]
        ends = np.cumsum([q * rows, *heights]).tolist()
        # A card keeps the order of W, without transposing; NumPy wants long runs, so rows last.
        if model.device.on_gpu:
            self.flight, self.lines = model.empty((2, ends[-1], columns)), ends[-1]
            flown = self.flight
        else:
            self.flight, self.lines = model.empty((2, columns, ends[-1])), 1
            flown = self.flight.transpose(0, 2, 1)
        self.open = flown[:, : q * rows].reshape(2, q, rows, columns)
        self.completed = [flown[:, i:j] for i, j in pairwise(ends)]
        price = np.repeat(model.price, model.rows // model.sub.threats, axis=2)
        self.price, self.repair = put(price[..., None]), put(model.repair)
        # A completed part lacks the axis of g_j, on which the price does not depend.
        self.completed_prices = [put(price[:, cell, ::3, None]) for cell in model.goal_cells]
        self.table = model.empty((model.arrivals, rows, columns))
        self.flight_steps = self._flight()
        self.completion_steps = [self._completion(slot) for slot in range(n)]

    def varies(self, slot: int) -> bool:
        """Whether a goal's priority varies within a block of rows."""
        return 3 * self.model.after[slot] <= self.rows

    def steps(self, expected: ExogenousTables, first: int) -> list[ArrayStep]:
        """Steps that fill `table` for the rows from `first` on."""
        q, span = self.model.q, slice(first, first + self.rows)
        source, price = expected.open[:, span], self.price[:, :, span]
        steps: list[ArrayStep] = [(np.copyto, (self.open[0], source))]
        for slot, part in enumerate(self.completed):
            start = self.model.row_without(slot, first)
            done = expected.completed[slot][start : start + part.shape[1]]
            steps.append((np.copyto, (part[0], done)))
        steps += self.flight_steps
        flown = self.table[: 2 * q].reshape(2, *source.shape)
        steps.append((np.add, (self.open, price, flown)))
        steps += self._ground(source, price[0])
        for slot, completion in enumerate(self.completion_steps):
            into, done = self._completing(slot), self.completed[slot]
            cell = self.model.goal_cells[slot]
            steps.append((np.copyto, (into, flown[:, cell])))
            start = self.model.row_without(slot, first)
            price_there = self.completed_prices[slot][:, start : start + done.shape[1]]
            steps.append((np.add, (done, price_there, done)))
            steps += completion
        return steps

    def _flight(self) -> list[ArrayStep]:
        """Expectation over each bit of f' (camera, actuator, sensor), and each r_j' or b'."""
        model, put = self.model, self.model.device.put
        room = model.empty(self.flight.size // 2)
        digits = [(p, 0) for p in model.failures] + [(loss, 1) for loss in model.losses]
        alike: list[ArrayStep] = []
        different: list[ArrayStep] = []
        for digit, (probability, leaves) in enumerate(digits):
            same = probability[0] == probability[1]  # Taken once for both modes.
            flight = self.flight[:1] if same else self.flight
            bits = flight.reshape(len(flight), self.lines * 2**digit, 2, -1)
            values, towards = bits[:, :, leaves], bits[:, :, 1 - leaves]
            scratch = room[: values.size].reshape(values.shape)
            weights = put(probability[: len(flight), None, None])
            (alike if same else different).extend(drift(values, towards, weights, scratch))
        if model.drain.size:
            same = np.array_equal(*model.drain)
            modes = 1 if same else 2
            levels = self.flight[:modes].reshape(modes, self.lines * 8, model.columns // 8, -1)
            scratch = model.empty((2, *levels.shape))
            (alike if same else different).extend(fall(levels, put(model.drain[:modes]), *scratch))
        return [*alike, (np.copyto, (self.flight[1], self.flight[0])), *different]

    def _ground(self, source: RealArray, price: RealArray) -> list[ArrayStep]:
        """Arrivals on the ground, in the order of `ON_GROUND`."""
        model, grid = self.model, self.model.sub.mission.grid
        first = 2 * model.q
        parked, *serviced = self.table[first : first + len(ON_GROUND)]
        faults = source[grid.service].reshape(source.shape[1], 8, -1)
        recharged, repaired = (table.reshape(faults.shape) for table in serviced)
        gained = max(int(model.recharged[0]), 1)
        return [
            (np.add, (source[grid.base], price[grid.base], parked)),
            (np.copyto, (recharged[:, :, -gained:], faults[:, :, -1:])),
            (np.copyto, (recharged[:, :, :-gained], faults[:, :, gained:])),
            (np.copyto, (repaired, faults)),
            *drift(repaired, faults[:, :1], self.repair, np.empty_like(faults)),
            *((np.add, (table, price[grid.service], table)) for table in serviced),
        ]

    def _completing(self, slot: int) -> RealArray:
        first = 2 * self.model.q + len(ON_GROUND) + 2 * slot
        return self.table[first : first + 2]

    def _completion(self, slot: int) -> list[ArrayStep]:
        """Mix with the completed part by completion_j(f), in the modes where it is not 0."""
        model, part = self.model, self.completed[slot]
        levels, after = (3, model.after[slot]) if self.varies(slot) else (1, part.shape[1])
        completion, width = model.completion[slot], model.columns // 8
        able = hull(completion > 0)
        inside = slice(able.start * width, able.stop * width)
        values = self._completing(slot).reshape(2, -1, levels, after, model.columns)[..., inside]
        towards = part.reshape(2, -1, 1, after, model.columns)[..., inside]
        probability = model.device.put(np.repeat(completion[able], width))
        return drift(values, towards, probability, np.empty_like(values))
