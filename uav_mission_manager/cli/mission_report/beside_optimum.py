"""A policy beside the optimal one, and the sub-MDPs behind it: the paper's figures of these."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

import numpy as np

from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.console.markup import bars_html
from uav_mission_manager.console.view import Bar
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission, StateSpace, action_name, global_actions
from uav_mission_manager.mdp.arrays import IntArray
from uav_mission_manager.policy import ExactPolicy, Policy, RecombinedPolicy, build_policy
from uav_mission_manager.policy.recombined_policy import RECOMBINATIONS
from uav_mission_manager.solver.evaluation import start_state
from uav_mission_manager.solver.evaluation.likeliest import likeliest_next

MOST_COMPARED = 400_000
"""States that are all compared: a choice, some seconds and three goals; of more some are drawn."""

DRAWN_STATES = 10_000
"""States that are drawn then: a choice, by which a share is known to 1 % or better. Their Q values
take too long, so that it is not said how many actions are as good."""

NEAR = 1e-3
"""Actions whose Q is within this of V*, relative to it, are as good as optimal: a choice."""


def _looked_at(mission: Mission) -> dict[str, IntArray]:
    """The start, and what else a page is about, by what they are called."""
    start = start_state(mission)
    threatened = start.copy()
    threatened[:, -2] = len(mission.threat.levels) - 1
    return {
        'at the start': start,
        f'at the start, threat {mission.threat.levels[-1]}': threatened,
    }


def sub_mdp_values(policy: Policy) -> Iterator[str]:
    """Yield what each goal's sub-MDP expects to pay, and what it would do by itself."""
    if not isinstance(policy, RecombinedPolicy):
        return
    yield '<h3>Values and actions of the sub-MDPs</h3>'
    mission = policy.mission
    for name, state in _looked_at(mission).items():
        values = [float(q.min()) for q in policy.local_values(state)]
        numbers = policy.local_choices(state)[0].tolist()
        behind = policy.parts_behind(state)
        most = max(values)
        bars = [
            Bar(
                f'{shown(mission.goals[goals[0]].name, 40)}: {_action(mission, number)}',
                f'{value:.4g}',
                value / most if most else 0.0,
                'choice' if goals in behind else '',
            )
            for goals, value, number in zip(policy.parts, values, numbers)
        ]
        yield bars_html(f'{name}: expected cost of each sub-MDP, and its own action', bars)
        yield page.note(
            f'Taken together they choose: {_action(mission, int(policy.act(state)[0]))}.'
        )
    yield page.note('Bold: whose values decide.')


def beside_optimum(policy: Policy, optimum: ExactPolicy) -> Iterator[str]:
    """Yield how a policy, and the paper's own, act beside the optimal one."""
    policies: dict[str, Policy] = {f'{policy.method}: this policy set': policy}
    if policy.method != optimum.method:
        policies['exact: the optimal policy'] = optimum
    for method in RECOMBINATIONS:
        if method != policy.method:
            policies[f'{method}, built anew'] = build_policy(optimum.mission, method)
    yield from _agreement(policies, optimum)
    yield from _next_states(policies, optimum.mission)


def _agreement(policies: dict[str, Policy], optimum: ExactPolicy) -> Iterator[str]:
    yield '<h3>In how many states it acts as the optimal policy</h3>'
    states, drawn = _compared(optimum)
    best = optimum.act(states)
    q = optimum.q_values(states) if len(states) == optimum.space.size else None
    bars: list[Bar] = []
    rows = []
    for name, policy in policies.items():
        actions = policy.act(states)
        same = actions == best
        bars.append(Bar(name, f'{same.mean():.1%}', float(same.mean()), '' if bars else 'choice'))
        counts = f'{same.sum():,}', f'{(~same).sum():,}'
        row = [name, *counts, f'{same.mean():.1%}']
        if q is not None:
            near = q[np.arange(len(q)), actions - 1] <= (1 + NEAR) * q.min(axis=1)
            row.append(f'{near.mean():.1%}')
        rows.append(row)
    yield bars_html('states with the same action as the optimal policy', bars)
    heads = ('policy', 'same action', 'another', 'same', 'as good, to 0.1 %')
    yield page.table(heads[: len(rows[0])], rows, range(1, 5))
    yield page.note(
        f'{drawn} Most states are hardly ever met in flight, so a share says little of the cost: '
        'that is under "How good it is".'
    )


def _next_states(policies: dict[str, Policy], mission: Mission) -> Iterator[str]:
    yield '<h3>What most likely follows</h3>'
    names = StateSpace.of(mission).names
    for title, state in _looked_at(mission).items():
        before = tuple(state[0].tolist())
        rows = [('now', '', *map(str, before), '')]
        for name, policy in policies.items():
            number = int(policy.act(state)[0])
            after, chance = likeliest_next(mission, before, number)
            done = _action(mission, number)
            rows.append((name, done, *map(str, after), f'{chance:.0%}'))
        yield f'<p>{escape(title.capitalize())}:</p>'
        heads = ('', 'does', *names, 'chance')
        yield page.table(heads, rows, range(2, len(heads)))
    yield page.note(
        'The likeliest next state by each policy, and its chance. f: fault mode, 1 for none; '
        'r: in range, or b: charge; g: priorities of the goals; l: cell; c: goal committed to; '
        't: threat; m: agile.'
    )


def _compared(optimum: ExactPolicy) -> tuple[IntArray, str]:
    """States to compare in, and which they are in words."""
    space = optimum.space
    if space.size <= MOST_COMPARED:
        return space.states(), f'Of all {space.size:,} states.'
    states = space.draw(DRAWN_STATES, np.random.default_rng(0))
    return states, f'Of {DRAWN_STATES:,} states, drawn evenly from {space.size:,}.'


def _action(mission: Mission, number: int) -> str:
    return shown(action_name(mission, global_actions(mission)[number - 1]), 60)
