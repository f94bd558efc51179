"""Sub-MDPs: the mission seen through some of its goals.

A sub-MDP tracks f, l, t and m, and of every goal in its cluster r_j, g_j and whether the UAV is
committed to it. The whole mission is the sub-MDP of all goals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.actions import Action, global_actions, local_actions
from uav_mission_manager.mdp.mission import Mission


@dataclass(frozen=True)
class SubMdp:
    """A sub-MDP.

    Attributes
    ----------
    mission : Mission
    goals : tuple of int
        Goals tracked, counted from 0, ascending.
    numbers : tuple of int
        Numbers of the global actions it may choose from.
    share : float
        Its part of the costs all goals share: fault, distance, service and threat.
    way : bool
        Whether the cost h of the way and of a service counts; the paper's Eq. (local_cost) has
        none.
    """

    mission: Mission
    goals: tuple[int, ...]
    numbers: tuple[int, ...]
    share: float = 1.0
    way: bool = True

    @property
    def n(self) -> int:
        """Number of goals tracked."""
        return len(self.goals)

    @cached_property
    def actions(self) -> tuple[Action, ...]:
        """The actions it may choose from."""
        everything = global_actions(self.mission)
        return tuple(everything[number - 1] for number in self.numbers)

    @property
    def states(self) -> int:
        """Number of states: 8 * 2^n * 3^n * q * (n+1) * 3 * 2."""
        return 8 * 6**self.n * self.mission.grid.q * (self.n + 1) * 6

    @property
    def entries(self) -> int:
        """Number of unknowns: q cells and n goals' sites, times 3 * 8 * 2^n * 3^n."""
        return (self.mission.grid.q + self.n) * 24 * 6**self.n

    def slot(self, action: Action) -> int | None:
        """Position in `goals` of the goal an action commits to, None where it tracks none."""
        goal = action.goal - 1
        return self.goals.index(goal) if goal in self.goals else None

    def allowed(self, action: Action) -> NDArray[np.bool_]:
        """Where the mission's feasibility rule allows an action.

        Over (g_j, f, r) with j the goal that the action commits to, shape (3, 8, 2^n); over
        (1, f, r) where that is none or not tracked. A rule that asks for what is not tracked
        does not restrict.
        """
        mission, slot = self.mission, self.slot(action)
        allowed = np.ones((1 if slot is None else 3, 8, 2**self.n), dtype=bool)
        if mission.feasibility == 'seed' or action.kind == 'none':
            return allowed
        if action.kind == 'commit':
            allowed &= (np.array(mission.faults.completion) > 0)[:, None]
            if slot is not None:
                allowed &= self.flags[slot] == 1
                allowed[0] = False
        elif action.kind == 'recharge':
            if self.n == mission.k:
                allowed &= (self.flags == 0).any(axis=0)
        else:
            allowed[:, 0] = False
        return allowed

    @cached_property
    def weights(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """eta_j and delta_j of the goals tracked, each of shape (n,)."""
        goals = [self.mission.goals[j] for j in self.goals]
        return np.array([goal.eta for goal in goals]), np.array([goal.delta for goal in goals])

    def columns(self, states: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Columns r and g of the goals tracked in global states (N, 2k+5), each (N, n)."""
        chosen = np.array(self.goals, dtype=np.intp)
        return states[:, 1 + chosen], states[:, 1 + self.mission.k + chosen]

    def allowed_in(self, states: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether each action is allowed in global states (N, 2k+5), shape (N, actions)."""
        mission, (r, g) = self.mission, self.columns(states)
        allowed = np.ones((len(states), len(self.actions)), dtype=bool)
        if mission.feasibility == 'seed':
            return allowed
        f, wanted = states[:, 0] - 1, (r == 1) & (g > 0)
        able = np.array(mission.faults.completion)[f] > 0
        for column, action in zip(allowed.T, self.actions):
            if action.kind == 'commit':
                slot = self.slot(action)
                column[:] = able if slot is None else able & wanted[:, slot]
            elif action.kind == 'recharge' and self.n == mission.k:
                column[:] = (r == 0).any(axis=1)
            elif action.kind == 'repair':
                column[:] = f > 0
        return allowed

    @cached_property
    def flags(self) -> NDArray[np.int64]:
        """r_j for every joint range flag, shape (n, 2^n)."""
        return np.indices((2,) * self.n).reshape(self.n, 2**self.n)

    @cached_property
    def priorities(self) -> NDArray[np.int64]:
        """g_j for every joint priority, shape (n, 3^n)."""
        return np.indices((3,) * self.n).reshape(self.n, 3**self.n)


def whole_mission(mission: Mission) -> SubMdp:
    """Return the mission itself as a sub-MDP."""
    return SubMdp(mission, tuple(range(mission.k)), tuple(range(1, 2 * mission.k + 5)))


def goal_sub_mdps(mission: Mission) -> tuple[SubMdp, ...]:
    """Return the paper's goal-wise sub-MDPs: one goal, six local actions, Eq. (local_cost)."""
    return tuple(
        SubMdp(mission, (j,), local_actions(mission.k, j + 1), way=False)
        for j in range(mission.k)
    )


def split_sub_mdps(mission: Mission) -> tuple[SubMdp, ...]:
    """Return one sub-MDP a goal with every action kept and the shared costs split evenly."""
    numbers = tuple(range(1, 2 * mission.k + 5))
    return tuple(SubMdp(mission, (j,), numbers, 1.0 / mission.k) for j in range(mission.k))
