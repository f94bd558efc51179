"""The trail of a vehicle: where it has been, by points that are some metres apart."""

from __future__ import annotations

import math
from typing import TypeVar

MOST_TRAIL_POINTS = 400
"""Points of the trail, at most: a choice."""

TRAIL_STEP = 2.0
"""Distance [m] between two points of the trail: a choice, below a pixel on most maps."""

TRAIL_BREAK = 50.0
"""Distance [m] between two positions from which the trail begins anew: a choice, no vehicle flies
so far between two messages."""

PointT = TypeVar('PointT', bound=tuple[float, ...])


def longer_trail(trail: tuple[PointT, ...], here: PointT) -> tuple[PointT, ...]:
    """Return a trail [m] that ends here; the same one where that is no step away."""
    if not trail or math.dist(trail[-1], here) > TRAIL_BREAK:
        return (here,)
    if math.dist(trail[-1], here) < TRAIL_STEP:
        return trail
    return (*trail, here)[-MOST_TRAIL_POINTS:]
