"""Which actions are allowed in a state.

`strict` missions allow

- commitment to goal j only where g_j > 0, r_j = 1 and completion(f) > 0;
- recharging only where some r_j = 0;
- repair only where f > 1.

`paper` missions allow every action everywhere, as the paper does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.actions import ActionKind, global_actions
from uav_mission_manager.mdp.arrays import BoolArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace


@dataclass(frozen=True)
class Feasibility:
    """The rule in factors: an action is allowed where all that concern it say so.

    Attributes
    ----------
    by_fault : bool array (2k+4, 8)
        Whether the fault mode f allows each action.
    by_goal : bool array (3, 2)
        Whether g_j and r_j allow commitment to goal j.
    needs_lost_range : bool array (2k+4,)
        Whether the action is allowed only where some r_j = 0.
    """

    by_fault: BoolArray
    by_goal: BoolArray
    needs_lost_range: BoolArray


def feasibility(mission: Mission) -> Feasibility:
    """Return the mission's feasibility rule."""
    kinds = [action.kind for action in global_actions(mission)]
    by_fault = np.ones((len(kinds), 8), dtype=bool)
    by_goal = np.ones((3, 2), dtype=bool)
    needs_lost_range = np.zeros(len(kinds), dtype=bool)
    if mission.feasibility == 'strict':
        by_goal[0] = by_goal[:, 0] = False
        completes = np.array(mission.faults.completion) > 0
        for a, kind in enumerate(kinds):
            if kind is ActionKind.COMMIT:
                by_fault[a] = completes
            elif kind is ActionKind.REPAIR:
                by_fault[a, 0] = False
            needs_lost_range[a] = kind is ActionKind.RECHARGE
    return Feasibility(by_fault, by_goal, needs_lost_range)


def allowed_actions(mission: Mission, states: ArrayLike) -> BoolArray:
    """Whether each action is allowed in states (N, 2k+5), shape (N, 2k+4). Raises `StateError`."""
    space, rule = StateSpace.of(mission), feasibility(mission)
    s = space.split(space.check(states))
    allowed = rule.by_fault[:, s.f - 1].T
    for column, action in zip(allowed.T, global_actions(mission)):
        if action.goal is not None:
            column &= rule.by_goal[s.g[:, action.goal], s.r[:, action.goal]]
    allowed[:, rule.needs_lost_range] &= (s.r == 0).any(axis=1)[:, None]
    return allowed
