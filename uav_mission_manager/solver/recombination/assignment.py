"""Who acts for which sub-MDP: the paper's queues, and optimal assignment (Algorithm 2).

The paper's loops leave open how agents share out: with every agent in every open queue, each
takes the action of the sub-MDP first in L, and all go to one goal. Here E_j and C_j follow each
agent that joins, so that the next one finds what is left; C_j^min = inf gives the loops as
printed. The agents, which the paper sorts by previous assignment or proximity, come in that
order for the goal first in L that is still open.

The alternative matches agents and open goals by the largest sum of gains (a linear assignment
problem), again and again until nothing is open.
"""

from __future__ import annotations

import itertools

import numpy as np
import scipy

from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.mdp.fleet_rules import Limits

NOTHING = 1e-9
"""Gain below which a match is none: a choice, far below any cost of a mission."""


class Board:
    """Decisions for N fleets of n agents and k goals in the making.

    Parameters
    ----------
    contributions : float array (N, n, k)
        What each agent adds to E_j when it acts for goal j.
    rewards : float array (N, k)
        E_j before any agent is sent.
    limits : Limits
    barred : bool array (N, n, k), optional
        Goals that an agent cannot act for.

    Attributes
    ----------
    rewards, complete : arrays (N, k)
        E_j and C_j.
    queues : int array (N, k, n)
        Place of each agent in A_j, -1 for none.
    pursued : int array (N, n)
        Goal each agent acts for, -1 for none.
    """

    def __init__(
        self,
        contributions: FloatArray,
        rewards: FloatArray,
        limits: Limits,
        barred: BoolArray | None = None,
    ) -> None:
        fleets, agents, goals = contributions.shape
        self.barred = np.zeros(contributions.shape, bool) if barred is None else barred
        self.contributions, self.rewards, self.limits = contributions, rewards, limits
        self.complete = rewards >= limits.thresholds
        self.ready = ~(limits.before & ~self.complete[:, None]).any(axis=2)
        self.acting = np.zeros((fleets, goals), np.int64)
        self.queues = np.full((fleets, goals, agents), -1)
        self.pursued = np.full((fleets, agents), -1)

    def need(self) -> IntArray:
        """Agents that must join a goal together, shape (N, k)."""
        return np.maximum(self.limits.counts - self.acting, 1)

    def open(self) -> BoolArray:
        """Goals whose queues take agents, shape (N, k)."""
        free = ((self.pursued < 0)[..., None] & ~self.barred).sum(axis=1)
        return self.ready & ~self.complete & (self.need() <= free)

    def keep(self, pursued: IntArray) -> None:
        """Let agents act for the goals that they keep whatever comes (N, n), -1 for none."""
        for agent, goals in enumerate(pursued.T):
            self.send(agent, goals)

    def send(self, agent: int, goals: IntArray) -> None:
        """Let an agent act for one goal of each fleet, -1 for none, and queue it for no other."""
        rows = np.flatnonzero(goals >= 0)
        only = np.arange(self.rewards.shape[1]) == goals[rows, None]
        self.join(rows, np.full(len(rows), agent), goals[rows], only)

    def join(self, rows: IntArray, agents: IntArray, goals: IntArray, queued: BoolArray) -> None:
        """Let one agent of each of some fleets act for a goal, queued where the mask says.

        Fleets, agents and goals are of shape (M,), the mask of (M, k).
        """
        places = (self.queues[rows] >= 0).sum(axis=2)
        self.queues[rows, :, agents] = np.where(queued, places, -1)
        self.pursued[rows, agents] = goals
        self.acting[rows, goals] += 1
        self.rewards[rows, goals] += self.contributions[rows, agents, goals]
        enough = self.rewards[rows, goals] >= self.limits.thresholds[goals]
        manned = self.acting[rows, goals] >= self.limits.counts[goals]
        self.complete[rows, goals] = enough & manned


def queue(board: Board, distances: FloatArray, ranking: IntArray) -> None:
    """Queue agents one by one to all that is open, the nearest to the first of that first.

    Distances are of shape (N, n, k), the ranking L of (N, k). An agent acts for the first of L
    among its queues.
    """
    for _ in range(board.pursued.shape[1]):
        open_ = board.open()
        rows = np.flatnonzero(open_.any(axis=1))
        first = np.take_along_axis(open_[rows], ranking[rows], axis=1).argmax(axis=1)
        goals = ranking[rows, first]
        may = (board.pursued[rows] < 0) & ~board.barred[rows, :, goals]
        agents = np.where(may, distances[rows, :, goals], np.inf).argmin(axis=1)
        board.join(rows, agents, goals, open_[rows] & ~board.barred[rows, agents])


def match(board: Board, gains: FloatArray) -> None:
    """Match agents and goals for the largest sum of gains (N, n, k), until nothing is open."""
    while (open_ := board.open()).any():
        need, matched = board.need(), np.full(board.pursued.shape, -1)
        for row in np.flatnonzero(open_.any(axis=1)):
            free = np.flatnonzero(board.pursued[row] < 0)
            chosen = np.flatnonzero(open_[row])
            barred = board.barred[row, free]
            matched[row, free] = matching(gains[row, free], chosen, need[row], barred)
        for agent, goals in enumerate(matched.T):
            board.send(agent, goals)


def matching(
    gains: FloatArray, goals: IntArray, need: IntArray, barred: BoolArray | None = None
) -> IntArray:
    """Goal of each agent (n,) by the largest sum of gains (n, k) not below 0, -1 for none.

    A goal gets all the agents that it needs, each with its part of the gain, or none: of those
    that need several every choice is tried. No agent gets a goal that it is barred from.
    """
    barred = np.zeros(gains.shape, bool) if barred is None else barred
    agents, best, matched = len(gains), -1.0, np.full(len(gains), -1)
    alone, teams = goals[need[goals] == 1], goals[need[goals] > 1]
    bonus = 1 + gains.sum()  # Who is in a team comes before who is not.
    for size in range(min(len(teams), agents // 2) + 1):
        for chosen in itertools.combinations(teams, size):
            team = np.array(chosen, int)
            if need[team].sum() > agents:
                continue
            slots = np.concatenate([np.repeat(team, need[team]), alone])
            parts = gains[:, slots] / need[slots]
            gain = parts + bonus * (need[slots] > 1)
            gain[barred[:, slots]] = -NOTHING  # As if not matched, and after all that may be.
            rows, places = scipy.optimize.linear_sum_assignment(gain, maximize=True)
            may = ~barred[rows, slots[places]]
            rows, places = rows[may], places[may]
            gained = parts[rows, places].sum()
            manned = (slots[places] == team[:, None]).sum(axis=1) == need[team]
            if gained >= best and manned.all():
                best, matched = gained, np.full(agents, -1)
                matched[rows] = slots[places]
    return matched
