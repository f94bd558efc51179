"""Other solvers on the written-out MDP, each as a function that returns what it found.

A result is (V or None, policy as action numbers from 1, sweeps or None). Building the model in
the form a solver wants is not timed: each function here makes it and returns the solve.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

from parts.explicit import Explicit
from uav_mission_manager.mdp.arrays import FloatArray, IntArray

TOLERANCE = 1e-6
"""Largest distance from V* that a solver is asked for, in cost."""

NOT_ALLOWED = 1e5
"""Cost of actions that are not allowed, for solvers that must have all actions everywhere."""

Result = tuple[FloatArray | None, IntArray, int | None]
Solve = Callable[[], Result]


def scipy_csr(model: Explicit) -> Solve:
    """Value iteration on CSR matrices, stopped on the same bounds as ours."""
    gain = model.discount / (1 - model.discount)

    def solve() -> Result:
        value, sweeps = np.zeros(len(model.states)), 0
        while True:
            q = np.stack([matrix @ value for matrix in model.transitions], axis=1)
            q *= model.discount
            q += model.cost
            change = q.min(axis=1) - value
            value, sweeps = value + change, sweeps + 1
            if gain * np.ptp(change) / 2 <= TOLERANCE:
                middle = gain * (change.max() + change.min()) / 2
                return value + middle, q.argmin(axis=1) + 1, sweeps

    return solve


def quantecon(method: str) -> Callable[[Explicit], Solve]:
    """QuantEcon's DiscreteDP on state-action pairs."""

    def make(model: Explicit) -> Solve:
        from quantecon.markov import DiscreteDP

        states, actions = np.nonzero(np.isfinite(model.cost))
        rows = sparse.vstack(
            [
                matrix[np.isfinite(model.cost[:, action])]
                for action, matrix in enumerate(model.transitions)
            ],
            format='csr',
        )
        order = np.lexsort((states, actions))
        rows = rows[np.argsort(order)]
        problem = DiscreteDP(-model.cost[states, actions], rows, model.discount, states, actions)

        def solve() -> Result:
            # epsilon bounds twice the distance from the optimum.
            result = problem.solve(method=method, epsilon=2 * TOLERANCE, max_iter=100_000)
            return -result.v, result.sigma + 1, result.num_iter

        return solve

    return make


def mdpsolver(algorithm: str) -> Callable[[Explicit], Solve]:
    """The C++ of mdpsolver on lists of probabilities and columns."""

    def make(model: Explicit) -> Solve:
        import mdpsolver as package

        allowed = [np.flatnonzero(row) for row in np.isfinite(model.cost)]
        parts = [(m.indptr, m.indices.tolist(), m.data.tolist()) for m in model.transitions]

        def rows(which: int) -> list[Any]:
            return [
                [parts[a][which][parts[a][0][s] : parts[a][0][s + 1]] for a in actions]
                for s, actions in enumerate(allowed)
            ]

        problem = package.model()
        problem.mdp(
            discount=model.discount,
            rewards=[(-model.cost[s, actions]).tolist() for s, actions in enumerate(allowed)],
            tranMatProbs=rows(2),
            tranMatColumns=rows(1),
        )

        def solve() -> Result:
            # Without a start it goes on from its last result.
            start = np.zeros(len(model.states)).tolist()
            problem.solve(algorithm=algorithm, tolerance=TOLERANCE, initValueVector=start)
            policy = [actions[x] + 1 for actions, x in zip(allowed, problem.getPolicy())]
            return -np.array(problem.getValueVector()), np.array(policy), None

        return solve

    return make


def pymdptoolbox(name: str) -> Callable[[Explicit], Solve]:
    """pymdptoolbox, all actions everywhere."""

    def make(model: Explicit) -> Solve:
        from mdptoolbox import mdp

        reward = -np.where(np.isfinite(model.cost), model.cost, NOT_ALLOWED)
        problem = getattr(mdp, name)(model.transitions, reward, model.discount, epsilon=TOLERANCE)

        def solve() -> Result:
            problem.V = np.zeros(len(model.states))
            problem.iter = 0
            problem.run()
            return None, np.array(problem.policy) + 1, problem.iter

        return solve

    return make


PEERS: dict[str, Callable[[Explicit], Solve]] = {
    'scipy CSR, value iteration': scipy_csr,
    'QuantEcon, value iteration': quantecon('value_iteration'),
    'QuantEcon, modified policy iteration': quantecon('modified_policy_iteration'),
    'QuantEcon, policy iteration': quantecon('policy_iteration'),
    'mdpsolver, modified policy iteration': mdpsolver('mpi'),
    'mdpsolver, value iteration': mdpsolver('vi'),
    'pymdptoolbox, value iteration': pymdptoolbox('ValueIteration'),
    'pymdptoolbox, modified policy iteration': pymdptoolbox('PolicyIterationModified'),
}
