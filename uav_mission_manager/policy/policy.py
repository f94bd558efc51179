"""A policy: the solved sub-MDPs of a mission and the rule that makes one decision of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.mdp import Mission, StateSpace
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.decision import Decision, decide
from uav_mission_manager.policy.store import PolicySet, write_policy_set
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
    whole_mission,
)
from uav_mission_manager.solver.evaluation.simulation import ControlVariate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    certificate : Certificate or None
        How far it may be from the optimum, where that was asked for.
    """

    def __init__(
        self,
        mission: Mission,
        method: str,
        solutions: Sequence[Solution],
        digest: str = '',
        certificate: Certificate | None = None,
    ) -> None:
        self.mission, self.method, self.digest = mission, method, digest
        self.certificate = certificate
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
    def control(self) -> ControlVariate | None:
        """What simulates its cost with less variance than the costs themselves, if anything."""
        return None

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
            **self._certified,
            'digest': self.digest,
        }

    @property
    def _certified(self) -> dict[str, Any]:
        """What `info` says of the certificate."""
        certificate = self.certificate
        if certificate is None:
            return {}
        return {
            'gap': certificate.gap,
            'gap_error': certificate.gap_error,
            'offset': certificate.offset,
            'coverage': certificate.coverage,
            'confidence': certificate.confidence,
        }

    def q_values(self, states: ArrayLike) -> FloatArray:
        """Q(s, a) of states (N, 2k+5) for all 2k+4 actions; inf where an action is not allowed.

        Raises
        ------
        StateError
            If the states have another shape or a value out of range.
        """
        return self._q_values(self.space.check(states))

    def _q_values(self, rows: IntArray) -> FloatArray:
        tables = [look_ahead.q_values(rows) for look_ahead in self._look_aheads]
        subs = [solution.sub for solution in self.solutions]
        q = METHODS[self.method].recombine(subs, rows, tables)
        return q if subs == [self._whole] else np.where(self._whole.allowed_in(rows), q, np.inf)

    def act(self, states: ArrayLike) -> NDArray[np.int64]:
        """Action numbers from 1 for states (N, 2k+5), shape (N,). Raises `StateError`."""
        return self._act(self.space.check(states))

    def _act(self, rows: IntArray) -> IntArray:
        actions = self.solutions[0].actions
        if actions is None:
            return choose(self._q_values(rows))
        return actions[self._operators[0].locate(rows)].astype(np.int64)

    def lower_bound(self, states: ArrayLike) -> FloatArray:
        """Guaranteed lower bound on V*, shape (N,); 0 where none is known."""
        rows = self.space.check(states)
        bound = self._lower_bound(rows)
        if self.certificate is not None:
            bound = np.maximum(bound, self.certificate.bound.sums(rows))
        return bound

    def upper_bound(self, states: ArrayLike) -> FloatArray:
        """Upper bound on the cost V^pi of this policy, shape (N,); inf where none is known.

        `upper_bound_holds` says where it holds.
        """
        rows = self.space.check(states)
        return self._bounds(rows, self._q_values(rows).min(axis=1))[1]

    def _bounds(self, rows: IntArray, least: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bounds in valid states of which the least Q is known."""
        lower, certificate = self._lower_bound(rows), self.certificate
        if self.method == 'exact':
            solution = self.solutions[0]
            offset = solution.upper + solution.policy_loss_bound
            return lower, self.part_values(rows)[:, 0] + offset
        if certificate is None:
            return lower, np.full(len(rows), np.inf)
        sums = certificate.bound.sums(rows)
        return np.maximum(lower, sums), self.estimate(least, sums) + certificate.offset

    @property
    def upper_bound_holds(self) -> str:
        """Where `upper_bound` holds, in words."""
        if self.method == 'exact':
            return 'everywhere'
        return 'nowhere' if self.certificate is None else self.certificate.holds

    def estimate(self, least: FloatArray, sums: FloatArray) -> FloatArray:
        """V', to which the certificate's offset is added, of the least Q and the lower bound."""
        return sums

    def _lower_bound(self, rows: IntArray) -> FloatArray:
        if not METHODS[self.method].bounded:
            return np.zeros(len(rows))
        return np.maximum(self.part_values(rows) + self._offsets, 0.0).sum(axis=1)

    @property
    def _offsets(self) -> FloatArray:
        return np.array([solution.lower for solution in self.solutions])

    @property
    def parts(self) -> list[tuple[int, ...]]:
        """Goals from 0 of each column of `part_values`."""
        return [solution.sub.goals for solution in self.solutions]

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
        values = self._q_values(row)[0]
        stored = self.solutions and self.solutions[0].actions is not None
        number = int((self._act(row) if stored else choose(values[None]))[0])
        bounds = (float(bound[0]) for bound in self._bounds(row, values.min(keepdims=True)))
        actions = self._whole.actions
        return decide(self.mission, actions, row[0].tolist(), number, values, *bounds)

    def save(self, directory: str | Path) -> None:
        """Write a policy set (see `uav_mission_manager.policy.store`). Raises `PolicyError`."""
        contents = PolicySet(
            self.mission, self.method, self.solutions, certificate=self.certificate
        )
        self.digest = write_policy_set(contents, Path(directory))
