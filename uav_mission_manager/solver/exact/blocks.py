"""Out of core: the exact solution block by block, with W in files.

A block is a set of cells times a set of fault modes. Its Bellman equation asks for the rest of W
only as boundary values: those of the cells an epoch away, and of the fault modes that its own may
turn into. A round backs up one block after the other from the W of the round before, so that it
makes a whole backup T W, and the bounds of `uav_mission_manager.solver.span_bounds` hold.

In memory are some five tables of the size of the block at hand, ten of one of its cells, and
the costs.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from uav_mission_manager.mdp.arrays import IndexArray, RealArray
from uav_mission_manager.mdp.dynamics import ON_GROUND, Regime
from uav_mission_manager.solver.axes import drift, fall, mix, run_steps
from uav_mission_manager.solver.exact.axis_model import AxisModel, Choice
from uav_mission_manager.solver.exact.value_iteration import Solution
from uav_mission_manager.solver.progress import Progress, Report, ignore, share_of_decades
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import SubMdp

Region = tuple[Sequence[int], Sequence[int]]
"""Cells, from 0, and fault modes, from 1, of a block."""

_Users = dict[tuple[int, int | None], list[tuple[Choice, int]]]
"""By regime and goal that may be completed (its slot): the actions and cells that lead there."""


def solve_blocks(
    sub: SubMdp,
    blocks: Sequence[Region],
    tolerance: float = 1e-7,
    *,
    directory: str | Path | None = None,
    max_rounds: int = 10_000,
    progress: Progress = ignore,
) -> Solution:
    """Solve a sub-MDP block by block.

    Parameters
    ----------
    sub : SubMdp
    blocks : sequence of (cells, fault modes)
        Cells from 0 and modes from 1; together they hold every cell in every mode.
    tolerance : float
        Largest distance of V from V*, in cost.
    directory : path, optional
        Where the files are, twice the size of W; by default where temporary files go. They have
        no names and vanish with the solution.
    max_rounds : int
        Rounds after which to give up; the result then says `converged=False`.
    progress : Progress
        Is told of each round.

    Returns
    -------
    Solution
        With a memory-mapped value, and rounds for iterations.

    Raises
    ------
    ValueError
        If tolerance or max_rounds is not above 0, or the blocks leave a state out.
    OSError
        If there is no room for the files.
    """
    if not tolerance > 0 or max_rounds < 1:
        raise ValueError(f'tolerance {tolerance} and max_rounds {max_rounds} must be above 0')
    _check_cover(sub, blocks)
    model, first, span, rounds = AxisModel(sub), 0.0, math.inf, 0
    present, coming = (_zeros(model.shape, directory) for _ in range(2))
    while True:
        changes = [_Block(model, present, block).back_up(coming) for block in blocks]
        lows, highs = zip(*changes)
        bounds = SpanBounds(min(lows), max(highs), sub.mission.discount)
        rounds, first = rounds + 1, first or bounds.distance
        done = share_of_decades(first, bounds.distance, tolerance)
        progress(Report(rounds, done, f'round {rounds}, within {bounds.distance:.1e} of V*'))
        if bounds.distance <= tolerance or bounds.stalled(span) or rounds == max_rounds:
            break
        present, coming, span = coming, present, bounds.span
    return Solution.at_middle(model, coming, bounds, rounds, tolerance)


class _Block:
    """A block, for as long as it is worked on."""

    def __init__(self, model: AxisModel, table: RealArray, block: Region) -> None:
        self.model, self.table, self.cells = model, table, sorted(set(block[0]))
        self.modes = np.unique(block[1]) - 1
        self.columns = self._columns(self.modes)
        self.risks = model.reduced.faults[:2, self.modes]
        self.reached = np.flatnonzero(self.risks.any(axis=(0, 1)))

    def back_up(self, into: RealArray) -> tuple[float, float]:
        """Write the block's part of T W; return the least and the largest change."""
        least = np.full((len(self.cells), self.model.rows, len(self.columns)), np.inf)
        for landing, users in self._users().items():
            for position in self._completable(users):
                self._arrive(least, landing, position, users)
        base_costs = self.model.base_cost
        low, high = math.inf, -math.inf
        for cell, values in zip(self.cells, least):
            base_cost = base_costs[cell % len(base_costs)][:, self.columns]
            values.reshape(-1, *base_cost.shape)[...] += base_cost
            change = values - self.table[cell][:, self.columns]
            low, high = min(low, float(change.min())), max(high, float(change.max()))
            into[cell][:, self.columns] = values
        return low, high

    def _users(self) -> dict[int, _Users]:
        """By landing cell, who leads there and how."""
        reduced = self.model.reduced
        users: dict[int, _Users] = defaultdict(lambda: defaultdict(list))
        for a, choice in enumerate(self.model.choices):
            for position, cell in enumerate(self.cells):
                slot = choice.slot if reduced.completes[a, cell] else None
                key = int(reduced.regimes[a, cell]), slot
                users[int(reduced.landings[a, cell])][key].append((choice, position))
        return {landing: dict(found) for landing, found in users.items()}

    @staticmethod
    def _completable(users: _Users) -> list[int | None]:
        """None, and the goals that may be completed."""
        return [None, *sorted({slot for _, slot in users if slot is not None})]

    def _arrive(
        self, least: RealArray, landing: int, completed: int | None, users: _Users
    ) -> None:
        """Lower `least` to Q, less b, of the actions that land in a cell."""
        open_ = self._landing(landing, None)
        done = {} if completed is None else self._landing(landing, completed)
        for (regime, slot), found in users.items():
            if slot != completed:
                continue
            expected = open_[regime]
            if slot is not None:
                expected = self._completed(expected, done[regime], slot)
            for choice, position in found:
                self._take(least[position], expected, choice, self.cells[position])

    def _take(self, least: RealArray, expected: RealArray, choice: Choice, cell: int) -> None:
        """Lower `least` in one cell to Q, less b, of one action."""
        after = len(least) if choice.slot is None else self._after(choice.slot)
        axes = -1, choice.cost.shape[1], after, len(self.columns)
        into = least.reshape(axes)[:, choice.levels]
        cost = choice.cost[cell, choice.levels][:, None, self.columns]
        np.minimum(into, expected.reshape(axes)[:, choice.levels] + cost, out=into)

    def _landing(self, cell: int, completed: int | None) -> dict[int, RealArray]:
        """Discounted E[W(s') + p(t', m')] in a cell by regime, each (rows, modes, 2^n).

        Without the rows of a goal's priority where that goal is completed.
        """
        model, grid = self.model, self.model.sub.mission.grid
        flights: RealArray = np.zeros((2, 1, 1, 1))
        for first in range(0, len(self.reached), len(self.modes)):
            some = self.reached[first : first + len(self.modes)]
            values = self._exogenous(cell, some, completed)
            flights = flights + [_expect(values, risks[None, :, some]) for risks in self.risks]
        for mode, flight in enumerate(flights):
            for digit, loss in enumerate(model.losses):
                flags = flight.reshape(-1, 2, 2**digit)
                away = np.empty_like(flags[:, 1])
                run_steps(drift(flags[:, 1], flags[:, 0], loss[mode], away))
            if model.drain.size:
                scratch = np.empty((2, 1, *flight.reshape(-1, flight.shape[-1]).shape))
                levels = flight.reshape(scratch.shape[1:])
                run_steps(fall(levels, model.drain[mode : mode + 1], *scratch))
        tables = dict(zip((Regime.NORMAL_FLIGHT, Regime.AGILE_FLIGHT), flights))
        if completed is None and cell in (grid.base, grid.service):
            tables.update(self._ground(cell))
        for regime, table in tables.items():
            price = model.price[int(regime == Regime.AGILE_FLIGHT), cell]
            table.reshape(len(price), -1)[...] += price[:, None]
        return {int(regime): table for regime, table in tables.items()}

    def _ground(self, cell: int) -> dict[Regime, RealArray]:
        """Discounted E[W] after staying, recharge and repair."""
        here = self._exogenous(cell, self.modes, None)
        nominal = self._exogenous(cell, np.zeros(1, np.intp), None)
        repaired = here.copy()
        run_steps(drift(repaired, nominal, self.model.repair, np.empty_like(here)))
        recharged = here.take(self.model.recharged, axis=2)
        return dict(zip(ON_GROUND, (here, recharged, repaired)))

    def _exogenous(self, cell: int, modes: IndexArray, completed: int | None) -> RealArray:
        """Discounted E over t' and g' of W in a cell in some modes, (rows, modes, 2^n)."""
        model, columns = self.model, self._columns(modes)
        values = self.table[cell][:, columns]
        values = _expect(values.reshape(1, model.sub.threats, -1), model.threat[cell][None])
        for slot, matrix in enumerate(model.priorities):
            values = values.reshape(-1, 3, self._after(slot) * len(columns))
            values = values[:, 0].copy() if slot == completed else _expect(values, matrix)
        return values.reshape(-1, len(modes), model.columns // 8)

    def _completed(self, expected: RealArray, done: RealArray, slot: int) -> RealArray:
        """Expectation over whether a goal is completed, of the tables without and with that."""
        axes = -1, 3, self._after(slot), *expected.shape[1:]
        values = expected.reshape(axes).copy()
        towards = done.reshape(values.shape[0], 1, *values.shape[2:])
        probability = self.model.completion[slot, self.modes, None]
        run_steps(drift(values, towards, probability, np.empty_like(values)))
        return values

    def _columns(self, modes: IndexArray) -> IndexArray:
        width = self.model.columns // 8
        return (modes[:, None] * width + np.arange(width)).ravel()

    def _after(self, slot: int) -> int:
        """Rows from one priority of a goal to the next."""
        return 3 ** (self.model.sub.n - 1 - slot)


def _expect(source: RealArray, matrices: RealArray) -> RealArray:
    """Expectation along axis 1, as `mix`."""
    out = np.empty((len(source), matrices.shape[1], *source.shape[2:]))
    run_steps(mix(source, matrices, out, np.empty_like(out)))
    return out


def _check_cover(sub: SubMdp, blocks: Sequence[Region]) -> None:
    covered = np.zeros((sub.mission.grid.q, 8), dtype=bool)
    for cells, faults in blocks:
        for cell, fault in product(cells, faults):
            if not (0 <= cell < len(covered) and 1 <= fault <= 8):
                raise ValueError(f'blocks: cell {cell} in fault mode {fault} does not exist')
            covered[cell, fault - 1] = True
    if not covered.all():
        cell, fault = np.argwhere(~covered)[0]
        raise ValueError(f'blocks: none holds cell {cell} in fault mode {fault + 1}')


def _zeros(shape: tuple[int, ...], directory: str | Path | None) -> RealArray:
    """Zeros in a file without a name; lack of room on the disk shows now, not as a crash later."""
    with tempfile.TemporaryFile(dir=directory) as file:
        os.posix_fallocate(file.fileno(), 0, 8 * math.prod(shape))
        return np.memmap(file, np.float64, 'r+', shape=shape)
