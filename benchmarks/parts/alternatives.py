"""Other ways to fewer or cheaper sweeps, counted in products with the transition matrices.

All run on the written-out MDP of one or two goals in float64, and stop on the same bounds. A
sweep is one product with the matrices of all actions; a product with those of one policy counts
as one too, since here it saves the minimum but none of the expectations: these are shared by
actions, not made for each.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, gmres

from parts.explicit import Explicit
from parts.peers import TOLERANCE
from uav_mission_manager.mdp.arrays import FloatArray, IndexArray


class Counted:
    """Backups of the written-out MDP, counted."""

    def __init__(self, model: Explicit) -> None:
        self.model, self.sweeps = model, 0
        self.gain = model.discount / (1 - model.discount)
        self.n = len(model.states)

    def backup(self, value: FloatArray) -> tuple[FloatArray, IndexArray]:
        """T V and its policy."""
        self.sweeps += 1
        model = self.model
        q = np.stack([matrix @ value for matrix in model.transitions], axis=1)
        q = model.cost + model.discount * q
        return q.min(axis=1), q.argmin(axis=1)

    def done(self, change: FloatArray) -> bool:
        """Whether the bounds meet the tolerance."""
        return bool(self.gain * np.ptp(change) / 2 <= TOLERANCE)

    def policy(self, actions: IndexArray) -> csr_matrix:
        """Transition matrix of a policy."""
        total = csr_matrix((self.n, self.n))
        for action, matrix in enumerate(self.model.transitions):
            mask = csr_matrix(((actions == action).astype(float), (range(self.n), range(self.n))))
            total = total + mask @ matrix
        return total


def value_iteration(mdp: Counted) -> None:
    """Plain sweeps."""
    value = np.zeros(mdp.n)
    while True:
        new, _ = mdp.backup(value)
        if mdp.done(new - value):
            return
        value = new


def modified_policy_iteration(steps: int) -> Callable[[Counted], None]:
    """Some sweeps with each policy."""

    def run(mdp: Counted) -> None:
        value = np.zeros(mdp.n)
        while True:
            new, actions = mdp.backup(value)
            if mdp.done(new - value):
                return
            matrix = mdp.policy(actions)
            cost = mdp.model.cost[np.arange(mdp.n), actions]
            for _ in range(steps):
                new = cost + mdp.model.discount * (matrix @ new)
                mdp.sweeps += 1
            value = new

    return run


def policy_iteration_gmres(mdp: Counted) -> None:
    """Policy iteration, each policy evaluated by GMRES to a tenth of the change."""
    value = np.zeros(mdp.n)
    while True:
        new, actions = mdp.backup(value)
        if mdp.done(new - value):
            return
        matrix = mdp.policy(actions)

        def apply(x: FloatArray, matrix: csr_matrix = matrix) -> FloatArray:
            mdp.sweeps += 1
            return x - mdp.model.discount * (matrix @ x)

        system = LinearOperator((mdp.n, mdp.n), apply)
        correction, _ = gmres(system, new - value, rtol=0.1, restart=30, maxiter=1)
        value = value + correction


def anderson(memory: int, start: int) -> Callable[[Counted], None]:
    """Anderson acceleration of the sweeps after the first ones."""

    def run(mdp: Counted) -> None:
        value = np.zeros(mdp.n)
        images: deque[FloatArray] = deque(maxlen=memory + 1)
        changes: deque[FloatArray] = deque(maxlen=memory + 1)
        while True:
            new, _ = mdp.backup(value)
            change = new - value
            if mdp.done(change):
                return
            images.append(new)
            changes.append(change - (change.max() + change.min()) / 2)
            value = new
            if mdp.sweeps > start and len(changes) > 1:
                last = changes[-1]
                steps = np.stack([other - last for other in list(changes)[:-1]], axis=1)
                weights = np.linalg.lstsq(steps, -last, rcond=1e-10)[0]
                for weight, image in zip(weights, images):
                    value = value + weight * (image - new)

    return run


def gauss_seidel(descending: bool) -> Callable[[Counted], None]:
    """Cell by cell, each with the newest values of the others, in either order.

    The bounds come from a plain sweep apart, which is not counted until the last.
    """

    def run(mdp: Counted) -> None:
        model, value = mdp.model, np.zeros(mdp.n)
        cells = model.space.split(model.states).l
        order = sorted(set(cells.tolist()), reverse=descending)
        rows = [np.flatnonzero(cells == cell) for cell in order]
        parts = [[matrix[chosen] for matrix in model.transitions] for chosen in rows]
        while True:
            change = mdp.backup(value)[0] - value
            mdp.sweeps -= 1
            if mdp.done(change):
                mdp.sweeps += 1
                return
            for chosen, matrices in zip(rows, parts):
                q = np.stack([matrix @ value for matrix in matrices], axis=1)
                value[chosen] = (model.cost[chosen] + model.discount * q).min(axis=1)
            mdp.sweeps += 1

    return run


ALTERNATIVES: dict[str, Callable[[Counted], None]] = {
    'value iteration': value_iteration,
    'modified policy iteration, 2 sweeps a policy': modified_policy_iteration(2),
    'modified policy iteration, 10 sweeps a policy': modified_policy_iteration(10),
    'policy iteration, GMRES': policy_iteration_gmres,
    'Anderson acceleration, memory 3': anderson(3, 0),
    'Anderson acceleration, memory 5, from sweep 15 on': anderson(5, 15),
    'Gauss-Seidel over cells, ascending': gauss_seidel(descending=False),
    'Gauss-Seidel over cells, descending': gauss_seidel(descending=True),
}
