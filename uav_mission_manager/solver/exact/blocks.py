"""Out of core: the exact solution block by block, with W in files.

A block is a set of cells, with the goals' sites in them, times a set of fault modes. Its Bellman
equation asks for the rest of W only as boundary values: those of the cells an epoch away, and of
the fault modes that its own may turn into. With these held it is swept once or more, then the
next block is (block Jacobi; Bertsekas and Tsitsiklis 1989). Every round nears W* by the discount
at least, and its first sweeps make up a whole backup T W, hence (MacQueen 1966)

    W + min(T W - W) / (1 - gamma) <= W* <= W + max(T W - W) / (1 - gamma).

One sweep a round tells most: what all of W has in common then shifts as one, and the bounds close
in as fast as those of value iteration. More sweeps let blocks run ahead of each other, and on the
case study take more rounds, not fewer.

In memory are some five tables of the size of the block at hand, ten of one of its places, and
the costs, about 1/(3q) of W.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.solver.axes import FloatArray, drift, mix, run
from uav_mission_manager.solver.exact.value_iteration import Solution
from uav_mission_manager.solver.reduced import GROUND, BellmanOperator, Choice
from uav_mission_manager.solver.submdp import SubMdp

Region = tuple[Sequence[int], Sequence[int]]
"""Cells, from 0, and fault modes, from 1, of a block."""


def solve_blocks(
    sub: SubMdp,
    blocks: Sequence[Region],
    tolerance: float = 1e-7,
    *,
    directory: str | Path | None = None,
    sweeps: int = 1,
    max_rounds: int = 10_000,
    on_round: Callable[[int, float], None] | None = None,
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
    sweeps : int
        Sweeps of a block with its boundary values held.
    max_rounds : int
        Rounds after which to give up; the result then says `converged=False`.
    on_round : callable, optional
        Called after each round with its number and the distance bound reached.

    Returns
    -------
    Solution
        With a memory-mapped value, and rounds for iterations.

    Raises
    ------
    ValueError
        If tolerance, sweeps or max_rounds is not above 0, or the blocks leave a state out.
    OSError
        If there is no room for the files.
    """
    if not tolerance > 0 or sweeps < 1 or max_rounds < 1:
        raise ValueError(
            f'tolerance {tolerance}, sweeps {sweeps} and max_rounds {max_rounds} must be above 0'
        )
    _check_cover(sub, blocks)
    operator, gain = BellmanOperator(sub), 1 / (1 - sub.mission.discount)
    present, coming = (_zeros(operator.shape, directory) for _ in range(2))
    for rounds in range(1, max_rounds + 1):
        changes = [_visit(operator, block, sweeps, present, coming) for block in blocks]
        low, high = min(low for low, _ in changes), max(high for _, high in changes)
        bound, rounding = gain * (high - low) / 2, operator.rounding(present)
        if on_round is not None:
            on_round(rounds, bound)
        if bound <= tolerance or (high - low) / 2 <= rounding or rounds == max_rounds:
            break
        present, coming = coming, present
    for values in present:
        values += gain * (low + high) / 2
    return Solution(
        sub=sub,
        value=present,
        lower=-bound - gain * rounding,
        upper=bound + gain * rounding,
        residual=(high - low) / 2,
        iterations=rounds,
        converged=bound <= tolerance,
    )


def _visit(
    operator: BellmanOperator,
    region: Region,
    sweeps: int,
    present: FloatArray,
    coming: FloatArray,
) -> tuple[float, float]:
    """Sweep a block of the present W into the coming; return the change of the first sweep."""
    block = _Block(operator, present, region)
    change = block.backup()
    for _ in range(sweeps - 1):
        block.backup()
    for place, values in zip(block.own, block.values):
        coming[place][:, block.columns] = values
    return change


class _Arrival(NamedTuple):
    """How an epoch may end: where, by what way, and which goal (its position) it completes.

    The ways are normal and agile flight, then those of `GROUND`.
    """

    place: int
    way: int
    done: int | None = None


class _Block:
    """A block, for as long as it is worked on.

    Attributes
    ----------
    own : list of int
        Its places.
    values : float array (own, rows, columns)
        Its part of W; the columns are those of its modes.
    uses : dict
        For each cell an epoch away, the ways to end there, one or two as completion happens or
        not, and for each the actions and places (positions in `own`) that end so.
    settled : float array like values
        Least Q, less b, of the actions that lead out of its cells.
    inflow : dict of (place, done) to float array (2, rows, modes, 2^n)
        What the other modes add to `_failing` in its own cells.
    """

    def __init__(self, operator: BellmanOperator, table: FloatArray, block: Region) -> None:
        self.operator, self.table = operator, table
        self.modes = np.unique(block[1]) - 1
        self.columns = self._columns(self.modes)
        self.risks = np.stack([_fault_matrix(p)[self.modes] for p in operator.failures.T])
        self.reached = np.flatnonzero(self.risks.any(axis=(0, 1)))
        self.own = [place for place, cell in enumerate(operator.cells) if cell in block[0]]
        self.values = np.stack([table[place][:, self.columns] for place in self.own])
        self.uses = self._uses()
        self.inflow: dict[tuple[int, int | None], FloatArray] = {}
        self.settled = np.full_like(self.values, np.inf)
        self._lower(self.settled, self.uses.keys() - block[0])

    def backup(self) -> tuple[float, float]:
        """Replace `values` by their Bellman backup; return the least and the largest change."""
        least = self.settled.copy()
        self._lower(least, self.uses.keys() & self.own)
        base_cost = self.operator.base_cost[:, self.columns]
        for values in least.reshape(-1, *base_cost.shape):
            values += base_cost
        change = np.subtract(least, self.values, out=self.values)
        low, high = float(change.min()), float(change.max())
        self.values = least
        return low, high

    def _columns(self, modes: NDArray[np.intp]) -> NDArray[np.intp]:
        width = self.operator.columns // 8
        return (modes[:, None] * width + np.arange(width)).ravel()

    def _after(self, slot: int) -> int:
        """Rows from one priority of a goal to the next."""
        return 3 ** (self.operator.sub.n - 1 - slot)

    def _uses(self) -> dict[int, dict[tuple[_Arrival, ...], list[tuple[Choice, int]]]]:
        uses: dict[int, Any] = defaultdict(lambda: defaultdict(list))
        for choice in self.operator.choices:
            for position, place in enumerate(self.own):
                arrivals = _arrivals(self.operator, place, int(choice.arrivals[place]))
                cell = self.operator.cells[arrivals[0].place]
                uses[cell][arrivals].append((choice, position))
        return uses

    def _lower(self, least: FloatArray, cells: Iterable[int]) -> None:
        """Lower `least` to Q, less b, of the actions that lead to some cells."""
        for cell in cells:
            known: dict[tuple[int, int | None], list[FloatArray]] = {}
            for arrivals, users in self.uses[cell].items():
                for place, _, done in arrivals:
                    if (place, done) not in known:
                        known[place, done] = self._landing(place, done)
                tables = [known[place, done][way] for place, way, done in arrivals]
                expected = self._expected(tables, arrivals[-1].done)
                for choice, position in users:
                    self._take(least[position], expected, choice, self.own[position])

    def _take(self, least: FloatArray, expected: FloatArray, choice: Choice, place: int) -> None:
        """Lower `least` at one place to Q, less b, of one action."""
        after = len(least) if choice.slot is None else self._after(choice.slot)
        axes = -1, choice.cost.shape[1], after, len(self.columns)
        into = least.reshape(axes)[:, choice.levels]
        cost = choice.cost[place, choice.levels][:, None, self.columns]
        np.minimum(into, expected.reshape(axes)[:, choice.levels] + cost, out=into)

    def _landing(self, place: int, done: int | None) -> list[FloatArray]:
        """Discounted E[W(x') + p(t', m')] by the way of arriving, each (rows, modes, 2^n).

        Without the rows of a goal's priority where that goal is completed.
        """
        operator, grid = self.operator, self.operator.sub.mission.grid
        if place not in self.own:
            ways = [*self._inflow(place, done, self.reached)]
        else:
            here = self._exogenous(self.values[self.own.index(place)], place, done)
            if (place, done) not in self.inflow:
                outside = np.setdiff1d(self.reached, self.modes)
                self.inflow[place, done] = self._inflow(place, done, outside)
            ways = [*(self.inflow[place, done] + self._failing(here, self.modes))]
        for way, loss in zip(ways, operator.loss):
            for digit in range(operator.sub.n):
                flags = way.reshape(-1, 2, 2**digit)
                run(drift(flags[:, 1], flags[:, 0], loss, np.empty_like(flags[:, 1])))
        if place in self.own and place in (grid.base, grid.service):
            ways += self._ground(here, place, done)
        for way, table in enumerate(ways):
            table.reshape(3, -1)[...] += operator.price[int(way == 1), place][:, None]
        return ways

    def _ground(self, here: FloatArray, place: int, done: int | None) -> list[FloatArray]:
        """Discounted E[W] after staying, recharge and repair."""
        recharged = np.repeat(here[:, :, -1:], here.shape[2], axis=2)
        nominal = here[:, :1]
        if self.modes[0] > 0:
            columns = self._columns(np.zeros(1, dtype=np.intp))
            nominal = self._exogenous(self.table[place][:, columns], place, done)
        repaired = here.copy()
        run(drift(repaired, nominal, self.operator.repair, np.empty_like(here)))
        return [here, recharged, repaired]

    def _inflow(self, place: int, done: int | None, modes: NDArray[np.intp]) -> FloatArray:
        """Sum of `_failing` over some modes, read from the file as many at once as are its own."""
        total: FloatArray = np.zeros((2, 1, 1, 1))
        for first in range(0, len(modes), len(self.modes)):
            some = modes[first : first + len(self.modes)]
            values = self.table[place][:, self._columns(some)]
            total = total + self._failing(self._exogenous(values, place, done), some)
        return total

    def _failing(self, expected: FloatArray, modes: NDArray[np.intp]) -> FloatArray:
        """What some modes f' add to E over f' in normal and in agile flight."""
        return np.stack([_expect(expected, risks[None, :, modes]) for risks in self.risks])

    def _exogenous(self, values: FloatArray, place: int, done: int | None) -> FloatArray:
        """Discounted E over t' and g' of some columns of W at a place, (rows, modes, 2^n)."""
        operator, columns = self.operator, values.shape[1]
        values = _expect(values.reshape(1, 3, -1), operator.threat[place][None])
        for slot, matrix in enumerate(operator.priorities):
            values = values.reshape(-1, 3, self._after(slot) * columns)
            values = values[:, 0].copy() if slot == done else _expect(values, matrix)
        return values.reshape(-1, columns * 8 // operator.columns, operator.columns // 8)

    def _expected(self, tables: Sequence[FloatArray], done: int | None) -> FloatArray:
        """Expectation over whether a goal is completed, of the tables without and with that."""
        if done is None:
            return tables[0]
        axes = -1, 3, self._after(done), *tables[0].shape[1:]
        values = tables[0].reshape(axes).copy()
        towards = tables[1].reshape(axes[0], 1, *axes[2:])
        probability = self.operator.completion[self.modes, None]
        run(drift(values, towards, probability, np.empty_like(values)))
        return values


def _expect(source: FloatArray, matrices: FloatArray) -> FloatArray:
    """Expectation along axis 1, as `mix`."""
    out = np.empty((len(source), matrices.shape[1], *source.shape[2:]))
    run(mix(source, matrices, out, np.empty_like(out)))
    return out


def _fault_matrix(risks: FloatArray) -> FloatArray:
    """P(f' | f) in flight, from the failure probability of camera, actuator and sensor."""
    return reduce(np.kron, [np.array([[1 - p, p], [0.0, 1.0]]) for p in risks])


def _arrivals(operator: BellmanOperator, place: int, arrival: int) -> tuple[_Arrival, ...]:
    """What a number in `Choice.arrivals` stands for."""
    cell, ways = operator.cells[place], 2 * operator.places + len(GROUND)

    def decode(number: int, places: Sequence[int], done: int | None) -> _Arrival:
        way, position = divmod(number, len(places))
        if way < 2:
            return _Arrival(places[position], way, done)
        return _Arrival(cell, 2 + number - 2 * len(places), done)

    if arrival < ways:
        return (decode(arrival, range(operator.places), None),)
    open_, completed = [pair for site in operator.sites for pair in site][arrival - ways]
    slot = place - operator.q
    return (
        decode(open_, range(operator.places), None),
        decode(completed, operator.landings[slot], slot),
    )


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


def _zeros(shape: tuple[int, ...], directory: str | Path | None) -> FloatArray:
    """Zeros in a file without a name; lack of room on the disk shows now, not as a crash later."""
    with tempfile.TemporaryFile(dir=directory) as file:
        os.posix_fallocate(file.fileno(), 0, 8 * math.prod(shape))
        return np.memmap(file, np.float64, 'r+', shape=shape)
