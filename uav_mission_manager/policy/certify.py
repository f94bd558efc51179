"""Certificates: how far a policy may be from the optimum, in the mean and in the state at hand.

V* is bounded from below by `uav_mission_manager.solver.bounds`, and from above by the cost V^pi of
the policy: by exact evaluation where its table fits, elsewhere by simulation. With an estimate V'
of V^pi, the larger of the policy's least Q and the lower bound,

    L(s) <= V*(s) <= V^pi(s) <= V'(s) + offset,

the offset being the largest V^pi - V' of all states or, by simulation, the largest upper
confidence bound of it in n states drawn evenly. Then with confidence 1 - c^n at most a share
1 - c of all states has a larger one (Wilks 1941).
"""

from __future__ import annotations

from functools import partial
from itertools import count

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.workers import Workers
from uav_mission_manager.solver.bounds import LowerBound
from uav_mission_manager.solver.evaluation.occupancy import flown_states
from uav_mission_manager.solver.evaluation.policy_evaluation import (
    evaluate,
    representatives,
    tabulate,
)
from uav_mission_manager.solver.evaluation.simulation import Estimate, estimate
from uav_mission_manager.solver.progress import Progress, Report, ignore
from uav_mission_manager.solver.submdp import whole_mission

MAX_EVALUATED_ENTRIES = 1 << 17
"""Entries of W up to which a policy is evaluated exactly; asking it for each takes some 20 us."""

EVEN_STATES, FLOWN_STATES = 20_000, 1_000
"""States drawn evenly, and from those flown, over which an exact evaluation's gap is averaged:
choices."""

SIMULATED_STATES = 96
"""States drawn evenly, and as many from those flown, whose cost is simulated: a choice."""

EPISODES_A_STATE = 8
"""Episodes simulated from each of them: a choice."""

SIMULATION_TASKS = 4
"""Tasks that share the simulated states; independent of the processes that solve them: a
choice."""

TRUNCATED_DISCOUNT = 1e-4
"""Largest discount^T at the last epoch T of a simulated episode: a choice."""

FAILURE_PROBABILITY = 0.01
"""Chance that any of a simulation's confidence bounds fails, and that the coverage does: a
choice."""


MeanGap = tuple[float, float] | tuple[None, None]
"""Mean of a gap and its standard error; None where one of the gaps is not finite."""


def certify(
    policy: Policy, bound: LowerBound, workers: Workers, progress: Progress = ignore
) -> Certificate:
    """Bound the cost of a policy from above and compare it with a bound from below."""
    # What best_value does depends on c, which tables over W lack.
    whole = whole_mission(policy.mission)
    tables = whole.entries <= MAX_EVALUATED_ENTRIES and policy.method != 'best_value'
    made = _evaluated(policy, bound) if tables else _simulated(policy, bound, workers, progress)
    progress(Report(0, 1.0, 'upper bound found'))
    return made


def _evaluated(policy: Policy, bound: LowerBound) -> Certificate:
    sub, rng = whole_mission(policy.mission), np.random.default_rng(0)
    evaluation, every = evaluate(sub, tabulate(sub, policy.act)), representatives(sub)
    above = evaluation.state_values(every) + evaluation.upper
    offset = _offset(policy, bound, every, above) + policy.estimate_rounding
    even = policy.space.draw(EVEN_STATES, rng)
    flown = flown_states(policy.mission, policy.act, FLOWN_STATES, rng)
    gaps = [
        _mean(_gaps(evaluation.state_values(states), bound.values(states)))
        for states in (even, flown)
    ]
    every_gap = _gaps(evaluation.state_values(every), bound.values(every))
    largest = float(every_gap.max()) if np.isfinite(every_gap).all() else None
    return _certificate(bound, offset, 1.0, 1.0, gaps, largest)


def _simulated(
    policy: Policy, bound: LowerBound, workers: Workers, progress: Progress
) -> Certificate:
    rng = np.random.default_rng(0)
    even = policy.space.draw(SIMULATED_STATES, rng)
    flown = flown_states(policy.mission, policy.act, SIMULATED_STATES, rng)
    parts = np.array_split(np.concatenate([even, flown]), SIMULATION_TASKS)
    tasks = [partial(_estimate, policy, part, seed) for seed, part in enumerate(parts)]
    ended = count(1)

    def tell(_: int) -> None:
        step = next(ended)
        # The comparison of the bounds is left to do.
        done = step / (len(tasks) + 1)
        progress(Report(step, done, f'{step} of {len(tasks)} simulations'))

    found = list(workers.run(tasks, tell))
    mean, above = (
        np.concatenate([getattr(part, name) for part in found]) for name in ('mean', 'upper')
    )
    offset = _offset(policy, bound, even, above[:SIMULATED_STATES])
    coverage = FAILURE_PROBABILITY ** (1 / SIMULATED_STATES)
    gaps = [
        _mean(_gaps(values, bound.values(states)))
        for values, states in zip(np.split(mean, 2), (even, flown))
    ]
    return _certificate(bound, offset, coverage, 1 - 2 * FAILURE_PROBABILITY, gaps, None)


def _certificate(
    bound: LowerBound,
    offset: float,
    coverage: float,
    confidence: float,
    gaps: list[MeanGap],
    largest_gap: float | None,
) -> Certificate:
    (gap, gap_error), (flown_gap, flown_gap_error) = gaps
    return Certificate(
        bound=bound,
        offset=offset,
        coverage=coverage,
        confidence=confidence,
        gap=gap,
        gap_error=gap_error,
        flown_gap=flown_gap,
        flown_gap_error=flown_gap_error,
        largest_gap=largest_gap,
    )


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
        EPISODES_A_STATE,
        np.random.default_rng(seed),
        control,
        truncation=TRUNCATED_DISCOUNT,
        confidence=1 - FAILURE_PROBABILITY / SIMULATED_STATES,
    )


def _gaps(above: FloatArray, below: FloatArray) -> FloatArray:
    """V^pi / L - 1; 0 where there is nothing to pay."""
    gaps = np.where(above > 0, np.inf, 0.0)
    np.divide(above - below, below, out=gaps, where=below > 0)
    return gaps


def _mean(gaps: FloatArray) -> MeanGap:
    if not np.isfinite(gaps).all():
        return None, None
    return float(np.mean(gaps)), float(np.std(gaps) / np.sqrt(len(gaps)))
