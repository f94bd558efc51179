"""The actions: 2k+4 global ones, six local ones for the sub-MDP of one goal, and their maps."""

from __future__ import annotations

from dataclasses import dataclass

from uav_mission_manager.mdp.mission import Mission


@dataclass(frozen=True)
class Action:
    """One global action.

    Attributes
    ----------
    number : int
        From 1, as in the paper's table 3.
    kind : {'none', 'commit', 'recharge', 'repair'}
    goal : int
        c': the goal committed to, from 1; 0 is none.
    agile : bool
        m': the mode flown in.
    destination : int
        Cell flown to.
    """

    number: int
    kind: str
    goal: int
    agile: bool
    destination: int


def global_actions(mission: Mission) -> tuple[Action, ...]:
    """Return all 2k+4 actions of a mission; action number n stands at n - 1."""
    grid = mission.grid
    actions = []
    for agile in (False, True):
        actions.append(('none', 0, agile, grid.base))
        actions += [('commit', j, agile, goal.cell) for j, goal in enumerate(mission.goals, 1)]
    actions.append(('recharge', 0, False, grid.service))
    actions.append(('repair', 0, False, grid.service))
    return tuple(Action(number, *action) for number, action in enumerate(actions, 1))


def action_name(mission: Mission, action: Action) -> str:
    """Name of an action for people and for the command topic, such as `commit goal1 agile`."""
    if action.kind in ('recharge', 'repair'):
        return action.kind
    what = f'commit {mission.goals[action.goal - 1].name}' if action.goal else 'none'
    return f'{what} {"agile" if action.agile else "normal"}'


def local_actions(k: int, goal: int) -> tuple[int, ...]:
    """Global numbers of the local actions 1..6 for a goal from 1 (the paper's table 4)."""
    return (1, 1 + goal, k + 2, k + 2 + goal, 2 * k + 3, 2 * k + 4)


def local_to_global(action: int, goal: int, k: int) -> int:
    """Global number of a local action 1..6 in the sub-MDP of a goal from 1."""
    return local_actions(k, goal)[action - 1]


def global_to_local(action: int, goal: int, k: int) -> int | None:
    """Local number of a global action, None where the goal's sub-MDP has no such action."""
    numbers = local_actions(k, goal)
    return numbers.index(action) + 1 if action in numbers else None
