"""Decomposition plans: the sub-MDPs that cover a mission, and which of them a state is in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.mdp.mission import FAULT_MODES, Mission
from uav_mission_manager.mdp.states import StateSpace


@dataclass(frozen=True)
class Part:
    """A sub-MDP M_i of a plan.

    Attributes
    ----------
    kind : {'goal', 'location', 'fault', 'mixed'}
    goals : tuple of int
        Goals tracked, counted from 0.
    cells : tuple of int
    faults : tuple of int
        Fault modes, from 1.
    states : int
        Its size, which T_max bounds.
    cost : int
        Estimated cost of a sweep: states times actions.
    reward_impact, spatial_coherence, fault_sensitivity : float
        See `Measures`.
    coupling : float
        Largest reward coupling between two of its goals.
    score : float
    """

    kind: str
    goals: tuple[int, ...]
    cells: tuple[int, ...]
    faults: tuple[int, ...]
    states: int
    cost: int
    reward_impact: float
    spatial_coherence: float
    fault_sensitivity: float
    coupling: float
    score: float

    @property
    def box(self) -> tuple[NDArray[np.intp], ...]:
        """Indices of what it covers in tables over (goal, cell, fault mode)."""
        goals, cells, faults = map(np.array, (self.goals, self.cells, self.faults))
        return np.ix_(goals, cells, faults - 1)


@dataclass(frozen=True)
class Plan:
    """A decomposition plan: the parts M_1..M_N, best first, and phi.

    Raises
    ------
    ValueError
        If the parts leave a state uncovered.
    """

    mission: Mission
    max_states: int
    parts: tuple[Part, ...]

    def __post_init__(self) -> None:
        missing = self._first > len(self.parts)
        if missing.any():
            raise ValueError(
                f'no part of at most T_max = {self.max_states:,} states covers '
                + _uncovered(self.mission, missing)
            )

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        """Number of the first part that covers a goal, cell and fault mode, (k, q, 8); N+1."""
        return first_part(self.mission, self.parts)

    def part_of(self, states: ArrayLike) -> NDArray[np.int64]:
        """phi(s) of states (N, 2k+5), in 1..N, shape (N,).

        A part covers the states in its cells and fault modes in which one of its goals is
        wanted, g_j > 0, or no goal at all. Of several the first, whose score is highest.

        Raises
        ------
        StateError
            If a state is none of the mission's.
        """
        k = self.mission.k
        rows = StateSpace(k, self.mission.grid.q).check(states)
        wanted = rows[:, 1 + k : 1 + 2 * k] > 0
        wanted |= ~wanted.any(axis=1, keepdims=True)
        first = self._first[:, rows[:, -4], rows[:, 0] - 1].T
        return first.min(axis=1, where=wanted, initial=len(self.parts))

    @property
    def regions(self) -> tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]:
        """Cells and fault modes of each part, the blocks of `solve_blocks`.

        Raises
        ------
        ValueError
            If a part leaves goals out.
        """
        for number, part in enumerate(self.parts, 1):
            if len(part.goals) < self.mission.k:
                raise ValueError(f'part {number} is no block: it leaves goals out')
        return tuple((part.cells, part.faults) for part in self.parts)

    def to_dict(self) -> dict[str, Any]:
        """Return the plan for JSON, goals and fault modes by name."""
        names = [goal.name for goal in self.mission.goals]
        parts = [
            asdict(part)
            | {
                'goals': [names[j] for j in part.goals],
                'cells': list(part.cells),
                'faults': [FAULT_MODES[f - 1] for f in part.faults],
            }
            for part in self.parts
        ]
        return {'max_states': self.max_states, 'parts': parts}


def first_part(mission: Mission, parts: Sequence[Part]) -> NDArray[np.int64]:
    """Number, from 1, of the first part that covers a goal, cell and fault mode, (k, q, 8).

    N + 1 where none of the N parts does.
    """
    first = np.full((mission.k, mission.grid.q, 8), len(parts) + 1)
    for number, part in reversed(list(enumerate(parts, 1))):
        first[part.box] = number
    return first


def _uncovered(mission: Mission, missing: NDArray[np.bool_]) -> str:
    """What is missing, (goal, cell, fault mode), in words and as a state."""
    names = [goal.name for goal in mission.goals]
    j, cell, f = (int(index) for index in np.argwhere(missing)[0])
    cells = [str(number) for number in range(mission.grid.q)]
    words = []
    for what, values, others in (
        ('goal', names, (1, 2)),
        ('location', cells, (0, 2)),
        ('fault mode', FAULT_MODES, (0, 1)),
    ):
        words += [f'{what} {values[i]}' for i in np.flatnonzero(missing.all(axis=others))]
    if missing.all():
        words = ['any state']
    elif not words:
        words = [f'goal {names[j]} at location {cell} in fault mode {FAULT_MODES[f]}']
    priorities = [2 * (goal == j) for goal in range(mission.k)]
    state = [f + 1, *[1] * mission.k, *priorities, cell, 0, 0, 0]
    return f'{", ".join(words)}, such as [{" ".join(map(str, state))}]'
