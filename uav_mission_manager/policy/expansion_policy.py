"""A policy by goal expansion, for missions whose exact solution takes too long."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.store import PolicyError, PolicySet
from uav_mission_manager.solver.decomposition.plan import Plan
from uav_mission_manager.solver.evaluation.simulation import ControlVariate
from uav_mission_manager.solver.expansion import Expansion, ExpansionLookAhead


class ExpansionPolicy(Policy):
    """Takes the action of least Q one epoch ahead in an expansion.

    Attributes
    ----------
    expansion : Expansion
    """

    def __init__(
        self,
        plan: Plan,
        expansion: Expansion,
        certificate: Certificate | None = None,
        digest: str = '',
    ) -> None:
        super().__init__(expansion.mission, 'expansion', plan, certificate, digest)
        self.expansion = expansion

    @classmethod
    def from_set(cls, contents: PolicySet, digest: str) -> ExpansionPolicy:
        """Make the policy that a policy set holds. Raises `PolicyError`."""
        if contents.expansion is None:
            raise PolicyError('expansion: is missing')
        return cls(contents.plan, contents.expansion, contents.certificate, digest)

    def contents(self) -> PolicySet:
        """Return what a policy set of it holds."""
        return PolicySet(
            self.mission, self.method, self.plan, (), self.expansion, self.certificate
        )

    @cached_property
    def _look_ahead(self) -> ExpansionLookAhead:
        return ExpansionLookAhead(self.expansion)

    @property
    def control(self) -> ControlVariate:
        """The expansion: it is close to the policy's cost."""
        return ControlVariate(self._look_ahead.values, self._look_ahead.q_values)

    def summary(self) -> dict[str, Any]:
        """Return sizes, features, and how well they are fitted."""
        expansion = self.expansion
        return {
            'sub_mdps': expansion.clusters.count,
            'sub_mdp_states': expansion.clusters.states(self.mission),
            'features': expansion.clusters.features,
            'points': expansion.points,
            'iterations': [expansion.iterations],
            'residual': expansion.spread / 2,
            'converged': expansion.converged,
            'fresh_residual': expansion.fresh_residual,
        }

    @property
    def warnings(self) -> list[str]:
        """What a user must know of the policy before it is flown, a line each."""
        fit = [self.expansion.warning] if self.expansion.warning else []
        return fit + super().warnings

    def look_up(self, rows: IntArray) -> FloatArray:
        """Q(s, a) of valid states (N, 2k+5), shape (N, 2k+4); inf where not allowed.

        No cost is below 0, so where the fit has them so all are lifted, and the choice stays.
        """
        q_values = self._look_ahead.q_values(rows)
        return q_values - np.minimum(q_values.min(axis=1, keepdims=True), 0.0)

    def estimate(self, least: FloatArray, sums: FloatArray) -> FloatArray:
        """V', to which the certificate's offset is added, of the least Q and the lower bound."""
        return np.maximum(least, sums)

    @property
    def estimate_rounding(self) -> float:
        """By how much rounding may change V' from one look-up of a state to the next, at most."""
        return self._look_ahead.rounding

    @property
    def parts(self) -> list[tuple[int, ...]]:
        """Each goal alone."""
        return [(j,) for j in range(self.mission.k)]

    def part_values(self, states: ArrayLike) -> FloatArray:
        """What each wanted goal adds to the expected cost, shape (N, k). Raises `StateError`."""
        rows, values = self.space.check(states), self._look_ahead.values
        whole, added = values(rows), []
        for j in range(self.mission.k):
            without = rows.copy()
            self.space.split(without).g[:, j] = 0
            added.append(whole - values(without))
        return np.stack(added, axis=1)

    def parts_behind(self, rows: IntArray) -> list[tuple[int, ...]]:
        """Clusters of goals that are all wanted in one valid state."""
        wanted = set(np.flatnonzero(self.space.split(rows).g[0] > 0).tolist())
        groups = self.expansion.clusters.groups
        clusters = dict.fromkeys(cluster for group in groups for cluster in group.clusters)
        return [cluster for cluster in clusters if wanted.issuperset(cluster)]
