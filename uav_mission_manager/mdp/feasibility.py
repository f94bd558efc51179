"""Which actions are allowed in a state.

`strict` missions allow

- commitment to goal j only where g_j > 0, r_j = 1 and completion_j(f) > 0;
- recharging only where some r_j = 0, or where the mission has a charge, where that is not full;
- repair only where f > 1.

`paper` missions allow every action everywhere, as the paper does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uav_mission_manager.mdp.actions import ActionKind, global_actions
from uav_mission_manager.mdp.arrays import BoolArray
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.mdp.dynamics import completion_probabilities
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
    needs_room : bool array (2k+4,)
        Whether the action is allowed only where some r_j = 0, or the charge is not full.
    """

    by_fault: BoolArray
    by_goal: BoolArray
    needs_room: BoolArray


def feasibility(mission: Mission) -> Feasibility:
    """Return the mission's feasibility rule."""
    actions = global_actions(mission)
    by_fault = np.ones((len(actions), 8), dtype=bool)
    by_goal = np.ones((3, 2), dtype=bool)
    needs_room = np.zeros(len(actions), dtype=bool)
    if mission.feasibility == 'strict':
        by_goal[0] = by_goal[:, 0] = False
        completes = completion_probabilities(mission) > 0
        for a, action in enumerate(actions):
            if action.goal is not None:
                by_fault[a] = completes[action.goal]
            elif action.kind is ActionKind.REPAIR:
                by_fault[a, 0] = False
            needs_room[a] = action.kind is ActionKind.RECHARGE
    return Feasibility(by_fault, by_goal, needs_room)


def allowed_actions(mission: Mission, states: ArrayLike) -> BoolArray:
    """Whether each action is allowed in states (N, 2k+5), shape (N, 2k+4). Raises `StateError`."""
    space, rule = StateSpace.of(mission), feasibility(mission)
    s = space.split(space.check(states))
    flags, allowed = RangeFlags(mission)(s), rule.by_fault[:, s.f - 1].T
    for column, action in zip(allowed.T, global_actions(mission)):
        if action.goal is not None:
            column &= rule.by_goal[s.g[:, action.goal], flags[:, action.goal]]
    room = np.less(np.concatenate([s.r, s.b], axis=1), space.charged).any(axis=1)
    allowed[:, rule.needs_room] &= room[:, None]
    return allowed
