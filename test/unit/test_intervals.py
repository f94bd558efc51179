"""Confidence intervals against definitions, enumeration and SciPy's own tests."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from uav_mission_manager.solver.evaluation.intervals import (
    mean,
    median,
    proportion,
    proportion_difference,
)


def outcomes(*counts):
    """Truth values, so many true and false of them."""
    return np.repeat([True, False], counts)


def binomial(n, k, p):
    return math.comb(n, k) * p**k * (1 - p) ** (n - k)


@pytest.mark.parametrize(('count', 'n'), [(3, 10), (40, 200), (199, 200)])
def test_bounds_of_a_probability_are_those_at_which_the_tails_are_2_5_percent(count, n):
    found = proportion(outcomes(count, n - count))
    assert found.value == count / n
    above = sum(binomial(n, k, found.low) for k in range(count, n + 1))
    below = sum(binomial(n, k, found.high) for k in range(count + 1))
    assert (above, below) == pytest.approx((0.025, 0.025), rel=1e-6)


def test_what_never_or_always_happened():
    never, always = proportion(outcomes(0, 50)), proportion(outcomes(50, 0))
    assert (never.value, never.low, always.value, always.high) == (0, 0, 1, 1)
    assert never.high == pytest.approx(1 - 0.025 ** (1 / 50))
    assert always.low == pytest.approx(0.025 ** (1 / 50))


def test_mean_is_students():
    samples = np.random.default_rng(0).exponential(3.0, 12)
    found, expected = mean(samples), stats.ttest_1samp(samples, 0.0).confidence_interval(0.95)
    assert found.value == pytest.approx(np.mean(samples))
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


@pytest.mark.parametrize('n', [6, 11, 100, 1001])
def test_bounds_of_a_median_are_the_tightest_order_statistics(n):
    """The k-th of n is above the median only where fewer than k are below."""
    found = median(np.random.default_rng(n).permutation(n) + 1)  # The k-th smallest is k.
    rank = int(found.low)
    assert found.high == n + 1 - rank
    assert found.value == (n + 1) / 2
    tails = [sum(math.comb(n, k) for k in range(r)) / 2**n for r in (rank, rank + 1)]
    assert tails[0] < 0.025 <= tails[1]


def test_median_of_what_is_not_over():
    assert median([*[1.0] * 30, *[math.inf] * 70]).value == math.inf
    found = median([*range(55), *[math.inf] * 45])
    assert (found.value, found.high) == (49.5, math.inf)
    assert math.isfinite(found.low)
    few = median([1.0, 2.0, 3.0])
    assert (few.value, few.low, few.high) == (2.0, -math.inf, math.inf)


@pytest.mark.parametrize('gained', [0.02, 0.1, 0.4])
@pytest.mark.parametrize('lost', [0.02, 0.1, 0.3])
def test_a_difference_of_pairs_is_covered_nearly_always(gained, lost):
    n, covered = 40, 0.0
    for b, c in itertools.product(range(n + 1), repeat=2):
        if b + c <= n:
            first, second = outcomes(c, n - c), np.roll(outcomes(b, n - b), c)
            found = proportion_difference(first, second)
            assert found.value == (b - c) / n
            ways = math.comb(n, b) * math.comb(n - b, c)
            weight = ways * gained**b * lost**c * (1 - gained - lost) ** (n - b - c)
            covered += weight * (found.low <= gained - lost <= found.high)
    assert covered > 0.935


def test_no_difference_in_few_pairs_is_not_none_at_all():
    same = outcomes(5, 15)
    found = proportion_difference(same, same)
    assert found.value == 0
    assert found.high == -found.low == pytest.approx(1.96 / 22, rel=1e-3)


def test_a_difference_of_many_pairs_is_walds():
    rng = np.random.default_rng(1)
    first, second = rng.random(100_000) < 0.3, rng.random(100_000) < 0.4
    found, walds = proportion_difference(first, second), mean(second * 1.0 - first)
    assert (found.low, found.high) == pytest.approx((walds.low, walds.high), abs=1e-5)
