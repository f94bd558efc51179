"""The actions: 2k+4 global ones, six local ones for the sub-MDP of one goal, and their maps.

Goals are counted from 0 here, as in `Mission.goals`. Only the state's c, and the names of actions
in the paper, count them from 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from uav_mission_manager.mdp.mission import Mission


class ActionKind(Enum):
    """What an action asks for."""

    NONE = 'none'
    COMMIT = 'commit'
    RECHARGE = 'recharge'
    REPAIR = 'repair'


@dataclass(frozen=True)
class Action:
    """One global action.

    Attributes
    ----------
    number : int
        From 1, as in the paper's table 3.
    kind : ActionKind
    goal : int or None
        The goal committed to, from 0; None where there is none.
    agile : bool
        m': the mode flown in.
    destination : int
        Cell flown to.
    """

    number: int
    kind: ActionKind
    goal: int | None
    agile: bool
    destination: int

    @property
    def commitment(self) -> int:
        """c': the goal committed to, from 1; 0 where there is none."""
        return 0 if self.goal is None else self.goal + 1


def global_actions(mission: Mission) -> tuple[Action, ...]:
    """Return all 2k+4 actions of a mission (the paper's table 3); number n stands at n - 1."""
    grid = mission.grid
    actions: list[tuple[ActionKind, int | None, bool, int]] = []
    for agile in (False, True):
        actions.append((ActionKind.NONE, None, agile, grid.base))
        for j, goal in enumerate(mission.goals):
            actions.append((ActionKind.COMMIT, j, agile, goal.cell))
    for kind in (ActionKind.RECHARGE, ActionKind.REPAIR):
        actions.append((kind, None, False, grid.service))
    return tuple(Action(number, *action) for number, action in enumerate(actions, 1))


def action_name(mission: Mission, action: Action) -> str:
    """Name of an action for people and for the command topic, such as `commit goal1 agile`."""
    if action.kind in (ActionKind.RECHARGE, ActionKind.REPAIR):
        return action.kind.value
    what = 'none' if action.goal is None else f'commit {mission.goals[action.goal].name}'
    return f'{what} {"agile" if action.agile else "normal"}'


def local_actions(k: int, goal: int) -> tuple[int, ...]:
    """Global numbers of the local actions 1..6 for a goal from 0 (the paper's table 4)."""
    return (1, 2 + goal, k + 2, k + 3 + goal, 2 * k + 3, 2 * k + 4)


def local_to_global(action: int, goal: int, k: int) -> int:
    """Global number of a local action 1..6 in the sub-MDP of a goal from 0."""
    return local_actions(k, goal)[action - 1]


def global_to_local(action: int, goal: int, k: int) -> int | None:
    """Local number of a global action, None where the goal's sub-MDP has no such action."""
    numbers = local_actions(k, goal)
    return numbers.index(action) + 1 if action in numbers else None
