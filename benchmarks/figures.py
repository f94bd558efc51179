"""The paper's figures, drawn on this project's data.

    make bench SCRIPTS=benchmarks/figures.py

Writes figures.md and figures/*.svg. Some seconds on an idle processor.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from parts import pages
from parts.agreement import (
    PAPER_CHOICES,
    PAPER_GOAL,
    SAMPLE,
    Chain,
    Optimum,
)
from parts.missions import case_study
from parts.pictures import BLUE, GREEN, ORANGE, PURPLE, SKY, drawing, save

from uav_mission_manager import build_policy
from uav_mission_manager.mdp import Mission, global_to_local
from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.mdp.dynamics import landings
from uav_mission_manager.solver.exact import AxisModel, Sweeper
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import whole_mission

LAST_RESIDUAL = 1e-6
"""Sup norm below which the paper's test stops, "typically"."""

METHODS = {
    'best_value': 'best value\n(paper)',
    'highest_priority': 'highest\npriority\n(paper)',
    'split': 'split',
    'expansion': 'expansion',
}
"""Recombined policies, and what the picture calls them."""

RULES = {'strict': ('strict', BLUE), 'paper': ('all allowed', ORANGE)}
"""Rules of what is allowed: what the picture calls them, and their bars."""

RAISED, ACHIEVED, THREATENED, EPOCHS = 3, 5, 7, 9
"""Case I: epochs in which the base station raises goal 1 to high, in which it is achieved, in
which the threat is high; and the last one."""

THREAT_AND_MODE = ('threat none', 'low', 'high', 'mode normal', 'agile')
"""Marks of the panel that shows both, one above the other."""

LOCAL_ACTIONS = ('none', 'commit', 'none, agile', 'commit, agile', 'recharge', 'repair')
"""Names of the local actions 1 to 6."""


def main() -> int:
    """Draw the figures and write their page."""
    options = pages.parser(__doc__.splitlines()[0]).parse_args()
    folder = pages.folder(options)
    (folder / 'figures').mkdir(exist_ok=True)
    optima = {
        rule: Optimum(dataclasses.replace(case_study(3), feasibility=rule)) for rule in RULES
    }
    sections = [
        INTRODUCTION,
        SCALABILITY,
        _convergence(folder),
        _case_one(folder),
        _sample_values(folder, optima['paper']),
        _agreement(folder, optima),
        _next_state(folder, optima['paper']),
    ]
    pages.publish(folder / 'figures.md', "The paper's figures on our data", sections)
    return 0


INTRODUCTION = """\
The paper's figures that show results, drawn anew. The paper publishes neither weights nor
probabilities, so what can agree is the shape, not the numbers; the mission is
`config/case_study.yaml`, one goal is `config/case_one.yaml`. The paper's other figures are block
diagrams and screens of text. [reproduce.md](reproduce.md) has all tables and figures."""

SCALABILITY = """\
## Fig. 3: scalability

![Solve time against states](scaling.svg)

**Agrees in shape, not in scale.** Time grows with a power of the number of states, as in the
paper: here nearly in proportion to it, in the paper faster. `make bench
SCRIPTS=benchmarks/solve.py` draws it; the numbers are in
[benchmarks.md](benchmarks.md#the-papers-tables)."""


def _residuals(mission: Mission) -> Iterator[SpanBounds]:
    """Changes of W in each sweep of value iteration in float64, from W = 0."""
    model = AxisModel(whole_mission(mission))
    sweeper = Sweeper(model, model.zero())
    while True:
        bounds = SpanBounds(*sweeper.backup(), mission.discount)
        yield bounds
        if max(-bounds.low, bounds.high) < LAST_RESIDUAL:
            return


def _convergence(folder: Path) -> str:
    """Draw the sup norm of the Bellman residual and the distance from V*, sweep by sweep."""
    figure, axes = drawing('convergence').subplots(figsize=(7, 3.8), layout='constrained')
    sweeps, enough = {}, {}
    for k, color in ((1, BLUE), (3, ORANGE)):
        bounds = list(_residuals(case_study(k)))
        number = np.arange(1, len(bounds) + 1)
        norms = [max(-b.low, b.high) for b in bounds]
        distances = np.array([b.distance for b in bounds])
        sweeps[k], enough[k] = len(bounds), int(number[distances <= LAST_RESIDUAL][0])
        until = distances > LAST_RESIDUAL / 10
        name = f'{k} goal{"s" * (k > 1)}'
        axes.semilogy(number, norms, color=color, label=f'{name}: sup norm of the residual')
        label = f'{name}: bound on the distance from V*'
        axes.semilogy(number[until], distances[until], '--', color=color, label=label)
    axes.set(xlabel='sweep', ylabel='cost', xlim=(0, None), ylim=(LAST_RESIDUAL / 10, None))
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    save(figure, folder / 'figures' / 'convergence.svg')
    return f"""\
## Fig. 5: convergence of value iteration

![Residual and bound by sweep](figures/convergence.svg)

**Agrees in what the paper's text says**: value iteration converges. Once the policy is settled,
the sup norm of V^(n+1) - V^n falls by the factor gamma a sweep. It is below {LAST_RESIDUAL:g}
after {sweeps[1]} sweeps for one goal, {sweeps[3]} for three, where the paper stops. Span bounds
tell V* to within {LAST_RESIDUAL:g} after {enough[1]} and {enough[3]}, where this solver stops if
that is asked for ([model.md](model.md#when-value-iteration-stops))."""


def _fly_case_one() -> IntArray:
    """States [f r g l c t m] of Case I, epoch by epoch."""
    policy = build_policy(case_study(1), 'exact')
    after = landings(policy.mission)
    states, cell, commitment, mode = [], policy.mission.grid.base, 0, 0
    for epoch in range(1, EPOCHS + 1):
        g = 2 * (RAISED <= epoch <= ACHIEVED)
        state = (1, 1, g, cell, commitment, 2 * (epoch == THREATENED), mode)
        action = policy.decide(state).action
        states.append(state)
        cell, mode = int(after[action.number - 1, cell]), int(action.agile)
        commitment = 0 if epoch == ACHIEVED else action.commitment
    return np.array(states)


def _case_one(folder: Path) -> str:
    """Draw the four panels of Case I."""
    states, epochs = _fly_case_one(), np.arange(1, EPOCHS + 1)
    g, cell, commitment, threat, mode = states.T[2:]
    figure, panels = drawing('case_one').subplots(
        2, 2, figsize=(8, 5), sharex=True, layout='constrained'
    )
    shown = (
        ('(a) goal priority', {'goal 1': g}, ('none', 'low', 'high')),
        ('(b) threat and mode', {'threat': threat, 'mode': mode + 3}, THREAT_AND_MODE),
        ('(c) location', {'cell': cell}, range(8)),
        ('(d) commitment', {'commitment': commitment}, ('none', 'goal 1')),
    )
    for axes, (title, lines, ticks) in zip(panels.flat, shown):
        for (name, values), color, style in zip(lines.items(), (BLUE, ORANGE), ('-o', '--s')):
            axes.step(epochs, values, style, where='post', color=color, ms=5, label=name)
        axes.set_title(title, fontsize=10)
        axes.set_yticks(range(len(ticks)), ticks)
        axes.set_ylim(-0.3, len(ticks) - 0.7)
        axes.set_xticks(epochs)
        axes.grid(alpha=0.3)
    panels[1, 0].set_ylabel('cell')
    for axes in panels[1]:
        axes.set_xlabel('epoch')
    save(figure, folder / 'figures' / 'case_one.svg')
    committed, agile = epochs[commitment > 0][0], epochs[mode > 0][0]
    home = epochs[cell > 0][-1] + 1
    return f"""\
## Fig. 6: Case I

![Priority, threat and mode, location, commitment by epoch](figures/case_one.svg)

**Agrees in what is done, epoch by epoch.** The events are scripted: the base station raises goal
1 in epoch {RAISED}, the threat is high in epoch {THREATENED}. The optimal policy does the rest. It
is committed in epoch {committed} and in cell 5 in epoch {ACHIEVED}; priority and commitment are 0
in epoch {ACHIEVED + 1}. The threat is answered in its own epoch by an agile action, and the next
action is a normal one, as in the paper; the mode in the picture is that of the action before, so
it is agile in epoch {agile}. The UAV is home in epoch {home}."""


def _sample_values(folder: Path, optimum: Optimum) -> str:
    """Draw value and action of each sub-MDP in the sample state."""
    state = np.array([SAMPLE])
    policy = build_policy(optimum.mission, 'best_value')
    values = [-float(q.min()) for q in policy.local_values(state)]
    chosen = policy.local_choices(state)[0].tolist()
    actions = [global_to_local(number, j, optimum.mission.k) for j, number in enumerate(chosen)]
    goals, followed = np.arange(1, len(values) + 1), int(np.argmax(values)) + 1
    figure, (left, right) = drawing('sub_mdps').subplots(
        1, 2, figsize=(8, 3.4), layout='constrained'
    )
    colors = [GREEN if goal == followed else SKY for goal in goals]
    bars = left.bar(goals, values, color=colors, width=0.6)
    left.bar_label(bars, fmt='%.1f', padding=-14, fontsize=9)
    left.set(ylabel='value of the best action, -Q [cost]', title='(a) values')
    right.bar(goals, actions, color=colors, width=0.6, label='here')
    right.plot(goals, PAPER_CHOICES, 'D', color='black', fillstyle='none', ms=8, label='paper')
    right.set_yticks(range(1, 7), [f'{n} {name}' for n, name in enumerate(LOCAL_ACTIONS, 1)])
    right.set(title='(b) local actions', ylim=(0, 6.5))
    right.legend(fontsize=8, loc='upper right')
    for axes in (left, right):
        axes.set_xticks(goals, [f'goal {goal}' for goal in goals])
        axes.grid(axis='y', alpha=0.3)
        axes.set_axisbelow(True)
    save(figure, folder / 'figures' / 'sub_mdps.svg')
    ours, paper = (', '.join(map(str, local)) for local in (actions, PAPER_CHOICES))
    return f"""\
## Fig. 9: values and actions of the sub-MDPs

![Value and action of each goal's sub-MDP](figures/sub_mdps.svg)

**Agrees in part.** In the sample state [{' '.join(map(str, SAMPLE))}], every action allowed as in
the paper, the sub-MDPs choose the local actions {ours}; in the paper {paper}. The one of the
best value, green, is that of goal {followed}; in the paper that of goal {PAPER_GOAL}. Which value
is best depends on weights that the paper does not publish."""


def _agreement(folder: Path, optima: dict[str, Optimum]) -> str:
    """Draw in how many states a recombined policy acts as the optimal one."""
    same = {
        rule: [_same(optimum, method) for method in METHODS] for rule, optimum in optima.items()
    }
    count, places = len(optima['strict'].states), np.arange(len(METHODS))
    figure, (left, right) = drawing('agreement').subplots(
        1, 2, figsize=(8.5, 3.8), layout='constrained'
    )
    for shift, (rule, (name, color)) in zip((-0.2, 0.2), RULES.items()):
        equal, style = np.array([mask.sum() for mask in same[rule]]), {'width': 0.38, 'ec': color}
        left.bar(places + shift, equal / 1e3, color=color, label=f'same, {name}', **style)
        rest = {'bottom': equal / 1e3, 'fc': 'white', 'hatch': '//', 'label': f'different, {name}'}
        left.bar(places + shift, (count - equal) / 1e3, **rest, **style)
        bars = right.bar(places + shift, 100 * equal / count, color=color, label=name, **style)
        right.bar_label(bars, fmt='%.1f', fontsize=7, padding=2)
    claim = right.axhline(100, color='black', ls='--', lw=1, label='as the paper says')
    left.set(ylabel='states [thousands]', title='(a) number of states')
    right.set(ylabel='states with the same action [%]', ylim=(0, 115), title='(b) share')
    for axes in (left, right):
        axes.set_xticks(places, METHODS.values(), fontsize=8)
    handles, labels = left.get_legend_handles_labels()
    handles, labels = [*handles, claim], [*labels, claim.get_label()]
    figure.legend(handles, labels, loc='outside lower center', ncols=5, fontsize=8)
    save(figure, folder / 'figures' / 'agreement.svg')
    shares = {
        method: ' and '.join(f'{100 * masks[column].mean():.1f} %' for masks in same.values())
        for column, method in enumerate(METHODS)
    }
    return f"""\
## Fig. 10: agreement of combined and global policy

![States with the same and with another action](figures/agreement.svg)

**Does not agree.** The paper finds the same action in all {count:,} states. Here its
`best_value` does so in {shares['best_value']}, `highest_priority` in
{shares['highest_priority']}: the first figure is with the strict rule of what is allowed, the
other with every action allowed, as in the paper. Goals share one UAV, so the theorem's conditions
do not hold ([theory.md](theory.md#one-uav)). The expansion acts as the optimum nearly
everywhere. What the other actions cost is in [paper.md](paper.md)."""


def _same(optimum: Optimum, method: str) -> Any:
    policy = build_policy(optimum.mission, method, order=2, certificate=False)
    return policy.act(optimum.states) == optimum.actions


def _next_state(folder: Path, optimum: Optimum) -> str:
    """Draw the likeliest next state of the sample state under three policies."""
    state, chain = np.array([SAMPLE]), Chain(optimum.mission)
    numbers = {'optimal (global)': int(optimum.actions[optimum.space.index(state)[0]])}
    for method in ('highest_priority', 'best_value'):
        policy = build_policy(optimum.mission, method, certificate=False)
        numbers[method] = int(policy.act(state)[0])
    after: dict[str, IntArray] = {}
    for name, number in numbers.items():
        likely = int(chain.successors(SAMPLE, number).argmax())
        after[name] = optimum.space.states([likely])[0]
    figure, axes = drawing('next_state').subplots(figsize=(7, 3.4), layout='constrained')
    places = np.arange(len(SAMPLE))
    axes.plot(places, SAMPLE, '_', color='black', ms=22, label='sample state')
    styles = zip((-0.22, 0.0, 0.22), ('o', 's', '^'), (GREEN, BLUE, PURPLE))
    for (name, values), (shift, marker, color) in zip(after.items(), styles):
        label = f'after {name}: action {numbers[name]}'
        axes.plot(places + shift, values, marker, color=color, ms=7, label=label)
    axes.set_xticks(places, optimum.space.names)
    axes.set(xlabel='state variable', ylabel='value', ylim=(-0.4, None))
    axes.set_yticks(range(9))
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    save(figure, folder / 'figures' / 'next_state.svg')
    best = after['optimal (global)']
    agree = [name for name in ('highest_priority', 'best_value') if (after[name] == best).all()]
    differ = [name for name in ('highest_priority', 'best_value') if name not in agree]
    return f"""\
## Fig. 12: next state

![Next state under the global and the combined policies](figures/next_state.svg)

**Agrees for {_listed(agree)}, not for {_listed(differ)}.** The likeliest next state of the sample
state, every action allowed as in the paper. In the paper the combined policy, `best_value`, and
the global one reach the same next state."""


def _listed(names: list[str]) -> str:
    return ' and '.join(f'`{name}`' for name in names) or 'none'


if __name__ == '__main__':
    raise SystemExit(main())
