# PYTHON_ARGCOMPLETE_OK
"""`policy_query`: what a policy does in one state, and why."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from uav_mission_manager.cli.errors import CommandParser, one_line_errors
from uav_mission_manager.cli.state_argument import STATE_FORM, parse_state
from uav_mission_manager.mdp import action_name, global_actions
from uav_mission_manager.policy import Policy, load_policy


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('policy_query'):
        options = _parser().parse_args(args)
        policy = load_policy(options.policy)
        answer = _answer(policy, parse_state('--state', options.state))
        if options.json:
            print(json.dumps(answer, allow_nan=False))
        else:
            _print(policy, answer)
        return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='policy_query', description='Show the Q values and the choice of a policy in a state.'
    )
    parser.add_argument('policy', help='directory of the policy set')
    parser.add_argument(
        '--state',
        required=True,
        help=STATE_FORM,
    )
    parser.add_argument('--json', action='store_true', help='print JSON')
    return parser


def _answer(policy: Policy, state: list[int]) -> dict[str, Any]:
    decision, mission = policy.decide(state), policy.mission
    row = np.array([state])
    names = [goal.name for goal in mission.goals]
    parts = zip(policy.parts, policy.part_values(row)[0])
    number = int(policy.plan.part_of(row)[0])
    part = policy.plan.parts[number - 1]
    return {
        'state': dict(zip(policy.space.names, state)),
        'actions': [
            {
                'number': action.number,
                'action': action_name(mission, action),
                'q': q if math.isfinite(q) else None,
            }
            for action, q in zip(global_actions(mission), decision.values)
        ],
        'choice': decision.action.number,
        'runner_up': decision.runner_up.number if decision.runner_up else None,
        'margin': decision.margin if decision.runner_up else None,
        'reason': decision.reason,
        'lower_bound': decision.lower_bound,
        'upper_bound': decision.upper_bound if math.isfinite(decision.upper_bound) else None,
        'upper_bound_holds': policy.upper_bound_holds,
        'sub_mdps': [
            {'goals': [names[j] for j in goals], 'value': float(value)} for goals, value in parts
        ],
        'decided_by': [[names[j] for j in goals] for goals in policy.parts_behind(row)],
        'plan_part': {
            'number': number,
            'kind': part.kind,
            'goals': [names[j] for j in part.goals],
            'states': part.states,
        },
    }


def _print(policy: Policy, answer: dict[str, Any]) -> None:
    width = None if Console().is_terminal else 100
    console = Console(width=width, markup=False, emoji=False)  # Goals may be called [b] or :b:.
    console.print(f'state {policy.space.text(tuple(answer["state"].values()))}')
    table = Table('number', 'action', 'Q', '', title=f'{policy.mission.name}, {policy.method}')
    marks = {answer['choice']: 'choice', answer['runner_up']: 'runner-up'}
    for action in answer['actions']:
        allowed = action['q'] is not None
        q = f'{action["q"]:.6f}' if allowed else ''
        mark = marks.get(action['number'], '') if allowed else 'not allowed'
        table.add_row(str(action['number']), action['action'], q, mark)
    console.print(table)
    console.print(f'why: {answer["reason"]}', highlight=False)
    console.print(f'lower bound on V*: {answer["lower_bound"]:.6f}')
    if answer['upper_bound'] is not None:
        upper, holds = answer['upper_bound'], answer['upper_bound_holds']
        console.print(f'upper bound on the cost of this policy: {upper:.6f} ({holds})')
    for sub in answer['sub_mdps']:
        console.print(f'sub-MDP of {", ".join(sub["goals"])}: V = {sub["value"]:.6f}')
    decided = ['+'.join(goals) for goals in answer['decided_by']]
    console.print(f'decided by the sub-MDPs of: {", ".join(decided) or "the common costs"}')
    part = answer['plan_part']
    console.print(
        f'phi: sub-MDP {part["number"]} of {len(policy.plan.parts)} in the plan '
        f'({part["kind"]}, {", ".join(part["goals"])}, {part["states"]:,} states)'
    )


if __name__ == '__main__':
    raise SystemExit(main())
