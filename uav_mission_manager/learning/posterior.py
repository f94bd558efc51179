"""What is believed of probabilities, rates and means after a count, and how sure that is.

The prior is what the mission file says, and has a weight w in counts:

    probabilities p of a row    Dirichlet(W p0 + n)            W = w / (1 - largest p0)
    a rate lambda               Gamma(W lambda0 + n, W + T)    W = w / lambda0
    a mean mu                   (w mu0 + sum x) / (w + N)

with n counts of each, T the time in which n events came, and N samples x. The estimate is the mean
of that. So w is how many events the file is worth, be they rare or frequent: a failure in 100
hours is not forgotten after 5 hours without one. Where the file's number is outside of the
interval, the file is contradicted: it is then worth w epochs only.

The interval is of the count alone, so that a wrong file does not take it along. It holds whatever
one count more would make of it, of this event or of another (Walley 1996); that is Clopper and
Pearson's interval of a probability, and Garwood's of a rate, which hold the true value at least as
often as they say. What was never seen may be impossible, and what happened each time certain. It
is widened where the estimate lies outside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.arrays import FloatArray

LEVEL = 0.9
"""Probability with which an interval holds the true value."""

LEVEL_TEXT = f'{100 * LEVEL:g} %'
"""The same for people."""

TAIL_BELOW, TAIL_ABOVE = (1 - LEVEL) / 2, (1 + LEVEL) / 2
"""Probability below its bounds."""

ONE_MORE = 1.0
"""Counts that may be of the event, or not, in an interval."""


IMPOSSIBLE = 1e-12
"""Probability and rate below which an event counts as impossible in the file."""


class Posterior(NamedTuple):
    """An estimate, and the bounds of its interval."""

    value: float
    low: float
    high: float


def row_posterior(prior: Sequence[float], counts: ArrayLike, weight: float) -> list[Posterior]:
    """Return what is believed of each probability of a row that sums to 1.

    Parameters
    ----------
    prior : sequence of float
        The file's row.
    counts : array
        How often each was seen, not all of them 0.
    weight : float
        Counts that the prior is worth, above 0.
    """
    seen, known = np.asarray(counts, float), np.asarray(prior, float)
    rest = seen.sum() - seen
    low = np.where(seen > 0, scipy.special.betaincinv(seen, rest + ONE_MORE, TAIL_BELOW), 0)
    high = np.where(rest > 0, scipy.special.betaincinv(seen + ONE_MORE, rest, TAIL_ABOVE), 1)
    agrees = bool(((low <= known) & (known <= high)).all())
    epochs = weight / max(1 - float(known.max()), IMPOSSIBLE) if agrees else weight
    values = epochs * known + seen
    return [_around(*numbers) for numbers in zip(values / values.sum(), low, high)]


def probability_posterior(prior: float, yes: float, no: float, weight: float) -> Posterior:
    """Return what is believed of one probability."""
    return row_posterior((prior, 1 - prior), (yes, no), weight)[0]


def rate_posterior(prior: float, events: float, epochs: float, weight: float) -> Posterior:
    """Return what is believed of a rate per epoch."""
    low = scipy.special.gammaincinv(events, TAIL_BELOW) / epochs if events else 0.0
    high = scipy.special.gammaincinv(events + ONE_MORE, TAIL_ABOVE) / epochs
    worth = weight / max(prior, IMPOSSIBLE) if low <= prior <= high else weight
    return _around((worth * prior + events) / (worth + epochs), low, high)


def mean_posterior(prior: float, samples: FloatArray, weight: float) -> Posterior:
    """Return what is believed of a mean, of at least two samples."""
    n = len(samples)
    value = float((weight * prior + samples.sum()) / (weight + n))
    reach = scipy.special.stdtrit(n - 1, TAIL_ABOVE) * samples.std(ddof=1) / math.sqrt(n)
    return _around(value, value - reach, value + reach)


def _around(value: float, low: float, high: float) -> Posterior:
    return Posterior(float(value), float(min(value, low)), float(max(value, high)))
