"""The optimal policy: one solved MDP of all goals."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.store import PolicyError, PolicySet
from uav_mission_manager.solver.decomposition.plan import Plan
from uav_mission_manager.solver.exact import AxisModel, LookAhead, Solution
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.submdp import whole_mission


class ExactPolicy(Policy):
    """Takes the action of least Q*.

    Attributes
    ----------
    solution : Solution
    """

    def __init__(self, plan: Plan, solution: Solution, digest: str = '') -> None:
        super().__init__(solution.sub.mission, 'exact', plan, digest=digest)
        self.solution = solution

    @classmethod
    def from_set(cls, contents: PolicySet, digest: str) -> ExactPolicy:
        """Make the policy that a policy set holds. Raises `PolicyError`."""
        whole = (whole_mission(contents.mission),)
        if tuple(solution.sub for solution in contents.solutions) != whole:
            raise PolicyError('sub_mdps: are not those of method exact')
        return cls(contents.plan, contents.solutions[0], digest)

    def contents(self) -> PolicySet:
        """Return what a policy set of it holds."""
        return PolicySet(self.mission, self.method, self.plan, (self.solution,))

    def summary(self) -> dict[str, Any]:
        """Return sizes, sweeps and bounds."""
        return summary_of((self.solution,))

    @property
    def proved_gap(self) -> float:
        """None is left: it is optimal, but for the tolerance that it was solved to."""
        return 0.0

    @cached_property
    def _model(self) -> AxisModel:
        return AxisModel(self.solution.sub)

    @cached_property
    def _look_ahead(self) -> LookAhead:
        return LookAhead(self._model, self.solution.value)

    def look_up(self, rows: IntArray) -> FloatArray:
        """Q*(s, a) of valid states (N, 2k+5), shape (N, 2k+4); inf where not allowed."""
        return self._look_ahead.q_values(rows)

    def choose_action(self, rows: IntArray) -> IntArray:
        """Action numbers of valid states (N, 2k+5), shape (N,)."""
        if self.solution.actions is None:
            return choose(self.look_up(rows))
        return self.solution.actions[self._model.locate(rows)].astype(np.int64)

    def choose_from(self, rows: IntArray, q_values: FloatArray) -> IntArray:
        """Action numbers: the stored ones where they are stored, for both to agree."""
        if self.solution.actions is None:
            return choose(q_values)
        return self.choose_action(rows)

    @property
    def parts(self) -> list[tuple[int, ...]]:
        """All goals."""
        return [self.solution.sub.goals]

    def part_values(self, states: ArrayLike) -> FloatArray:
        """V*, shape (N, 1). Raises `StateError`."""
        return self._values(self.space.check(states))[:, None]

    def _values(self, rows: IntArray) -> FloatArray:
        return self._model.state_values(self.solution.value, rows)

    def own_lower_bound(self, rows: IntArray) -> FloatArray:
        """Lower bound on V* of valid states, shape (N,)."""
        return np.maximum(self._values(rows) + self.solution.lower, 0.0)

    def own_upper_bound(self, rows: IntArray) -> FloatArray:
        """Upper bound on V^pi of valid states, shape (N,)."""
        return self._values(rows) + (self.solution.upper + self.solution.policy_loss_bound)

    @property
    def upper_bound_holds(self) -> str:
        """Where `upper_bound` holds, in words."""
        return 'everywhere'


def summary_of(solutions: tuple[Solution, ...]) -> dict[str, Any]:
    """Sizes, sweeps and bounds of solved sub-MDPs."""
    return {
        'sub_mdps': len(solutions),
        'sub_mdp_states': [solution.sub.states for solution in solutions],
        'iterations': [solution.iterations for solution in solutions],
        'residual': max(solution.residual for solution in solutions),
        'lower': sum(solution.lower for solution in solutions),
        'upper': sum(solution.upper for solution in solutions),
        'converged': all(solution.converged for solution in solutions),
    }
