"""How near the optimum the policies of decomposed missions are, on random missions too.

    make bench                          case study, five random missions; some minutes
    python benchmarks/quality.py --seeds 1 2 3 4 5 --goals 3 5 6

Writes docs/quality.md. The judge is the exact solution.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from parts.missions import case_study, random_mission

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission, StateSpace
from uav_mission_manager.policy import Policy
from uav_mission_manager.solver import value_iteration, whole_mission
from uav_mission_manager.solver.evaluation import evaluate, tabulate

DOCS = Path(__file__).resolve().parents[1] / 'docs'
MOST = 1_000_000
"""States in which losses are taken: all, or as many drawn at random."""

ORDERS = {3: (1, 2), 4: (2, 3), 5: (2, 3), 6: (3,)}
"""Orders of the expansion by number of goals."""


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2, 3, 4, 5])
    parser.add_argument('--goals', type=int, nargs='+', default=[3, 5], choices=sorted(ORDERS))
    options, _ = parser.parse_known_args()  # `make bench` gives its ARGS to every script.
    rows = []
    for k in options.goals:
        missions = [case_study(k), *(random_mission(k, seed) for seed in options.seeds)]
        for mission in missions:
            rows += _rows(mission)
            print(rows[-1], flush=True)
    (DOCS / 'quality.md').write_text('\n'.join([HEAD, *rows]) + '\n')
    return 0


HEAD = f"""# Loss of decomposed policies

`python benchmarks/quality.py` writes this page. Loss is (V^pi - V*) / V* by exact evaluation of
the policy against the exact optimum, in all states or {MOST:,} drawn at random; `within 0.1 %` is
the share of states whose action's Q is within 0.1 % of V*; `largest` the states of the largest
sub-problem. Missions `random_N` are drawn from wide ranges with seed N and were not tuned to.

| mission | goals | method | largest | build [s] | within 0.1 % | mean loss | largest loss |
| --- | --- | --- | --- | --- | --- | --- | --- |"""


def _rows(mission: Mission) -> list[str]:
    """One row a method."""
    whole = whole_mission(mission)
    # As the policies see it: W* and the Q of every action in it.
    exact = build_policy(mission)
    solution = exact.solutions[0]
    if solution.actions is None:
        solution = value_iteration(whole, with_actions=True)
    states = _states(exact.space)
    optimal = evaluate(whole, solution.actions).state_values(states)
    methods = [('expansion', order) for order in ORDERS[mission.k]]
    if mission.k == 3:
        methods += [('split', 0), ('highest_priority', 0)]
    return [_row(mission, name, order, exact, states, optimal) for name, order in methods]


def _row(
    mission: Mission, name: str, order: int, exact: Policy, states: np.ndarray, optimal: np.ndarray
) -> str:
    start = time.perf_counter()
    policy = build_policy(mission, name, **({'order': order} if order else {}))
    seconds = time.perf_counter() - start
    whole = whole_mission(mission)
    loss = evaluate(whole, tabulate(whole, policy.act)).state_values(states) / optimal - 1
    sample = states[:: max(1, len(states) // 100_000)]
    q = exact.q_values(sample)
    chosen = q[np.arange(len(q)), policy.act(sample) - 1]
    within = np.mean(chosen <= 1.001 * q.min(axis=1))
    size = max(policy.info['sub_mdp_states'])
    label = f'{name} {order}' if order else name
    return (
        f'| {mission.name} | {mission.k} | {label} | {size:,} | {seconds:.2f} | {within:.2%} '
        f'| {loss.mean():.4%} | {loss.max():.2%} |'
    )


def _states(space: StateSpace) -> np.ndarray:
    if space.size <= MOST:
        return space.states()
    return space.states(np.random.default_rng(0).integers(0, space.size, MOST))


if __name__ == '__main__':
    raise SystemExit(main())
