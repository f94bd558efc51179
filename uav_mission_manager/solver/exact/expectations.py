"""E[W(x') + p(t', m')] on every arrival, in blocks that fit the caches.

The first half takes the expectation over t' and g', which no action touches, axis by axis in
blocks of columns (f, r). The second takes that over f' and r' in both modes in blocks of rows
(t, g) of all places, along the outer axis of the transposed block.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.solver.axes import FloatArray, Step, drift, gather, mix
from uav_mission_manager.solver.reduced import GROUND, BellmanOperator, hull


@dataclass(frozen=True)
class Expected:
    """Discounted E over t' and g' of W on arrival, given the present t and g.

    Attributes
    ----------
    tables : list of float array
        First that of all places, (places, 3 * 3^n, 8 * 2^n); then for each goal j that of the
        landings from its site where it is completed, g_j' = 0, over the present t and the other
        goals' g: (landings of j, 3^n, 8 * 2^n).
    """

    tables: list[FloatArray]

    @classmethod
    def empty(cls, operator: BellmanOperator) -> Expected:
        """Tables yet to be filled."""
        third = operator.rows // 3, operator.columns
        shapes = [operator.shape, *((len(cells), *third) for cells in operator.landings)]
        return cls([np.empty(shape, operator.dtype) for shape in shapes])


class FirstHalf:
    """Scratch of one thread for the expectation over t' and g'."""

    def __init__(self, operator: BellmanOperator, places: int, columns: int) -> None:
        self.operator, self.places, self.columns = operator, places, columns
        self.scratch = np.empty((3, places * operator.rows * columns), operator.dtype)

    def steps(self, values: FloatArray, expected: Expected, place: int, column: int) -> list[Step]:
        """Steps that fill `expected` for some places and columns, from the given ones on."""
        operator, n = self.operator, self.operator.sub.n
        places, columns = slice(place, place + self.places), slice(column, column + self.columns)
        source = values[places, :, columns].reshape(self.places, 3, -1, self.columns)
        x, y, scratch = self.scratch.reshape(3, *source.shape)
        steps = mix(source, operator.threat[places], x, scratch)
        completed: dict[int, FloatArray] = {}
        for slot, matrix in enumerate(operator.priorities):
            axes = -1, 3, 3 ** (n - 1 - slot) * self.columns
            x, y, scratch = x.reshape(axes), y.reshape(axes), scratch.reshape(axes)
            for other, table in completed.items():
                table = table.reshape(axes)
                completed[other] = np.empty_like(table)
                steps += mix(table, matrix, completed[other], np.empty_like(table))
            here = range(place, place + self.places)
            landings = [cell - place for cell in operator.landings[slot] if cell in here]
            if landings:
                achieved = x.reshape(self.places, -1, *axes[1:])[:, :, 0]
                completed[slot] = np.empty((len(landings), *achieved.shape[1:]), operator.dtype)
                steps += [
                    (np.copyto, (into, achieved[landing]))
                    for into, landing in zip(completed[slot], landings)
                ]
            steps += mix(x, matrix, y, scratch)
            x, y = y, x
        into = expected.tables[0][places, :, columns]
        steps.append((np.copyto, (into, x.reshape(into.shape))))
        for slot, table in completed.items():
            start = bisect_left(operator.landings[slot], place)
            table = table.reshape(-1, operator.rows // 3, self.columns)
            into = expected.tables[slot + 1][start : start + len(table), :, columns]
            steps.append((np.copyto, (into, table)))
        return steps


class Arrivals:
    """Scratch of one thread for the rest, some rows (t, g) at a time.

    Attributes
    ----------
    rows : int
        A power of 3, or all.
    table : float array (arrivals, rows, columns)
        Discounted E[W(x') + p(t', m')], in the order of `Choice.arrivals`.
    """

    def __init__(self, operator: BellmanOperator, rows: int) -> None:
        n, columns, dtype = operator.sub.n, operator.columns, operator.dtype
        self.operator, self.rows = operator, rows
        self.after = [3 ** (n - 1 - slot) for slot in range(n)]
        self.heights = [rows // 3 if 3 * after <= rows else rows for after in self.after]
        cells = [range(operator.places), *operator.landings]
        parts = list(zip(map(len, cells), [rows, *self.heights]))
        ends = np.cumsum([0] + [count * height for count, height in parts])
        self.flight = np.empty((2, columns, ends[-1]), dtype)
        self.parts = [
            self.flight[:, :, start:end].reshape(2, columns, *part)
            for start, end, part in zip(ends, ends[1:], parts)
        ]
        self.prices = [
            np.repeat(operator.price[:, list(chosen)], height // 3, axis=2)[..., None]
            for chosen, height in zip(cells, [operator.rows] + n * [operator.rows // 3])
        ]
        ways = 2 * operator.places + len(GROUND)
        self.table = np.empty((ways + sum(map(len, operator.sites)), rows, columns), dtype)
        self.ways = [self.table[:ways]] + [
            np.empty((2 * count + len(GROUND), height, columns), dtype)
            for count, height in parts[1:]
        ]
        self.fixed_steps = self._flight()
        self.site_steps = [step for slot in range(n) for step in self._site(slot)]

    def steps(self, expected: Expected, first: int) -> list[Step]:
        """Steps that fill `table` for the rows from `first` on."""
        starts = [first, *(self._row_without(slot, first) for slot in range(len(self.after)))]
        spans = [slice(start, start + ways.shape[1]) for start, ways in zip(starts, self.ways)]
        sources = [table[:, span] for table, span in zip(expected.tables, spans)]
        steps: list[Step] = [
            (np.copyto, (part[0], source.transpose(2, 0, 1)))
            for part, source in zip(self.parts, sources)
        ]
        steps += self.fixed_steps
        for ways, part, source, price, span in zip(
            self.ways, self.parts, sources, self.prices, spans
        ):
            flying = ways[: -len(GROUND)].reshape(2, *source.shape)
            steps.append((np.add, (part.transpose(0, 2, 3, 1), price[:, :, span], flying)))
        for goal, (ways, source, price, span) in enumerate(
            zip(self.ways, sources, self.prices, spans)
        ):
            steps += self._ground(ways[-len(GROUND) :], source, price[0, :, span], goal)
        return steps + self.site_steps

    def _row_without(self, slot: int, row: int) -> int:
        """Row of a table that lacks the axis of a goal's priority."""
        before, after = divmod(row, 3 * self.after[slot])
        return before * self.after[slot] + after % self.after[slot]

    def _flight(self) -> list[Step]:
        """Expectation over each bit of f' (camera, actuator, sensor) and each r_j' in flight."""
        operator = self.operator
        room = np.empty(self.flight.size // 2, operator.dtype)
        digits = [(p, 0) for p in operator.failures] + [(operator.loss, 1)] * operator.sub.n
        alike: list[Step] = []
        different: list[Step] = []
        for digit, (probability, leaves) in enumerate(digits):
            same = probability[0] == probability[1]  # Taken once for both modes.
            flight = self.flight[:1] if same else self.flight
            bits = flight.reshape(len(flight), 2**digit, 2, -1)
            values, towards = bits[:, :, leaves], bits[:, :, 1 - leaves]
            scratch = room[: values.size].reshape(values.shape)
            weights = probability[: len(flight), None, None]
            (alike if same else different).extend(drift(values, towards, weights, scratch))
        return [*alike, (np.copyto, (self.flight[1], self.flight[0])), *different]

    def _ground(
        self, into: FloatArray, source: FloatArray, price: FloatArray, goal: int
    ) -> list[Step]:
        """Arrivals in the order of `GROUND`, from any cell (goal 0) or from a goal's site."""
        operator, grid = self.operator, self.operator.sub.mission.grid
        cells: Sequence[int] = range(operator.q)
        if goal > 0:
            cells = operator.landings[goal - 1]
        steps: list[Step] = []
        if goal == 0 or grid.base == operator.cells[operator.q + goal - 1]:
            base = cells.index(grid.base)
            steps.append((np.add, (source[base], price[base], into[0])))
        if goal == 0 or grid.service == operator.cells[operator.q + goal - 1]:
            service = cells.index(grid.service)
            faults = source[service].reshape(source.shape[1], 8, -1)
            recharged, repaired = into[1:].reshape(2, *faults.shape)
            steps.append((np.copyto, (recharged, faults[:, :, -1:])))
            steps.append((np.copyto, (repaired, faults)))
            steps += drift(repaired, faults[:, :1], operator.repair, np.empty_like(faults))
            steps.append((np.add, (into[1:], price[service], into[1:])))
        return steps

    def _site(self, slot: int) -> list[Step]:
        """Arrivals from a site: mixed with those on completion where that can happen."""
        operator, height, site = self.operator, self.heights[slot], self.operator.sites[slot]
        columns = operator.columns
        first = len(self.ways[0]) + sum(map(len, operator.sites[:slot]))
        open_, completed = np.array(site).T.copy()
        into = self.table[first : first + len(site)]
        done = np.empty((len(site), height, columns), operator.dtype)
        levels, after = (3, self.after[slot]) if height < self.rows else (1, height)
        able = hull(operator.completion > 0)
        width = columns // 8
        inside = slice(able.start * width, able.stop * width)
        values = into.reshape(len(site), -1, levels, after, columns)[..., inside]
        towards = done.reshape(len(site), -1, 1, after, columns)[..., inside]
        probability = np.repeat(operator.completion[able], width)
        return [
            gather(self.ways[0], open_, into),
            gather(self.ways[slot + 1], completed, done),
            *drift(values, towards, probability, np.empty_like(values)),
        ]
