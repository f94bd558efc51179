"""Goal expansion: V as a sum of tables of a few goals each, fitted to its own Bellman backup.

V(s) = p(t, m) - [c > 0] eta_c g_c r_c + W(y, x), as in `uav_mission_manager.solver.reduced`, with
y = (l, t, f) and x = (x_1, .., x_k), is approximated by

    W(y, x) = sum over features of theta(y) phi(x),

phi the products of `uav_mission_manager.solver.expansion.basis`. Fitted value iteration
(Gordon 1995) backs up W in a set of design points x and all y, exactly, and fits theta to the
result by weighted least squares; with the design fixed, a sweep is matrix products. Nothing in it
grows with 2^k 3^k. Where every goal is in one fine cluster and the design holds all x, the fit is
exact and so is V. The policy takes the action of least Q, one epoch ahead in W.

A fitted backup need not contract, least of all in few points. A fit that runs away is tried again
with more of them, and given up for a smaller one. `Expansion.converged` says whether it settled;
the policy is judged by its certificate, not by the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike
from scipy.linalg import lapack

from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver import threads
from uav_mission_manager.solver.expansion.basis import LIKELIHOOD, Basis, Clusters
from uav_mission_manager.solver.expansion.design_backup import DesignBackup
from uav_mission_manager.solver.progress import Progress, Report, ignore, share_of_decades
from uav_mission_manager.solver.reduced import X_VALUES, ReducedMission, goal_order
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import whole_mission
from uav_mission_manager.solver.threads import single_threaded_blas

WHOLE = 1 << 13
"""Design points up to which the design is all x."""

FIT_TOLERANCE = {True: 1e-4, False: 3e-3}
"""Spread of the last change, relative to the largest W, at which a fit in all design points or in
drawn ones ends. Measured: with 1e-3 in all points the losses of random missions double; with ten
goals and drawn points, 3e-3 and 2e-4 cost the same to 0.04 %."""

TINY = float(np.finfo(np.float32).tiny)

POINTS, LEAST, SHARE = (2, 4, 8), 2048, 3
"""Design points a feature, where they are drawn: as many as it takes to settle. The least of them,
and the part of all x that is drawn where that is no more than the most a feature."""

RUNAWAY = 3.0
"""Spread of a change, relative to the first, that says that a fit does not settle."""

FIRST = 256
"""Features of a first fit, at most. What it has found is where the whole one starts from, whose
sweeps are long."""


SUMMED_POINTS = 2048
"""Design points over which inner products are summed up in single precision, and not more."""

PANEL = 512
"""Features that a thread works on at a time."""

RIDGE = 1e-9
"""Added to the diagonal of the inner products: keeps a design without some pair of x_j from
blowing up."""


@dataclass(frozen=True)
class Expansion:
    """The fitted expansion.

    Attributes
    ----------
    mission : Mission
    clusters : Clusters
    theta : float32 array (q, 3, 8, P)
        Coefficients over cell, t, f and feature.
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
    theta: RealArray
    points: int
    iterations: int
    spread: float
    converged: bool


def fit_expansion(
    mission: Mission,
    clusters: Clusters,
    tolerance: float | None = None,
    max_iterations: int = 1000,
    progress: Progress = ignore,
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
    progress : Progress
        Told after each sweep how far the fit has come.

    Returns
    -------
    Expansion
        Over these clusters, or the first of them where more do not settle.

    Raises
    ------
    ValueError
        If not even those settle.
    """
    complete = X_VALUES**mission.k <= WHOLE
    if tolerance is None:
        tolerance = FIT_TOLERANCE[complete]
    reduced, found = ReducedMission(whole_mission(mission)), None
    for part in dict.fromkeys((clusters.within(FIRST), clusters)):
        for points in POINTS:
            x = design(mission, _points(mission, part, points))
            with single_threaded_blas():
                fitted = _fit(reduced, part, x, found, tolerance, max_iterations, progress)
            if fitted is not None or complete:
                break
        if fitted is None:
            break
        found = fitted
    if found is None:
        raise ValueError(f'mission {mission.name}: no expansion settles; use another method')
    return found


def _points(mission: Mission, clusters: Clusters, points: int) -> int:
    share = X_VALUES**mission.k // SHARE
    least = share if share <= POINTS[-1] * clusters.features else LEAST
    return max(points * clusters.features, least)


def _fit(
    reduced: ReducedMission,
    clusters: Clusters,
    x: IntArray,
    start: Expansion | None,
    tolerance: float,
    max_iterations: int,
    progress: Progress,
) -> Expansion | None:
    """Fit in the design points x, from another expansion; None where that runs away."""
    mission, basis = reduced.sub.mission, Basis(reduced, clusters)
    dtype = np.dtype(np.float32)
    theta: RealArray = np.zeros((reduced.q, 3, 8, basis.size), dtype)
    iterations = 0
    if start is not None:
        theta = basis.embed(start.theta, Basis(reduced, start.clusters))
        iterations = start.iterations
    backup, fit = DesignBackup(basis, x, dtype), LeastSquares(basis, x, dtype)
    present: RealArray = theta @ fit.now
    last, first = iterations + max_iterations, 0.0
    while True:
        values = backup(theta)
        change = values - present
        bounds = SpanBounds(float(change.min()), float(change.max()), mission.discount)
        relative = bounds.span / max(float(np.abs(values).max()), TINY)
        iterations += 1
        first = first or relative
        converged = relative <= tolerance
        done = share_of_decades(first, relative, tolerance)
        text = f'{basis.size} features, sweep {iterations}, change {relative:.1e}'
        progress(Report(iterations, done, text))
        if not converged and not relative <= RUNAWAY * first:
            return None
        shift = dtype.type(bounds.middle)
        theta = fit(values)
        theta[..., 0] += shift
        present = values + shift
        if converged or iterations == last:
            return Expansion(mission, clusters, theta, len(x), iterations, bounds.span, converged)


def design(mission: Mission, points: int) -> IntArray:
    """Design points x (M, k): all where they are few, else drawn by their likelihood.

    Goals are drawn for in an order of their own, so that relabelling them changes nothing.
    """
    k = mission.k
    if X_VALUES**k <= WHOLE:
        return np.indices((X_VALUES,) * k).reshape(k, -1).T
    rng = np.random.default_rng(points)
    drawn = rng.choice(6, (2 * points, k), p=LIKELIHOOD)
    chosen = rng.permutation(np.unique(drawn, axis=0))[:points]
    x = np.empty_like(chosen)
    x[:, goal_order(mission)] = chosen
    return x


class LeastSquares:
    """Fits coefficients to values in the design points, all weighted alike or by likelihood.

    Parameters
    ----------
    basis : Basis
    x : int array (M, k)
    dtype : numpy type

    Attributes
    ----------
    now : float array (P, M)
        The features in the design points.
    """

    def __init__(self, basis: Basis, x: IntArray, dtype: DTypeLike) -> None:
        size = basis.size
        self.now = np.empty((size, len(x)), dtype)
        complete = len(x) == X_VALUES ** x.shape[1]
        weights = LIKELIHOOD[x].prod(axis=1) if complete else np.full(len(x), 1 / len(x))
        self.weights = weights.astype(dtype)
        for start in range(0, len(x), SUMMED_POINTS):
            part = slice(start, start + SUMMED_POINTS)
            self.now[:, part] = basis.now(x[part], dtype)
        self._panels = [slice(start, start + PANEL) for start in range(0, size, PANEL)]
        gram = np.zeros((size, size))
        self._share(lambda panel: self._add_products(gram, panel))
        gram[np.diag_indices_from(gram)] += RIDGE
        factor, _ = lapack.dpotrf(gram, lower=True, overwrite_a=True)
        inverse, _ = lapack.dpotri(factor, lower=True, overwrite_c=True)
        self.inverse = (np.tril(inverse) + np.tril(inverse, -1).T).astype(dtype)

    def __call__(self, values: RealArray) -> RealArray:
        """Coefficients (..., P) for values (..., M)."""
        flat = values.reshape(-1, values.shape[-1])
        weighted = flat * self.weights
        moments, out = np.empty((2, len(flat), len(self.now)), values.dtype)

        def project(panel: slice) -> None:
            np.matmul(weighted, self.now[panel].T, out=moments[:, panel])

        def solve(panel: slice) -> None:
            np.matmul(moments, self.inverse[:, panel], out=out[:, panel])

        self._share(project)
        self._share(solve)
        return out.reshape(*values.shape[:-1], -1)

    def _add_products(self, gram: FloatArray, panel: slice) -> None:
        """Inner products of some features with those up to them, summed in double precision."""
        for start in range(0, self.now.shape[1], SUMMED_POINTS):
            part = slice(start, start + SUMMED_POINTS)
            left = self.now[panel, part] * self.weights[part]
            gram[panel, : panel.stop] += left @ self.now[: panel.stop, part].T

    def _share(self, work: Callable[[slice], None]) -> None:
        threads.share(lambda _, panel: work(panel), self._panels, threads.processors())
