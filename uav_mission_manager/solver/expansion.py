"""Goal expansion: V as a sum of tables of a few goals each, fitted to its own Bellman backup.

V(s) = p(t, m) - [c > 0] eta_c g_c r_c + W(y, x), as in `uav_mission_manager.solver.bellman`, with
y = (place, t, f) and x = (x_1, .., x_k), is approximated by

    W(y, x) = sum over features of theta(y) phi(x),

phi the products of `uav_mission_manager.solver.basis`. Fitted value iteration (Gordon 1995)
backs up W in a set of design points x and all y, exactly, and fits theta to the result by
weighted least squares; with the design fixed, a sweep is matrix products. Nothing in it grows
with 2^k 3^k. Where every goal is in one fine cluster and the design holds all x, the fit is
exact and so is V. The policy takes the action of least Q, one epoch ahead in W.

A fitted backup need not contract; `Expansion.converged` says whether it did, and the policy is
judged by its certificate, not by the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.basis import LIKELIHOOD, Basis, Clusters
from uav_mission_manager.solver.factors import FLAGS, LEVELS, WAYS, Factors

WHOLE = 1 << 13
"""Design points up to which the design is all x."""

FIT_TOLERANCE = 1e-3
"""Spread of the last change, relative to the largest W, at which a fit ends. Measured: policies
fitted to 3e-3 and to 1e-5 cost the same to 0.0001 %."""

TINY = float(np.finfo(np.float32).tiny)

POINTS = 2
"""Design points a feature, where they are drawn."""


@dataclass(frozen=True)
class Expansion:
    """The fitted expansion.

    Attributes
    ----------
    mission : Mission
    clusters : Clusters
    theta : float32 array (P, places, 3, 8)
        Coefficients over feature, place, t and f.
    points : int
        Design points.
    iterations : int
        Sweeps.
    spread : float
        Spread of the last change over all design points.
    converged : bool
        Whether that met the tolerance.
    """

    mission: Mission
    clusters: Clusters
    theta: FloatArray
    points: int
    iterations: int
    spread: float
    converged: bool


def fit_expansion(
    mission: Mission,
    clusters: Clusters,
    tolerance: float = FIT_TOLERANCE,
    max_iterations: int = 1000,
    on_sweep: Callable[[int, float], None] | None = None,
) -> Expansion:
    """Fit an expansion.

    Parameters
    ----------
    mission : Mission
    clusters : Clusters
    tolerance : float
        Spread of the last change to stop at, relative to the largest W.
    max_iterations : int
        Sweeps after which to give up.
    on_sweep : callable, optional
        Called after each sweep with its number and the relative spread.
    """
    factors = Factors(mission)
    basis = Basis(factors, clusters)
    x = design(mission, basis.size)
    backup = DesignBackup(basis, x)
    now, fit = _least_squares(basis, x)
    theta: FloatArray = np.zeros((basis.size, factors.places, 3, 8), np.float32)
    gain = mission.discount / (1 - mission.discount)
    for iteration in range(1, max_iterations + 1):
        values = backup(theta).reshape(len(x), -1)
        fitted = (fit @ values).reshape(theta.shape)
        change = now @ (fitted - theta).reshape(basis.size, -1)
        low, high = float(change.min()), float(change.max())
        theta = fitted
        theta[0] += np.float32(gain * (high + low) / 2)
        relative = (high - low) / max(float(np.abs(values).max()), TINY)
        if on_sweep is not None:
            on_sweep(iteration, relative)
        if not relative > tolerance:
            break
    converged = relative <= tolerance
    return Expansion(mission, clusters, theta, len(x), iteration, high - low, converged)


def design(mission: Mission, features: int) -> NDArray[np.int64]:
    """Design points x (M, k): all where they are few, else drawn by their likelihood.

    Goals are drawn for in an order of their own, so that relabelling them changes nothing.
    """
    k = mission.k
    if 6**k <= WHOLE:
        return np.indices((6,) * k).reshape(k, -1).T
    keys = [(g.cell, g.eta, g.delta, g.priority_transition) for g in mission.goals]
    order = sorted(range(k), key=keys.__getitem__)
    rng = np.random.default_rng(features)
    drawn = rng.choice(6, (2 * POINTS * features, k), p=LIKELIHOOD)
    points = rng.permutation(np.unique(drawn, axis=0))[: POINTS * features]
    x = np.empty_like(points)
    x[:, order] = points
    return x


def _least_squares(basis: Basis, x: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Features (M, P) in the design, and the matrix (P, M) that fits them, in float32."""
    now = basis.now(x)
    complete = len(x) == 6 ** x.shape[1]
    weights = LIKELIHOOD[x].prod(axis=1) if complete else np.full(len(x), 1 / len(x))
    weighted = now * weights[:, None]
    gram = now.T @ weighted
    # The least that keeps a design without some pair of x_j from blowing up.
    gram[np.diag_indices_from(gram)] += 1e-9
    single = now.astype(np.float32)
    return single, np.linalg.inv(gram).astype(np.float32) @ weighted.T.astype(np.float32)


class DesignBackup:
    """T W in the design points, for all y.

    Parameters
    ----------
    basis : Basis
    x : int array (M, k)
    """

    def __init__(self, basis: Basis, x: NDArray[np.int64]) -> None:
        self.basis, self.factors, self.x = basis, basis.factors, x
        factors, goals, dtype = self.factors, np.arange(x.shape[1]), np.float32
        self.discount = dtype(factors.mission.discount)
        # A repair moves the goals as staying on the ground does.
        self.expected = [basis.expected(x, [way], dtype=dtype)[:, 0] for way in range(4)]
        self.expected.append(self.expected[WAYS.index('none')])
        self.completed = self._completed()
        self.threat = factors.threat.astype(dtype)
        self.faults = factors.faults.astype(dtype)
        self.able = np.flatnonzero(factors.completion > 0)
        wanted = (LEVELS[x] > 0) & (FLAGS[x] > 0)
        saving = factors.saving[:, goals, x]
        self.saving = np.where(wanted | (not factors.strict), saving, -np.inf).astype(dtype)
        self.full = (FLAGS[x] > 0).all(axis=1) & factors.strict
        costs = factors.cost[goals, x].sum(axis=1)[:, None] + factors.mission.faults.cost
        self.costs = costs[:, None].astype(dtype)

    def __call__(self, theta: FloatArray) -> FloatArray:
        """Return T W of W = theta phi, shape (M, places, 3, 8)."""
        factors, features = self.factors, len(theta)
        mixed = np.einsum('xst,pxtf->pxsf', self.threat, theta, optimize=True)
        coefficients = [mixed @ matrix.T for matrix in self.faults]
        grid = factors.mission.grid
        flights = [
            (self.expected[way] @ coefficients[way].reshape(features, -1)).reshape(
                len(self.x), factors.places, 3, 8
            )
            for way in range(2)
        ]
        cells = {'none': grid.base, 'recharge': grid.service, 'repair': grid.service}
        grounded = {
            WAYS.index(name): (
                self.expected[WAYS.index(name)]
                @ coefficients[WAYS.index(name)][:, cell].reshape(features, -1)
            ).reshape(-1, 3, 8)
            for name, cell in cells.items()
        }
        out = np.full((len(self.x), factors.places, 3, 8), np.inf, np.float32)
        for place in range(factors.places):
            gains = self._gains(place - factors.q, coefficients) if place >= factors.q else {}
            for way, landing, actions in self._arrivals(place):
                arrived = flights[way][:, landing] if way < 2 else grounded[way]
                if place >= factors.q:
                    cell = int(factors.cells[landing])
                    done = flights[way][:, cell] if way < 2 else grounded[way]
                    arrived = self._mixed(arrived, done, gains[way][cell])
                price = factors.price[int(way == 1), landing].astype(np.float32)[:, None]
                q = self.discount * arrived + price
                self._minimise(out[:, place], q, place, actions)
        out += self.costs[:, None]
        return out

    def _arrivals(self, place: int) -> list[tuple[int, int, list[int]]]:
        """Ways and landings from a place, and the actions that lead there."""
        arrivals: dict[tuple[int, int], list[int]] = {}
        for action in range(len(self.factors.actions)):
            key = int(self.factors.way[action, place]), int(self.factors.landing[action, place])
            arrivals.setdefault(key, []).append(action)
        return [(way, landing, actions) for (way, landing), actions in arrivals.items()]

    def _completed(self) -> dict[tuple[int, int], FloatArray]:
        """What the features of a goal gain where it is completed, by goal and way."""
        gains: dict[tuple[int, int], FloatArray] = {}
        for goal, members in enumerate(self.basis.of_goal):
            basis = Basis(self.factors, self.basis.clusters.of(goal))
            for way in set(self.factors.way[:, self.factors.q + goal].tolist()):
                done = basis.expected(self.x, [way], goal, np.float32)[:, 0, 1:]
                gains[goal, way] = done - self.expected[way][:, members]
        return gains

    def _gains(
        self, goal: int, coefficients: list[FloatArray]
    ) -> dict[int, dict[int, FloatArray]]:
        """What E gains where a goal is completed on its site, (M, 3, able f) by way and cell."""
        factors, members, place = self.factors, self.basis.of_goal[goal], self.factors.q + goal
        gains: dict[int, dict[int, FloatArray]] = {}
        for way in set(factors.way[:, place].tolist()):
            landings = factors.landing[factors.way[:, place] == way, place]
            cells = sorted(set(factors.cells[landings].tolist()))
            part = coefficients[way][np.ix_(members, cells, np.arange(3), self.able)]
            gain = self.completed[goal, way] @ part.reshape(len(members), -1)
            gain = gain.reshape(len(self.x), len(cells), 3, len(self.able))
            gains[way] = {cell: gain[:, position] for position, cell in enumerate(cells)}
        return gains

    def _mixed(self, arrived: FloatArray, done: FloatArray, gain: FloatArray) -> FloatArray:
        """E on arrival from a goal's site, completed with some probability.

        `done` is E on the cell, to which completion adds `gain` in the fault modes able to it.
        """
        out, before = arrived.copy(), arrived[..., self.able]
        probability = self.factors.completion[self.able].astype(np.float32)
        out[..., self.able] = before + probability * (done[..., self.able] + gain - before)
        return out

    def _minimise(
        self, least: FloatArray, q: FloatArray, place: int, actions: list[int]
    ) -> None:
        """Lower `least` (M, 3, 8) to the Q of actions of one arrival, q but for their cost."""
        factors = self.factors
        commits = [a for a in actions if factors.actions[a].kind == 'commit']
        for a in set(actions) - set(commits):
            kind, cost = factors.actions[a].kind, np.float32(factors.distance[a, place])
            value = q + cost
            if kind == 'recharge':
                value[self.full] = np.inf
            elif kind == 'repair' and factors.strict:
                value[..., 0] = np.inf
            np.minimum(least, value, out=least)
        if commits:
            able = self.able if factors.strict else np.arange(8)
            kept = 1 - factors.completion[able] if place >= factors.q else np.ones(len(able))
            kept = kept.astype(np.float32)
            costs: FloatArray = np.full((len(self.x), len(able)), np.inf, np.float32)
            for a in commits:
                action = factors.actions[a]
                saving = self.saving[int(action.agile), :, action.goal - 1, None]
                # Not -inf * kept, which may be 0.
                price = np.where(np.isfinite(saving), -np.maximum(saving, 0) * kept, np.inf)
                np.minimum(costs, price + np.float32(factors.distance[a, place]), out=costs)
            value = q[..., able] + costs[:, None]
            least[..., able] = np.minimum(least[..., able], value)
