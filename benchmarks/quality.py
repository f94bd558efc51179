"""How near the optimum the policies of decomposed missions are, on random missions too.

    make bench                                                case study, five random missions
    python benchmarks/quality.py --seeds 1 2 3 4 5 --goals 3 5 6

Writes docs/quality.md. The judge is the exact solution. Some minutes; with six goals half an hour.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from parts.machine import machine
from parts.missions import case_study, random_mission

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy import Policy
from uav_mission_manager.policy.workers import workers
from uav_mission_manager.solver import whole_mission
from uav_mission_manager.solver.evaluation.policy_evaluation import evaluate, tabulate

DOCS = Path(__file__).resolve().parents[1] / 'docs'
MOST, ACTIONS = 1_000_000, 100_000
"""States in which losses are taken and in which actions are compared, drawn at random."""

METHODS = {
    3: (('expansion', 1), ('expansion', 2), ('split', 0), ('highest_priority', 0)),
    5: (('expansion', 3),),
    6: (('expansion', 3),),
}
"""Methods and orders by number of goals."""


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2, 3, 4, 5])
    parser.add_argument('--goals', type=int, nargs='+', default=[3, 5], choices=sorted(METHODS))
    options, _ = parser.parse_known_args()  # `make bench` gives its ARGS to every script.
    times, growth = _times(), _growth()
    tasks = [
        partial(_losses, k, seed)
        for k in sorted(options.goals, reverse=True)
        for seed in ([0] if k == 6 else [0, *options.seeds])
    ]
    tasks += [partial(_gaps, k, seed) for k in (3, 10) for seed in [0, *options.seeds]]
    with workers(jobs=2) as pool:
        rows = []
        for found in pool.run(tasks):
            print(*found, sep='\n', flush=True)
            rows.append(found)
    gaps = 2 * (1 + len(options.seeds))
    text = [HEAD, LOSSES, *_flat(rows[:-gaps]), GAPS, *_flat(rows[-gaps:])]
    text += [TIMES, *times, GROWTH, *growth, '', _machine()]
    (DOCS / 'quality.md').write_text('\n'.join(text) + '\n', encoding='utf-8')
    return 0


HEAD = """# Decomposed policies: loss, certified gap, time

`python benchmarks/quality.py` writes this page. Missions `random_N` are drawn from wide ranges
with seed N, and nothing was tuned to them.
"""

LOSSES = f"""## Loss against the exact optimum

Loss is (V^pi - V*) / V* by exact evaluation of the policy, in {MOST:,} states drawn at random;
`within 0.1 %` is the share of {ACTIONS:,} states in which the action's Q is within 0.1 % of V*;
`largest` the states of the largest sub-problem. The rows of a mission are the frontier: what
larger sub-problems buy.

| mission | goals | method | largest | features | within 0.1 % | mean loss | largest loss |
| --- | ---: | --- | ---: | ---: | ---: | ---: | ---: |"""

GAPS = """
## Certified gap

What a policy set of its own proves, without the exact solution: the mean of V^pi / L - 1, L the
lower bound in the manifest, V^pi by exact evaluation or by simulation (with its standard error).
`offset` over the mean of the upper bound says how much of that is allowance for the state at hand.

| mission | goals | order | largest | gap | offset | upper bound holds |
| --- | ---: | ---: | ---: | ---: | ---: | --- |"""

TIMES = """
## Ten goals: build and decision

The case study with ten goals, two processes (`--jobs 2`), certificate included where there is
one; `decide` in 3,000 states drawn at random, one at a time.

| method | build [s] | policy set [MB] | decision, median [us] | 99 % [us] | certified gap |
| --- | ---: | ---: | ---: | ---: | ---: |"""

GROWTH = """
## The paper's single goals: growth with their number

| goals | build [ms] |
| ---: | ---: |"""


def _machine() -> str:
    found = machine()
    return (
        f'Measured on {found["processors"]} processors, {found["processor"]}, Python '
        f'{found["python"]}, NumPy {found["numpy"]}.'
    )


def _flat(rows: list[list[str]]) -> list[str]:
    return [row for found in rows for row in found]


def _mission(k: int, seed: int) -> Mission:
    return random_mission(k, seed) if seed else case_study(k)


def _losses(k: int, seed: int) -> list[str]:
    """One row a method."""
    mission = _mission(k, seed)
    exact, rng = build_policy(mission, 'exact', jobs=1), np.random.default_rng(0)
    states = exact.space.draw(MOST, rng)
    optimal, q = exact.part_values(states)[:, 0], exact.q_values(states[:ACTIONS])
    return [_loss(mission, *method, states, optimal, q) for method in METHODS[k]]


def _loss(
    mission: Mission,
    method: str,
    order: int,
    states: np.ndarray,
    optimal: np.ndarray,
    q: np.ndarray,
) -> str:
    policy = build_policy(mission, method, order=order or 3, certificate=False)
    whole = whole_mission(mission)
    evaluation = evaluate(whole, tabulate(whole, policy.act), 1e-7 * optimal.mean(), threads=1)
    loss = evaluation.state_values(states) / optimal - 1
    chosen = q[np.arange(len(q)), policy.act(states[: len(q)]) - 1]
    within = np.mean(chosen <= 1.001 * q.min(axis=1))
    info, label = policy.info, f'{method} {order}' if order else method
    return (
        f'| {mission.name} | {mission.k} | {label} | {max(info["sub_mdp_states"]):,} '
        f'| {info.get("features", "")} | {within:.2%} | {loss.mean():.4%} | {loss.max():.2%} |'
    )


def _gaps(k: int, seed: int) -> list[str]:
    mission, order = _mission(k, seed), 2 if k == 3 else 3
    policy = build_policy(mission, 'expansion', order=order)
    info, states = policy.info, policy.space.draw(1000, np.random.default_rng(1))
    offset = info['offset'] / policy.upper_bound(states).mean()
    return [
        f'| {mission.name} | {k} | {order} | {max(info["sub_mdp_states"]):,} | {_gap(policy)} '
        f'| {offset:.1%} | {policy.upper_bound_holds} |'
    ]


def _gap(policy: Policy) -> str:
    certificate = policy.certificate
    if certificate is None or certificate.gap is None:
        return ''
    return f'{certificate.gap:.2%} ± {certificate.gap_error:.2%}'


def _times() -> list[str]:
    mission, rows = case_study(10), []
    for method, order in (('highest_priority', 1), ('expansion', 2), ('expansion', 3)):
        start = time.perf_counter()
        policy = build_policy(mission, method, order=order, jobs=1 if order == 1 else 2)
        seconds = time.perf_counter() - start
        with tempfile.TemporaryDirectory() as folder:
            policy.save(Path(folder, 'set'))
            size = sum(file.stat().st_size for file in Path(folder, 'set').iterdir())
        micros = _decisions(policy)
        label = f'{method} {order}' if method == 'expansion' else method
        rows.append(
            f'| {label} | {seconds:.2f} | {size / 1e6:.1f} | {np.median(micros):.0f} '
            f'| {np.percentile(micros, 99):.0f} | {_gap(policy)} |'
        )
        print(rows[-1], flush=True)
    return rows


def _decisions(policy: Policy) -> list[float]:
    """Microseconds of decisions."""
    states = policy.space.draw(3000, np.random.default_rng(0))
    policy.decide(states[0])
    times = []
    for state in states:
        start = time.perf_counter()
        policy.decide(state)
        times.append(1e6 * (time.perf_counter() - start))
    return times


def _growth() -> list[str]:
    """Build times of single goals, and the exponents of powers fitted to them."""
    goals, numbers, medians = case_study(10).goals, (1, 2, 5, 10, 20, 40), []
    for k in numbers:
        some = tuple(dataclasses.replace(goals[j % 10], name=f'goal{j}') for j in range(k))
        mission, times = dataclasses.replace(case_study(3), goals=some), []
        for _ in range(5):
            start = time.perf_counter()
            build_policy(mission, 'highest_priority')
            times.append(time.perf_counter() - start)
        medians.append(1e3 * float(np.median(times)))
    every, more = (
        np.polyfit(np.log(numbers[first:]), np.log(medians[first:]), 1)[0] for first in (0, 1)
    )
    rows = [f'| {k} | {median:.1f} |' for k, median in zip(numbers, medians)]
    return [
        *rows,
        '',
        f'Fitted to a power of their number, the exponent is {every:.2f}; from two goals on, '
        f'{more:.2f}. One',
        'goal alone is the whole mission, whose sub-MDP knows when all goals are in range and '
        'takes a third',
        'of the sweeps.',
    ]


if __name__ == '__main__':
    raise SystemExit(main())
