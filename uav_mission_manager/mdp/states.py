"""The state s = [f, r_1..r_k, g_1..g_k, l, c, t, m] and its index."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.mission import THREAT_LEVELS, Mission


class StateError(ValueError):
    """States with a variable out of its range; the message names the variable and the value."""


class StateView(NamedTuple):
    """The variables of N states by name: views of the state array, not copies.

    Attributes
    ----------
    f : int array (N,)
        Fault mode, from 1.
    r, g : int array (N, k)
        Range flags and priorities.
    l, c, t, m : int array (N,)
        Cell, commitment (from 1, 0 none), threat, mode.
    """

    f: IntArray
    r: IntArray
    g: IntArray
    l: IntArray  # noqa: E741  The paper's letter.
    c: IntArray
    t: IntArray
    m: IntArray


@dataclass(frozen=True)
class StateSpace:
    """All states of a mission with k goals on q cells and some threat levels.

    A state is a row of 2k+5 integers; f counts from 1, all others from 0. The index runs over
    the rows in lexicographic order, m fastest.
    """

    k: int
    q: int
    threats: int = len(THREAT_LEVELS)

    @classmethod
    def of(cls, mission: Mission) -> StateSpace:
        """Return the states of a mission."""
        return cls(mission.k, mission.grid.q, len(mission.threat.levels))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each variable."""
        return (8, *(2,) * self.k, *(3,) * self.k, self.q, self.k + 1, self.threats, 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each variable."""
        numbers = range(1, self.k + 1)
        ranges, priorities = (tuple(f'{letter}{j}' for j in numbers) for letter in 'rg')
        return ('f', *ranges, *priorities, 'l', 'c', 't', 'm')

    @property
    def size(self) -> int:
        """Number of states: 8 * 2^k * 3^k * q * (k+1) * threats * 2."""
        return math.prod(self.shape)

    def check(self, states: ArrayLike) -> IntArray:
        """Return states as an integer array (N, 2k+5); one state becomes one row.

        Raises
        ------
        StateError
            If they have another number of variables or a value out of range.
        """
        rows = np.atleast_2d(np.asarray(states))
        if rows.ndim != 2 or rows.shape[1] != 2 * self.k + 5:
            raise StateError(
                f'a state has {2 * self.k + 5} variables ({" ".join(self.names)}), '
                f'not {rows.shape[-1]}'
            )
        if not np.issubdtype(rows.dtype, np.integer):
            raise StateError(f'states are integers, not {rows.dtype}')
        low, top = self._limits
        outside = (rows < low) | (rows > top)
        if outside.any():
            row, column = np.argwhere(outside)[0]
            raise StateError(
                f'{self.names[column]} = {rows[row, column]} is outside '
                f'{low[column]}..{top[column]}'
            )
        return rows.astype(np.int64, copy=False)

    @cached_property
    def _limits(self) -> tuple[IntArray, IntArray]:
        """Least and largest value of each variable."""
        low = np.array([1] + [0] * (len(self.shape) - 1))
        return low, low + np.array(self.shape) - 1

    def index(self, states: ArrayLike) -> IntArray:
        """Index of each state, shape (N,). Raises `StateError`."""
        digits = self.check(states).T.copy()
        digits[0] -= 1
        return np.asarray(np.ravel_multi_index(tuple(digits), self.shape), dtype=np.int64)

    def split(self, states: IntArray) -> StateView:
        """Return the variables of states (..., 2k+5) as views with the array's leading axes."""
        g, end = self.k + 1, 2 * self.k + 1
        return StateView(
            f=states[..., 0],
            r=states[..., 1:g],
            g=states[..., g:end],
            l=states[..., end],
            c=states[..., end + 1],
            t=states[..., end + 2],
            m=states[..., end + 3],
        )

    def draw(self, count: int, rng: np.random.Generator) -> IntArray:
        """States drawn evenly, shape (count, 2k+5)."""
        rows = rng.integers(0, self.shape, (count, len(self.shape)))
        rows[:, 0] += 1
        return rows

    def states(self, indices: ArrayLike | None = None) -> IntArray:
        """States of indices, shape (N, 2k+5); all of them by default."""
        chosen = np.arange(self.size) if indices is None else np.asarray(indices)
        rows = np.stack(np.unravel_index(chosen, self.shape), axis=-1).astype(np.int64)
        rows[..., 0] += 1
        return rows
