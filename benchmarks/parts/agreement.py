"""A policy against the optimal one, in every state of a mission."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parts.epoch import Epoch
from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission, StateSpace, stage_costs
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver.evaluation.occupancy import flown_states
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.threads import single_threaded_blas

NEAR = 1e-3
"""Actions whose Q is within this of V*, relative to it, are as good as optimal."""

FLOWN_STATES = 100_000
"""States drawn from those that a policy flies through."""

SAMPLE = (1, 1, 0, 1, 0, 2, 1, 1, 0, 2, 1)
"""The paper's sample state [f r1 r2 r3 g1 g2 g3 l c t m]."""

PAPER_CHOICES, PAPER_GOAL = (4, 3, 4), 2
"""What the paper's sub-MDPs choose there, by local number, and the sub-MDP it follows."""


class Optimum:
    """The exact solution in all states, in the order of their index.

    Attributes
    ----------
    states : int array (N, 2k+5)
    q : float array (N, 2k+4)
    values : float array (N,)
        V*.
    actions : int array (N,)
        Optimal action numbers; of actions that tie the lowest.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        policy = build_policy(mission, 'exact')
        self.space, self.states = policy.space, policy.space.states()
        self.q = policy.q_values(self.states)
        self.values, self.actions = self.q.min(axis=1), choose(self.q)


@dataclass(frozen=True)
class Agreement:
    """A policy beside the optimum; arrays over all states are of shape (N,).

    Attributes
    ----------
    policy : Policy
    actions : int array
    same : bool array
        Whether the action is the optimal one.
    near : bool array
        Whether Q*(s, a) <= (1 + NEAR) V*(s).
    loss : float array
        (V^pi - V*) / V*.
    flown : int array (FLOWN_STATES,)
        Indices of states drawn from the policy's discounted occupancy from base.
    """

    policy: Policy
    actions: IntArray
    same: BoolArray
    near: BoolArray
    loss: FloatArray
    flown: IntArray


def compare(optimum: Optimum, method: str) -> Agreement:
    """Build the method's policy and compare it in all states."""
    mission, space = optimum.mission, optimum.space
    policy = build_policy(mission, method, order=2, certificate=False)
    actions = policy.act(optimum.states)
    chosen = np.take_along_axis(optimum.q, actions[:, None] - 1, axis=1)[:, 0]
    with single_threaded_blas():
        cost = Chain(mission).evaluate(actions)
    rng = np.random.default_rng(0)
    flown = flown_states(mission, lambda rows: actions[space.index(rows)], FLOWN_STATES, rng)
    return Agreement(
        policy=policy,
        actions=actions,
        same=actions == optimum.actions,
        near=chosen <= (1 + NEAR) * optimum.values,
        loss=cost / optimum.values - 1,
        flown=space.index(flown),
    )


def groups(space: StateSpace, states: IntArray) -> dict[str, dict[int, BoolArray]]:
    """Masks of states (N, 2k+5) by fault mode, threat level and number of active goals."""
    s = space.split(states)
    variables = {'f': s.f, 't': s.t, 'active goals': (s.g > 0).sum(axis=1)}
    return {
        name: {value: column == value for value in np.unique(column).tolist()}
        for name, column in variables.items()
    }


class Chain:
    """The Markov chain of a policy that may look at every variable.

    The solver's own evaluation wants policies that look at neither c nor m; the rule of the best
    value looks at c. It shares no array layout with the solver. Arrays over states have the axes
    (m, l, c, (f, r), (g, t)).
    """

    def __init__(self, mission: Mission) -> None:
        self.mission, self.epoch = mission, Epoch(mission)
        self.space = StateSpace(mission.k, mission.grid.q)

    def evaluate(self, numbers: IntArray, tolerance: float = 1e-7) -> FloatArray:
        """V^pi of the policy with these action numbers (N,), shape (N,)."""
        discount = self.mission.discount
        states = self.space.states()
        cost = self._arranged(stage_costs(self.mission, states, numbers))
        values, policy = cost, self._arranged(numbers - 1)
        while True:
            change = cost + discount * self._expected(values, policy) - values
            values = values + change
            bounds = SpanBounds(change.min(), change.max(), discount)
            if bounds.distance <= tolerance:
                return self._flat(values + bounds.middle)

    def successors(self, state: Sequence[int], number: int) -> FloatArray:
        """P(s' | s, a) of all states s', shape (N,)."""
        after = self._arranged(np.zeros(self.space.size))
        where = self._arranged(np.arange(self.space.size)) == self.space.index(state)
        _, cell, _, row, column = (int(axis[0]) for axis in np.nonzero(where))
        action = self.epoch.actions[number - 1]
        landing = self.epoch.landings[number - 1, cell]
        health = self.epoch.faults_and_ranges(action, cell)[row]
        for probability, commitment, goals_and_threat in self.epoch.outcomes(action, cell):
            joint = probability[row] * np.outer(health, goals_and_threat[column])
            after[int(action.agile), landing, commitment] += joint
        return self._flat(after)

    def _expected(self, values: FloatArray, policy: IntArray) -> FloatArray:
        """E[V(s')] of the policy's actions, counted from 0."""
        expected = np.empty_like(values)
        for cell in range(self.mission.grid.q):
            every = np.array(
                [self._ahead(values, a, cell) for a in range(len(self.epoch.actions))]
            )
            chosen = policy[:, cell].reshape(-1, *values.shape[-2:])
            flat = np.take_along_axis(every, chosen, axis=0)
            expected[:, cell] = flat.reshape(expected[:, cell].shape)
        return expected

    def _ahead(self, values: FloatArray, a: int, cell: int) -> FloatArray:
        """E[V(s')] of one action in one cell, over (f, r) and (g, t)."""
        action = self.epoch.actions[a]
        there = values[int(action.agile), self.epoch.landings[a, cell]]
        health = self.epoch.faults_and_ranges(action, cell)
        return sum(
            probability[:, None] * (health @ (there[commitment] @ goals_and_threat.T))
            for probability, commitment, goals_and_threat in self.epoch.outcomes(action, cell)
        )

    def _arranged(self, by_index: np.ndarray) -> np.ndarray:
        """Return a table by state index (N,) over this class's axes."""
        k, q = self.mission.k, self.mission.grid.q
        axes = by_index.reshape(8 * 2**k, 3**k, q, k + 1, 3, 2)
        return axes.transpose(5, 2, 3, 0, 1, 4).reshape(2, q, k + 1, 8 * 2**k, -1)

    def _flat(self, arranged: np.ndarray) -> np.ndarray:
        k, q = self.mission.k, self.mission.grid.q
        axes = arranged.reshape(2, q, k + 1, 8 * 2**k, 3**k, 3)
        return axes.transpose(3, 4, 1, 2, 5, 0).ravel()
