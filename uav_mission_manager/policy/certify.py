"""Certificates: how far a policy may be from the optimum, in the mean and in the state at hand.

From below V* is bounded by `uav_mission_manager.solver.bounds.lower_bound`, from above by the cost V^pi of the
policy: by exact evaluation where its table fits, elsewhere by simulation. With an estimate V' of
V^pi, the larger of the expansion's and the lower bound,

    L(s) <= V*(s) <= V^pi(s) <= V'(s) + offset,

the offset being the largest V^pi - V' of all states or, by simulation, the largest upper
confidence bound of it in n states drawn evenly. Then with confidence 1 - c^n at most a share
1 - c of all states has a larger one (Wilks 1941).
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.workers import Workers
from uav_mission_manager.solver import LowerBound, whole_mission
from uav_mission_manager.solver.evaluation.policy_evaluation import (
    evaluate,
    representatives,
    tabulate,
)
from uav_mission_manager.solver.evaluation.simulation import Estimate, estimate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EVALUATED = 1 << 17
"""Entries of W up to which a policy is evaluated exactly; asking it for each takes some 20 us."""

SAMPLE = 20_000
"""States over which the gap of an exact evaluation is averaged."""

STARTS, EPISODES, PARTS = 96, 8, 4
"""States drawn for a simulation, episodes from each, and tasks that share them."""

TRUNCATION = 1e-4
"""Largest discount^T of a simulation."""

FAILURE = 0.01
"""Chance that any of a simulation's confidence bounds fails, and that the coverage does."""


def certify(policy: Policy, bound: LowerBound, workers: Workers) -> Certificate:
    """Bound the cost of a policy from above and compare it with a bound from below."""
    # What that rule does depends on commitments everywhere, which tables over places lack.
    tables = whole_mission(policy.mission).entries <= EVALUATED and policy.method != 'best_value'
    return _evaluated(policy, bound) if tables else _simulated(policy, bound, workers)


def _evaluated(policy: Policy, bound: LowerBound) -> Certificate:
    sub = whole_mission(policy.mission)
    evaluation, every = evaluate(sub, tabulate(sub, policy.act)), representatives(sub)
    above = evaluation.state_values(every) + evaluation.upper
    states = policy.space.draw(SAMPLE, np.random.default_rng(0))
    gaps = _gaps(evaluation.state_values(states), bound.values(states))
    return Certificate(bound, _offset(policy, bound, every, above), 1.0, 1.0, *_mean(gaps))


def _simulated(policy: Policy, bound: LowerBound, workers: Workers) -> Certificate:
    starts = policy.space.draw(STARTS, np.random.default_rng(0))
    parts = np.array_split(starts, PARTS)
    tasks = [partial(_estimate, policy, part, seed) for seed, part in enumerate(parts)]
    found = list(workers.run(tasks))
    mean, above = (
        np.concatenate([getattr(part, name) for part in found]) for name in ('mean', 'upper')
    )
    offset, coverage = _offset(policy, bound, starts, above), FAILURE ** (1 / STARTS)
    gaps = _gaps(mean, bound.values(starts))
    return Certificate(bound, offset, coverage, 1 - 2 * FAILURE, *_mean(gaps))


def _offset(policy: Policy, bound: LowerBound, states: IntArray, above: FloatArray) -> float:
    """Largest V^pi - V' in some states."""
    least = policy.q_values(states).min(axis=1)
    return float((above - policy.estimate(least, bound.sums(states))).max())


def _estimate(policy: Policy, starts: IntArray, seed: int) -> Estimate:
    control = policy.control
    return estimate(
        policy.mission,
        None if control else policy.act,
        starts,
        EPISODES,
        np.random.default_rng(seed),
        control,
        truncation=TRUNCATION,
        confidence=1 - FAILURE / STARTS,
    )


def _gaps(above: FloatArray, below: FloatArray) -> FloatArray:
    """V^pi / L - 1; 0 where there is nothing to pay."""
    gaps = np.where(above > 0, np.inf, 0.0)
    np.divide(above - below, below, out=gaps, where=below > 0)
    return gaps


def _mean(gaps: FloatArray) -> tuple[float, float] | tuple[None, None]:
    if not np.isfinite(gaps).all():
        return None, None
    return float(np.mean(gaps)), float(np.std(gaps) / np.sqrt(len(gaps)))
