"""Whole-table backups, in place.

Once the expectation over t' and g' is known for all of W, the rest of a backup needs it only
row by row (t, g): E over f' and r' and the minimum over the actions, which overwrites W. So a
sweep needs W and its expectation, and nothing else that grows with the mission. A sweep that
follows a given policy takes its actions' entries in place of the minimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.solver.axes import FloatArray, Step, gather, run
from uav_mission_manager.solver.exact.expectations import Arrivals, Expected, FirstHalf
from uav_mission_manager.solver.recombination.rules import TIE
from uav_mission_manager.solver.reduced import BellmanOperator, Choice

BLOCK = 1 << 17
"""Entries of W that a thread works on at a time."""

THREADED = 1 << 20
"""Entries of W from which threads pay."""

T = TypeVar('T')
R = TypeVar('R')


@dataclass(frozen=True)
class _Candidate:
    """An action within a block of rows.

    Attributes
    ----------
    number : int
    look_up : Step
        Writes E of its arrivals from all places.
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
    look_up: Step
    box: Callable[[NDArray[Any]], NDArray[Any]]
    q: FloatArray
    costs: Sequence[FloatArray | None]
    after: int


class SecondHalf:
    """Scratch of one thread for the rest of the backup, some rows (t, g) at a time."""

    def __init__(
        self, operator: BellmanOperator, rows: int, policy: NDArray[np.uint8] | None = None
    ) -> None:
        self.operator, self.rows, self.policy = operator, rows, policy
        self.arrivals = Arrivals(operator, rows)
        self.q = np.empty((operator.places, rows, operator.columns), operator.dtype)
        self.least = np.empty_like(self.q)
        self.candidates = [self._candidate(choice) for choice in operator.choices]

    def steps(self, values: FloatArray, expected: Expected, first: int) -> list[Step]:
        """Steps that back up W in these rows and leave the change in `q`."""
        old = values[:, first : first + self.rows]
        return [
            *self._minimise(expected, first, self.policy),
            (np.add, (self.least, self._base_cost(first), self.least)),
            (np.subtract, (self.least, old, self.q)),
            (np.copyto, (old, self.least)),
        ]

    def change(self) -> tuple[float, float]:
        """Least and largest entry of `q`."""
        entries = self.q.reshape(-1)
        return float(np.minimum.reduce(entries)), float(np.maximum.reduce(entries))

    def greedy(self, numbers: NDArray[np.uint8], expected: Expected, first: int) -> None:
        """Write the numbers of the actions of least Q; of those that tie the lowest."""
        run(self._minimise(expected, first))
        tie = max(TIE, 8 * float(np.finfo(self.q.dtype).eps))
        limit = self.least + tie * np.abs(self.least + self._base_cost(first))
        chosen = np.zeros(self.least.shape, np.uint8)
        for candidate, steps in self._each(self.candidates[::-1], first):
            run(steps)
            best = candidate.q <= candidate.box(limit)
            np.copyto(candidate.box(chosen), candidate.number, where=best)
        numbers[:, first : first + self.rows] = chosen

    def _minimise(
        self, expected: Expected, first: int, policy: NDArray[np.uint8] | None = None
    ) -> list[Step]:
        """Steps to the least Q less b, or to that of the policy, inf where it is not allowed."""
        steps = self.arrivals.steps(expected, first)
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
    ) -> Iterator[tuple[_Candidate, list[Step]]]:
        """Candidates allowed in the block, and the steps to their Q less b."""
        for candidate in candidates:
            cost = candidate.costs[first // candidate.after % len(candidate.costs)]
            if cost is not None:
                q = candidate.q
                yield candidate, [candidate.look_up, (np.add, (q, cost, q))]

    def _base_cost(self, first: int) -> FloatArray:
        """Rows of b, to add to (places, rows, columns)."""
        cost = self.operator.base_cost
        if self.rows > len(cost):
            return np.concatenate([cost] * 3)
        start = first % len(cost)
        return cost[start : start + self.rows]

    def _candidate(self, choice: Choice) -> _Candidate:
        operator, slot = self.operator, choice.slot
        after = 1 if slot is None else self.arrivals.after[slot]
        varies = slot is not None and 3 * after <= self.rows
        digits = (-1, 3, after) if varies else (1, 1, self.rows)
        axes = operator.places, *digits, operator.columns
        levels = choice.levels if varies else slice(None)
        cost = choice.cost[:, None, :, None, :]
        look_up = gather(self.arrivals.table, choice.arrivals, self.q)

        def box(table: NDArray[Any]) -> NDArray[Any]:
            return table.reshape(axes)[:, :, levels]

        if self.rows == operator.rows:  # Small: what is in one piece is faster than a part.
            split = self.q.reshape(axes)
            whole = np.broadcast_to(cost, split.shape).reshape(self.q.shape)
            return _Candidate(choice.action.number, look_up, np.asarray, self.q, [whole], after)
        costs: list[FloatArray | None] = [cost[:, :, levels]]
        if slot is not None and not varies:
            within = range(3)[choice.levels]
            costs = [cost[:, :, [level]] if level in within else None for level in range(3)]
        return _Candidate(choice.action.number, look_up, box, box(self.q), costs, after)


class Sweeper:
    """Backups of the whole of W.

    Attributes
    ----------
    values : float array (places, rows, columns)
        W, overwritten by each backup.
    policy : uint8 array like values, optional
        Numbers of the actions to take; by default the best.
    """

    def __init__(
        self,
        operator: BellmanOperator,
        values: FloatArray,
        threads: int = 1,
        policy: NDArray[np.uint8] | None = None,
    ) -> None:
        self.operator, self.values = operator, values
        self.threads = threads if values.size >= THREADED else 1
        self.expected = Expected.empty(operator)
        places, rows, columns = operator.shape
        block_places, block_columns, block_rows = block_shape(operator)
        self.first = [
            FirstHalf(operator, block_places, block_columns) for _ in range(self.threads)
        ]
        self.second = [SecondHalf(operator, block_rows, policy) for _ in range(self.threads)]
        self.blocks = [
            (place, column)
            for place in range(0, places, block_places)
            for column in range(0, columns, block_columns)
        ]
        self.row_blocks = range(0, rows, block_rows)
        self.whole: list[Step] | None = None

    def backup(self) -> tuple[float, float]:
        """Replace W by its Bellman backup; return the least and the largest change."""
        if len(self.row_blocks) == 1:
            if self.whole is None:
                self.whole = self.first[0].steps(self.values, self.expected, 0, 0)
                self.whole += self.second[0].steps(self.values, self.expected, 0)
            run(self.whole)
            return self.second[0].change()
        self.expect()
        lows, highs = zip(*self._share(self._back_up, self.row_blocks))
        return min(lows), max(highs)

    def greedy(self) -> NDArray[np.uint8]:
        """Numbers of the actions of least Q in W, shape as W."""
        self.expect()
        numbers = np.empty(self.values.shape, np.uint8)

        def choose(worker: int, first: int) -> None:
            self.second[worker].greedy(numbers, self.expected, first)

        self._share(choose, self.row_blocks)
        return numbers

    def expect(self) -> None:
        """Take the expectation of W over t' and g', the first half of a backup."""

        def fill(worker: int, block: tuple[int, int]) -> None:
            run(self.first[worker].steps(self.values, self.expected, *block))

        self._share(fill, self.blocks)

    def _back_up(self, worker: int, first: int) -> tuple[float, float]:
        second = self.second[worker]
        run(second.steps(self.values, self.expected, first))
        return second.change()

    def _share(self, work: Callable[[int, T], R], blocks: Sequence[T]) -> list[R]:
        """Results of work(thread, block), shared among the threads."""
        queue = iter(blocks)

        def each(worker: int) -> list[R]:
            return [work(worker, block) for block in queue]

        if self.threads == 1:
            return each(0)
        with ThreadPoolExecutor(self.threads) as pool:
            try:
                return [result for part in pool.map(each, range(self.threads)) for result in part]
            finally:
                for _ in queue:  # After Ctrl-C no further block is begun.
                    pass


def _lower(least: FloatArray, q: FloatArray) -> None:
    np.minimum(least, q, out=least)


def _follow(followed: FloatArray, q: FloatArray, numbers: NDArray[np.uint8], number: int) -> None:
    np.copyto(followed, q, where=numbers == number)


def block_shape(operator: BellmanOperator) -> tuple[int, int, int]:
    """Places and columns of a block of the first half, rows of one of the second."""
    places, rows, columns = operator.shape
    if places * rows * columns <= BLOCK:
        return places, columns, rows
    height, width = rows, columns
    while rows * width > BLOCK and width > 16:
        width //= 2
    while height > 3 and places * height * columns > BLOCK:
        height //= 3
    return 1, width, height
