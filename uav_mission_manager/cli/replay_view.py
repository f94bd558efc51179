"""A replay for people: where it decides otherwise, and how often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import StateSpace

MOST_SHOWN = 100
"""Differences that are shown: a choice; `--json` has all."""

DIGITS = 12
"""Of a digest that are shown, as in the manager's log."""


def print_replay(answer: dict[str, Any], spaces: Sequence[StateSpace]) -> None:
    """Print what `mission_replay` found by policies of some spaces of states."""
    policy, flown = answer['policy'], answer['flown_by']
    print(f'{shown(answer["bag"])}: {answer["seconds"]:.1f} s of {answer["mission"]}')
    names = [digest[:DIGITS] or 'a policy without files' for digest in flown]
    print(f'recorded by {", ".join(names) or "nobody"}')
    for each in policy, *answer['further_policies']:
        print(f'replayed by {each["digest"][:DIGITS]}, {each["method"]}: {each["directory"]}')
    differences = answer['differences']
    for difference in differences[:MOST_SHOWN]:
        _print_difference(difference, spaces)
    if len(differences) > MOST_SHOWN:
        print(f'and {len(differences) - MOST_SHOWN:,} more differences, which --json has')
    _print_counts(answer)


def _print_difference(difference: dict[str, Any], spaces: Sequence[StateSpace]) -> None:
    recorded, replayed = difference['recorded'], difference['replayed']
    print(
        f'{difference["seconds"]:.2f} s to {difference["until"]:.2f} s, '
        f'{difference["decisions"]:,} decisions: {_command(recorded)} was commanded, '
        f'now {_command(replayed)}'
    )
    print(f'    recorded {_reason(recorded, replayed, spaces)}')
    print(f'    replayed {_reason(replayed, recorded, spaces)}')


def _command(outcome: dict[str, Any]) -> str:
    return outcome.get('command', 'nothing')


def _reason(outcome: dict[str, Any], other: dict[str, Any], spaces: Sequence[StateSpace]) -> str:
    """State and Q values behind an outcome, and of what the other one chose."""
    if 'refused' in outcome:
        return shown(outcome['refused'])
    state = outcome['state']
    texts = (space.text(state) for space in spaces if len(state) == len(space.names))
    named = next(texts, ' '.join(map(str, state)))
    text = f'in {named}: {outcome["command"]} {_q(outcome)}'
    if outcome['margin'] is not None:
        text += f', margin {outcome["margin"]:.4g} to {outcome["runner_up_command"]}'
    if 'command' in other:
        text += f'; {other["command"]} {_q(outcome, other["action"])}'
    return text


def _q(outcome: dict[str, Any], action: int | None = None) -> str:
    value = outcome['values'][(action or outcome['action']) - 1]
    return 'not allowed' if value is None else f'Q {value:.6g}'


def _print_counts(answer: dict[str, Any]) -> None:
    if answer['manager_starts'] > 1:
        print(f'the manager was started {answer["manager_starts"]:,} times')
    if answer['gaps']:
        print(f'the trace has {answer["gaps"]:,} gaps')
    if answer['not_replayed']:
        print(f'{answer["not_replayed"]:,} decisions not replayed: nothing is known before them')
    print(
        f'{answer["decisions"]:,} decisions: {answer["same"]:,} as recorded, '
        f'{answer["identical"]:,} of them bit for bit; {answer["different"]:,} different'
    )
