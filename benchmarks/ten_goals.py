"""How good an expansion is where the optimum was out of reach: ten goals, with one battery.

    make bench SCRIPTS=benchmarks/ten_goals.py
    make bench SCRIPTS=benchmarks/ten_goals.py ARGS='--goals 3 6'

Writes ten_goals.md. Ten goals need about half an hour on two idle processors, and 6 GB.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from parts import pages
from parts.missions import case_study, with_battery

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver.evaluation.occupancy import flown_states
from uav_mission_manager.solver.evaluation.simulation import (
    ControlVariate,
    cost_horizon,
    simulate,
)
from uav_mission_manager.solver.exact import AxisModel, LookAhead, Sweeper, value_iteration
from uav_mission_manager.solver.submdp import whole_mission

ORDERS = (2, 3)
"""Orders of the expansions."""

STATES = 1000
"""States of either kind from which a flight each is simulated."""

TRUNCATION = 1e-3
"""Discount^T after which a simulated flight of T epochs is cut."""

NEAR = 1e-3
"""Actions whose Q* is within this of V*, relative to it, count as near."""

TOLERANCE = 1e-4
"""Largest distance of the exact values from V*; costs are in the hundreds."""

INTRODUCTION = f"""\
The case study's grid with more goals and one battery. The exact optimum V* judges expansions and
their certificates, in {STATES:,} states drawn evenly from all and {STATES:,} of those that the
policy flies through. Errors are standard errors.

*Loss* is the mean of V^pi / V* - 1. V^pi is V* and what each action of a simulated flight costs
more than the best one, by Q*, until discount^T is {TRUNCATION:g}. *Near* is the share of states in
which Q* of the action is within {NEAR:.1%} of V*. *Gap* is what the policy set proves of itself
without V*, the mean of V^pi / L - 1. *Of this the bound's* is the mean of V* / L - 1: what the gap
would be were the policy optimal."""


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--goals', type=int, nargs='+', default=[3, 6, 10])
    parser.add_argument('--keep', type=Path, help='folder for the exact values, for another run')
    options = parser.parse_args()
    rows = [row for k in options.goals for row in _rows(k, options)]
    head = ['goals', 'states', 'order', 'build [s]', 'drawn', 'near', 'loss', 'gap']
    table = pages.table([*head, "of this the bound's"], rows)
    pages.publish(
        pages.folder(options) / 'ten_goals.md',
        'Expansions of ten goals beside the optimum',
        [INTRODUCTION, table],
    )
    return 0


def _rows(k: int, options: argparse.Namespace) -> list[list[str]]:
    """Two rows for each order: over even and over flown states."""
    mission = with_battery(case_study(k))
    model = AxisModel(whole_mission(mission))
    values = _exact(model, options.keep and options.keep / f'{k}.npy')
    sweeper = Sweeper(model, values)
    sweeper.expect()
    look_ahead = LookAhead(model, values, sweeper.expected)
    optimum = ControlVariate(
        lambda states: model.state_values(values, states), look_ahead.q_values
    )
    rows = []
    for order in ORDERS:
        start = time.perf_counter()
        policy = build_policy(mission, 'expansion', order=order, jobs=2)
        known = [k, f'{policy.space.size:,}', order, f'{time.perf_counter() - start:.1f}']
        for figures in _judged(policy, optimum):
            rows.append([str(entry) for entry in (*known, *figures)])
            print(*rows[-1], flush=True)
    return rows


def _exact(model: AxisModel, file: Path | None) -> RealArray:
    """W*, from the file if it was kept there."""
    if file and file.exists():
        return np.load(file)
    start = time.perf_counter()
    values = value_iteration(model.sub, TOLERANCE).value
    print(f'{model.sub.n} goals exactly: {time.perf_counter() - start:.1f} s', flush=True)
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, values)
    return values


def _judged(policy: Policy, optimum: ControlVariate) -> list[list[str]]:
    """Figures of a policy in even and in flown states."""
    mission, rng = policy.mission, np.random.default_rng(0)
    certificate = policy.certificate
    even = policy.space.draw(STATES, rng)
    flown = flown_states(mission, policy.act, STATES, rng)
    pairs = (
        ('evenly', even, certificate.gap, certificate.gap_error),
        ('flown', flown, certificate.flown_gap, certificate.flown_gap_error),
    )
    return [
        [
            drawn,
            f'{_near(policy.act, states, optimum):.2%}',
            _percent(_losses(mission, policy.act, states, optimum)),
            'unbounded' if gap is None else f'{gap:.2%} ± {error:.2%}',
            _percent(optimum.values(states) / certificate.bound.values(states) - 1),
        ]
        for drawn, states, gap, error in pairs
    ]


def _losses(
    mission: Mission,
    act: Callable[[IntArray], IntArray],
    states: IntArray,
    optimum: ControlVariate,
) -> FloatArray:
    """V^pi / V* - 1 of states, each by one flight."""
    horizon, rng = cost_horizon(mission, TRUNCATION), np.random.default_rng(1)
    samples, _ = simulate(mission, act, states, horizon, rng, optimum)
    return samples / optimum.values(states) - 1


def _near(act: Callable[[IntArray], IntArray], states: IntArray, optimum: ControlVariate) -> float:
    """Share of states in which the action is all but optimal."""
    q, actions = optimum.q_values(states), act(states)
    chosen = q[np.arange(len(q)), actions - 1]
    return float((chosen <= (1 + NEAR) * q.min(axis=1)).mean())


def _percent(samples: FloatArray) -> str:
    """Mean and standard error."""
    return f'{samples.mean():.3%} ± {samples.std(ddof=1) / np.sqrt(len(samples)):.3%}'


if __name__ == '__main__':
    raise SystemExit(main())
