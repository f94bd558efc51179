"""How near the optimum the policies of decomposed missions are, on random missions too.

    make bench SCRIPTS=benchmarks/quality.py
    make bench SCRIPTS=benchmarks/quality.py ARGS='--sections losses --goals 3 --seeds 4'

Writes quality.md. The whole takes about 25 minutes on two idle processors. Random missions have
three, five or ten goals; with six the exact solutions of five more would take too long.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np
from parts import pages
from parts.missions import case_study, random_mission

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy import ExactPolicy, Policy
from uav_mission_manager.policy.workers import workers
from uav_mission_manager.solver.bounds import covering
from uav_mission_manager.solver.evaluation.occupancy import flown_states
from uav_mission_manager.solver.evaluation.policy_evaluation import evaluate, tabulate
from uav_mission_manager.solver.submdp import state_count, whole_mission

EVEN_STATES, FLOWN_STATES = 1_000_000, 100_000
"""States drawn evenly, and from those that a policy flies through, in which losses are taken."""

COMPARED_STATES = 100_000
"""States of either kind in which actions are compared."""

NEAR = 1e-3
"""Actions whose Q is within this of V*, relative to it, count as near."""

LOSSES = {
    3: (('expansion', 1), ('expansion', 2), ('split', 0), ('highest_priority', 0)),
    5: (('expansion', 3),),
    6: (('expansion', 3),),
}
"""Methods and orders whose loss is taken, by number of goals."""

LOSS_TARGETS = {(3, 'expansion', 2): (1e-4, 1e-2), (6, 'expansion', 3): (2e-4, 1e-2)}
"""Mean and largest loss aimed at."""

GAPS = {3: 2, 10: 3}
"""Order of the expansions whose certified gap is taken, by number of goals."""

GAP_TARGETS = {3: 0.025, 10: 0.06}
"""Certified gap aimed at, by number of goals."""

SECTIONS = ('losses', 'gaps', 'times', 'growth')

Row = list[str]


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--sections', nargs='+', default=SECTIONS, choices=SECTIONS)
    parser.add_argument(
        '--goals', type=int, nargs='+', default=[3, 5, 6, 10], choices=[3, 5, 6, 10]
    )
    parser.add_argument('--seeds', type=int, nargs='*', default=[1, 2, 3, 4, 5], help='above 0')
    parser.add_argument('--jobs', type=int, default=2, help='processes; default: %(default)s')
    options = parser.parse_args()
    run = {'losses': _losses, 'gaps': _gaps, 'times': _times, 'growth': _growth}
    found = [run[section](options) for section in SECTIONS if section in options.sections]
    file = pages.folder(options) / 'quality.md'
    pages.publish(file, 'Decomposed policies: loss, certified gap, time', [INTRODUCTION, *found])
    return 0


INTRODUCTION = """\
Missions `random_N` are drawn from wide ranges with seed N; nothing was tuned to them. Figures are
given over two sets of states. *Even* states are drawn evenly from all. *Flown* states are those a
UAV meets that follows the policy: from base, nominal and charged, with any priorities, each epoch
weighted by its discount. Most states are hardly ever flown."""


def _each(
    options: argparse.Namespace, goals: Iterable[int], work: Callable[[int, int], list[Row]]
) -> list[Row]:
    """Rows of all missions with these numbers of goals, the largest solved first."""
    chosen = [k for k in goals if k in options.goals]
    keys = [(k, seed) for k in chosen for seed in ([0] if k == 6 else [0, *options.seeds])]
    rows = {}
    order = sorted(keys, key=lambda key: key[0], reverse=True)
    with workers(options.jobs) as pool:
        for key, found in zip(order, pool.run([partial(work, *key) for key in order])):
            rows[key] = found
            print(*(' '.join(row) for row in found), sep='\n', flush=True)
    return [row for key in keys for row in rows[key]]


def _mission(k: int, seed: int) -> Mission:
    return random_mission(k, seed) if seed else case_study(k)


def _largest(policy: Policy, order: int) -> str:
    """States of the largest sub-problem, of the policy and of its certificate."""
    mission, sizes = policy.mission, policy.info['sub_mdp_states']
    if order:
        limit = state_count(min(order, mission.k), mission.grid.q, 8)
        clusters = covering(mission, limit)
        sizes = [*sizes, *(state_count(len(c), mission.grid.q, 8) for c in clusters)]
    return f'{max(sizes):,}'


def _losses(options: argparse.Namespace) -> str:
    head = ['mission', 'goals', 'method', 'largest', 'features']
    for kind in ('even', 'flown'):
        head += [f'{kind}: near', 'mean loss', 'largest loss']
    targets = '; '.join(
        f'{method} {order} with {k} goals: mean {mean:.2%}, largest {most:.0%}'
        for (k, method, order), (mean, most) in LOSS_TARGETS.items()
    )
    return f"""## Loss against the exact optimum

Loss is (V^pi - V*) / V*, with V^pi by exact evaluation of the policy, in {EVEN_STATES:,} even and
{FLOWN_STATES:,} flown states. *Near* is the share of {COMPARED_STATES:,} of them in which Q* of
the action is within {NEAR:.1%} of V*. *Largest* counts the states of the largest sub-problem, in
the policy or in the certificate that goes with it. The rows of a mission show what larger
sub-problems buy.

Targets: {targets}.

{pages.table([*head, 'target'], _each(options, LOSSES, _losses_of))}"""


def _losses_of(k: int, seed: int) -> list[Row]:
    """One row a method."""
    exact = build_policy(_mission(k, seed), 'exact', jobs=1)
    return [_loss(exact, *method) for method in LOSSES[k]]


def _loss(exact: ExactPolicy, method: str, order: int) -> Row:
    mission, rng = exact.mission, np.random.default_rng(0)
    policy = build_policy(mission, method, order=order or 1, certificate=False)
    whole = whole_mission(mission)
    actions = tabulate(whole, policy.act)
    even = exact.space.draw(EVEN_STATES, rng)
    tolerance = 1e-7 * float(exact.part_values(even[:1000]).mean())
    evaluation = evaluate(whole, actions, tolerance, threads=1)

    def act(states: IntArray) -> IntArray:
        return actions[evaluation.model.locate(states)].astype(np.int64)

    figures, losses = [], []
    for states in (even, flown_states(mission, act, FLOWN_STATES, rng)):
        loss = evaluation.state_values(states) / exact.part_values(states)[:, 0] - 1
        compared = states[:COMPARED_STATES]
        near = _near(exact, compared, act(compared))
        figures += [f'{near:.2%}', f'{loss.mean():.4%}', f'{loss.max():.2%}']
        losses.append(loss)
    label, features = f'{method} {order}' if order else method, policy.info.get('features', '')
    target = LOSS_TARGETS.get((mission.k, method, order))
    met = [x.mean() <= target[0] and x.max() <= target[1] for x in losses] if target else []
    row = [mission.name, mission.k, label, _largest(policy, order), features, *figures, _met(met)]
    return [str(entry) for entry in row]


def _near(exact: ExactPolicy, states: IntArray, actions: IntArray) -> float:
    """Share of states in which the actions are all but optimal."""
    near = actions == exact.act(states)
    differ = np.flatnonzero(~near)
    if differ.size:
        q = exact.q_values(states[differ])
        near[differ] = q[np.arange(len(q)), actions[differ] - 1] <= (1 + NEAR) * q.min(axis=1)
    return float(near.mean())


def _met(met: list[bool]) -> str:
    """Whether a target is met over even and over flown states; empty where there is none."""
    if len(set(met)) == 2:
        return 'met where flown' if met[1] else 'missed where flown'
    return ('met' if met[0] else 'missed') if met else ''


def _gaps(options: argparse.Namespace) -> str:
    targets = ', '.join(f'{gap:.1%} with {k} goals' for k, gap in GAP_TARGETS.items())
    head = ['mission', 'goals', 'order', 'largest', 'even: gap', 'flown: gap', 'target', 'offset']
    return f"""## Certified gap

What a policy set proves of itself, without the exact solution: the mean of V^pi / L - 1, with its
standard error. L is the certificate's lower bound on V*; V^pi comes from exact evaluation or, of
large missions, from simulation. *Offset* is what the upper bound allows for the state at hand,
over the mean of that bound.

Targets: {targets}.

{pages.table([*head, 'upper bound holds'], _each(options, GAPS, _gaps_of))}"""


def _gaps_of(k: int, seed: int) -> list[Row]:
    mission, order = _mission(k, seed), GAPS[k]
    policy = build_policy(mission, 'expansion', order=order)
    certificate = policy.certificate
    states = policy.space.draw(1000, np.random.default_rng(1))
    offset = certificate.offset / policy.upper_bound(states).mean()
    gaps = certificate.gap, certificate.flown_gap
    met = _met([gap is not None and gap <= GAP_TARGETS[k] for gap in gaps])
    row = [mission.name, k, order, _largest(policy, order), *_gap(policy), met]
    return [[str(entry) for entry in (*row, f'{offset:.1%}', policy.upper_bound_holds)]]


def _gap(policy: Policy) -> tuple[str, str]:
    """Return the certified gap over even and over flown states."""
    certificate = policy.certificate
    if certificate is None:
        return '', ''
    pairs = (
        (certificate.gap, certificate.gap_error),
        (certificate.flown_gap, certificate.flown_gap_error),
    )
    even, flown = ('unbounded' if gap is None else f'{gap:.2%} ± {e:.2%}' for gap, e in pairs)
    return even, flown


def _times(options: argparse.Namespace) -> str:
    mission, rows = case_study(10), []
    for method, order in (('highest_priority', 0), ('expansion', 2), ('expansion', 3)):
        start = time.perf_counter()
        policy = build_policy(mission, method, order=order or 1, jobs=options.jobs if order else 1)
        seconds = time.perf_counter() - start
        with tempfile.TemporaryDirectory() as folder:
            policy.save(Path(folder, 'set'))
            size = sum(file.stat().st_size for file in Path(folder, 'set').iterdir())
        micros = _decisions(policy)
        figures = [f'{seconds:.2f}', f'{size / 1e6:.1f}']
        figures += [f'{np.median(micros):.0f}', f'{np.percentile(micros, 99):.0f}']
        rows.append([f'{method} {order}' if order else method, *figures, *_gap(policy)])
        print(*rows[-1], flush=True)
    head = ['method', 'build [s]', 'policy set [MB]', 'decision, median [us]', '99 % [us]']
    return f"""## Ten goals: build and decision

The case study with ten goals; expansions with `--jobs {options.jobs}` and with their certificate.
Decisions are taken in 3,000 even states, one at a time.

{pages.table([*head, 'even: gap', 'flown: gap'], rows)}"""


def _decisions(policy: Policy) -> FloatArray:
    """Time of each decision [us]."""
    states = policy.space.draw(3000, np.random.default_rng(0))
    policy.decide(states[0])
    times = []
    for state in states:
        start = time.perf_counter()
        policy.decide(state)
        times.append(1e6 * (time.perf_counter() - start))
    return np.array(times)


def _growth(options: argparse.Namespace) -> str:
    """Build times of single goals, and the exponent of a power fitted to them."""
    goals, numbers, medians = case_study(10).goals, (1, 2, 5, 10, 20, 40), []
    for k in numbers:
        some = tuple(dataclasses.replace(goals[j % 10], name=f'goal{j}') for j in range(k))
        mission, times = dataclasses.replace(case_study(3), goals=some), []
        for _ in range(5):
            start = time.perf_counter()
            build_policy(mission, 'highest_priority')
            times.append(time.perf_counter() - start)
        medians.append(1e3 * float(np.median(times)))
    exponent = np.polyfit(np.log(numbers[1:]), np.log(medians[1:]), 1)[0]
    rows = [[str(k), f'{median:.1f}'] for k, median in zip(numbers, medians)]
    return f"""## The paper's single goals: growth with their number

{pages.table(['goals', 'build [ms]'], rows)}

From two goals on the time grows as the number of goals to the power of {exponent:.2f}. One goal
alone is the whole mission: its MDP allows recharging only where the range is lost."""


if __name__ == '__main__':
    raise SystemExit(main())
