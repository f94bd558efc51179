"""Decomposition plans: the sub-MDPs that cover a mission, and which of them a state is in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.echo import quoted
from uav_mission_manager.mdp.arrays import BoolArray, IndexArray, IntArray
from uav_mission_manager.mdp.fields import numbers, one_of
from uav_mission_manager.mdp.mission import FAULT_MODES, Mission
from uav_mission_manager.mdp.states import StateSpace

PHI_RULE = (
    'the first part in whose cells and fault modes the state is, with a goal wanted or none at all'
)
"""The map phi from states to parts, as a plan's JSON says it."""

MAX_NAMED_VALUES = 5
"""Most values of a variable that an error names: a choice."""

PART_NUMBERS = (
    'states',
    'cost',
    'reward_impact',
    'spatial_coherence',
    'fault_sensitivity',
    'coupling',
    'score',
)
"""Attributes of a part that are numbers."""


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

    def to_dict(self, mission: Mission) -> dict[str, Any]:
        """Return the part for JSON: goals and fault modes by name, cells as first and last."""
        return vars(self) | {
            'goals': [mission.goals[j].name for j in self.goals],
            'cells': _runs(self.cells),
            'faults': [FAULT_MODES[f - 1] for f in self.faults],
        }

    @classmethod
    def from_dict(cls, mission: Mission, data: Mapping[str, Any]) -> Part:
        """Return the part that `to_dict` wrote; raises what `Plan.from_dict` does."""
        names = [goal.name for goal in mission.goals]
        runs = data['cells']
        if not runs or not all(0 <= first <= last < mission.grid.q for first, last in runs):
            raise ValueError(f'cells {quoted(runs)} are not all cells of the grid')
        cells = tuple(cell for first, last in runs for cell in range(first, last + 1))
        numbers(data, PART_NUMBERS)
        one_of('goal', 'location', 'fault', 'mixed')(data['kind'])
        written = {
            'goals': tuple(names.index(name) for name in data['goals']),
            'cells': cells,
            'faults': tuple(FAULT_MODES.index(name) + 1 for name in data['faults']),
        }
        return cls(**{**data, **written})

    @property
    def box(self) -> tuple[IndexArray, ...]:
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
    def _first(self) -> IntArray:
        """Number of the first part that covers a goal, cell and fault mode, (k, q, 8); N+1."""
        return first_part(self.mission, self.parts)

    def part_of(self, states: ArrayLike) -> IntArray:
        """phi(s) of states (N, 2k+5), in 1..N, shape (N,).

        A part covers the states in its cells and fault modes in which one of its goals is
        wanted, g_j > 0, or no goal at all. Of several the first, whose score is highest.

        Raises
        ------
        StateError
            If a state is none of the mission's.
        """
        space = StateSpace.of(self.mission)
        s = space.split(space.check(states))
        wanted = s.g > 0
        wanted |= ~wanted.any(axis=1, keepdims=True)
        first = self._first[:, s.l, s.f - 1].T
        return np.asarray(first.min(axis=1, where=wanted, initial=len(self.parts)), np.int64)

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
        """Return the plan for JSON; its parts, in their order, and the rule phi map all states."""
        parts = [part.to_dict(self.mission) for part in self.parts]
        return {'max_states': self.max_states, 'phi': PHI_RULE, 'parts': parts}

    @classmethod
    def from_dict(cls, mission: Mission, data: Mapping[str, Any]) -> Plan:
        """Return the plan of a mission that `to_dict` wrote.

        Raises
        ------
        ValueError, LookupError, TypeError
            If it is no such plan: a field is missing, is unknown or does not fit the mission.
        """
        if data['phi'] != PHI_RULE:
            raise ValueError(f'phi: {quoted(data["phi"])} is not {PHI_RULE!r}')
        parts = tuple(Part.from_dict(mission, part) for part in data['parts'])
        return cls(mission, numbers(data, ['max_states'])['max_states'], parts)


def first_part(mission: Mission, parts: Sequence[Part]) -> IntArray:
    """Number, from 1, of the first part that covers a goal, cell and fault mode, (k, q, 8).

    N + 1 where none of the N parts does. In the smallest integers that hold it.
    """
    last = len(parts) + 1
    first = np.full((mission.k, mission.grid.q, 8), last, np.min_scalar_type(last))
    for number, part in reversed(list(enumerate(parts, 1))):
        first[part.box] = number
    return first


def _runs(cells: Sequence[int]) -> list[list[int]]:
    """First and last of each run of consecutive numbers among ascending ones."""
    numbers = np.array(cells)
    after = np.flatnonzero(np.diff(numbers) > 1) + 1
    firsts, lasts = numbers[np.r_[0, after]], numbers[np.r_[after, len(numbers)] - 1]
    return np.column_stack([firsts, lasts]).tolist()


def _uncovered(mission: Mission, missing: BoolArray) -> str:
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
        absent = np.flatnonzero(missing.all(axis=others))
        words += [f'{what} {values[i]}' for i in absent[:MAX_NAMED_VALUES]]
        if len(absent) > MAX_NAMED_VALUES:
            words.append(f'{len(absent) - MAX_NAMED_VALUES} more of the {what}s')
    if missing.all():
        words = ['any state']
    elif not words:
        words = [f'goal {names[j]} at location {cell} in fault mode {FAULT_MODES[f]}']
    priorities = [2 * (goal == j) for goal in range(mission.k)]
    state = [f + 1, *[1] * mission.k, *priorities, cell, 0, 0, 0]
    return f'{", ".join(words)}, such as [{" ".join(map(str, state))}]'
