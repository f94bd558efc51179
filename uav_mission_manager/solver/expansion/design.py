"""Design points: the x in which an expansion is backed up and fitted."""

from __future__ import annotations

import numpy as np

from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.expansion.basis import Clusters, likelihood
from uav_mission_manager.solver.reduced import goal_order

COMPLETE_DESIGN = 1 << 13
"""Most points of a design that holds all x."""

POINTS_A_FEATURE = (4, 8, 16)
"""Design points a feature, where they are drawn: as many as it takes to settle. Measured with six
goals and pairs: two lose 58 % more on average than four, eight 8 % less."""

LEAST_POINTS = 2048
"""Least number of points of a drawn design."""


def is_complete(mission: Mission) -> bool:
    """Whether the design holds all x."""
    return _every(mission) <= COMPLETE_DESIGN


def _every(mission: Mission) -> int:
    """Number of all x."""
    return int((3 * mission.range.flag_values) ** mission.k)


def design_size(mission: Mission, clusters: Clusters, points_a_feature: int) -> int:
    """Number of design points for an expansion."""
    every = _every(mission)
    if is_complete(mission):
        return every
    return min(max(points_a_feature * clusters.features, LEAST_POINTS), every)


def design(mission: Mission, points: int) -> IntArray:
    """Design points x (M, k): all where they are few, else drawn by their likelihood.

    Goals are drawn for in an order of their own, so that relabelling them changes nothing.
    """
    k, values = mission.k, 3 * mission.range.flag_values
    if is_complete(mission):
        return np.indices((values,) * k).reshape(k, -1).T
    rng = np.random.default_rng(points)
    drawn = rng.choice(values, (2 * points, k), p=likelihood(values))
    chosen = rng.permutation(np.unique(drawn, axis=0))[:points]
    x = np.empty_like(chosen)
    x[:, goal_order(mission)] = chosen
    return x
