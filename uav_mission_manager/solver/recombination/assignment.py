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

import graphlib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IntArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.recombination.priority import PriorityWeights


@dataclass(frozen=True)
class Limits:
    """What binds the assignment.

    Attributes
    ----------
    before : bool array (k, k)
        Over (j, i): whether goal j waits until goal i is complete before agents are sent.
    counts : int array (k,)
        Minimal agent counts.
    thresholds : float array (k,)
        C_j^min.
    """

    before: BoolArray
    counts: IntArray
    thresholds: FloatArray


@dataclass(frozen=True)
class FleetRules:
    """What the operator asks for; goals by name.

    Attributes
    ----------
    weights : PriorityWeights
    preconditions : mapping of goal to goals
        Goals to be complete before agents are sent, that is achieved, for a goal to be begun.
    agents : mapping of goal to int
        Minimal agent counts; 1 for the rest.
    thresholds : mapping of goal to float
        C_j^min, above 0; `threshold` for the rest. Goals achieved have E_j = 1.
    threshold : float
        A higher one sends more agents to distant goals: see docs/fleet.md.
    persistence : float
        How much more an agent gains, in an optimal assignment, by the goal that it pursued last:
        a share of its gain. Agents then do not trade goals for nothing. Measured with three goals
        and three UAVs, and nine and eight: 0.1 costs 7 to 9 % less than 0.
    """

    weights: PriorityWeights = field(default_factory=PriorityWeights)
    preconditions: Mapping[str, Sequence[str]] = field(default_factory=dict)
    agents: Mapping[str, int] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)
    threshold: float = 0.25
    persistence: float = 0.1

    def limits(self, mission: Mission) -> Limits:
        """Return the rules in the mission's goals.

        Raises
        ------
        ValueError
            If they name what is no goal, ask for what cannot be or make goals wait in a circle.
        """
        for name, count in self.agents.items():
            if not isinstance(count, int) or count < 1:
                raise ValueError(f'agents: {name}: {count!r} is not a whole number above 0')
        if not 0 <= self.persistence < math.inf:
            raise ValueError(f'persistence: {self.persistence} is not a finite number >= 0')
        limits = Limits(
            before=_preconditions(mission, self.preconditions),
            counts=np.ones(mission.k, np.int64),
            thresholds=np.full(mission.k, float(self.threshold)),
        )
        limits.counts[_positions(mission, 'agents', self.agents)] = list(self.agents.values())
        chosen = _positions(mission, 'thresholds', self.thresholds)
        limits.thresholds[chosen] = list(self.thresholds.values())
        for threshold in limits.thresholds:
            if not threshold > 0:
                raise ValueError(f'thresholds: {threshold} is not above 0')
        return limits


class Board:
    """Decisions for N fleets of n agents and k goals in the making.

    Parameters
    ----------
    contributions : float array (N, n, k)
        What each agent adds to E_j when it acts for goal j.
    rewards : float array (N, k)
        E_j before any agent is sent.
    limits : Limits

    Attributes
    ----------
    rewards, complete : arrays (N, k)
        E_j and C_j.
    queues : int array (N, k, n)
        Place of each agent in A_j, -1 for none.
    pursued : int array (N, n)
        Goal each agent acts for, -1 for none.
    """

    def __init__(self, contributions: FloatArray, rewards: FloatArray, limits: Limits) -> None:
        fleets, agents, goals = contributions.shape
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
        free = (self.pursued < 0).sum(axis=1, keepdims=True)
        return self.ready & ~self.complete & (self.need() <= free)

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
        far = np.where(board.pursued[rows] < 0, distances[rows, :, goals], np.inf)
        board.join(rows, far.argmin(axis=1), goals, open_[rows])


def match(board: Board, gains: FloatArray) -> None:
    """Match agents and goals for the largest sum of gains (N, n, k), until nothing is open."""
    while (open_ := board.open()).any():
        need, matched = board.need(), np.full(board.pursued.shape, -1)
        for row in np.flatnonzero(open_.any(axis=1)):
            free = np.flatnonzero(board.pursued[row] < 0)
            matched[row, free] = matching(gains[row, free], np.flatnonzero(open_[row]), need[row])
        for agent, goals in enumerate(matched.T):
            rows = np.flatnonzero(goals >= 0)
            only = np.arange(gains.shape[2]) == goals[rows, None]
            board.join(rows, np.full(len(rows), agent), goals[rows], only)


def matching(gains: FloatArray, goals: IntArray, need: IntArray) -> IntArray:
    """Goal of each agent (n,) by the largest sum of gains (n, k) not below 0, -1 for none.

    A goal gets all the agents that it needs, each with its part of the gain, or none: of those
    that need several every choice is tried.
    """
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
            rows, places = scipy.optimize.linear_sum_assignment(gain, maximize=True)
            gained = parts[rows, places].sum()
            if gained >= best:
                best, matched = gained, np.full(agents, -1)
                matched[rows] = slots[places]
    return matched


def _preconditions(mission: Mission, graph: Mapping[str, Sequence[str]]) -> BoolArray:
    before = np.zeros((mission.k, mission.k), bool)
    for j, earlier in zip(_positions(mission, 'preconditions', graph), graph.values()):
        before[j, _positions(mission, 'preconditions', earlier)] = True
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        raise ValueError(f'preconditions: a cycle: {" before ".join(error.args[1])}') from None
    return before


def _positions(mission: Mission, rule: str, names: Iterable[str]) -> list[int]:
    """Positions of the goals that a rule names."""
    goals = [goal.name for goal in mission.goals]
    for name in names:
        if name not in goals:
            raise ValueError(f'{rule}: {name!r} is no goal of {", ".join(goals)}')
    return [goals.index(name) for name in names]
