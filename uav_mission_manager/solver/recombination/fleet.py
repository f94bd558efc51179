"""A fleet's decisions: local policies, agents on goals, joint policy, replanning (Algorithm 2).

Each UAV has its own f, r, l, c, t and m; the priorities g are the mission's. In every decision
the goal-wise sub-MDPs are ranked into L by their best agent's score (see
`uav_mission_manager.solver.recombination.priority`), and agents join the queues of those that are
open: not complete (C_j = 0), with all preconditions complete before agents are sent, and needing
no more agents than are left. An agent in several queues takes the action of the one first in L
(see `uav_mission_manager.solver.recombination.assignment`).

What agent k brings to sub-MDP j is what pursuing the goal saves against being idle for it,

    G_j(s_k) = V_j^idle(s_k) - V_j(s_k) >= 0,

V_j^idle the value of the sub-MDP without its commit actions. The expected reward counts a goal
achieved as 1 and an agent acting for it as what it brings of what the best placed one would:

    E_j = [g_j = 0] + sum over the agents acting for j of G_j(s_k) / max G_j,

the maximum at the g_j at hand. It is 0 for a goal that is wanted and that nobody acts for, even
where an agent stands on its cell: only an action that commits to the goal completes it. M_j is
complete where E_j >= C_j^min: at once, or when the agents asked for have joined.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.mdp.actions import ActionKind
from uav_mission_manager.mdp.arrays import BoolArray, FloatArray, IndexArray, IntArray
from uav_mission_manager.mdp.dynamics import completion_probabilities
from uav_mission_manager.mdp.feasibility import allowed_actions
from uav_mission_manager.mdp.fleet_rules import FleetRules
from uav_mission_manager.mdp.mission import Goal, Mission
from uav_mission_manager.mdp.routes import distances
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.exact import AxisModel, LookAhead, value_iteration
from uav_mission_manager.solver.greedy import choose
from uav_mission_manager.solver.recombination.assignment import Board, match, queue
from uav_mission_manager.solver.recombination.priority import PriorityScore, ranked
from uav_mission_manager.solver.submdp import SubMdp, goal_sub_mdps

ASSIGNMENTS = ('queue', 'optimal')
"""How agents are put on goals: in queues (Algorithm 2), or for the largest sum of gains."""


@dataclass(frozen=True)
class LocalPolicy:
    """A solved goal-wise sub-MDP.

    Attributes
    ----------
    look_ahead : LookAhead
        V_j, and Q_j, whose minimum gives pi_j.
    gain : float array (q, 9, 16)
        G_j over l, (t, g_j), (f, r_j).
    best_gain : float array (3,)
        max G_j by g_j; 0 where no more than rounding.
    expected_return : float
        R_j, the mean of -V_j over all states without commitment in normal mode.
    """

    look_ahead: LookAhead
    gain: FloatArray
    best_gain: FloatArray
    expected_return: float

    def gains(self, states: IntArray) -> FloatArray:
        """G_j(s) of states (N, 2k+5), shape (N,)."""
        return self.gain[self.look_ahead.model.locate(states)]


@dataclass(frozen=True)
class FleetPlan:
    """A decision for N fleets of n agents; goals and agents counted from 0.

    Attributes
    ----------
    scores, ranking : arrays (N, k)
        rho_j, and L.
    gains : float array (N, n, k)
        G_j of each agent.
    queues : int array (N, k, n)
        Place of each agent in the queue A_j, from 0; -1 where it is not in it.
    rewards, complete : arrays (N, k)
        E_j and C_j.
    pursued : int array (N, n)
        Goal whose policy each agent follows; -1 where it stands by: it follows that of the first
        of L, but does not commit.
    actions : int array (N, n)
        The joint policy: global action numbers.
    """

    scores: FloatArray
    ranking: IndexArray
    gains: FloatArray
    queues: IntArray
    rewards: FloatArray
    complete: BoolArray
    pursued: IntArray
    actions: IntArray


class FleetPlanner:
    """Local policies of a mission, and the joint decisions made of them.

    Parameters
    ----------
    mission : Mission
    agents : int array (n, 2k+5), optional
        States at hand, by which the sub-MDPs are ranked to be solved; by default one at the base,
        nominal and charged, with all goals wanted.
    rules : FleetRules, optional
        Those of the mission, if not given.
    known : mapping, optional
        Local policies by all that they depend on, as `known` of another planner.

    Attributes
    ----------
    limits : Limits
        The rules in the mission's goals.
    policies : tuple of LocalPolicy
        One a goal.
    order : tuple of str
        The goals in the order of L.
    solved : tuple of str
        Those whose sub-MDPs were solved anew.

    Raises
    ------
    ValueError
        If a rule names what is no goal or asks for what cannot be.
    StateError
        If a state is not valid.
    """

    def __init__(
        self,
        mission: Mission,
        agents: ArrayLike | None = None,
        rules: FleetRules | None = None,
        known: Mapping[SubMdp, LocalPolicy] | None = None,
    ) -> None:
        self.mission, self.rules = mission, rules or mission.fleet
        self.limits = self.rules.limits([goal.name for goal in mission.goals])
        self._space = StateSpace.of(mission)
        self._score = PriorityScore(mission, self.rules.weights)
        to_goals = [distances(mission.grid, goal.cell) for goal in mission.goals]
        self._distances = np.stack(to_goals, axis=1)
        if agents is None:
            agents = [(1, *self._space.charged, *(2,) * mission.k, mission.grid.base, 0, 0, 0)]
        order = ranked(self._scores(self._checked(np.asarray(agents)[None])))[0].tolist()
        self.order = tuple(mission.goals[j].name for j in order)
        subs = goal_sub_mdps(mission)
        keys = [_essence(sub) for sub in subs]
        found, solved = dict(known or {}), []
        for j in order:
            if keys[j] not in found:
                found[keys[j]] = _solve(subs[j])
                solved.append(mission.goals[j].name)
        self.solved = tuple(solved)
        self.known = {key: found[key] for key in keys}
        self.policies = tuple(self.known.values())

    def replan(self, mission: Mission, agents: ArrayLike) -> FleetPlanner:
        """Return a planner for a changed mission: only what the change enters is solved anew.

        Changed states, new faults and priorities among them, need no more than another `plan`.
        """
        return FleetPlanner(mission, agents, self.rules, self.known)

    def plan(
        self,
        fleets: ArrayLike,
        previous: IntArray | None = None,
        assignment: str = 'queue',
        *,
        kept: IntArray | None = None,
        barred: BoolArray | None = None,
    ) -> FleetPlan:
        """Decide for fleets of states (N, n, 2k+5).

        Parameters
        ----------
        fleets : int array
        previous : int array (N, n), optional
            `pursued` of the last decision: who pursued a goal goes first in its queue, and gains
            more by it in an optimal assignment.
        assignment : {'queue', 'optimal'}
        kept : int array (N, n), optional
            Goals that agents pursue whatever is decided, -1 for none.
        barred : bool array (N, n, k), optional
            Goals that an agent must not be given.

        Raises
        ------
        ValueError
            If there is no such assignment, a shape is wrong, or agents of a fleet differ in g.
        StateError
            If a state is not valid.
        """
        if assignment not in ASSIGNMENTS:
            raise ValueError(f'assignment {assignment!r} is none of {", ".join(ASSIGNMENTS)}')
        states = self._checked(np.asarray(fleets))
        scores, gains = self._scores(states), self._gains(states)
        board = Board(*self._rewards(states, gains), self.limits, barred)
        if kept is not None:
            board.keep(kept)
        ranking = ranked(scores)
        held = self._held(states, previous)
        if assignment == 'queue':
            # Below 0 for who pursued the goal.
            nearness = self._distances[self._space.split(states).l] - self.mission.grid.q * held
            queue(board, nearness, ranking)
        else:
            match(board, gains * (1 + self.rules.persistence * held))
        return FleetPlan(
            scores=scores,
            ranking=ranking,
            gains=gains,
            queues=board.queues,
            rewards=board.rewards,
            complete=board.complete,
            pursued=board.pursued,
            actions=self._actions(states, board.pursued, ranking),
        )

    def _checked(self, fleets: NDArray[np.integer]) -> IntArray:
        if fleets.ndim != 3 or not fleets.shape[1]:
            variables = len(self._space.shape)
            raise ValueError(f'fleets have shape {fleets.shape}, not (N, n, {variables})')
        states = self._space.check(fleets.reshape(-1, fleets.shape[2])).reshape(fleets.shape)
        g = self._space.split(states).g
        differ = np.flatnonzero((g != g[:, :1]).any(axis=(1, 2)))
        if differ.size:
            of = g[differ[0]].tolist()
            raise ValueError(f'agents of fleet {differ[0]} differ in their priorities: {of}')
        return states

    def _scores(self, fleets: IntArray) -> FloatArray:
        """rho_j of the agent for whom it is highest, shape (N, k)."""
        scores = self._score.of_goals(fleets.reshape(-1, fleets.shape[2]))
        return scores.reshape(*fleets.shape[:2], -1).max(axis=1)

    def _gains(self, fleets: IntArray) -> FloatArray:
        """G_j(s_k), shape (N, n, k)."""
        rows = fleets.reshape(-1, fleets.shape[2])
        gains = np.stack([policy.gains(rows) for policy in self.policies], axis=1)
        return gains.reshape(*fleets.shape[:2], -1)

    def _rewards(self, fleets: IntArray, gains: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What each agent adds to E_j, shape (N, n, k), and E_j without agents, (N, k)."""
        g = self._space.split(fleets).g[:, 0]
        best = np.stack([p.best_gain[g[:, j]] for j, p in enumerate(self.policies)], axis=1)
        # Where nothing can be gained one agent is enough.
        contributions = np.ones_like(gains)
        np.divide(gains, best[:, None], out=contributions, where=best[:, None] > 0)
        return contributions, (g == 0).astype(float)

    def _held(self, fleets: IntArray, previous: IntArray | None) -> BoolArray:
        """Whether each agent pursued each goal in the last decision, shape (N, n, k)."""
        if previous is None:
            return np.zeros((*fleets.shape[:2], self.mission.k), bool)
        if previous.shape != fleets.shape[:2]:
            raise ValueError(
                f'the previous plan is for fleets of shape {previous.shape}, '
                f'not {fleets.shape[:2]}'
            )
        return np.asarray(previous[..., None] == np.arange(self.mission.k))

    def _actions(self, fleets: IntArray, pursued: IntArray, ranking: IndexArray) -> IntArray:
        """The joint policy: a_k = pi_j(s_k) of the goal that agent k pursues."""
        states, standby = fleets.reshape(-1, fleets.shape[2]), (pursued < 0).ravel()
        goals = np.where(pursued < 0, ranking[:, :1], pursued).ravel()
        # A sub-MDP does not see all that the mission's rule asks for.
        allowed = allowed_actions(self.mission, states)
        actions = np.empty(len(states), np.int64)
        for j, policy in enumerate(self.policies):
            mine, sub = goals == j, policy.look_ahead.model.sub
            numbers = np.array(sub.numbers)
            q = policy.look_ahead.q_values(states[mine])
            commits = np.array([action.kind is ActionKind.COMMIT for action in sub.actions])
            q[np.ix_(standby[mine], commits)] = np.inf
            q[~allowed[mine][:, numbers - 1]] = np.inf
            actions[mine] = numbers[choose(q) - 1]
        return actions.reshape(pursued.shape)


def _essence(sub: SubMdp) -> SubMdp:
    """Return the sub-MDP with all blanked that does not enter it; equal ones solve alike."""
    mission = sub.mission
    flown_to = {action.goal for action in sub.actions}
    completion = completion_probabilities(mission).tolist()
    goals = tuple(
        replace(goal, name='', task=None, completion=tuple(row))
        if j in sub.goals
        else Goal('', goal.cell if j in flown_to else 0, 0.0, 0.0, ())
        for j, (goal, row) in enumerate(zip(mission.goals, completion))
    )
    grid = replace(mission.grid, origin=None, elevation=(), bearing=0.0)
    faults = replace(mission.faults, completion=())
    essence = replace(mission, name='', grid=grid, goals=goals, faults=faults)
    if mission.range.charge is None:  # By which it is told what is in range.
        essence = replace(essence, grid=replace(grid, cell_size=0.0), energy=None)
    return replace(sub, mission=essence)


def _solve(sub: SubMdp) -> LocalPolicy:
    """Solve a goal-wise sub-MDP, and the same without commitment."""
    uncommitted = tuple(a.number for a in sub.actions if a.kind is not ActionKind.COMMIT)
    pursuing, idle = (value_iteration(s) for s in (sub, replace(sub, numbers=uncommitted)))
    gain = np.maximum(idle.value - pursuing.value, 0.0, dtype=np.float64)
    best = gain.reshape(-1, 3, gain.shape[2]).max(axis=(0, 2))
    noise = idle.upper - idle.lower + pursuing.upper - pursuing.lower
    return LocalPolicy(
        look_ahead=LookAhead(AxisModel(sub), pursuing.value),
        gain=gain,
        best_gain=np.where(best > noise, best, 0.0),
        expected_return=-float(pursuing.value.mean() + sub.threat_costs[:, 0].mean()),
    )
