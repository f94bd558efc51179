"""Counts of random draws held against their probabilities."""

from __future__ import annotations

import math

DRAWS = 20_000


def assert_drawn_from(counts, expected):
    """Counts of DRAWS outcomes no further off than Bernstein's bound of chance 1e-10 allows."""
    log = math.log(2e10)
    for outcome in counts.keys() | expected.keys():
        p = expected.get(outcome, 0.0)
        allowed = log / 3 + math.sqrt(log**2 / 9 + 2 * log * DRAWS * p * (1 - p))
        assert p > 0 or outcome not in counts, f'{outcome} cannot be'
        assert abs(counts.get(outcome, 0) - DRAWS * p) <= allowed, outcome
