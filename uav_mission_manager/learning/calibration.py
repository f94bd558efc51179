"""Polynomials of what was measured at reduced effectiveness of a part.

As in the paper's section 3.4: faults are introduced at several levels of effectiveness of a part,
and a polynomial says how the performance depends on it. Fitted by least squares,

    y = c_0 + c_1 e + .. + c_d e^d,     e the effectiveness, 0 to 1.

Its error is told in three ways: the residual's standard deviation; that of what each measurement
differs by from a fit of all others, r_i / (1 - h_i) with h_i its leverage; and Student's interval
of the mean at a place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from uav_mission_manager.learning.posterior import TAIL_ABOVE, Posterior
from uav_mission_manager.mdp.arrays import FloatArray

WHOLE = 100.0
"""An effectiveness of 1."""

LEVERAGE_OF_ITS_OWN = 1 - 1e-9
"""Leverage from which on the others say nothing of a measurement."""


class Measurement(NamedTuple):
    """One measurement: at which effectiveness [%] of a part, of what, and how much."""

    part: str
    effectiveness: float
    quantity: str
    value: float


@dataclass(frozen=True)
class PolynomialFit:
    """A polynomial of one quantity of one part.

    Attributes
    ----------
    part, quantity : str
    at, values : float array (n,)
        What was measured: effectiveness [%] and value.
    coefficients : float array (degree + 1,)
        c_0 first.
    residual, leave_one_out : float
        In the quantity's unit; NaN where there are too few measurements to tell.
    """

    part: str
    quantity: str
    at: FloatArray
    values: FloatArray
    coefficients: FloatArray
    residual: float
    leave_one_out: float

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return len(self.coefficients) - 1

    def extrapolates(self, effectiveness: float) -> bool:
        """Whether an effectiveness [%] is beyond what was measured."""
        return not self.at.min() <= effectiveness <= self.at.max()

    def __call__(self, effectiveness: float) -> Posterior:
        """Return the mean at an effectiveness [%], with its interval; NaN where it has none."""
        design = _powers(self.at, self.degree)
        row = _powers(np.array([effectiveness]), self.degree)[0]
        value, free = float(row @ self.coefficients), len(self.at) - self.degree - 1
        if not free:
            return Posterior(value, math.nan, math.nan)
        spread = float(row @ np.linalg.inv(design.T @ design) @ row)
        reach = scipy.special.stdtrit(free, TAIL_ABOVE) * self.residual * math.sqrt(spread)
        return Posterior(value, value - reach, value + reach)


def fit_polynomial(measurements: Sequence[Measurement], degree: int) -> PolynomialFit:
    """Fit the measurements of one quantity of one part.

    Raises
    ------
    ValueError
        If there are not more levels of effectiveness than the degree.
    """
    part, quantity = measurements[0].part, measurements[0].quantity
    at = np.array([m.effectiveness for m in measurements])
    values = np.array([m.value for m in measurements])
    if (levels := len(np.unique(at))) <= degree:
        raise ValueError(
            f'{part}: {quantity}: {levels} levels of effectiveness carry no polynomial of '
            f'degree {degree}'
        )
    design = _powers(at, degree)
    orthogonal, upper = np.linalg.qr(design)
    coefficients = scipy.linalg.solve_triangular(upper, orthogonal.T @ values)
    residuals, leverage = values - design @ coefficients, (orthogonal**2).sum(axis=1)
    free = len(at) - degree - 1
    alone = (leverage > LEVERAGE_OF_ITS_OWN).any()
    left_out = math.nan if alone else math.sqrt(np.mean((residuals / (1 - leverage)) ** 2))
    return PolynomialFit(
        part=part,
        quantity=quantity,
        at=at,
        values=values,
        coefficients=coefficients,
        residual=math.sqrt(residuals @ residuals / free) if free else math.nan,
        leave_one_out=left_out,
    )


def _powers(effectiveness: FloatArray, degree: int) -> FloatArray:
    return np.vander(effectiveness / WHOLE, degree + 1, increasing=True)
