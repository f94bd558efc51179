"""The state and its index: s = [f, r_1..r_k, g_1..g_k, l, c, t, m].

Where the mission has a charge, its level b is in place of the k range flags, which it tells (see
`uav_mission_manager.mdp.charge`): s = [f, b, g_1..g_k, l, c, t, m].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    r : int array (N, k)
        Range flags; (N, 0) where the charge tells them.
    b : int array (N, 1)
        Level of the charge; (N, 0) where it is no variable.
    g : int array (N, k)
        Priorities.
    l, c, t, m : int array (N,)
        Cell, commitment (from 1, 0 none), threat, mode.
    """

    f: IntArray
    r: IntArray
    b: IntArray
    g: IntArray
    l: IntArray  # noqa: E741  The paper's letter.
    c: IntArray
    t: IntArray
    m: IntArray


@dataclass(frozen=True)
class StateSpace:
    """All states of a mission with k goals on q cells, some threat levels and levels of charge.

    A state is a row of 2k+5 integers, with a charge of k+6; f counts from 1, all others from 0.
    The index runs over the rows in lexicographic order, m fastest.
    """

    k: int
    q: int
    threats: int = len(THREAT_LEVELS)
    levels: int = 1

    @classmethod
    def of(cls, mission: Mission) -> StateSpace:
        """Return the states of a mission."""
        return cls(mission.k, mission.grid.q, len(mission.threat.levels), mission.range.levels)

    @classmethod
    def of_length(cls, variables: int, levels: int = 1) -> StateSpace:
        """Return the states of so many variables; of how many cells is not known, 1 is said."""
        return cls((variables - 5) // 2 if levels == 1 else variables - 6, 1, levels=levels)

    @property
    def ranges(self) -> tuple[int, ...]:
        """Number of values of each variable that tells range: k flags, or one charge."""
        return (2,) * self.k if self.levels == 1 else (self.levels,)

    @property
    def charged(self) -> tuple[int, ...]:
        """These variables when all is in range, and the battery full."""
        return tuple(values - 1 for values in self.ranges)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each variable."""
        return (8, *self.ranges, *(3,) * self.k, self.q, self.k + 1, self.threats, 2)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each variable."""
        numbers = range(1, self.k + 1)
        flags, priorities = (tuple(f'{letter}{j}' for j in numbers) for letter in 'rg')
        return ('f', *(flags if self.levels == 1 else 'b'), *priorities, 'l', 'c', 't', 'm')

    def text(self, state: Sequence[int]) -> str:
        """Write a state with its names, as f=1 b=15 g1=2 l=5 c=1 t=0 m=0."""
        return ' '.join(f'{name}={x}' for name, x in zip(self.names, state, strict=True))

    @property
    def size(self) -> int:
        """Number of states: 8 * 2^k * 3^k * q * (k+1) * threats * 2; a charge has B for 2^k."""
        return math.prod(self.shape)

    def check(self, states: ArrayLike) -> IntArray:
        """Return states as an integer array (N, 2k+5); one state becomes one row.

        Raises
        ------
        StateError
            If they have another number of variables or a value out of range.
        """
        rows = np.atleast_2d(np.asarray(states))
        if rows.ndim != 2 or rows.shape[1] != len(self.shape):
            raise StateError(
                f'a state has {len(self.shape)} variables ({" ".join(self.names)}), '
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
        g = 1 + len(self.ranges)
        b, end = 1 if self.levels > 1 else g, g + self.k
        return StateView(
            f=states[..., 0],
            r=states[..., 1:b],
            b=states[..., b:g],
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
