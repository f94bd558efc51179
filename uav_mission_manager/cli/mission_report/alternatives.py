"""What else might have been done, by what a decision says that each action would cost."""

from __future__ import annotations

import math

from uav_mission_manager.console.heard import HeardDecision
from uav_mission_manager.mdp import Action, Mission, global_actions
from uav_mission_manager.onboard import format_command


def _values(mission: Mission, decision: HeardDecision) -> dict[str, tuple[Action, float]]:
    """Action and expected cost of each command."""
    return {
        format_command(mission, action): (action, value)
        for action, value in zip(global_actions(mission), decision.values)
    }


def other_destination(mission: Mission, decision: HeardDecision) -> tuple[str, float] | None:
    """Return the best command to another destination, and what it would cost more.

    None where the second best is one already, or nothing else was allowed.
    """
    values = _values(mission, decision)
    chosen, second = values.get(decision.command), values.get(decision.runner_up)
    if chosen is None or second is None or _aim(chosen[0]) != _aim(second[0]):
        return None
    others = [
        (value - chosen[1], command)
        for command, (action, value) in values.items()
        if _aim(action) != _aim(chosen[0]) and math.isfinite(value)
    ]
    return min(others)[::-1] if others else None


def _aim(action: Action) -> tuple[object, ...]:
    return action.kind, action.goal


def then_and_now(
    mission: Mission, before: HeardDecision, after: HeardDecision
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return what a new command and the one before were expected to cost: earlier, and now.

    None where either was not allowed at one of these times.
    """
    commands = after.command, before.command
    found = []
    for decision in before, after:
        values = _values(mission, decision)
        new, old = (values[c][1] if c in values else math.inf for c in commands)
        if not (math.isfinite(new) and math.isfinite(old)):
            return None
        found.append((new, old))
    return found[0], found[1]
