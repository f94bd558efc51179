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
with more of them, and given up for a smaller one. `Expansion.converged` says whether it settled,
`Expansion.fresh_residual` how far it is from its own backup where it was not fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver import memory, threads
from uav_mission_manager.solver.expansion.basis import LIKELIHOOD, Basis, Clusters
from uav_mission_manager.solver.expansion.design_backup import BLOCK_POINTS, DesignBackup
from uav_mission_manager.solver.expansion.least_squares import LeastSquares
from uav_mission_manager.solver.progress import Progress, Report, ignore, share_of_decades
from uav_mission_manager.solver.reduced import X_VALUES, ReducedMission, goal_order
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import whole_mission

COMPLETE_DESIGN = 1 << 13
"""Most points of a design that holds all x."""

FIT_TOLERANCE = {True: 1e-4, False: 5e-4}
"""Spread of the last change, relative to the largest W, at which a fit in all design points or in
drawn ones ends. Measured: with 1e-3 in all points the losses of random missions double; with six
goals in drawn points the largest loss is 1.4 % with 3e-3 and 0.8 % with 2e-4."""

POINTS_A_FEATURE = (4, 8, 16)
"""Design points a feature, where they are drawn: as many as it takes to settle."""

LEAST_POINTS = 2048
"""Least number of points of a drawn design."""

DRAWN_SHARE = 3
"""A design holds one in so many of all x, where those are no more than the most a feature."""

RUNAWAY = 3.0
"""Spread of a change, relative to the first, that says that a fit does not settle."""

FIRST_FEATURES = 256
"""Features of a first fit, at most. What it has found is where the whole one starts from, whose
sweeps are long."""

FRESH_POINTS = 1024
"""Points that are drawn anew to look at a fit where it was not made."""

TRUSTED_RESIDUAL = 0.6
"""`Expansion.fresh_residual` up to which an expansion counts as close to V*."""

SINGLE_PRECISION_COSTS = 1e4
"""Largest cost of a mission over the least, up to which single precision tells both apart in W."""

SINGLE_PRECISION_SCALE = 1e25
"""Costs above this, and below its inverse, leave the range of single precision in a fit."""

REMEMBERED_SWEEPS = 2
"""Earlier sweeps that a step is extrapolated from. Measured: two save 25 to 45 % of all sweeps,
four hardly more."""

TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Expansion:
    """The fitted expansion.

    Attributes
    ----------
    mission : Mission
    clusters : Clusters
    theta : float array (q, 3, 8, P)
        Coefficients over cell, t, f and feature; float64 where the costs need it, else float32.
    points : int
        Design points.
    iterations : int
        Sweeps.
    spread : float
        Spread of the last change over all design points.
    converged : bool
        Whether that met the tolerance.
    fresh_residual : float
        How far apart the bounds on V* are that `uav_mission_manager.solver.span_bounds` gives for
        W, relative to the largest W, as far as points tell that the fit has not seen (all x
        where they are few). Policies of less than 0.3 lost 0.02 % on average in measured
        missions, those of more than 1 up to 37 %.
    """

    mission: Mission
    clusters: Clusters
    theta: RealArray
    points: int
    iterations: int
    spread: float
    converged: bool
    fresh_residual: float = float('nan')

    @property
    def warning(self) -> str:
        """Why the expansion may be far from V*, for people; empty where nothing says so."""
        if not self.converged:
            return f'the fit has not settled after {self.iterations} sweeps'
        if self.fresh_residual > TRUSTED_RESIDUAL:
            return (
                f'the fit leaves a residual of {self.fresh_residual:.2g} where it was not made '
                f'(trusted: {TRUSTED_RESIDUAL}); a higher order or exact solution is closer'
            )
        return ''


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
    MissionSizeError
        If the memory does not suffice.
    """
    needed = fit_bytes(mission, clusters)
    if not memory.fits(needed):
        free = memory.size_text(memory.available_bytes())
        raise memory.MissionSizeError(
            f'mission {mission.name}: a fit of {clusters.features} features needs '
            f'{memory.size_text(needed)} of memory, {free} are free: use a lower order'
        )
    complete = _is_complete(mission)
    if tolerance is None:
        tolerance = FIT_TOLERANCE[complete]
    reduced, found = ReducedMission(whole_mission(mission)), None
    for part in dict.fromkeys((clusters.within(FIRST_FEATURES), clusters)):
        for points in POINTS_A_FEATURE:
            x = design(mission, _points(mission, part, points))
            with threads.single_threaded_blas():
                fitted = _fit(reduced, part, x, found, tolerance, max_iterations, progress)
            if fitted is not None or complete:
                break
        if fitted is None:
            break
        found = fitted
    if found is None:
        raise ValueError(f'mission {mission.name}: no expansion settles; use another method')
    return found


def fit_bytes(mission: Mission, clusters: Clusters) -> int:
    """Memory that a fit takes at most, as long as it settles in the fewest design points."""
    size, q, k = clusters.features, mission.grid.q, mission.k
    reduced = ReducedMission(whole_mission(mission))
    points = min(_points(mission, clusters, POINTS_A_FEATURE[0]), X_VALUES**k)
    # Of each feature now and after each of four regimes, and of those that look at a goal what
    # they gain where it is completed, in two modes, if commitment is allowed.
    committed = float(reduced.sub.feasibility.by_goal.mean())
    of_goals = sum(g.n * g.size * len(g.clusters) for g in clusters.groups)
    features = (5 * size + int(2 * committed * of_goals)) * points
    # Least costs of the arrivals from a cell: eight regimes and directions, and completions.
    costs = 8 * points * (q * min(2 * k + 4, 12) + 2 * k)
    # T W now and in the remembered sweeps with their fits, and as much while it is computed.
    values = 24 * q * points * (3 + 2 * (REMEMBERED_SWEEPS + 1))
    scratch = 24 * (2 * q + 3) * BLOCK_POINTS * threads.processors()
    coefficients = 24 * q * size * (8 + 3 * (REMEMBERED_SWEEPS + 1))
    return (
        precision(reduced).itemsize * (features + costs + values + scratch + coefficients)
        + 24 * size**2
    )


def precision(reduced: ReducedMission) -> np.dtype[np.floating[Any]]:
    """Single precision where all costs of the mission matter in it, else double."""
    parts = reduced.goal_costs, reduced.fault_costs, reduced.travel, reduced.sub.threat_costs
    costs = np.abs(np.concatenate([part.ravel() for part in parts]))
    costs = costs[costs > 0]
    if not costs.size:
        return np.dtype(np.float32)
    low, high = costs.min(), costs.max()
    single = high <= SINGLE_PRECISION_COSTS * low and high < SINGLE_PRECISION_SCALE
    return np.dtype(np.float32 if single and high > 1 / SINGLE_PRECISION_SCALE else np.float64)


def _is_complete(mission: Mission) -> bool:
    """Whether the design holds all x."""
    return X_VALUES**mission.k <= COMPLETE_DESIGN


def _points(mission: Mission, clusters: Clusters, points: int) -> int:
    if _is_complete(mission):
        return int(X_VALUES**mission.k)
    share = X_VALUES**mission.k // DRAWN_SHARE
    least = share if share <= POINTS_A_FEATURE[-1] * clusters.features else LEAST_POINTS
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
    mission, basis, dtype = reduced.sub.mission, Basis(reduced, clusters), precision(reduced)
    theta: RealArray = np.zeros((reduced.q, 3, 8, basis.size), dtype)
    iterations = 0
    if start is not None:
        theta = basis.embed(start.theta, Basis(reduced, start.clusters))
        iterations = start.iterations
    backup, fit = DesignBackup(basis, x, dtype), LeastSquares(basis, x, dtype)
    present: RealArray = theta @ fit.now
    last, first, steps = iterations + max_iterations, 0.0, _Extrapolation()
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
        fitted = fit(values)
        fitted[..., 0] += shift
        if converged or iterations == last:
            residual = _fresh_residual(basis, fitted, backup, x)
            return Expansion(
                mission, clusters, fitted, len(x), iterations, bounds.span, converged, residual
            )
        theta, present = steps(theta, fitted, values + shift)


class _Extrapolation:
    """Steps towards a fixed point from the last ones, after Anderson (1965).

    Of all averages of the last sweeps' results, weights adding up to 1, the one whose change
    would be least if changes were linear. A change by a constant does not count.
    """

    def __init__(self) -> None:
        self._changes: list[FloatArray] = []
        self._results: list[tuple[RealArray, RealArray]] = []

    def __call__(
        self, theta: RealArray, fitted: RealArray, values: RealArray
    ) -> tuple[RealArray, RealArray]:
        """Next theta and its values, from theta, and what a sweep has made of it."""
        change = (fitted - theta).astype(np.float64)
        change[..., 0] -= change[..., 0].mean()
        self._changes = [*self._changes[-REMEMBERED_SWEEPS:], change.ravel()]
        self._results = [*self._results[-REMEMBERED_SWEEPS:], (fitted, values)]
        weights = self._weights(np.array(self._changes)).astype(theta.dtype)
        averages = [
            sum(weight * result[part] for weight, result in zip(weights, self._results))
            for part in (0, 1)
        ]
        return averages[0], averages[1]

    @staticmethod
    def _weights(changes: FloatArray) -> FloatArray:
        weights = np.zeros(len(changes))
        weights[-1] = 1.0
        if len(changes) > 1:
            steps = np.diff(changes, axis=0)
            products = steps @ steps.T
            # Nearly parallel steps would be given large weights.
            products[np.diag_indices_from(products)] += 1e-10 * np.trace(products) + TINY
            shares = np.linalg.solve(products, steps @ changes[-1])
            weights[1:] -= shares
            weights[:-1] += shares
        return weights


def _fresh_residual(basis: Basis, theta: RealArray, backup: DesignBackup, x: IntArray) -> float:
    """See `Expansion.fresh_residual`."""
    mission = basis.reduced.sub.mission
    if not _is_complete(mission):
        rng = np.random.default_rng(len(x))
        x = np.empty((FRESH_POINTS, mission.k), np.int64)
        x[:, goal_order(mission)] = rng.integers(0, X_VALUES, x.shape)
        backup = DesignBackup(basis, x, theta.dtype)
    values = backup(theta)
    change = values - theta @ basis.now(x, theta.dtype)
    bounds = SpanBounds(float(change.min()), float(change.max()), mission.discount)
    return bounds.gain * bounds.span / max(float(np.abs(values).max()), TINY)


def design(mission: Mission, points: int) -> IntArray:
    """Design points x (M, k): all where they are few, else drawn by their likelihood.

    Goals are drawn for in an order of their own, so that relabelling them changes nothing.
    """
    k = mission.k
    if _is_complete(mission):
        return np.indices((X_VALUES,) * k).reshape(k, -1).T
    rng = np.random.default_rng(points)
    drawn = rng.choice(6, (2 * points, k), p=LIKELIHOOD)
    chosen = rng.permutation(np.unique(drawn, axis=0))[:points]
    x = np.empty_like(chosen)
    x[:, goal_order(mission)] = chosen
    return x
