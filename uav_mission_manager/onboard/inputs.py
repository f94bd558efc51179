"""What may be wrong with an input."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import Mission

REQUIRED_INPUTS = ('battery_state', 'odom', 'fault_mode')
"""Inputs that a decision needs, each of them fresh."""


class InputError(ValueError):
    """A refused input: one line naming topic, field and value."""


def index_of(name: str, names: Sequence[str], topic: str) -> int:
    """Return where a name stands among those that a topic may have. Raises `InputError`."""
    if name not in names:
        raise InputError(f'{topic}: {quoted(name)} is not one of {shown(", ".join(names))}')
    return names.index(name)


def checked_priorities(values: Sequence[int], mission: Mission) -> tuple[int, ...]:
    """Return priorities of the goals of a mission, where added ones may be left out.

    Who asks may not have heard of goals that were added in flight. Raises `InputError`.
    """
    least = sum(not goal.added for goal in mission.goals)
    if not least <= len(values) <= mission.k:
        counts = str(mission.k) if least == mission.k else f'{least} to {mission.k}'
        raise InputError(f'goal_priorities: data has {len(values)} values, not {counts}')
    for goal, value in zip(mission.goals, values):
        if value not in (0, 1, 2):
            raise InputError(
                f'goal_priorities: {shown(goal.name)} is {shown(value)}, not 0, 1 or 2'
            )
    return tuple(values)


def missing_inputs(ages: Mapping[str, float], timeout: float) -> tuple[str, ...]:
    """Name the required inputs older than `timeout` [s] or never heard, and how old."""
    # A clock set back makes ages negative: as suspect as old ones.
    return tuple(
        f'{topic} {ages[topic]:.1f} s old' if topic in ages else f'{topic} never received'
        for topic in REQUIRED_INPUTS
        if topic not in ages or abs(ages[topic]) > timeout
    )


def silence(ages: Mapping[str, float], timeout: float) -> str:
    """Say why nothing can be decided, '' if it can; what was never heard is not lost."""
    missing = missing_inputs(ages, timeout)
    if not missing:
        return ''
    never = missing == missing_inputs(ages, math.inf)
    return f'{"waiting for data" if never else "link lost"}: {", ".join(missing)}'
