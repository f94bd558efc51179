"""The paper's comparison of combined and global policy, in all states of the case study.

    make bench SCRIPTS=benchmarks/paper.py

Writes paper.md and paper.svg. Some twenty seconds on an idle processor.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from parts import pages
from parts.agreement import (
    FLOWN_STATES,
    PAPER_CHOICES,
    PAPER_GOAL,
    SAMPLE,
    Agreement,
    Chain,
    Optimum,
    compare,
    groups,
)
from parts.missions import case_study
from parts.pictures import drawing, save

from uav_mission_manager.mdp import (
    FAULT_MODES,
    THREAT_LEVELS,
    action_name,
    global_actions,
    global_to_local,
)
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy import METHODS

FEASIBILITY = {
    'strict': 'strict, the default',
    'paper': 'every action everywhere, as in the paper',
}

SUB_MDPS = {'best_value': 'six actions, no travel cost', 'split': 'all actions, costs split'}
"""What the sub-MDPs of a method keep."""

Found = dict[str, tuple[Optimum, dict[str, Agreement]]]


def main() -> int:
    """Run the comparison."""
    options = pages.parser(__doc__.splitlines()[0]).parse_args()
    found: Found = {}
    for rule in FEASIBILITY:
        optimum = Optimum(dataclasses.replace(case_study(3), feasibility=rule))
        methods = [method for method in METHODS if method != 'auto']
        found[rule] = optimum, {method: compare(optimum, method) for method in methods}
    optimum, folder = found['strict'][0], pages.folder(options)
    sections = [
        INTRODUCTION,
        *(_overall(*found[rule], text) for rule, text in FEASIBILITY.items()),
        '![Share of states above a loss](paper.svg)',
        _breakdown(*found['strict']),
        _together(found),
        _sample(found),
    ]
    title = f"The paper's comparison, in all {len(optimum.states):,} states"
    pages.publish(folder / 'paper.md', title, sections)
    _draw(found['strict'][1], folder / 'paper.svg')
    return 0


def _percent(share: float) -> str:
    """Three figures at most; 100 % only where it is all."""
    percent = 100 * float(share)
    if 99.9 < percent < 100:
        return f'{min(percent, 99.9999):.4f} %'
    return '0' if abs(percent) < 1e-6 else f'{percent:#.3g}'.rstrip('.') + ' %'


INTRODUCTION = f"""\
The mission is `config/case_study.yaml`. Every combined policy is compared with the optimal one, in
every state:

- Is the action the same? Of actions that tie, the one with the lowest number counts.
- Is Q*(s, a) of the action within 0.1 % of V*(s)?
- What does it cost to follow the policy from there on? The loss is (V^pi - V*) / V*, by exact
  evaluation. *Flown* is its mean over {FLOWN_STATES:,} states that a UAV meets which follows the
  policy from base, each epoch weighted by its discount.

The policies:

- `best_value` follows the sub-MDP with the least cost (the paper's `ActionCalc_with_values`).
- `highest_priority` follows the sub-MDP with the largest eta_j g_j r_j (the paper's Algorithm 2).
- `split` splits the common costs evenly and adds up the Q values of all sub-MDPs.
- `expansion` fits tables of sub-problems no larger than two goals' 41,472 states.

[theory.md](theory.md) says why they differ."""


def _overall(optimum: Optimum, agreements: dict[str, Agreement], rule: str) -> str:
    rows = [
        [
            name,
            f'{a.same.sum():,}',
            f'{(~a.same).sum():,}',
            *map(_percent, (a.same.mean(), a.near.mean(), a.loss.mean(), a.loss.max())),
            _percent(a.loss[a.flown].mean()),
        ]
        for name, a in agreements.items()
    ]
    rows.append(['paper', f'{len(optimum.states):,}', '0', '100 %', '', '', '', ''])
    head = ['method', 'same', 'different', 'same', 'within 0.1 %', 'mean loss', 'largest loss']
    head.append('flown: mean loss')
    return f'## Combined and global policy: {rule}\n\n{pages.table(head, rows)}'


def _breakdown(optimum: Optimum, agreements: dict[str, Agreement]) -> str:
    names = {
        'f': {f: f'fault mode {name}' for f, name in enumerate(FAULT_MODES, 1)},
        't': {t: f'threat {name}' for t, name in enumerate(THREAT_LEVELS)},
    }
    same, loss = [], []
    for variable, masks in groups(optimum.space, optimum.states).items():
        for value, mask in masks.items():
            name = names.get(variable, {}).get(value, f'{variable}: {value}')
            chosen = [(a.same[mask], a.loss[mask]) for a in agreements.values()]
            same.append([name, f'{mask.sum():,}', *(_percent(s.mean()) for s, _ in chosen)])
            loss.append(
                [name, *(f'{_percent(x.mean())} ({_percent(x.max())})' for _, x in chosen)]
            )
    return f"""## By fault mode, threat and goals

Strict missions. A goal is active where g > 0. States with the same action:

{pages.table(['', 'states', *agreements], same)}

Loss, mean and in brackets the largest:

{pages.table(['', *agreements], loss)}"""


def _idle(optimum: Optimum, agreement: Agreement) -> float:
    """Share of the states with active and achieved goals whose sub-MDP of least cost is idle."""
    active = optimum.space.split(optimum.states).g > 0
    both = active.any(axis=1) & ~active.all(axis=1)
    least = agreement.policy.part_values(optimum.states[both]).argmin(axis=1)
    return 1 - float(np.take_along_axis(active[both], least[:, None], axis=1).mean())


def _together(found: Found) -> str:
    rows = []
    for rule, (optimum, agreements) in found.items():
        for name, what in SUB_MDPS.items():
            policy = agreements[name].policy
            choices = policy.local_choices(optimum.states)
            one = (choices == choices[:, :1]).all(axis=1)
            right = choices[one, 0] == optimum.actions[one]
            ratio = policy.part_values(optimum.states).sum(axis=1) / optimum.values
            shares = map(_percent, (one.mean(), right.mean()))
            ratios = (f'{x:.2f}' for x in (ratio.min(), ratio.mean(), ratio.max()))
            rows.append([f'{what}; {rule}', *shares, *ratios])
    head = [
        'sub-MDPs; feasibility',
        'one action for all',
        'of these optimal',
        'least',
        'mean',
        'largest',
    ]
    idle = _percent(_idle(found['strict'][0], found['strict'][1]['best_value']))
    return f"""## What the theorem would have

The theorem's joint policy (pi_1, .., pi_k) has one action for each sub-MDP. One UAV can follow it
only where all of them choose the same one. *Of these optimal* is the share of such states in which
that action is optimal. The last columns are the sum of all V_i* over V*, which the theorem says
is 1.

{pages.table(head, rows)}

The sub-MDP of least cost is the one with least to do. Of the (strict) states that have both active
and achieved goals, `best_value` follows the sub-MDP of an achieved goal in {idle}."""


def _sample(found: Found) -> str:
    state = np.array([SAMPLE])
    parts = [_sub_mdps(found, state), _decisions(found, state), _difference(found, state)]
    return f'## The sample state [{" ".join(map(str, SAMPLE))}]\n\n' + '\n\n'.join(parts)


def _local(found: Found, state: IntArray, rule: str) -> tuple[list[FloatArray], list[int | None]]:
    """Q values of each goal's sub-MDP, and the local number of its choice."""
    optimum, agreements = found[rule]
    policy, k = agreements['best_value'].policy, optimum.mission.k
    chosen = policy.local_choices(state)[0].tolist()
    numbers = [global_to_local(number, j, k) for j, number in enumerate(chosen)]
    return [values[0] for values in policy.local_values(state)], numbers


def _sub_mdps(found: Found, state: IntArray) -> str:
    names = ['none', 'commit', 'none, agile', 'commit, agile', 'recharge', 'repair']
    rows = [[f'{number} {name}'] for number, name in enumerate(names, 1)]
    for rule in found:
        for values, choice in zip(*_local(found, state, rule)):
            for number, (row, value) in enumerate(zip(rows, values), 1):
                text = f'{value:.2f}' if np.isfinite(value) else ''
                row.append(f'**{text}**' if number == choice else text)
    head = ['local action', *(f'goal {j}, {rule}' for rule in found for j in (1, 2, 3))]
    return f"""\
Q of the local actions in each goal's sub-MDP; the paper's action value is -Q. The choice is bold;
a field is empty where the action is not allowed.

{pages.table(head, rows)}"""


def _decisions(found: Found, state: IntArray) -> str:
    rows = []
    for rule, (optimum, agreements) in found.items():
        actions, chain = global_actions(optimum.mission), Chain(optimum.mission)
        at = optimum.q[chain.space.index(state)[0]]
        for name, agreement in agreements.items():
            number = int(agreement.policy.act(state)[0])
            likely = chain.space.states([chain.successors(SAMPLE, number).argmax()])[0]
            next_ = f'[{" ".join(map(str, likely.tolist()))}]'
            action = f'{number} {action_name(optimum.mission, actions[number - 1])}'
            rows.append([f'{name}, {rule}', action, next_, f'{at[number - 1]:.2f}'])
    head = ['method, feasibility', 'global action', 'likeliest next state', 'Q*']
    return f'What each method does:\n\n{pages.table(head, rows)}'


def _difference(found: Found, state: IntArray) -> str:
    values, choices = _local(found, state, 'paper')
    costs = [value.min() for value in values]
    least, most = int(np.argmin(costs)) + 1, int(np.argmax(costs)) + 1
    numbers = {name: int(a.policy.act(state)[0]) for name, a in found['paper'][1].items()}
    best = numbers.pop('exact')
    alike = ', '.join(name for name, number in numbers.items() if number == best)
    paper, ours = (', '.join(map(str, local)) for local in (PAPER_CHOICES, choices))
    return f"""\
- In the paper the local choices are {paper}. Goal {PAPER_GOAL} is followed, by global action 5.
  The global policy reaches the same next state.
- Here, with every action allowed as in the paper, the local choices are {ours}. The least cost
  is that of goal {least}, the largest that of goal {most}. Global action {best} is optimal.
  The same is chosen by: {alike or 'none'}.

In this state goal 1 is achieved and goal 2 is out of range. The paper publishes neither weights
nor probabilities, so its values cannot be found again. Those of the case study are this project's
own."""


def _draw(agreements: dict[str, Agreement], file: Path) -> None:
    """Draw the share of states whose loss is above x."""
    figure, axes = drawing('paper').subplots(figsize=(7, 4))
    below = np.linspace(0, 1, 401)
    for name, agreement in agreements.items():
        if name != 'exact':
            losses = 100 * np.quantile(agreement.loss, below)
            axes.semilogx(np.maximum(losses, 1e-5), 100 * (1 - below), label=name)
    axes.set(xlabel='loss [%]', ylabel='states above it [%]', xlim=(1e-4, None))
    axes.legend()
    axes.grid(alpha=0.3)
    figure.tight_layout()
    save(figure, file)


if __name__ == '__main__':
    raise SystemExit(main())
