"""What every policy can do: look up Q values and actions, bound costs, decide and explain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp import Action, Mission, StateSpace, global_actions
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.decision import Decision, explain
from uav_mission_manager.policy.store import PolicySet, write_policy_set
from uav_mission_manager.solver.decomposition.plan import Plan
from uav_mission_manager.solver.evaluation.simulation import ControlVariate
from uav_mission_manager.solver.greedy import choose

DECISIONS_KEPT = 1000
"""Decisions that a policy remembers: a choice, what one flight meets. A vehicle reports the same
state many times a second, and what flickers comes back to the states it was in."""


class Policy(ABC):
    """A policy of a mission; `build_policy` and `load_policy` make one.

    Attributes
    ----------
    mission : Mission
    method : str
        How it was made, a key of `uav_mission_manager.policy.build.BUILDERS`.
    plan : Plan
        The sub-MDPs that Algorithm 1 made of the mission.
    certificate : Certificate or None
        How far it may be from the optimum, where that was asked for.
    digest : str
        SHA-256 of the policy set it was loaded from or saved to; empty before.
    reason : str
        Why this method was taken, where the choice was left to `build_policy`; else empty.
    """

    reason = ''

    def __init__(
        self,
        mission: Mission,
        method: str,
        plan: Plan,
        certificate: Certificate | None = None,
        digest: str = '',
    ) -> None:
        self.mission, self.method, self.plan = mission, method, plan
        self.certificate, self.digest = certificate, digest
        self.space = StateSpace.of(mission)

    @classmethod
    @abstractmethod
    def from_set(cls, contents: PolicySet, digest: str) -> Policy:
        """Make the policy that a policy set holds. Raises `PolicyError`."""

    @abstractmethod
    def contents(self) -> PolicySet:
        """Return what a policy set of it holds."""

    @abstractmethod
    def summary(self) -> dict[str, Any]:
        """Return what `info` says of this kind of policy beside what all have in common."""

    @abstractmethod
    def look_up(self, rows: IntArray) -> FloatArray:
        """Q(s, a) of valid states (N, 2k+5), shape (N, 2k+4); inf where not allowed."""

    @property
    @abstractmethod
    def parts(self) -> list[tuple[int, ...]]:
        """Goals, from 0, of each column of `part_values`."""

    @abstractmethod
    def part_values(self, states: ArrayLike) -> FloatArray:
        """Share of each part in the cost, shape (N, parts). Raises `StateError`."""

    def parts_behind(self, rows: IntArray) -> list[tuple[int, ...]]:
        """Parts whose Q values decide in one valid state (1, 2k+5)."""
        return self.parts

    def choose_action(self, rows: IntArray) -> IntArray:
        """Action numbers of valid states (N, 2k+5), shape (N,)."""
        return choose(self.look_up(rows))

    def own_lower_bound(self, rows: IntArray) -> FloatArray:
        """Lower bound on V* of valid states without a certificate, shape (N,)."""
        return np.zeros(len(rows))

    def own_upper_bound(self, rows: IntArray) -> FloatArray:
        """Upper bound on V^pi of valid states without a certificate, shape (N,)."""
        return np.full(len(rows), np.inf)

    def estimate(self, least: FloatArray, sums: FloatArray) -> FloatArray:
        """V', to which the certificate's offset is added, of the least Q and the lower bound."""
        return sums

    @property
    def estimate_rounding(self) -> float:
        """By how much rounding may change V' from one look-up of a state to the next, at most."""
        return 0.0

    @property
    def control(self) -> ControlVariate | None:
        """What simulates its cost with less variance than the costs themselves, if anything."""
        return None

    @property
    def warnings(self) -> list[str]:
        """What a user must know of the policy before it is flown, a line each."""
        certificate = self.certificate
        return [certificate.warning] if certificate and certificate.warning else []

    @property
    def proved_gap(self) -> float | None:
        """Mean of V^pi / V* - 1 over all states, at most; None where nothing is proved."""
        return self.certificate.gap if self.certificate else None

    @property
    def info(self) -> dict[str, Any]:
        """What is known of the policy: sizes, sweeps, residual, bounds."""
        return {
            'mission': self.mission.name,
            'method': self.method,
            'goals': self.mission.k,
            'states': self.space.size,
            **self.summary(),
            **(self.certificate.summary() if self.certificate else {}),
            'digest': self.digest,
        }

    def q_values(self, states: ArrayLike) -> FloatArray:
        """Q(s, a) of states (N, 2k+5) for all 2k+4 actions; inf where an action is not allowed.

        Raises
        ------
        StateError
            If the states have another shape or a value out of range.
        """
        return self.look_up(self.space.check(states))

    def act(self, states: ArrayLike) -> IntArray:
        """Action numbers from 1 for states (N, 2k+5), shape (N,). Raises `StateError`."""
        return self.choose_action(self.space.check(states))

    def lower_bound(self, states: ArrayLike) -> FloatArray:
        """Guaranteed lower bound on V*, shape (N,); 0 where none is known."""
        rows = self.space.check(states)
        bound = self.own_lower_bound(rows)
        if self.certificate is not None:
            bound = np.maximum(bound, self.certificate.bound.sums(rows))
        return bound

    def upper_bound(self, states: ArrayLike) -> FloatArray:
        """Upper bound on the cost V^pi of this policy, shape (N,); inf where none is known.

        `upper_bound_holds` says where it holds.
        """
        rows = self.space.check(states)
        return self._bounds(rows, self.look_up(rows).min(axis=1))[1]

    def _bounds(self, rows: IntArray, least: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bounds in valid states of which the least Q is known."""
        lower, upper = self.own_lower_bound(rows), self.own_upper_bound(rows)
        if self.certificate is not None:
            sums = self.certificate.bound.sums(rows)
            lower = np.maximum(lower, sums)
            upper = np.minimum(upper, self.estimate(least, sums) + self.certificate.offset)
        return lower, upper

    @property
    def upper_bound_holds(self) -> str:
        """Where `upper_bound` holds, in words."""
        return 'nowhere' if self.certificate is None else self.certificate.holds

    def decide(self, state: Sequence[int]) -> Decision:
        """Decide in one state, [f r.. g.. l c t m]. Raises `StateError`."""
        return self._decisions(tuple(state))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the decisions: a copy in another process remembers its own."""
        return {name: value for name, value in vars(self).items() if name != '_decisions'}

    @cached_property
    def _decisions(self) -> Callable[[tuple[int, ...]], Decision]:
        return lru_cache(DECISIONS_KEPT)(self._decide)

    def _decide(self, state: tuple[int, ...]) -> Decision:
        row = self.space.check(state)
        values = self.look_up(row)[0]
        number = int(self.choose_from(row, values[None])[0])
        bounds = partial(self._bounds, row, values.min(keepdims=True))
        return explain(self.mission, self._actions, row[0].tolist(), number, values, bounds)

    @cached_property
    def _actions(self) -> tuple[Action, ...]:
        return global_actions(self.mission)

    def choose_from(self, rows: IntArray, q_values: FloatArray) -> IntArray:
        """Action numbers of valid states of which the Q values are known, shape (N,)."""
        return choose(q_values)

    def save(self, directory: str | Path) -> None:
        """Write a policy set (see `uav_mission_manager.policy.store`). Raises `PolicyError`."""
        self.digest = write_policy_set(self.contents(), Path(directory))
