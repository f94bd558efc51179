"""A policy by goal expansion, for missions whose exact solution does not fit."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.store import PolicySet, write_policy_set
from uav_mission_manager.solver import Expansion, ExpansionLookAhead, choose
from uav_mission_manager.solver.evaluation.simulation import ControlVariate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class ExpansionPolicy(Policy):
    """Look-ups of Q values one epoch ahead in an expansion.

    Attributes
    ----------
    expansion : Expansion
    """

    def __init__(
        self, expansion: Expansion, digest: str = '', certificate: Certificate | None = None
    ) -> None:
        super().__init__(expansion.mission, 'expansion', (), digest, certificate)
        self.expansion = expansion

    @cached_property
    def _look_ahead(self) -> ExpansionLookAhead:
        return ExpansionLookAhead(self.expansion)

    @property
    def control(self) -> ControlVariate:
        """The expansion, and Q in it."""
        return ControlVariate(self._look_ahead.values, self._look_ahead.q_values)

    @property
    def info(self) -> dict[str, Any]:
        """What is known of the policy: sizes, sweeps, residual, certificate."""
        expansion = self.expansion
        return {
            'mission': self.mission.name,
            'method': self.method,
            'goals': self.mission.k,
            'states': self.space.size,
            'sub_mdps': expansion.clusters.count,
            'sub_mdp_states': expansion.clusters.states(self.mission),
            'features': expansion.clusters.features,
            'points': expansion.points,
            'iterations': [expansion.iterations],
            'residual': expansion.spread / 2,
            'converged': expansion.converged,
            **self._certified,
            'digest': self.digest,
        }

    def _q_values(self, rows: IntArray) -> FloatArray:
        return self._look_ahead.q_values(rows)

    def _act(self, rows: IntArray) -> IntArray:
        return choose(self._q_values(rows))

    def _lower_bound(self, rows: IntArray) -> FloatArray:
        return np.zeros(len(rows))

    def estimate(self, least: FloatArray, sums: FloatArray) -> FloatArray:
        """V', to which the certificate's offset is added, of the least Q and the lower bound."""
        return np.maximum(least, sums)

    @property
    def parts(self) -> list[tuple[int, ...]]:
        """Each goal alone."""
        return [(j,) for j in range(self.mission.k)]

    def part_values(self, states: ArrayLike) -> FloatArray:
        """What each wanted goal adds to the expected cost, shape (N, k). Raises `StateError`."""
        rows, k = self.space.check(states), self.mission.k
        without = np.repeat(rows[None], k, axis=0)
        for j in range(k):
            without[j, :, 1 + k + j] = 0
        values = self._look_ahead.values
        return np.stack([values(rows) - values(other) for other in without], axis=1)

    def save(self, directory: str | Path) -> None:
        """Write a policy set (see `uav_mission_manager.policy.store`). Raises `PolicyError`."""
        contents = PolicySet(
            self.mission, self.method, (), self.expansion, certificate=self.certificate
        )
        self.digest = write_policy_set(contents, Path(directory))
