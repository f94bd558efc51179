"""A recombined policy against the optimal one, in every state of a mission."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission, StateSpace, global_actions
from uav_mission_manager.mdp.actions import Action
from uav_mission_manager.mdp.dynamics import (
    failure_matrices,
    on_ground,
    priority_matrices,
    range_matrix,
    threat_matrices,
)
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.solver import BellmanOperator, LookAhead, choose, whole_mission

NEAR = 1e-3
"""Actions whose Q is within this of V*, relative to it, are as good as optimal."""

Array = NDArray[Any]


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
        self.states = policy.space.states()
        self.q = policy.q_values(self.states)
        self.values, self.actions = self.q.min(axis=1), choose(self.q)


@dataclass(frozen=True)
class Agreement:
    """A policy beside the optimum, all arrays of shape (N,).

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
    """

    policy: Policy
    actions: Array
    same: Array
    near: Array
    loss: Array


def compare(optimum: Optimum, method: str) -> Agreement:
    """Build the method's policy and compare it in all states."""
    policy = build_policy(optimum.mission, method, order=2)
    actions = policy.act(optimum.states)
    chosen = np.take_along_axis(optimum.q, actions[:, None] - 1, axis=1)[:, 0]
    cost = Chain(optimum.mission).evaluate(actions)
    return Agreement(
        policy=policy,
        actions=actions,
        same=actions == optimum.actions,
        near=chosen <= (1 + NEAR) * optimum.values,
        loss=cost / optimum.values - 1,
    )


def groups(states: Array) -> dict[str, dict[int, Array]]:
    """Masks of states (N, 2k+5) by fault mode, threat level and number of active goals."""
    k = states.shape[1] // 2 - 2
    active = (states[:, 1 + k : 1 + 2 * k] > 0).sum(axis=1)
    variables = {'f': states[:, 0], 't': states[:, -2], 'active goals': active}
    return {
        name: {value: column == value for value in np.unique(column).tolist()}
        for name, column in variables.items()
    }


def local_values(policy: Policy, states: Array) -> list[Array]:
    """Q of each sub-MDP's own actions in global states (N, 2k+5), each (N, its actions)."""
    return [
        LookAhead(BellmanOperator(solution.sub), solution.value).q_values(states)
        for solution in policy.solutions
    ]


def local_choices(policy: Policy, states: Array) -> Array:
    """Global number of the action each sub-MDP would take, shape (N, sub-MDPs)."""
    columns = [
        np.array(solution.sub.numbers)[choose(values) - 1]
        for solution, values in zip(policy.solutions, local_values(policy, states))
    ]
    return np.stack(columns, axis=1)


class Chain:
    """One epoch of a mission for policies that may look at every variable.

    The solver's own evaluation wants policies that see c only where a goal may be completed;
    the rule of the best value sees it everywhere. Arrays over states have the axes
    (m, l, c, (f, r), (g, t)).
    """

    def __init__(self, mission: Mission) -> None:
        self.mission, self.grid, k = mission, mission.grid, mission.k
        self.actions, self.hops = global_actions(mission), mission.grid.next_hops()
        self.space = StateSpace(k, self.grid.q)
        full, success = np.eye(2**k)[-1], mission.faults.repair_success
        repair = (1 - success) * np.eye(8) + success * np.eye(8)[0]
        self.ground = {
            'none': np.eye(8 * 2**k),
            'recharge': np.kron(np.eye(8), np.tile(full, (2**k, 1))),
            'repair': np.kron(repair, np.eye(2**k)),
        }
        self.flight = [
            reduce(
                np.kron,
                [*failure_matrices(mission, agile)[::-1], *[range_matrix(mission, agile)] * k],
            )
            for agile in (False, True)
        ]
        # P(g', t' | g, t) on arrival in each cell, and where goal j has just been completed.
        goals = list(priority_matrices(mission))
        achieved = np.tile([1.0, 0.0, 0.0], (3, 1))
        completed = [[*goals[:j], achieved, *goals[j + 1 :]] for j in range(k)]
        self.rest, *self.rest_completed = (
            np.array([reduce(np.kron, [*g, t]) for t in threat_matrices(mission)])
            for g in (goals, *completed)
        )

    def evaluate(self, numbers: Array, tolerance: float = 1e-7) -> Array:
        """V^pi of the policy with these action numbers (N,), shape (N,).

        As `uav_mission_manager.solver.exact.value_iteration` does it, with the same bounds.
        """
        discount, cost = self.mission.discount, self._arranged(self._cost(numbers))
        gain = discount / (1 - discount)
        values, policy = cost, self._arranged(numbers - 1)
        while True:
            change = cost + discount * self._expected(values, policy) - values
            values = values + change
            if gain * np.ptp(change) / 2 <= tolerance:
                return self._flat(values + gain * (change.max() + change.min()) / 2)

    def successors(self, state: Sequence[int], number: int) -> Array:
        """P(s' | s, a) of all states s', shape (N,)."""
        action, k = self.actions[number - 1], self.mission.k
        f, r, g = state[0] - 1, state[1 : 1 + k], state[1 + k : 1 + 2 * k]
        cell, goal, threat, _ = state[1 + 2 * k :]
        landing = self.hops[cell, action.destination]
        health = self._health(action, cell)[np.ravel_multi_index((f, *r), (8, *[2] * k))]
        row = np.ravel_multi_index((*g, threat), (*[3] * k, 3))
        after = self._arranged(np.zeros(self.space.size))
        completion = 0.0
        if goal and cell == self.mission.goals[goal - 1].cell:
            completion = self.mission.faults.completion[f]
            rest = self.rest_completed[goal - 1][landing, row]
            after[int(action.agile), landing, 0] = completion * np.outer(health, rest)
        rest = (1 - completion) * self.rest[landing, row]
        after[int(action.agile), landing, action.goal] += np.outer(health, rest)
        return self._flat(after)

    def _health(self, action: Action, cell: int) -> Array:
        """P(f', r' | f, r)."""
        if on_ground(self.mission, action, cell):
            return self.ground[action.kind]
        return self.flight[action.agile]

    def _expected(self, values: Array, policy: Array) -> Array:
        """E[V(s')] of the policy's actions, counted from 0."""
        expected = np.empty_like(values)
        arrivals = values @ self.rest.swapaxes(1, 2)[:, None]
        for cell in range(self.grid.q):
            expected[:, cell] = self._ahead(arrivals, cell, policy[:, cell])
        share = np.repeat(self.mission.faults.completion, 2**self.mission.k)[:, None]
        for j, goal in enumerate(self.mission.goals):
            site = (slice(None), goal.cell, j + 1)
            rest = self.rest_completed[j].swapaxes(1, 2)[:, None]
            achieved = np.broadcast_to(values[:, :, :1] @ rest, values.shape)
            completed = self._ahead(achieved, goal.cell, policy[site])
            expected[site] += share * (completed - expected[site])
        return expected

    def _ahead(self, arrivals: Array, cell: int, policy: Array) -> Array:
        """E over f', r' of the policy's actions in a cell, given E over the rest on arrival."""
        ways = [
            self._health(action, cell)
            @ arrivals[int(action.agile), self.hops[cell, action.destination], action.goal]
            for action in self.actions
        ]
        flat = policy.reshape(-1, *policy.shape[-2:])
        return np.take_along_axis(np.array(ways), flat, axis=0).reshape(policy.shape)

    def _cost(self, numbers: Array) -> Array:
        """J(s, a) in all states."""
        mission, states = self.mission, self.space.states()
        distance = self.grid.distances()[:, [action.destination for action in self.actions]]
        ahead = mission.distance_weight * distance
        ahead[self.grid.service] += [
            getattr(mission.service_cost, action.kind, 0.0) for action in self.actions
        ]
        cost = BellmanOperator(whole_mission(mission)).stage_cost(states)
        return cost + ahead[states[:, -4], numbers - 1]

    def _arranged(self, table: Array) -> Array:
        """A table by state index (N,) over this class's axes."""
        k = self.mission.k
        axes = table.reshape(8 * 2**k, 3**k, self.grid.q, k + 1, 3, 2)
        return axes.transpose(5, 2, 3, 0, 1, 4).reshape(2, self.grid.q, k + 1, 8 * 2**k, -1)

    def _flat(self, table: Array) -> Array:
        k = self.mission.k
        axes = table.reshape(2, self.grid.q, k + 1, 8 * 2**k, 3**k, 3)
        return axes.transpose(3, 4, 1, 2, 5, 0).ravel()
