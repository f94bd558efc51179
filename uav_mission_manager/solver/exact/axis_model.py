"""The reduced mission as arrays along the axes of W, for backups of the whole of it.

W (see `uav_mission_manager.solver.reduced`) has the axes (cell, (t, g), (f, r)) and the shape
(q, T * 3^n, 8 * 2^n) for T threat levels; a charge of B levels has (f, b) for (f, r), and B for
2^n. An expectation is one small matrix an axis; a transition
matrix over states never exists. Where an action leads is one of 2q + 3 + 2n *arrivals*:

- in cell l' after normal flight, then in l' after agile flight;
- on the ground: parked on base, recharged or repaired on the service cell;
- on the cell of goal j, committed to it, in normal and in agile mode: the goal may be completed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from uav_mission_manager.mdp.actions import Action
from uav_mission_manager.mdp.arrays import FloatArray, IndexArray, IntArray, RealArray
from uav_mission_manager.mdp.dynamics import (
    ON_GROUND,
    completion_probabilities,
    drain_probabilities,
    failure_probabilities,
    priority_matrices,
    range_loss_probabilities,
    recharged_levels,
)
from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.solver.exact.device import CPU, Device
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import SubMdp

ROUNDINGS_A_GOAL, ROUNDINGS_A_THREAT, ROUNDINGS_A_DRAIN, OTHER_ROUNDINGS = 12, 2, 2, 38
"""Errors of half an ulp of the largest entry in one backup, at most: 2 T - 1 for t, 4 for each
g_j, 8 for each r_j, each part that fails and completion, 2 for each number of levels that may be
drained, 7 for costs, change and shift."""


@dataclass(frozen=True)
class Choice:
    """An action as the backup sees it.

    Attributes
    ----------
    action : Action
    arrivals : int array (q,)
        Number of its arrival from each cell.
    slot : int or None
        Goal tracked whose priority the cost below depends on.
    levels : slice
        Priorities of that goal outside which it is allowed nowhere.
    cost : float array (q, 3, columns)
        `ReducedMission.action_costs` over that priority; (q, 1, columns) where there is no such
        goal.
    """

    action: Action
    arrivals: IndexArray
    slot: int | None
    levels: slice
    cost: RealArray


class AxisModel:
    """What a sub-MDP's backup is made of, in one floating type, as arrays of NumPy.

    Attributes
    ----------
    device : Device
        Where the backup is made.
    shape : tuple of int
        Of W: (cells q, rows (t, g), columns (f, r)).
    goal_cells : tuple of int
        Cell of each goal tracked.
    threat : float array (q, T, T)
        discount P(t' | t) on arrival.
    price : float array (2, q, T)
        discount E[p(t', m) | t] on arrival.
    priorities : list of float array (1, 3, 3)
        P(g_j' | g_j).
    failures : float array (3, 2)
        Failure probability of camera, actuator and sensor in normal and agile flight.
    losses : list of float array (2,)
        P(r_j: 1 -> 0) in flight, of each range flag that is a variable.
    drain : float array (2, D)
        P(d levels of the charge are drained) in flight, of d = 0..D-1; (2, 0) without a charge.
    recharged : int array (columns / 8,)
        (r) or (b) after an epoch of recharging, of that before.
    repair : float array ()
        P(f' = 1) of a repair.
    completion : float array (n, 8)
    base_cost : float array (1, 3^n, columns)
        What f, r and g cost, as if uncommitted; (q, 3^n, columns) with a charge, for r_j(b, l).
    choices : tuple of Choice
    """

    def __init__(self, sub: SubMdp, dtype: DTypeLike = np.float64, device: Device = CPU) -> None:
        mission = sub.mission
        self.sub, self.dtype, self.device = sub, np.dtype(dtype), device
        self.reduced = reduced = ReducedMission(sub)
        self.shape = self.q, self.rows, self.columns = sub.shape
        self.goal_cells = tuple(mission.goals[j].cell for j in sub.goals)
        self.threat = self._array(mission.discount * reduced.threat)
        self.price = self._array(reduced.price)
        matrices = priority_matrices(mission)
        self.priorities = [self._array(matrices[j][None]) for j in sub.goals]
        self.failures = self._array(failure_probabilities(mission)[:, ::-1].T)
        self._range_axes(mission)
        self.repair = self._array(mission.faults.repair_success)
        self.completion = self._array(completion_probabilities(mission)[list(sub.goals)])
        self.base_cost = self._base_cost()
        self.choices = self._choices()

    def _range_axes(self, mission: Mission) -> None:
        """Set `losses`, `drain` and `recharged`."""
        if mission.range.charge is None:
            self.losses = [self._array(range_loss_probabilities(mission))] * self.sub.n
            self.drain = self._array(np.empty((2, 0)))
            self.recharged = np.full(2**self.sub.n, 2**self.sub.n - 1)
            return
        self.losses, drain = [], drain_probabilities(mission)
        self.drain = self._array(drain[:, : np.flatnonzero(drain.any(axis=0))[-1] + 1])
        self.recharged = recharged_levels(mission)

    @property
    def arrivals(self) -> int:
        """Number of arrivals."""
        return 2 * self.q + len(ON_GROUND) + 2 * self.sub.n

    @cached_property
    def action_arrivals(self) -> IndexArray:
        """`Choice.arrivals` of all actions, shape (q, A)."""
        return np.stack([choice.arrivals for choice in self.choices], axis=1)

    @cached_property
    def action_costs(self) -> RealArray:
        """`Choice.cost` of all actions, shape (q, A, 3, columns)."""
        costs = np.empty((self.q, len(self.choices), 3, self.columns), self.dtype)
        for a, choice in enumerate(self.choices):
            costs[:, a] = choice.cost
        return costs

    @cached_property
    def action_levels(self) -> NDArray[np.uint8]:
        """Priority of each action's goal, 0 for those without one, shape (rows, A)."""
        levels = np.zeros((self.rows, len(self.choices)), np.uint8)
        for a, choice in enumerate(self.choices):
            if choice.slot is not None:
                levels[:, a] = np.arange(self.rows) // self.after[choice.slot] % 3
        return levels

    @cached_property
    def after(self) -> list[int]:
        """Rows from one priority of each goal tracked to the next."""
        return [3**slot for slot in reversed(range(self.sub.n))]

    def row_without(self, slot: int, row: int) -> int:
        """Row of a table that lacks the axis of a goal's priority."""
        before, within = divmod(row, 3 * self.after[slot])
        return before * self.after[slot] + within % self.after[slot]

    def zero(self) -> RealArray:
        """Return W = 0, on the device."""
        return self.device.namespace.zeros(self.shape, self.dtype)

    def empty(self, shape: int | tuple[int, ...]) -> RealArray:
        """Room for a table, on the device."""
        return self.device.namespace.empty(shape, self.dtype)

    def rounding(self, values: RealArray) -> float:
        """Bound on what rounding adds to one backup of W."""
        largest = max(-float(values.min()), float(values.max())) + self._largest_costs
        of_axes = ROUNDINGS_A_GOAL * self.sub.n + ROUNDINGS_A_THREAT * self.sub.threats
        roundings = of_axes + ROUNDINGS_A_DRAIN * self.drain.shape[1] + OTHER_ROUNDINGS
        return 1.01 * roundings * float(np.finfo(self.dtype).eps) / 2 * largest

    @cached_property
    def _largest_costs(self) -> float:
        costs = (self.base_cost, self.price, *(choice.cost for choice in self.choices))
        return sum(max(map(_largest, cost)) for cost in costs)  # By cells: b is large.

    def _array(self, values: Any) -> RealArray:
        return np.array(values, dtype=self.dtype)

    def _base_cost(self) -> RealArray:
        n, tables = self.sub.n, self.reduced.level_costs
        flags, width = self._flags(), self.columns // 8
        cost = np.zeros((tables.shape[1], 1, 8, width)) + self.sub.fault_costs[:, None]
        for table, r in zip(tables, flags):  # Each goal brings the axis of its priority.
            x = (self._flag_values * np.arange(3)[:, None] + r).T
            own = np.ascontiguousarray(table[..., x].transpose(0, 3, 1, 2))
            own = own.reshape(len(table), 1, 3, 1, width)
            cost = (cost[:, :, None] + own).reshape(len(table), -1, 8, width)
        return cost.reshape(len(cost), 3**n, self.columns).astype(self.dtype, copy=False)

    def _flags(self) -> IntArray:
        """r_j of each goal tracked over the values of the range flags that are variables."""
        n = self.sub.n
        return np.indices((self._flag_values,) * n).reshape(n, self._flag_values**n)

    @property
    def _flag_values(self) -> int:
        return self.sub.mission.range.flag_values

    def _choices(self) -> tuple[Choice, ...]:
        flags, reduced = self._flags(), self.reduced
        # An action looks at the priority of its own goal only, so all may have the same one.
        x = self._flag_values * np.arange(3)[:, None, None] + flags.T
        costs = reduced.action_costs(np.arange(self.q), x.reshape(3 * len(flags.T), self.sub.n))
        costs = costs.reshape(-1, self.q, reduced.z_values, 3, flags.shape[1])
        costs = costs.swapaxes(2, 3).reshape(-1, self.q, 3, self.columns)
        choices = []
        for a, action in enumerate(self.sub.actions):
            slot = self.sub.slot(action)
            cost = costs[a] if slot is not None else costs[a, :, :1]
            levels = hull(np.isfinite(cost).any(axis=(0, 2)))
            choices.append(Choice(action, self._arrivals(a), slot, levels, self._array(cost)))
        return tuple(choices)

    def _arrivals(self, a: int) -> IndexArray:
        reduced, ground = self.reduced, 2 * self.q
        regimes = reduced.regimes[a]
        flight = regimes * self.q + reduced.landings[a]
        arrivals = np.where(regimes < 2, flight, ground + regimes - 2)
        completing = ground + len(ON_GROUND) + 2 * reduced.slots[a] + reduced.agile[a]
        return np.where(reduced.completes[a], completing, arrivals)

    def locate(self, states: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Indices (cell, row, column) into W of global states (N, 2k+5), each of shape (N,)."""
        s, (by_level, by_range) = self.reduced.split(states), self._weights
        ranges, g = self.sub.range_values(states), self.sub.priorities(states)
        column = (s.f - 1) * by_range[0] + ranges @ by_range[1:]
        return s.l, s.t * by_level[0] + g @ by_level[1:], column

    @cached_property
    def _weights(self) -> tuple[IntArray, IntArray]:
        """What t and each g_j count for in a row, and f and each r_j, or b, in a column."""
        ranges = self.sub.ranges
        after = [math.prod(ranges[place:]) for place in range(len(ranges) + 1)]
        return 3 ** np.arange(self.sub.n, -1, -1), np.array(after)

    def state_values(self, values: RealArray, states: IntArray) -> FloatArray:
        """V(s) of global states, shape (N,)."""
        return values[self.locate(states)] + self.reduced.mode_costs(states)


def _largest(costs: RealArray) -> float:
    """Largest magnitude that is finite."""
    return float(np.abs(costs).max(initial=0.0, where=np.isfinite(costs)))


def hull(flags: ArrayLike) -> slice:
    """Smallest slice that holds all true flags; the whole where none is."""
    true = np.flatnonzero(flags)
    return slice(int(true[0]), int(true[-1]) + 1) if true.size else slice(0, np.size(flags))
