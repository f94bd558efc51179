"""The report of a policy set: mission, what it does where, how good it is, what to expect."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from html import escape
from typing import Any

import numpy as np

from uav_mission_manager.cli.check.html_page import finding_list, goal_table, map_legend, summary
from uav_mission_manager.cli.check.plausibility import findings
from uav_mission_manager.cli.check.solving import Solved, obstacle_to_solving, solve
from uav_mission_manager.cli.check.svg_map import svg_map
from uav_mission_manager.cli.check.terminal import SHOWN_SENSITIVITIES
from uav_mission_manager.cli.forecast_view import interval_texts, percent_texts, quantities
from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.cli.mission_report.beside_optimum import (
    beside_optimum,
    sub_mdp_values,
)
from uav_mission_manager.cli.mission_report.policy_maps import (
    MAPS_STYLE,
    fault_rows,
    hatch,
    legend,
    maps_table,
    priority_rows,
)
from uav_mission_manager.console.markup import bars_html
from uav_mission_manager.console.view import part_bars
from uav_mission_manager.console.words import closeness
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.policy import ExpansionPolicy, Policy
from uav_mission_manager.solver.evaluation import start_state
from uav_mission_manager.solver.evaluation.flights import fly
from uav_mission_manager.solver.evaluation.forecast import (
    FORECAST_MINUTES,
    WITHIN_MINUTES,
    forecast,
    forecast_epochs,
)

EPISODES, EXPANSION_EPISODES = 2000, 200
"""Simulated flights of the forecast: choices, of some seconds; an expansion decides slowly."""

MOST_SOLVE_SECONDS = 5.0
"""Longest exact solution, as predicted, that a report waits for [s]: a choice, five goals. What
the cost depends on takes three times as long."""

START = 'at base, all goals at high priority and in range, no fault, no threat'
"""The state that numbers are of, in words."""


def policy_page(policy: Policy, directory: str) -> str:
    """Return the report of a policy set."""
    mission = policy.mission
    unchecked = obstacle_to_solving(mission, MOST_SOLVE_SECONDS)
    solved = None if unchecked else solve(mission)
    found = [*findings(mission), *(solved.findings if solved else ())]
    return page.page(
        f'Policy of mission {shown(mission.name)}',
        (
            f'<style>{MAPS_STYLE}</style>{hatch(mission.grid)}',
            _head(policy, directory),
            '<h2>The mission</h2>',
            f'<p>{escape(summary(mission))}</p>',
            svg_map(mission).replace('<svg ', '<svg class="map" ', 1),
            f'<ul class="legend">{map_legend(mission)}</ul>',
            goal_table(mission),
            finding_list(found),
            '<h2>What it does in each cell</h2>',
            f'<ul class="legend">{legend(mission)}</ul>',
            '<h3>By fault and threat, all goals high and in range</h3>',
            maps_table(policy, fault_rows(mission)),
            '<h3>By priority and threat, without faults</h3>',
            maps_table(policy, priority_rows(mission)),
            *_quality(policy),
            *sub_mdp_values(policy),
            *_beside_optimum(policy, solved, unchecked),
            *_forecast(policy),
            *_sensitivities(mission, solved, unchecked),
        ),
    )


def _head(policy: Policy, directory: str) -> str:
    entries = [
        ('policy set', shown(directory)),
        ('digest', policy.digest),
        ('method', policy.method),
        ('states', f'{policy.space.size:,}'),
        ('goals', str(policy.mission.k)),
    ]
    if policy.certificate:
        entries.append(('certificate', f'its upper bound holds {policy.upper_bound_holds}'))
    warnings = ''.join(f'<p><b>{escape(text)}</b></p>' for text in policy.warnings)
    return page.facts(entries) + warnings


def _quality(policy: Policy) -> Iterator[str]:
    """Bounds, certificate, and the share of each sub-MDP in the cost."""
    yield '<h2>How good it is</h2>'
    start = start_state(policy.mission)
    lower, upper = float(policy.lower_bound(start)[0]), float(policy.upper_bound(start)[0])
    expected = float(policy.q_values(start).min())
    rows = [
        ('expected cost', f'{expected:.6g}'),
        ('no policy costs less than', f'{lower:.6g}' if lower > 0 else 'not known'),
        (
            f'it costs no more than, {policy.upper_bound_holds}',
            f'{upper:.6g}' if math.isfinite(upper) else 'not known',
        ),
        ('so it is', closeness(lower, upper, expected).text),
    ]
    yield page.note(f'From the start: {START}.')
    yield page.table(('', ''), rows)
    if policy.certificate is not None:
        names = {
            'gap': 'mean gap over all states',
            'flown_gap': 'mean gap over the states that are flown',
            'largest_gap': 'largest gap of a state',
        }
        known = policy.certificate.summary()
        yield page.table(
            ('certificate', ''),
            [(name, f'{known[key]:.2%}') for key, name in names.items() if known[key] is not None],
        )
    parts = list(zip(policy.parts, policy.part_values(start)[0].tolist()))
    if len(parts) > 1:
        yield bars_html('share of each sub-MDP in the cost', part_bars(parts, policy.mission))


def _beside_optimum(policy: Policy, solved: Solved | None, unchecked: str) -> Iterator[str]:
    yield '<h2>Beside the optimal policy</h2>'
    if solved is None:
        yield page.note(f'Left out: {unchecked}.')
        return
    yield from beside_optimum(policy, solved.policy)


def _forecast(policy: Policy) -> Iterator[str]:
    yield f'<h2>What to expect in {FORECAST_MINUTES} minutes</h2>'
    mission, start = policy.mission, start_state(policy.mission)
    try:
        epochs = forecast_epochs(mission)
    except Bad as error:
        yield page.note(f'Not known: {error}')
        return
    count = EXPANSION_EPISODES if isinstance(policy, ExpansionPolicy) else EPISODES
    rows = np.repeat(start, count, axis=0)
    flights = fly(mission, policy.act, rows, epochs, np.random.default_rng(0))
    found = asdict(forecast(flights))
    yield page.note(
        f'Of {count:,} simulated flights, {START}; with 95 % intervals. `mission_simulate` '
        'makes more, from any state.'
    )
    heads = ['goal', *(f'done in {limit} min [%]' for limit in WITHIN_MINUTES)]
    heads += ['median [min]', 'withdrawn first [%]']
    yield page.table(heads, [_goal_row(goal) for goal in found['goals']], range(1, len(heads)))
    yield page.table(
        ('', 'estimate', '95 % interval'),
        [(name, *interval_texts(value)) for name, value in quantities(found)],
        (1, 2),
    )


def _goal_row(goal: dict[str, Any]) -> list[str]:
    shares = [percent_texts(goal['done_within'][limit]) for limit in WITHIN_MINUTES]
    median = interval_texts(_finite(goal['median_minutes']), beyond=f'> {FORECAST_MINUTES}')
    cells = [*shares, median, percent_texts(goal['withdrawn'])]
    return [shown(goal['name'], 60), *(f'{value} ({bounds})' for value, bounds in cells)]


def _finite(interval: dict[str, float]) -> dict[str, float | None]:
    return {key: value if math.isfinite(value) else None for key, value in interval.items()}


def _sensitivities(mission: Mission, solved: Solved | None, unchecked: str) -> Iterator[str]:
    yield '<h2>What its cost depends on most</h2>'
    if solved is None:
        yield page.note(f'Left out: {unchecked}. `mission_check` waits longer.')
        return
    yield page.note(
        f'V* from the start is {solved.value:.4f}; it changes by as much where one number of the '
        'mission is 10 % larger, or smaller if it is at its limit; of discount its horizon '
        f'({solved.method}).'
    )
    rows = []
    for s in solved.sensitivities[:SHOWN_SENSITIVITIES]:
        section, _, rest = s.name.partition('.')
        whose = ''
        if section == 'goals':
            whose = shown(mission.goals[int(rest.partition('.')[0])].name, 60)
        change = f'{s.value:.4g} → {s.changed:.4g}'
        rows.append((s.name, whose, change, f'{s.relative:+.2%}'))
    yield page.table(('field', 'goal', 'changed', 'V* changes by'), rows, (2, 3))
