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

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from uav_mission_manager.mdp.arrays import IntArray, RealArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver import memory, threads
from uav_mission_manager.solver.expansion.basis import Basis, Clusters
from uav_mission_manager.solver.expansion.design import (
    POINTS_A_FEATURE,
    design,
    design_size,
    is_complete,
)
from uav_mission_manager.solver.expansion.design_backup import BLOCK_POINTS, DesignBackup
from uav_mission_manager.solver.expansion.extrapolation import (
    REMEMBERED_SWEEPS,
    SMALLEST_SINGLE,
    Extrapolation,
)
from uav_mission_manager.solver.expansion.least_squares import LeastSquares
from uav_mission_manager.solver.progress import Progress, Report, ignore, share_of_decades
from uav_mission_manager.solver.reduced import X_VALUES, ReducedMission, goal_order
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import whole_mission

FIT_TOLERANCE = {True: 2e-3, False: 1e-2}
"""Largest step that sweeps may still be away from their limit, relative to the largest W, at which
a fit in all design points or in drawn ones ends. Measured: ten times as much in all points doubles
the losses of random missions; with six goals in drawn points the largest loss is 1.4 % with 6e-2
and 0.8 % with 4e-3."""

RUNAWAY = 3.0
"""Spread of a change, relative to the first, that says that a fit does not settle."""

FIRST_FEATURES = 256
"""Features of a first fit, at most. What it has found is where the whole one starts from, whose
sweeps are long."""

STALLED_SWEEPS = 50
"""Sweeps without a smaller change than ever before after which a fit does not settle any more."""

FIRST_SHARE = 0.1
"""Estimated part of the work that the first fit is."""

NOT_YET_DONE = 0.99
"""Most of the work that is reported as done before it is finished."""

FRESH_POINTS = 1024
"""Points that are drawn anew to look at a fit where it was not made."""

TRUSTED_RESIDUAL = 1.0
"""`Expansion.fresh_residual` above which a fit says nothing for certain about V*, not even that it
is above 0. Such a fit is tried once more, in more points."""

SINGLE_PRECISION_COSTS = 1e4
"""Largest cost of a mission over the least, up to which single precision tells both apart in W."""

SINGLE_PRECISION_CHANGE = 1e-5
"""Change of a sweep, relative to the largest W, that single precision can tell from rounding."""

SINGLE_PRECISION_SCALE = 1e25
"""Costs above this, and below its inverse, leave the range of single precision in a fit."""


@dataclass(frozen=True)
class Expansion:
    """The fitted expansion.

    Attributes
    ----------
    mission : Mission
    clusters : Clusters
    theta : float array (q, T, 8, P)
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
        where they are few). Losses are mostly far smaller: of 32 measured fits of two to four
        goals, those below 0.3 lost up to 0.8 % anywhere, but for one that lost 16 % at 0.17;
        those above 1 lost up to 55 %.
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
                f'bounds on the optimum from the fit are {self.fresh_residual:.2g} of it apart: '
                f'a higher order or the exact solution is closer'
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
        Largest distance from the limit to stop at, relative to the largest W; see
        `FIT_TOLERANCE`.
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
            f'mission {mission.name}: a fit of {clusters.features:,} features needs '
            f'{memory.size_text(needed)} of memory, {free} are free: use a lower order'
        )
    if tolerance is None:
        tolerance = FIT_TOLERANCE[is_complete(mission)]
    fit = _Fit(ReducedMission(whole_mission(mission)), tolerance, max_iterations, progress)
    with threads.single_threaded_blas():
        found = fit(clusters.within(FIRST_FEATURES), None, math.inf)
        if found is not None and found.clusters != clusters:
            found = fit(clusters, found, TRUSTED_RESIDUAL) or found
    if found is None:
        raise ValueError(f'mission {mission.name}: no expansion settles; use another method')
    progress(Report(found.iterations, 1.0, f'{found.clusters.features} features fitted'))
    return found


def fit_bytes(
    mission: Mission, clusters: Clusters, points_a_feature: int = POINTS_A_FEATURE[0]
) -> int:
    """Memory that a fit takes, in bytes: measured, within a tenth."""
    size, q, k = clusters.features, mission.grid.q, mission.k
    reduced = ReducedMission(whole_mission(mission))
    points = design_size(mission, clusters, points_a_feature)
    # Of each feature now and after each of four regimes, and of those that look at a goal what
    # they gain where it is completed, in two modes, if commitment is allowed.
    committed = float(reduced.sub.feasibility.by_goal.mean())
    of_goals = sum(g.n * g.size * len(g.clusters) for g in clusters.groups)
    features = (5 * size + int(2 * committed * of_goals)) * points
    # Least costs of the arrivals from a cell: regimes and directions, and completions.
    costs = 8 * points * (q * min(2 * k + 4, 12) + 2 * k)
    levels = 8 * reduced.sub.threats
    # T W now and in the remembered sweeps with their fits, and as much while it is computed.
    values = levels * q * points * (3 + 2 * (REMEMBERED_SWEEPS + 1))
    scratch = levels * (2 * q + 3) * BLOCK_POINTS * threads.processors()
    coefficients = levels * q * size * (8 + 3 * (REMEMBERED_SWEEPS + 1))
    numbers = features + costs + values + scratch + coefficients
    return precision(reduced).itemsize * numbers * 21 // 20 + 24 * size**2


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


class _Fit:
    """Fits of one mission.

    Parameters
    ----------
    reduced : ReducedMission
    tolerance, max_iterations, progress
        See `fit_expansion`.
    """

    def __init__(
        self, reduced: ReducedMission, tolerance: float, max_iterations: int, progress: Progress
    ) -> None:
        self.reduced, self.mission = reduced, reduced.sub.mission
        self.max_iterations, self.progress, self.done = max_iterations, progress, 0.0
        # Bounds are so much further apart than the change; less than the change would not do.
        gain = max(SpanBounds(0.0, 0.0, self.mission.discount).gain, 1.0)
        self.change = tolerance / gain
        fine = self.change < SINGLE_PRECISION_CHANGE
        self.dtype = np.dtype(np.float64) if fine else precision(reduced)

    def __call__(
        self, clusters: Clusters, found: Expansion | None, trusted: float
    ) -> Expansion | None:
        """Fit from another expansion; once more where it does not settle or is not trusted.

        Returns None where it runs away in any number of points.
        """
        best = None
        for points in POINTS_A_FEATURE:
            # Only here what comes out may depend on how much memory there is.
            if best is not None and not memory.fits(fit_bytes(self.mission, clusters, points)):
                break
            x = design(self.mission, design_size(self.mission, clusters, points))
            fitted = self.in_points(clusters, x, best or found)
            if best is not None:
                fits = [best] if fitted is None else [best, fitted]
                return min(fits, key=lambda fit: (not fit.converged, fit.fresh_residual))
            best = fitted
            if is_complete(self.mission) or (best is not None and self._is_final(best, trusted)):
                break
        return best

    def _is_final(self, fitted: Expansion, trusted: float) -> bool:
        """Whether it is trusted, or all sweeps are spent."""
        spent = fitted.iterations >= self.max_iterations
        return spent or (fitted.converged and fitted.fresh_residual <= trusted)

    def in_points(
        self, clusters: Clusters, x: IntArray, start: Expansion | None
    ) -> Expansion | None:
        """Fit in the design points x, from another expansion; None where that runs away."""
        basis = Basis(self.reduced, clusters)
        axes = self.reduced.q, self.reduced.sub.threats, 8, basis.size
        theta: RealArray = np.zeros(axes, self.dtype)
        iterations = 0
        if start is not None:
            theta = basis.embed(start.theta, Basis(self.reduced, start.clusters))
            iterations = start.iterations
        backup = DesignBackup(basis, x, self.dtype)
        fit = LeastSquares(basis, x, self.dtype)
        present: RealArray = theta @ fit.now
        changes, steps = list[float](), Extrapolation()
        while True:
            values = backup(theta)
            bounds, change = _bounds(self.mission, values, present)
            iterations += 1
            changes.append(change)
            self._report(iterations, basis.size, start is None, changes)
            converged = change <= self.change
            if not converged and not change <= RUNAWAY * changes[0]:
                return None
            fitted = fit(values)
            fitted[..., 0] += self.dtype.type(bounds.middle)
            stalled = min(changes) < min(changes[-STALLED_SWEEPS:])
            if converged or stalled or iterations >= self.max_iterations:
                break
            values += self.dtype.type(bounds.middle)
            theta, present = steps(theta, fitted, values)
        residual = _fresh_residual(basis, fitted, backup, x)
        return Expansion(
            self.mission, clusters, fitted, len(x), iterations, bounds.span, converged, residual
        )

    def _report(self, step: int, features: int, first: bool, changes: list[float]) -> None:
        share = share_of_decades(changes[0], changes[-1], self.change)
        done = FIRST_SHARE * share if first else FIRST_SHARE + (1 - FIRST_SHARE) * share
        self.done = max(self.done, min(done, NOT_YET_DONE))
        text = f'{features} features, sweep {step}, change {changes[-1]:.1e}'
        self.progress(Report(step, self.done, text))


def _bounds(mission: Mission, values: RealArray, present: RealArray) -> tuple[SpanBounds, float]:
    """Bounds from a backup, and their span relative to the largest value."""
    change = values - present
    bounds = SpanBounds(float(change.min()), float(change.max()), mission.discount)
    return bounds, bounds.span / max(float(np.abs(values).max()), SMALLEST_SINGLE)


def _fresh_residual(basis: Basis, theta: RealArray, backup: DesignBackup, x: IntArray) -> float:
    """See `Expansion.fresh_residual`."""
    mission = basis.reduced.sub.mission
    if not is_complete(mission):
        rng = np.random.default_rng(len(x))
        x = np.empty((FRESH_POINTS, mission.k), np.int64)
        x[:, goal_order(mission)] = rng.integers(0, X_VALUES, x.shape)
        backup = DesignBackup(basis, x, theta.dtype)
    values, present = backup(theta), theta @ basis.now(x, theta.dtype)
    bounds, relative = _bounds(mission, values, present)
    return bounds.gain * relative
