"""Policies recombined from the solved sub-MDPs of single goals (Algorithm 2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp import Mission, allowed_actions
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.exact_policy import summary_of
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.store import PolicyError, PolicySet
from uav_mission_manager.solver.decomposition.plan import Plan
from uav_mission_manager.solver.exact import AxisModel, LookAhead, Solution
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.recombination.rules import best_value, highest_priority, summed
from uav_mission_manager.solver.submdp import SubMdp, goal_sub_mdps, split_sub_mdps


@dataclass(frozen=True)
class Recombination:
    """How Q values of sub-MDPs become one.

    Attributes
    ----------
    sub_mdps : callable
        The sub-MDPs of a mission, one a goal.
    rule : callable
        See `uav_mission_manager.solver.recombination.rules`.
    bounded : bool
        Whether the sub-MDPs' optimal costs sum to a lower bound on V*: every action is kept in
        each and their shares of the cost add up to it.
    """

    sub_mdps: Callable[[Mission], tuple[SubMdp, ...]]
    rule: Callable[[Sequence[SubMdp], IntArray, Sequence[FloatArray]], FloatArray]
    bounded: bool


RECOMBINATIONS = {
    'split': Recombination(split_sub_mdps, summed, bounded=True),
    'highest_priority': Recombination(goal_sub_mdps, highest_priority, bounded=False),
    'best_value': Recombination(goal_sub_mdps, best_value, bounded=False),
}
"""The recombinations by name."""


class RecombinedPolicy(Policy):
    """Takes the action of least Q after recombination.

    Attributes
    ----------
    solutions : tuple of Solution
        One a goal, in the mission's order.
    """

    def __init__(
        self,
        method: str,
        plan: Plan,
        solutions: Sequence[Solution],
        certificate: Certificate | None = None,
        digest: str = '',
    ) -> None:
        super().__init__(plan.mission, method, plan, certificate, digest)
        self.solutions = tuple(solutions)
        self._subs = [solution.sub for solution in self.solutions]
        self._recombination = RECOMBINATIONS[method]

    @classmethod
    def from_set(cls, contents: PolicySet, digest: str) -> RecombinedPolicy:
        """Make the policy that a policy set holds. Raises `PolicyError`."""
        subs = tuple(solution.sub for solution in contents.solutions)
        if subs != RECOMBINATIONS[contents.method].sub_mdps(contents.mission):
            raise PolicyError(f'sub_mdps: are not those of method {contents.method}')
        return cls(
            contents.method, contents.plan, contents.solutions, contents.certificate, digest
        )

    def contents(self) -> PolicySet:
        """Return what a policy set of it holds."""
        return PolicySet(
            self.mission, self.method, self.plan, self.solutions, certificate=self.certificate
        )

    def summary(self) -> dict[str, Any]:
        """Return sizes, sweeps and bounds."""
        return summary_of(self.solutions)

    @cached_property
    def _models(self) -> list[AxisModel]:
        return [AxisModel(sub) for sub in self._subs]

    @cached_property
    def _look_aheads(self) -> list[LookAhead]:
        return [
            LookAhead(model, solution.value)
            for model, solution in zip(self._models, self.solutions)
        ]

    def _tables(self, rows: IntArray) -> list[FloatArray]:
        return [look_ahead.q_values(rows) for look_ahead in self._look_aheads]

    def look_up(self, rows: IntArray) -> FloatArray:
        """Recombined Q(s, a) of valid states (N, 2k+5), (N, 2k+4); inf where not allowed."""
        q = self._recombination.rule(self._subs, rows, self._tables(rows))
        return np.where(allowed_actions(self.mission, rows), q, np.inf)

    @property
    def parts(self) -> list[tuple[int, ...]]:
        """The goal of each sub-MDP."""
        return [sub.goals for sub in self._subs]

    def part_values(self, states: ArrayLike) -> FloatArray:
        """Optimal cost of each sub-MDP, shape (N, k). Raises `StateError`."""
        rows = self.space.check(states)
        pairs = zip(self._models, self.solutions)
        return np.stack([model.state_values(s.value, rows) for model, s in pairs], axis=1)

    def local_values(self, states: ArrayLike) -> list[FloatArray]:
        """Q of each sub-MDP's own actions in global states, each (N, its actions)."""
        return self._tables(self.space.check(states))

    def local_choices(self, states: ArrayLike) -> IntArray:
        """Global number of the action that each sub-MDP would take, shape (N, k)."""
        columns = [
            np.array(sub.numbers)[choose(values) - 1]
            for sub, values in zip(self._subs, self.local_values(states))
        ]
        return np.stack(columns, axis=1)

    def parts_behind(self, rows: IntArray) -> list[tuple[int, ...]]:
        """Sub-MDPs whose Q values decide in one valid state: one of them, or all, summed."""
        rule, tables = self._recombination.rule, self._tables(rows)
        together = rule(self._subs, rows, tables)
        chosen = [
            sub.goals
            for sub, table in zip(self._subs, tables)
            if np.array_equal(rule([sub], rows, [table]), together)
        ]
        return chosen[:1] or self.parts

    def own_lower_bound(self, rows: IntArray) -> FloatArray:
        """Sum of the sub-MDPs' lower bounds, shape (N,); 0 where that is no bound on V*."""
        if not self._recombination.bounded:
            return np.zeros(len(rows))
        offsets = [solution.lower for solution in self.solutions]
        return np.maximum(self.part_values(rows) + offsets, 0.0).sum(axis=1)
