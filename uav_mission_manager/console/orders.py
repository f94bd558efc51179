"""What an operator may order from the page: by which words, and what is asked before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uav_mission_manager.mdp import THREAT_LEVELS, Mission, StateSpace

PRIORITY_NAMES = ('none', 'low', 'high')
"""Names of the priorities 0, 1 and 2."""


@dataclass(frozen=True)
class OperatorOrder:
    """Something to be done to a vehicle.

    Attributes
    ----------
    vehicle : str
        Its namespace.
    kind : str
        A key of `QUESTIONS`.
    values : tuple of int
        The priorities, or the number of the threat level.
    """

    vehicle: str
    kind: str
    values: tuple[int, ...] = ()


QUESTIONS = {
    'hold': 'Hold {vehicle}? In flight it stops where it is and hovers, on the ground it stays '
    'there, until Resume.',
    'resume': 'Resume {vehicle}? Command goes back to the manager, whatever the flight mode is, '
    'and the vehicle flies what the manager commands.',
    'reload': 'Reload the policy set of {vehicle}? The manager reads its folder again.',
    'priorities': 'Ask {vehicle} for: {what}? This replaces all that was asked for before.',
    'threat': 'Tell {vehicle} that the threat is {what}? A detector that reports again overrides '
    'it.',
}
"""What is asked before an order is given."""


def standing_priorities(
    mission: Mission, asked: Sequence[int], state: Sequence[int]
) -> tuple[int, ...]:
    """Return the priorities that an order begins with: an operator changes some of them.

    They are as asked for. Those of goals that were requested in flight, which nobody may have
    asked the base station for, are as the manager holds them.

    Parameters
    ----------
    mission : Mission
    asked : sequence of int
        What the base station asks for; it may leave added goals out.
    state : sequence of int
        That was last decided in; empty for none.
    """
    space, none = StateSpace.of(mission), (0,) * mission.k
    held = space.split(np.array(state)).g if len(state) == len(space.names) else none
    return tuple(
        int(held[j] if goal.slot or j >= len(asked) else asked[j])
        for j, goal in enumerate(mission.goals)
    )


def question(order: OperatorOrder, mission: Mission | None) -> str:
    """Return what to ask before an order is given."""
    what = ''
    if order.kind == 'threat':
        what = THREAT_LEVELS[order.values[0]]
    elif order.kind == 'priorities' and mission is not None:
        pairs = zip(mission.goals, order.values)
        what = ', '.join(f'{goal.name} {PRIORITY_NAMES[g]}' for goal, g in pairs)
    return QUESTIONS[order.kind].format(vehicle=order.vehicle, what=what)
