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
from uav_mission_manager.solver.design_backup import DesignBackup
from uav_mission_manager.solver.factors import Factors, goal_order

WHOLE = 1 << 13
"""Design points up to which the design is all x."""

FIT_TOLERANCE = {True: 1e-4, False: 3e-3}
"""Spread of the last change, relative to the largest W, at which a fit in all design points or in
drawn ones ends. Measured: with 1e-3 in all points the losses of random missions double; with ten
goals and drawn points, 3e-3 and 2e-4 cost the same to 0.04 %."""

TINY = float(np.finfo(np.float32).tiny)

POINTS = 2
"""Design points a feature, where they are drawn."""

FIRST = 256
"""Features of a first fit, at most. What it has found is where the whole one starts from, whose
sweeps are long."""


@dataclass(frozen=True)
class Expansion:
    """The fitted expansion.

    Attributes
    ----------
    mission : Mission
    clusters : Clusters
    theta : float32 array (places, 3, 8, P)
        Coefficients over place, t, f and feature.
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
    tolerance: float | None = None,
    max_iterations: int = 1000,
    on_sweep: Callable[[int, float], None] | None = None,
) -> Expansion:
    """Fit an expansion.

    Parameters
    ----------
    mission : Mission
    clusters : Clusters
    tolerance : float, optional
        Spread of the last change to stop at, relative to the largest W; see `FIT_TOLERANCE`.
    max_iterations : int
        Sweeps after which to give up.
    on_sweep : callable, optional
        Called after each sweep with its number and the relative spread.
    """
    if tolerance is None:
        tolerance = FIT_TOLERANCE[6**mission.k <= WHOLE]
    factors, gain = Factors(mission), mission.discount / (1 - mission.discount)
    theta: FloatArray = np.zeros((factors.places, 3, 8, 1), np.float32)
    basis, iterations = Basis(factors, Clusters(())), 0
    for part in dict.fromkeys((clusters.within(FIRST), clusters)):
        basis, before = Basis(factors, part), basis
        theta = basis.embed(theta, before)
        x = design(mission, basis.size)
        backup, fit = DesignBackup(basis, x), LeastSquares(basis, x)
        present: FloatArray = theta @ fit.now
        relative = np.inf
        while relative > tolerance and iterations < max_iterations:
            values = backup(theta)
            change = values - present
            low, high = float(change.min()), float(change.max())
            shift = np.float32(gain * (high + low) / 2)
            theta = fit(values)
            theta[..., 0] += shift
            present = values + shift
            relative = (high - low) / max(float(np.abs(values).max()), TINY)
            iterations += 1
            if on_sweep is not None:
                on_sweep(iterations, relative)
    converged = relative <= tolerance
    return Expansion(mission, clusters, theta, len(x), iterations, high - low, converged)


def design(mission: Mission, features: int) -> NDArray[np.int64]:
    """Design points x (M, k): all where they are few, else drawn by their likelihood.

    Goals are drawn for in an order of their own, so that relabelling them changes nothing.
    """
    k = mission.k
    if 6**k <= WHOLE:
        return np.indices((6,) * k).reshape(k, -1).T
    rng = np.random.default_rng(features)
    drawn = rng.choice(6, (2 * POINTS * features, k), p=LIKELIHOOD)
    points = rng.permutation(np.unique(drawn, axis=0))[: POINTS * features]
    x = np.empty_like(points)
    x[:, goal_order(mission)] = points
    return x


class LeastSquares:
    """Fits coefficients to values in the design points, all weighted alike or by likelihood.

    Parameters
    ----------
    basis : Basis
    x : int array (M, k)

    Attributes
    ----------
    now : float32 array (P, M)
        The features in the design points.
    """

    def __init__(self, basis: Basis, x: NDArray[np.int64]) -> None:
        self.now = basis.now(x, np.float32)
        complete = len(x) == 6 ** x.shape[1]
        weights = LIKELIHOOD[x].prod(axis=1) if complete else np.full(len(x), 1 / len(x))
        self.weighted = (self.now * weights.astype(np.float32)).T
        # In single precision the sum over the points is not good enough.
        root = self.now * np.sqrt(weights)
        gram = root @ root.T
        # The least that keeps a design without some pair of x_j from blowing up.
        gram[np.diag_indices_from(gram)] += 1e-9
        self.inverse = np.linalg.inv(gram).astype(np.float32)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Coefficients (..., P) for values (..., M)."""
        flat = values.reshape(-1, values.shape[-1])
        return ((flat @ self.weighted) @ self.inverse).reshape(*values.shape[:-1], -1)
