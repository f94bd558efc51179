"""The reduced mission: what is left of a sub-MDP without c and m, in factors.

c and m do not reach the future, for neither the dynamics nor the feasibility rule asks for them.
They enter the stage cost by two terms only, so that exactly

    V(s) = p(t, m) - [c > 0] eta_c g_c r_c + W(l, t, f, x),

with x_j = 2 g_j + r_j the goal's part of the state. W solves

    W = sum_j goal_costs_j(x_j) + phi(f)
        + min_a { h(a, l) - saving(a, l, f, x) + discount E[W(l', t', f', x') + p(t', m')] },

where the saving is what the commitment c' of an action takes off the next stage cost. An action
leads from a cell to one *arrival*: a cell l' and a regime of `uav_mission_manager.mdp.dynamics`.
Given the arrival, t, f and every x_j move independently, each by a small matrix of its own. Where
an action may complete its goal j, E is mixed, by completion(f), with the same expectation at
g_j' = 0.

Every factored form in this package takes its terms from here, and they come from
`uav_mission_manager.mdp`. Only elementwise operations in a fixed order are used, so that the
terms are the same bits on every machine.
"""

from __future__ import annotations

import numpy as np

from uav_mission_manager.mdp import dynamics
from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace, StateView
from uav_mission_manager.solver.submdp import SubMdp

X_VALUES = 6
"""Values of x_j = 2 g_j + r_j."""

X_PRIORITY, X_RANGE = np.divmod(np.arange(X_VALUES), 2)
"""g_j and r_j of each x_j."""


class ReducedMission:
    """Small matrices and costs of a sub-MDP with n goals, q cells and A actions.

    Parameters
    ----------
    sub : SubMdp

    Attributes
    ----------
    landings, regimes : int array (A, q)
        The arrival of each action from each cell: l' and the regime.
    completes : bool array (A, q)
        Where an action may complete the goal that it commits to, and that goal is tracked.
    slots : int array (A,)
        Position among the goals tracked of the one an action commits to, -1 for none.
    agile : int array (A,)
        m' of each action.
    threat : float array (q, T, T)
        P(t' | t) of T threat levels on arrival in each cell.
    faults : float array (5, 8, 8)
        P(f' | f) in each regime.
    goals : float array (5, n, 6, 6)
        P(x_j' | x_j) in each regime.
    completed : float array (5, 6, 6)
        The same where the goal is completed.
    completion : float array (8,)
    goal_costs : float array (n, 6)
        Cost of x_j as if uncommitted.
    fault_costs : float array (8,)
    travel : float array (A, q)
        h of each action in each cell.
    saving : float array (2, n, 6)
        Discounted E[eta_j g_j' r_j'] after a normal and an agile flight: what a commitment saves.
    price : float array (2, q, T)
        Discounted E[p(t', m') | t] on arrival in each mode and cell.
    """

    def __init__(self, sub: SubMdp) -> None:
        mission, chosen = sub.mission, np.array(sub.numbers) - 1
        self.sub, self.n, self.q = sub, sub.n, mission.grid.q
        self.space = StateSpace.of(mission)
        self.landings = dynamics.landings(mission)[chosen]
        self.regimes = dynamics.regimes(mission)[chosen]
        slots = [sub.slot(action) for action in sub.actions]
        self.slots = np.array([-1 if slot is None else slot for slot in slots])
        self.completes = dynamics.may_complete(mission)[chosen] & (self.slots >= 0)[:, None]
        self.agile = np.array([int(action.agile) for action in sub.actions])
        self.threat = dynamics.threat_matrices(mission)
        self.faults = dynamics.fault_matrices(mission)
        ranges = dynamics.range_matrices(mission)
        priorities = dynamics.priority_matrices(mission)[list(sub.goals)]
        self.goals = np.empty((len(ranges), self.n, X_VALUES, X_VALUES))
        for regime, slot in np.ndindex(self.goals.shape[:2]):
            self.goals[regime, slot] = np.kron(priorities[slot], ranges[regime])
        achieved = np.array([[1.0, 0.0, 0.0]] * 3)
        self.completed = np.array([np.kron(achieved, r) for r in ranges])
        self.completion = dynamics.completion_probabilities(mission)
        self.goal_costs = sub.goal_costs.reshape(sub.n, X_VALUES)
        self.fault_costs, self.travel = sub.fault_costs, sub.travel_costs
        self._savings = sub.commitment_savings.reshape(sub.n, X_VALUES)
        # c to a slot; the last one is that of commitments which save nothing here.
        self._slot_of_commitment = np.full(mission.k + 1, -1)
        self._slot_of_commitment[np.array(sub.goals, int) + 1] = np.arange(sub.n)
        self._savings_or_none = np.vstack([self._savings, np.zeros(X_VALUES)])
        self.saving = mission.discount * _expected(self.goals[:2], self._savings)
        by_mode = sub.threat_costs.T[:, None]
        self.price = mission.discount * _expected(self.threat, by_mode)
        self._allowed_x = sub.feasibility.by_goal.ravel()

    def action_costs(
        self, cells: int | IndexArray, x: IntArray, faults: slice | IntArray = slice(None)
    ) -> FloatArray:
        """What an action adds to Q before what follows: h less the saving of its commitment.

        Parameters
        ----------
        cells : int or int array (C,)
        x : int array (N, n)
        faults : slice or int array (F,)
            Fault modes, from 0; all eight by default.

        Returns
        -------
        float array (A, C, F, N), or (A, F, N) of a single cell
            inf where an action is not allowed.
        """
        if np.ndim(cells) == 0:
            return self.action_costs(np.array([cells]), x, faults)[:, 0]
        rule, completion = self.sub.feasibility, self.completion[faults]
        costs = np.empty((len(self.slots), np.size(cells), len(completion), len(x)))
        costs[:] = self.travel[:, cells, None, None]
        for action in np.flatnonzero(self.slots >= 0).tolist():
            slot = self.slots[action]
            kept = 1 - self.completes[action, cells][:, None] * completion
            own = x[:, slot]
            costs[action] -= kept[..., None] * self.saving[self.agile[action], slot, own]
            costs[action][..., ~self._allowed_x[own]] = np.inf
        by_action, by_fault = np.nonzero(~rule.by_fault[:, faults])
        costs[by_action, :, by_fault] = np.inf
        charged = X_RANGE[x].all(axis=1)
        for action in np.flatnonzero(rule.needs_lost_range).tolist():
            costs[action][..., charged] = np.inf
        return costs

    def split(self, states: IntArray) -> StateView:
        """Return the variables of global states (N, 2k+5) by name."""
        return self.space.split(states)

    def x(self, states: IntArray) -> IntArray:
        """x_j of the goals tracked in global states (N, 2k+5), shape (N, n)."""
        r, g = self.sub.flags_and_priorities(states)
        return 2 * g + r

    def mode_costs(self, states: IntArray) -> FloatArray:
        """V - W = p(t, m) - [c > 0] eta_c g_c r_c of global states, shape (N,)."""
        return self._mode_costs(self.split(states), self.x(states))

    def _mode_costs(self, s: StateView, x: IntArray) -> FloatArray:
        slot = self._slot_of_commitment[s.c]
        saved = self._savings_or_none[slot, x[np.arange(len(x)), slot]] if self.n else 0.0
        return np.asarray(self.sub.threat_costs[s.t, s.m] - saved)

    def state_costs(self, states: IntArray) -> FloatArray:
        """J(s, a) - h(a, l) of global states, shape (N,)."""
        s, x = self.split(states), self.x(states)
        goals = self.goal_costs[np.arange(self.n), x].sum(axis=1)
        return self.fault_costs[s.f - 1] + goals + self._mode_costs(s, x)


def goal_order(mission: Mission) -> list[int]:
    """Goals from 0 in an order that does not depend on how they are numbered or called."""
    keys = [(g.cell, g.eta, g.delta, g.priority_transition) for g in mission.goals]
    return sorted(range(mission.k), key=keys.__getitem__)


def _expected(matrices: FloatArray, values: FloatArray) -> FloatArray:
    """sum_j P[.., i, j] values[.., j], added up in the order of j."""
    out = matrices[..., 0] * values[..., None, 0]
    for j in range(1, matrices.shape[-1]):
        out = out + matrices[..., j] * values[..., None, j]
    return np.asarray(out)
