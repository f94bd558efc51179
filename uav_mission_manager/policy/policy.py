"""A policy: the solved sub-MDPs of a mission and the rule that makes one decision of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.mdp import Mission, StateSpace
from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.decision import Decision, decide
from uav_mission_manager.policy.store import (
    PolicyError,
    PolicySet,
    read_policy_set,
    write_policy_set,
)
from uav_mission_manager.solver import (
    BellmanOperator,
    LookAhead,
    Solution,
    SubMdp,
    best_value,
    choose,
    goal_sub_mdps,
    highest_priority,
    split_sub_mdps,
    summed,
    value_iteration,
    whole_mission,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """How a policy is made: its sub-MDPs, and how their Q values become one.

    `bounded` says that the sub-MDPs' optimal costs sum to a lower bound on V*: every action is
    kept in each and their shares of the cost add up to it.
    """

    decompose: Callable[[Mission], tuple[SubMdp, ...]]
    recombine: Callable[[Sequence[SubMdp], NDArray[np.int64], Sequence[FloatArray]], FloatArray]
    bounded: bool


METHODS = {
    'exact': Method(lambda mission: (whole_mission(mission),), summed, bounded=True),
    'split': Method(split_sub_mdps, summed, bounded=True),
    'highest_priority': Method(goal_sub_mdps, highest_priority, bounded=False),
    'best_value': Method(goal_sub_mdps, best_value, bounded=False),
}


class Policy:
    """Look-ups of Q values and actions; `build_policy` and `load_policy` make one.

    Attributes
    ----------
    mission : Mission
    method : str
        Key of `METHODS`.
    solutions : tuple of Solution
        One a sub-MDP, in the method's order.
    digest : str
        SHA-256 of the policy set it was loaded from or saved to; empty before.
    """

    def __init__(
        self, mission: Mission, method: str, solutions: Sequence[Solution], digest: str = ''
    ) -> None:
        self.mission, self.method, self.digest = mission, method, digest
        self.solutions = tuple(solutions)
        self.space = StateSpace(mission.k, mission.grid.q)
        self._operators = [BellmanOperator(solution.sub) for solution in self.solutions]
        self._whole = whole_mission(mission)

    @cached_property
    def _look_aheads(self) -> list[LookAhead]:
        return [
            LookAhead(operator, solution.value)
            for operator, solution in zip(self._operators, self.solutions)
        ]

    @property
    def info(self) -> dict[str, Any]:
        """What is known of the policy: sizes, sweeps, residual, bounds."""
        return {
            'mission': self.mission.name,
            'method': self.method,
            'goals': self.mission.k,
            'states': self.space.size,
            'sub_mdps': len(self.solutions),
            'sub_mdp_states': [solution.sub.states for solution in self.solutions],
            'iterations': [solution.iterations for solution in self.solutions],
            'residual': max(solution.residual for solution in self.solutions),
            'lower': sum(solution.lower for solution in self.solutions),
            'upper': sum(solution.upper for solution in self.solutions),
            'converged': all(solution.converged for solution in self.solutions),
            'digest': self.digest,
        }

    def q_values(self, states: ArrayLike) -> FloatArray:
        """Q(s, a) of states (N, 2k+5) for all 2k+4 actions; inf where an action is not allowed.

        Raises
        ------
        StateError
            If the states have another shape or a value out of range.
        """
        rows = self.space.check(states)
        tables = [look_ahead.q_values(rows) for look_ahead in self._look_aheads]
        subs = [solution.sub for solution in self.solutions]
        q = METHODS[self.method].recombine(subs, rows, tables)
        return q if subs == [self._whole] else np.where(self._whole.allowed_in(rows), q, np.inf)

    def act(self, states: ArrayLike) -> NDArray[np.int64]:
        """Action numbers from 1 for states (N, 2k+5), shape (N,). Raises `StateError`."""
        actions = self.solutions[0].actions
        if actions is None:
            return choose(self.q_values(states))
        rows = self.space.check(states)
        return actions[self._operators[0].locate(rows)].astype(np.int64)

    def lower_bound(self, states: ArrayLike) -> FloatArray:
        """Guaranteed lower bound on V*, shape (N,); 0 where the method gives none."""
        rows = self.space.check(states)
        if not METHODS[self.method].bounded:
            return np.zeros(len(rows))
        return np.maximum(self.part_values(rows) + self._offsets, 0.0).sum(axis=1)

    @property
    def _offsets(self) -> FloatArray:
        return np.array([solution.lower for solution in self.solutions])

    def part_values(self, states: ArrayLike) -> FloatArray:
        """Optimal cost of each sub-MDP, shape (N, sub-MDPs). Raises `StateError`."""
        rows = self.space.check(states)
        return np.stack(
            [
                operator.state_values(solution.value, rows)
                for operator, solution in zip(self._operators, self.solutions)
            ],
            axis=1,
        )

    def decide(self, state: Sequence[int]) -> Decision:
        """Decide in one state, [f r.. g.. l c t m]. Raises `StateError`."""
        row = self.space.check(state)
        values, bound = self.q_values(row)[0], float(self.lower_bound(row)[0])
        stored = self.solutions[0].actions is not None
        number = int((self.act(row) if stored else choose(values[None]))[0])
        return decide(self.mission, row[0].tolist(), number, values, bound)

    def save(self, directory: str | Path) -> None:
        """Write a policy set (see `uav_mission_manager.policy.store`). Raises `PolicyError`."""
        contents = PolicySet(self.mission, self.method, self.solutions)
        self.digest = write_policy_set(contents, Path(directory))


def build_policy(
    mission: Mission,
    method: str = 'exact',
    tolerance: float = 1e-7,
    on_sweep: Callable[[int, int, float], None] | None = None,
    *,
    precision: str = 'mixed',
    threads: int | None = None,
    checkpoint: Checkpoint | None = None,
) -> Policy:
    """Solve a mission.

    Parameters
    ----------
    mission : Mission
    method : {'exact', 'split', 'highest_priority', 'best_value'}
    tolerance : float
        Largest distance of each sub-MDP's V from its optimum, in cost.
    on_sweep : callable, optional
        Called with the sub-MDP's position, the sweep and the distance bound reached.
    precision, threads
        See `uav_mission_manager.solver.value_iteration`.
    checkpoint : Checkpoint, optional
        Where to go on from and to leave word from time to time.

    Raises
    ------
    ValueError
        If there is no such method or precision.
    MissionSizeError
        If the memory does not suffice.
    """
    if method not in METHODS:
        raise ValueError(f'method {method!r} is none of {", ".join(METHODS)}')
    solutions = []
    for position, sub in enumerate(METHODS[method].decompose(mission)):

        def report(sweep: int, bound: float, position: int = position) -> None:
            if on_sweep is not None:
                on_sweep(position, sweep, bound)

        solutions.append(
            value_iteration(
                sub,
                tolerance,
                on_sweep=report,
                precision=precision,
                threads=threads,
                start=checkpoint.load(position) if checkpoint else None,
                on_values=partial(checkpoint.save, position) if checkpoint else None,
                with_actions=method == 'exact' and not LookAhead.tabulates(sub),
            )
        )
    return Policy(mission, method, solutions)


def load_policy(directory: str | Path, mission: Mission | None = None) -> Policy:
    """Read a policy set.

    Parameters
    ----------
    directory : path
    mission : Mission, optional
        Refuse a policy for goals of other names or cells, or for another grid, than this one's.

    Raises
    ------
    PolicyError
        If it is broken or for another mission.
    """
    contents, digest = read_policy_set(Path(directory))
    if contents.method not in METHODS:
        raise PolicyError(f'{directory}: method: {contents.method!r} is unknown')
    subs = tuple(solution.sub for solution in contents.solutions)
    if subs != METHODS[contents.method].decompose(contents.mission):
        raise PolicyError(f'{directory}: sub_mdps: are not those of method {contents.method!r}')
    if mission is not None:
        for what, wanted in _geography(mission).items():
            found = _geography(contents.mission)[what]
            if found != wanted:
                raise PolicyError(f'{directory}: mission.{what}: {found} are not {wanted}')
    return Policy(contents.mission, contents.method, contents.solutions, digest)


def _geography(mission: Mission) -> dict[str, object]:
    """Return what a command means on the ground: weights may differ, these must not."""
    return {'goals': [(goal.name, goal.cell) for goal in mission.goals], 'grid': mission.grid}
