"""Whole-table backups, in place.

Once the expectation over t' and g' is known for all of W, the rest of a backup needs it only
row by row (t, g): E over f' and r' and the minimum over the actions, which overwrites W. So a
sweep needs W and its expectation, and nothing else that grows with the mission. A sweep that
follows a given policy takes its actions' entries in place of the minimum.

Where numba is installed, large missions are swept by `uav_mission_manager.solver.exact.compiled`,
which computes the same bits sooner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.arrays import RealArray
from uav_mission_manager.solver import fused
from uav_mission_manager.solver.axes import ArrayStep, gather, run_steps
from uav_mission_manager.solver.exact.axis_model import AxisModel, Choice
from uav_mission_manager.solver.exact.device import CPU, Device
from uav_mission_manager.solver.exact.expectations import (
    ArrivalExpectation,
    ExogenousExpectation,
    ExogenousTables,
)
from uav_mission_manager.solver.greedy import TIE_TOLERANCE
from uav_mission_manager.solver.submdp import SubMdp
from uav_mission_manager.solver.threads import share

if TYPE_CHECKING:
    from uav_mission_manager.solver.exact.compiled import CompiledSweep

MAX_BLOCK_ENTRIES = 1 << 17
"""Entries of W that a thread works on at a time: a choice; ten tables of that size fit caches."""

MAX_GPU_BLOCK_ENTRIES = 1 << 25
"""The same of a card: a choice. A step on so many takes far longer than its launch, and thirty
tables of that size are a small part of a large card's memory."""

MIN_THREADED_ENTRIES = 1 << 20
"""Entries of W from which threads pay: measured."""

MIN_COMPILED_ENTRIES = 1 << 21
"""Entries of W from which the compiled sweep pays: measured. The first time on a machine it has
to be compiled, which takes some ten seconds or twice that."""

ActionTable = NDArray[np.uint8]
"""Action numbers over W."""


@dataclass(frozen=True)
class _Candidate:
    """An action within a block of rows.

    Attributes
    ----------
    number : int
    look_up : Step
        Writes E of its arrivals from all cells.
    box : callable
        View that holds all rows where it is allowed.
    q : float array
        Its Q there, less b, once its `costs` are added.
    costs : list of float array or None
        One for each priority that the block may lie in, None where the action is not allowed
        in it; a single one where the priority varies within the block or does not matter.
    after : int
        Rows to the next priority.
    """

    number: int
    look_up: ArrayStep
    box: Callable[[NDArray[Any]], NDArray[Any]]
    q: RealArray
    costs: Sequence[RealArray | None]
    after: int


class RowBackup:
    """Backs up some rows (t, g) of W at a time; holds the scratch of one thread."""

    def __init__(self, model: AxisModel, rows: int, policy: ActionTable | None = None) -> None:
        self.model, self.rows, self.policy = model, rows, policy
        self.expectation = ArrivalExpectation(model, rows)
        self.q = model.empty((model.q, rows, model.columns))
        self.least = np.empty_like(self.q)
        self.base_cost = model.device.put(model.base_cost)
        self.candidates = [self._candidate(choice) for choice in model.choices]

    def steps(self, values: RealArray, expected: ExogenousTables, first: int) -> list[ArrayStep]:
        """Steps that back up W in these rows and leave the change in `q`."""
        old = values[:, first : first + self.rows]
        if self.model.device.on_gpu and self.policy is None:
            return [*self.expectation.steps(expected, first), self._fused(old, first)]
        return [
            *self._minimise(expected, first, self.policy),
            (np.add, (self.least, self._base_cost(first), self.least)),
            (np.subtract, (self.least, old, self.q)),
            (np.copyto, (old, self.least)),
        ]

    def change(self) -> tuple[Any, Any]:
        """Least and largest entry of `q`; nothing waits for a card to have them."""
        entries = self.q.reshape(-1)
        return entries.min(), entries.max()

    def go_on(self, values: RealArray, further: float, first: int) -> None:
        """Change W in these rows by so many times more than the backup did."""
        reached = values[:, first : first + self.rows]
        np.multiply(self.q, further, self.q)
        np.add(reached, self.q, reached)

    def greedy(self, numbers: ActionTable, expected: ExogenousTables, first: int) -> None:
        """Write the numbers of the actions of least Q; of those that tie the lowest.

        `numbers` is an array of NumPy's.
        """
        run_steps(self._minimise(expected, first))
        tie = max(TIE_TOLERANCE, 8 * float(np.finfo(self.q.dtype).eps))
        limit = self.least + tie * np.abs(self.least + self._base_cost(first))
        chosen = np.zeros_like(self.least, np.uint8)
        for candidate, steps in self._each(self.candidates[::-1], first):
            run_steps(steps)
            best = candidate.q <= candidate.box(limit)
            np.copyto(candidate.box(chosen), candidate.number, where=best)
        numbers[:, first : first + self.rows] = self.model.device.take_back(chosen)

    def _minimise(
        self, expected: ExogenousTables, first: int, policy: ActionTable | None = None
    ) -> list[ArrayStep]:
        """Steps to the least Q less b, or to that of the policy, inf where it is not allowed."""
        steps = self.expectation.steps(expected, first)
        steps.append((self.least.fill, (np.inf,)))
        for candidate, look_up in self._each(self.candidates, first):
            least = candidate.box(self.least)
            steps += look_up
            if policy is None:
                steps.append((_lower, (least, candidate.q)))
            else:
                numbers = candidate.box(policy[:, first : first + self.rows])
                steps.append((_follow, (least, candidate.q, numbers, candidate.number)))
        return steps

    def _each(
        self, candidates: Sequence[_Candidate], first: int
    ) -> Iterator[tuple[_Candidate, list[ArrayStep]]]:
        """Candidates allowed in the block, and the steps to their Q less b."""
        for candidate in candidates:
            cost = candidate.costs[first // candidate.after % len(candidate.costs)]
            if cost is not None:
                q = candidate.q
                yield candidate, [candidate.look_up, (np.add, (q, cost, q))]

    def _fused(self, old: RealArray, first: int) -> ArrayStep:
        """All of it at once, on a card."""
        counts = len(self.model.choices), first, self.rows, self.model.columns
        tables = self.expectation.table, *self._action_tables, self._base_cost(first), np.inf
        return fused.run, (fused.BACK_UP, *tables, *counts, old, self.q)

    @cached_property
    def _action_tables(self) -> list[Any]:
        model = self.model
        tables = model.action_arrivals.astype(np.int32), model.action_costs, model.action_levels
        return [model.device.put(table) for table in tables]

    def _base_cost(self, first: int) -> RealArray:
        """Rows of b, to add to (cells, rows, columns)."""
        cost = self.base_cost
        if self.rows > cost.shape[1]:
            return np.concatenate([cost] * self.model.sub.threats, axis=1)
        start = first % cost.shape[1]
        return cost[:, start : start + self.rows]

    def _candidate(self, choice: Choice) -> _Candidate:
        model, slot = self.model, choice.slot
        after = 1 if slot is None else model.after[slot]
        varies = slot is not None and self.expectation.varies(slot)
        digits = (-1, 3, after) if varies else (1, 1, self.rows)
        axes = model.q, *digits, model.columns
        levels = choice.levels if varies else slice(None)
        cost = choice.cost[:, None, :, None, :]
        put = model.device.put
        look_up = gather(self.expectation.table, put(choice.arrivals), self.q)

        def box(table: NDArray[Any]) -> NDArray[Any]:
            return table.reshape(axes)[:, :, levels]

        # Small: what is in one piece is faster than a part.
        if self.rows == model.rows and model.sub.entries <= MAX_BLOCK_ENTRIES:
            split = self.q.reshape(axes)
            whole = put(np.broadcast_to(cost, split.shape).reshape(self.q.shape))
            return _Candidate(choice.action.number, look_up, _all, self.q, [whole], after)
        costs: list[RealArray | None] = [put(cost[:, :, levels])]
        if slot is not None and not varies:
            within = range(3)[choice.levels]
            costs = [put(cost[:, :, [level]]) if level in within else None for level in range(3)]
        return _Candidate(choice.action.number, look_up, box, box(self.q), costs, after)


class Sweeper:
    """Backups of the whole of W.

    Attributes
    ----------
    values : float array (cells, rows, columns)
        W on the model's device, overwritten by each backup.
    policy : uint8 array like values, optional
        Numbers of the actions to take; by default the best.
    expected : ExogenousTables
        Of W, once `expect` has filled them.
    """

    def __init__(
        self,
        model: AxisModel,
        values: RealArray,
        threads: int = 1,
        policy: ActionTable | None = None,
    ) -> None:
        self.model, self.values = model, values
        threaded = values.size >= MIN_THREADED_ENTRIES and not model.device.on_gpu
        self.threads = threads if threaded else 1
        self.expected = ExogenousTables.empty(model)
        self.policy = policy
        cells, rows, columns = model.shape
        shape = block_shape(model.sub, model.device)
        self.block_cells, self.block_columns, self.block_rows = shape
        self.blocks = [
            (cell, column)
            for cell in range(0, cells, self.block_cells)
            for column in range(0, columns, self.block_columns)
        ]
        self.row_blocks = range(0, rows, self.block_rows)
        self.whole: list[ArrayStep] | None = None
        self.compiled = None if policy is not None else self._compiled()

    def _compiled(self) -> CompiledSweep | None:
        """Return the compiled sweep where it pays and can be had."""
        if not is_compiled(self.model.sub, self.model.device):
            return None
        try:
            from uav_mission_manager.solver.exact.compiled import CompiledSweep
        except ImportError:  # numba may not know this NumPy.
            return None
        n = self.model.sub.n
        inner = max(goals for goals in range(n + 1) if 3**goals <= self.block_rows)
        return CompiledSweep(self.model, self.values, self.expected, inner)

    @cached_property
    def exogenous(self) -> list[ExogenousExpectation]:
        """One for each thread."""
        shape = self.block_cells, self.block_columns
        return [ExogenousExpectation(self.model, *shape) for _ in range(self.threads)]

    @cached_property
    def row_backups(self) -> list[RowBackup]:
        """One for each thread."""
        arguments = self.model, self.block_rows, self.policy
        return [RowBackup(*arguments) for _ in range(self.threads)]

    def backup(self, further: float = 0.0) -> tuple[float, float]:
        """Replace W by its Bellman backup; return the least and the largest change.

        Afterwards W is changed by `further` times that change.
        """
        if self.compiled is not None:
            return self.compiled.backup(further, self.threads)
        if len(self.row_blocks) == 1:
            if self.whole is None:
                self.whole = self.exogenous[0].steps(self.values, self.expected, 0, 0)
                self.whole += self.row_backups[0].steps(self.values, self.expected, 0)
            changes = [self._back_up(0, 0, further, self.whole)]
        else:
            self.expect()
            row_backups = self.row_backups

            def back_up(worker: int, first: int) -> tuple[Any, Any]:
                steps = row_backups[worker].steps(self.values, self.expected, first)
                return self._back_up(worker, first, further, steps)

            changes = share(back_up, self.row_blocks, self.threads)
        lows, highs = (map(float, ends) for ends in zip(*changes))
        return min(lows), max(highs)

    def greedy(self) -> ActionTable:
        """Numbers of the actions of least Q in W, shape as W, in an array of NumPy's."""
        self.expect()
        numbers = np.empty(self.values.shape, np.uint8)
        row_backups = self.row_backups

        def choose(worker: int, first: int) -> None:
            row_backups[worker].greedy(numbers, self.expected, first)

        share(choose, self.row_blocks, self.threads)
        return numbers

    def expect(self) -> None:
        """Take the expectation of W over t' and g'."""
        exogenous = self.exogenous

        def fill(worker: int, block: tuple[int, int]) -> None:
            run_steps(exogenous[worker].steps(self.values, self.expected, *block))

        share(fill, self.blocks, self.threads)

    def _back_up(
        self, worker: int, first: int, further: float, steps: list[ArrayStep]
    ) -> tuple[Any, Any]:
        row_backup = self.row_backups[worker]
        run_steps(steps)
        change = row_backup.change()
        if further:
            row_backup.go_on(self.values, further, first)
        return change


def _all(table: NDArray[Any]) -> NDArray[Any]:
    return table


def _lower(least: RealArray, q: RealArray) -> None:
    np.minimum(least, q, out=least)


def _follow(followed: RealArray, q: RealArray, numbers: ActionTable, number: int) -> None:
    np.copyto(followed, q, where=numbers == number)


def is_compiled(sub: SubMdp, device: Device = CPU) -> bool:
    """Whether compiling pays for the sweeps of a sub-MDP, and numba is there to do it."""
    pays = not device.on_gpu and sub.entries >= MIN_COMPILED_ENTRIES and sub.threats == 3
    return pays and find_spec('numba') is not None


def block_shape(sub: SubMdp, device: Device = CPU) -> tuple[int, int, int]:
    """Cells and columns of a block of the exogenous expectation, rows of a block of the rest."""
    most = MAX_GPU_BLOCK_ENTRIES if device.on_gpu else MAX_BLOCK_ENTRIES
    cells, rows, columns = sub.shape
    if sub.entries <= most:
        return cells, columns, rows
    height, width = rows, columns
    while rows * width > most and width > 16:
        width //= 2
    while height > 1 and cells * height * columns > most:
        height //= sub.threats if height == rows else 3
    return max(1, min(cells, most // (rows * width))), width, height
