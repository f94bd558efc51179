"""Sub-MDPs: the mission seen through some of its goals.

A sub-MDP tracks f, l, t and m, and of every goal in its cluster r_j, g_j and whether the UAV is
committed to it. The whole mission is the sub-MDP of all goals. Its costs are those of
`uav_mission_manager.mdp.cost`, each times the sub-MDP's share of it; its rules are those of
`uav_mission_manager.mdp.feasibility`, as far as they ask for what it tracks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from uav_mission_manager.mdp import cost
from uav_mission_manager.mdp.actions import Action, global_actions, local_actions
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.mdp.feasibility import Feasibility, feasibility
from uav_mission_manager.mdp.mission import THREAT_LEVELS, Mission
from uav_mission_manager.mdp.states import StateSpace


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
        Its part of the costs that all goals share: fault, travel and threat.
    travel : bool
        Whether the travel cost h counts; the paper's Eq. (local_cost) has none.
    goal_shares : tuple of float
        Its part of the cost of each goal tracked; empty where that is all of it.
    """

    mission: Mission
    goals: tuple[int, ...]
    numbers: tuple[int, ...]
    share: float = 1.0
    travel: bool = True
    goal_shares: tuple[float, ...] = ()

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
    def threats(self) -> int:
        """Number T of threat levels."""
        return len(self.mission.threat.levels)

    @property
    def states(self) -> int:
        """Number of states: 8 * 2^n * 3^n * q * (n+1) * T * 2."""
        return state_count(self.n, self.mission.grid.q, 8, self.threats)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of W over the axes l, (t, g), (f, r): (q, T * 3^n, 8 * 2^n)."""
        return self.mission.grid.q, self.threats * 3**self.n, 8 * 2**self.n

    @property
    def entries(self) -> int:
        """Number of unknowns W(l, t, g, f, r)."""
        return math.prod(self.shape)

    def slot(self, action: Action) -> int | None:
        """Position in `goals` of the goal an action commits to, None where it tracks none."""
        return self.goals.index(action.goal) if action.goal in self.goals else None

    @cached_property
    def goal_costs(self) -> FloatArray:
        """Cost of each goal tracked as if uncommitted, over slot, g_j, r_j: (n, 3, 2)."""
        return cost.goal_costs(self.mission)[list(self.goals)] * self._goal_shares

    @cached_property
    def commitment_savings(self) -> FloatArray:
        """What commitment to each goal tracked takes off, over slot, g_j, r_j: (n, 3, 2)."""
        return cost.commitment_savings(self.mission)[list(self.goals)] * self._goal_shares

    @cached_property
    def travel_costs(self) -> FloatArray:
        """The travel cost h of each action in each cell, shape (actions, q)."""
        chosen = cost.travel_costs(self.mission)[np.array(self.numbers) - 1]
        return chosen * (self.share * self.travel)

    @cached_property
    def fault_costs(self) -> FloatArray:
        """phi(f), shape (8,)."""
        return self.share * cost.fault_costs(self.mission)

    @cached_property
    def threat_costs(self) -> FloatArray:
        """p(t, m), shape (T, 2)."""
        return self.share * cost.threat_costs(self.mission)

    @cached_property
    def feasibility(self) -> Feasibility:
        """The mission's rule for its actions; what it does not track does not restrict."""
        rule, chosen = feasibility(self.mission), np.array(self.numbers) - 1
        whole = self.n == self.mission.k
        return Feasibility(
            rule.by_fault[chosen], rule.by_goal, rule.needs_lost_range[chosen] & whole
        )

    def flags_and_priorities(self, states: IntArray) -> tuple[IntArray, IntArray]:
        """Return r and g of the goals tracked in global states (N, 2k+5), each (N, n)."""
        s = self._space.split(states)
        return s.r[:, self._chosen], s.g[:, self._chosen]

    @cached_property
    def _space(self) -> StateSpace:
        return StateSpace.of(self.mission)

    @cached_property
    def _chosen(self) -> IntArray:
        return np.array(self.goals, dtype=np.int64)

    @property
    def _goal_shares(self) -> FloatArray:
        return np.array(self.goal_shares or (1.0,) * self.n)[:, None, None]


def state_count(
    goals: int, cells: int, fault_modes: int, threats: int = len(THREAT_LEVELS)
) -> int:
    """States of an MDP that tracks so many goals, cells, fault modes and threat levels."""
    return fault_modes * 6**goals * cells * (goals + 1) * threats * 2


def whole_mission(mission: Mission) -> SubMdp:
    """Return the mission itself as a sub-MDP."""
    return SubMdp(mission, tuple(range(mission.k)), _all_actions(mission))


def goal_sub_mdps(mission: Mission) -> tuple[SubMdp, ...]:
    """Return the paper's goal-wise sub-MDPs: one goal, six local actions, Eq. (local_cost)."""
    return tuple(
        SubMdp(mission, (j,), local_actions(mission.k, j), travel=False) for j in range(mission.k)
    )


def shared_sub_mdps(mission: Mission, clusters: IntArray) -> tuple[SubMdp, ...]:
    """Return sub-MDPs of clusters of goals whose costs add up to the mission's.

    Each keeps all 2k+4 actions, and an even share of every cost among those that see it: of what
    the goals have in common among all clusters, of a goal's own cost among those that hold it.
    Hence their optimal costs sum to a lower bound on V* (Russell and Zimdars 2003).

    Parameters
    ----------
    mission : Mission
    clusters : int array (C, n)
        Goals of each cluster, from 0, ascending; every goal in at least one.
    """
    holders = np.bincount(clusters.ravel(), minlength=mission.k)
    return tuple(
        SubMdp(
            mission,
            tuple(goals.tolist()),
            _all_actions(mission),
            share=1.0 / len(clusters),
            goal_shares=tuple((1.0 / holders[goals]).tolist()),
        )
        for goals in clusters
    )


def split_sub_mdps(mission: Mission) -> tuple[SubMdp, ...]:
    """Return one sub-MDP a goal with every action kept and the common costs split evenly."""
    return shared_sub_mdps(mission, np.arange(mission.k)[:, None])


def _all_actions(mission: Mission) -> tuple[int, ...]:
    return tuple(range(1, 2 * mission.k + 5))
