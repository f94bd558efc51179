"""Confidence intervals at 95 % of what independent episodes show.

- A probability: Clopper and Pearson's interval, which holds at least as often as it says.
- A mean: Student's.
- A median: order statistics. The k-th smallest of n samples is above the median only where fewer
  than k are below it, and how many are is binomial.
- The difference of two probabilities, of pairs: Wald's interval with half an episode more in each
  cell of the 2x2 table (Agresti and Min 2005), so that no difference in n pairs is not taken for
  none at all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import BoolArray, FloatArray

CONFIDENCE = 0.95
"""Probability with which an interval holds what it is about."""

TAIL = (1 - CONFIDENCE) / 2
"""Probability on either side."""


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval; infinite where it is beyond what was simulated."""

    value: float
    low: float
    high: float


def proportion(happened: BoolArray) -> Interval:
    """Probability of what happened in some of N episodes."""
    return proportion_of(int(happened.sum()), len(happened))


def proportion_of(count: int, n: int) -> Interval:
    """Probability of what happened in so many of n episodes."""
    found = scipy.stats.binomtest(count, n).proportion_ci(CONFIDENCE, method='exact')
    return Interval(count / n, float(found.low), float(found.high))


def proportion_difference(first: BoolArray, second: BoolArray) -> Interval:
    """Probability of the second less that of the first, of N pairs of episodes."""
    gained, lost = int((second & ~first).sum()), int((first & ~second).sum())
    n = len(first) + 2
    centre, discordant = (gained - lost) / n, (gained + lost + 1) / n
    reach = float(scipy.special.ndtri(1 - TAIL)) * math.sqrt((discordant - centre**2) / n)
    value = (gained - lost) / len(first)
    return Interval(value, max(centre - reach, -1.0), min(centre + reach, 1.0))


def mean(samples: ArrayLike) -> Interval:
    """Mean of N samples, N at least 2."""
    values: FloatArray = np.asarray(samples, np.float64)
    error = values.std(ddof=1) / math.sqrt(len(values))
    reach = float(scipy.special.stdtrit(len(values) - 1, 1 - TAIL)) * error
    value = float(values.mean())
    return Interval(value, value - reach, value + reach)


def median(samples: ArrayLike) -> Interval:
    """Median of N samples, some of which may be infinite; of less than 6 the bounds are too."""
    values, n = np.sort(np.asarray(samples, np.float64)), len(np.asarray(samples))
    rank = int(scipy.stats.binom.ppf(TAIL, n, 0.5))  # P(fewer than `rank` are below) < TAIL.
    bounds = (values[rank - 1], values[n - rank]) if rank else (-math.inf, math.inf)
    return Interval(float(np.median(values)), float(bounds[0]), float(bounds[1]))
