"""The reduced mission: what is left of a sub-MDP without c and m, in factors.

c and m do not reach the future, for neither the dynamics nor the feasibility rule asks for them.
They enter the stage cost by two terms only, so that exactly

    V(s) = p(t, m) - [c > 0] eta_c g_c r_c + W(l, t, z, x),

with z = f the UAV's *condition* and x_j = 2 g_j + r_j the goal's part of the state. Where the
mission has a charge, its level b tells the r_j in each cell: then z = (f, b), counted as
(f - 1) B + b, and x_j = g_j. W solves

    W = sum_j goal_costs_j(l, z, x_j) + phi(f)
        + min_a { h(a, l, z) - saving(a, l, z, x) + discount E[W(l', t', z', x') + p(t', m')] },

where h has the cost of flying on an empty battery too, and the saving is what the commitment c' of
an action takes off the next stage cost. An action leads from a cell to one *arrival*: a cell l'
and a regime of `uav_mission_manager.mdp.dynamics`. Given the arrival, t, f, b and every x_j move
independently, each by a small matrix of its own. Where an action may complete its goal j, E is
mixed, by completion_j(f), with the same expectation at g_j' = 0.

Every factored form in this package takes its terms from here, and they come from
`uav_mission_manager.mdp`. Only elementwise operations in a fixed order are used, so that the
terms are the same bits on every machine.
"""

from __future__ import annotations

import numpy as np

from uav_mission_manager.mdp import dynamics
from uav_mission_manager.mdp.arrays import AnyArray, BoolArray, FloatArray, IndexArray, IntArray
from uav_mission_manager.mdp.charge import range_table
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.mdp.states import StateSpace, StateView
from uav_mission_manager.solver.submdp import SubMdp


class ReducedMission:
    """Small matrices and costs of a sub-MDP with n goals, q cells and A actions.

    Tables of the goals' costs do not depend on cell and condition z where the range flags are in
    the x_j. They are then views that repeat one entry.

    Parameters
    ----------
    sub : SubMdp

    Attributes
    ----------
    x_values, z_values : int
        X and Z, values of each x_j and of the condition.
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
    charge : float array (5, levels, levels)
        P(b' | b) in each regime.
    conditions : float array (5, Z, Z)
        P(z' | z) in each regime.
    goals : float array (5, n, X, X)
        P(x_j' | x_j) in each regime.
    completed : float array (5, X, X)
        The same where the goal is completed.
    defect : float
        By how much P(z' | z) of all z' may sum to more or less than 1, but for rounding.
    completion : float array (n, Z)
    fault_costs : float array (Z,)
    goal_costs : float array (n, q, Z, X)
        Cost of x_j as if uncommitted.
    level_costs : float array (n, q or 1, levels, X)
        The same, without what it does not depend on.
    travel : float array (A, q, Z)
        h of each action in each cell.
    saving : float array (2, n, q, Z, X)
        Discounted E[eta_j g_j' r_j'] after a normal and an agile flight into a cell: what a
        commitment saves.
    price : float array (2, q, T)
        Discounted E[p(t', m') | t] on arrival in each mode and cell.
    """

    def __init__(self, sub: SubMdp) -> None:
        mission, chosen = sub.mission, np.array(sub.numbers) - 1
        self.sub, self.n, self.q = sub, sub.n, mission.grid.q
        self.space = StateSpace.of(mission)
        self.x_values = 3 * mission.range.flag_values
        self.levels = mission.range.levels
        self.z_values = 8 * self.levels
        self.landings = dynamics.landings(mission)[chosen]
        self.regimes = dynamics.regimes(mission)[chosen]
        slots = [sub.slot(action) for action in sub.actions]
        self.slots = np.array([-1 if slot is None else slot for slot in slots])
        self.completes = dynamics.may_complete(mission)[chosen] & (self.slots >= 0)[:, None]
        self.agile = np.array([int(action.agile) for action in sub.actions])
        self.threat = dynamics.threat_matrices(mission)
        self._dynamics(mission)
        completion = dynamics.completion_probabilities(mission)[list(sub.goals)]
        self.completion = np.repeat(completion, self.levels, axis=1)
        self.fault_costs = np.repeat(sub.fault_costs, self.levels)
        travel = sub.travel_costs[..., None] + sub.empty_costs
        self.travel = self._by_condition(travel)
        by_mode = sub.threat_costs.T[:, None]
        self.price = mission.discount * _expected(self.threat, by_mode)
        self._goal_tables()

    def _dynamics(self, mission: Mission) -> None:
        self.faults = dynamics.fault_matrices(mission)
        self.charge = dynamics.charge_matrices(mission)
        self.conditions = np.array([np.kron(f, b) for f, b in zip(self.faults, self.charge)])
        self.defect = float(np.abs(self.charge.sum(axis=-1) - 1).max())
        ranges = dynamics.range_matrices(mission)
        priorities = dynamics.priority_matrices(mission)[list(self.sub.goals)]
        self.goals = np.empty((len(ranges), self.n, self.x_values, self.x_values))
        for regime, slot in np.ndindex(self.goals.shape[:2]):
            self.goals[regime, slot] = np.kron(priorities[slot], ranges[regime])
        achieved = np.array([[1.0, 0.0, 0.0]] * 3)
        self.completed = np.array([np.kron(achieved, r) for r in ranges])

    def _goal_tables(self) -> None:
        """Tables (n, cells, levels, X) of what x_j costs, saves and allows."""
        sub, flags = self.sub, self._flags()
        priorities = np.arange(self.x_values) // sub.mission.range.flag_values
        slots = np.arange(self.n)[:, None, None, None]
        costs, savings = (
            table[slots, priorities, flags] for table in (sub.goal_costs, sub.commitment_savings)
        )
        self.level_costs = np.broadcast_to(costs, (*flags.shape[:3], self.x_values))
        self.goal_costs = self._by_cell(costs)
        # c to a slot; the last one is that of commitments which save nothing here.
        self._slot_of_commitment = np.full(sub.mission.k + 1, -1)
        self._slot_of_commitment[np.array(sub.goals, int) + 1] = np.arange(self.n)
        none = np.zeros((1, *savings.shape[1:]))
        self._savings_or_none = self._by_cell(np.concatenate([savings, none]))
        after = _expected(self.goals[:2, :, None, None], savings)
        drains = self.charge[:2, None, None, None]
        after = _expected(drains, after.swapaxes(-1, -2)).swapaxes(-1, -2)
        self.saving = self._by_cell(sub.mission.discount * after)
        self._allowed = self._by_cell(sub.feasibility.by_goal[priorities, flags])

    def _flags(self) -> IntArray:
        """r_j over slot, cell, level and x_j: (n, q, levels, 1), or (n, 1, 1, X)."""
        mission, goals = self.sub.mission, list(self.sub.goals)
        if mission.range.charge is not None:
            return range_table(mission)[goals][..., None] * 1
        flags = np.arange(self.x_values) % mission.range.flag_values
        return np.broadcast_to(flags, (self.n, 1, 1, self.x_values))

    def _by_condition(self, table: AnyArray) -> AnyArray:
        """A table (.., levels) as one over the conditions (.., Z)."""
        *axes, levels = table.shape
        return np.broadcast_to(table[..., None, :], (*axes, 8, levels)).reshape(*axes, 8 * levels)

    def _by_cell(self, table: AnyArray) -> AnyArray:
        """A table (.., cells, levels, X) as one over all cells and conditions (.., q, Z, X)."""
        by_condition = self._by_condition(table.swapaxes(-1, -2)).swapaxes(-1, -2)
        axes = *table.shape[:-3], self.q, self.z_values, self.x_values
        return np.broadcast_to(by_condition, axes)

    def action_costs(
        self, cells: int | IndexArray, x: IntArray, conditions: slice | IntArray = slice(None)
    ) -> FloatArray:
        """What an action adds to Q before what follows: h less the saving of its commitment.

        Parameters
        ----------
        cells : int or int array (C,)
        x : int array (N, n)
        conditions : slice or int array (Z',)
            Conditions, from 0; all by default.

        Returns
        -------
        float array (A, C, Z', N), or (A, Z', N) of a single cell
            inf where an action is not allowed.
        """
        if np.ndim(cells) == 0:
            return self.action_costs(np.array([cells]), x, conditions)[:, 0]
        z = np.arange(self.z_values)[conditions]
        rule = self.sub.feasibility
        costs = np.empty((len(self.slots), np.size(cells), len(z), len(x)))
        costs[:] = self.travel[:, cells][..., z, None]
        for action in np.flatnonzero(self.slots >= 0).tolist():
            slot, own = self.slots[action], x[:, self.slots[action]]
            kept = 1 - self.completes[action, cells][:, None] * self.completion[slot, z]
            saving = self.saving[self.agile[action], slot, self.landings[action, cells]]
            costs[action] -= kept[..., None] * saving[:, z][..., own]
            allowed = self._allowed[slot, cells][:, z][..., own]
            np.copyto(costs[action], np.inf, where=~allowed)
        by_action, by_fault = np.nonzero(~rule.by_fault[:, z // self.levels])
        costs[by_action, :, by_fault] = np.inf
        full = self._full(x, z)
        for action in np.flatnonzero(rule.needs_room).tolist():
            np.copyto(costs[action], np.inf, where=full)
        return costs

    def _full(self, x: IntArray, z: IntArray) -> BoolArray:
        """Whether nothing can be recharged, (Z', N)."""
        flag_values = self.sub.mission.range.flag_values
        in_range = (x % flag_values == flag_values - 1).all(axis=1)
        return (z % self.levels == self.levels - 1)[:, None] & in_range

    def own_costs(self, x: IntArray) -> FloatArray:
        """What z and x cost whatever is done, as if uncommitted: (q, Z, N), or (1, Z, N).

        Parameters
        ----------
        x : int array (N, n)
        """
        tables = self.level_costs
        goals = np.empty((*tables.shape[1:3], len(x)))
        for cell, level in np.ndindex(tables.shape[1:3]):
            goals[cell, level] = tables[np.arange(self.n), cell, level, x].sum(axis=1)
        costs = self.sub.fault_costs[:, None, None] + goals[:, None]
        return np.asarray(costs.reshape(len(costs), self.z_values, len(x)))

    def split(self, states: IntArray) -> StateView:
        """Return the variables of global states (N, 2k+5) by name."""
        return self.space.split(states)

    def x(self, states: IntArray) -> IntArray:
        """x_j of the goals tracked in global states (N, 2k+5), shape (N, n)."""
        g = self.sub.priorities(states)
        return g if self.levels > 1 else 2 * g + self.sub.range_values(states)

    def z(self, states: IntArray) -> IntArray:
        """Conditions, from 0, of global states (N, 2k+5), shape (N,)."""
        s = self.split(states)
        return (s.f - 1) * self.levels + s.b.sum(axis=1)

    def mode_costs(self, states: IntArray) -> FloatArray:
        """V - W = p(t, m) - [c > 0] eta_c g_c r_c of global states, shape (N,)."""
        return self._mode_costs(self.split(states), self.z(states), self.x(states))

    def _mode_costs(self, s: StateView, z: IntArray, x: IntArray) -> FloatArray:
        slot = self._slot_of_commitment[s.c]
        saved: FloatArray | float = 0.0
        if self.n:
            saved = self._savings_or_none[slot, s.l, z, x[np.arange(len(x)), slot]]
        return np.asarray(self.sub.threat_costs[s.t, s.m] - saved)

    def state_costs(self, states: IntArray) -> FloatArray:
        """J(s, a) - h(a, l) of global states, shape (N,)."""
        s, x, z = self.split(states), self.x(states), self.z(states)
        goals = self.goal_costs[np.arange(self.n), s.l[:, None], z[:, None], x].sum(axis=1)
        return self.fault_costs[z] + goals + self._mode_costs(s, z, x)


def goal_order(mission: Mission) -> list[int]:
    """Goals from 0 in an order that does not depend on how they are numbered or called."""
    completion = dynamics.completion_probabilities(mission).tolist()
    keys = [
        (goal.cell, goal.eta, goal.delta, goal.priority_transition, row)
        for goal, row in zip(mission.goals, completion)
    ]
    return sorted(range(mission.k), key=keys.__getitem__)


def _expected(matrices: FloatArray, values: FloatArray) -> FloatArray:
    """sum_j P[.., i, j] values[.., j], added up in the order of j."""
    out = matrices[..., 0] * values[..., None, 0]
    for j in range(1, matrices.shape[-1]):
        out = out + matrices[..., j] * values[..., None, j]
    return np.asarray(out)
