"""Weighted least squares in the design points, its matrix products shared among threads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import DTypeLike

from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.solver import threads
from uav_mission_manager.solver.expansion.basis import Basis, likelihood

SUMMED_POINTS = 2048
"""Design points over which inner products are summed up in single precision, and not more."""

PANEL_FEATURES = 512
"""Features that a thread works on at a time."""

RIDGE = 1e-9
"""Added to the diagonal of the inner products: keeps a design without some pair of x_j from
blowing up."""


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
        values = basis.reduced.x_values
        complete = len(x) == values ** x.shape[1]
        weights = likelihood(values)[x].prod(axis=1) if complete else np.full(len(x), 1 / len(x))
        self.weights = weights.astype(dtype)
        for start in range(0, len(x), SUMMED_POINTS):
            part = slice(start, start + SUMMED_POINTS)
            self.now[:, part] = basis.now(x[part], dtype)
        self._panels = [
            slice(start, start + PANEL_FEATURES) for start in range(0, size, PANEL_FEATURES)
        ]
        gram = np.zeros((size, size))
        self._share(lambda panel: self._add_products(gram, panel))
        gram[np.diag_indices_from(gram)] += RIDGE
        factor, _ = scipy.linalg.lapack.dpotrf(gram, lower=True, overwrite_a=True)
        inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=True, overwrite_c=True)
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
