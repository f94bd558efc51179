"""The Bellman equation on the mission's Kronecker structure.

The stage cost splits into a part that the state's c and m decide and a part they do not:

    J(s, a) = p(t, m) - [c > 0] eta_c g_c r_c + b(f, r, g) + h(a, l)

with b the paper's cost of all goals as if uncommitted. c and m touch the future only where c = j
on the cell of goal j, where the goal may be completed. Hence, exactly,

    V(s) = p(t, m) - [c > 0] eta_c g_c r_c + W(x, t, g, f, r),

with x the *place*: the cell l, or the site of goal j, which is its cell while committed to it. W
over the q + n places is all there is to compute:

    W(x) = b + min_a h(a, x) - bonus(a, x) + discount E[W(x') + p(t', m')]

An action leads to one *arrival*: a place x' in a mode, or one of three on the ground. On a site
the goal is completed with some probability, and then the arrival is that on the cell x' without
commitment, with g_j' = 0. Given the arrival the variables move independently, so E is one small
matrix a variable, applied along its axis; a transition matrix over states never exists.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from uav_mission_manager.mdp.actions import Action
from uav_mission_manager.mdp.dynamics import (
    failure_matrices,
    on_ground,
    priority_matrices,
    range_matrix,
    threat_matrices,
)
from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.submdp import SubMdp

GROUND = ('none', 'recharge', 'repair')
"""The arrivals on the ground: `none` on base, the others on the service cell."""

ROUNDINGS_A_GOAL, ROUNDINGS = 12, 44
"""Errors of half an ulp of the largest entry in one backup, at most: 5 for t, 4 for each g_j, 8
for each r_j, each part that fails and completion, 7 for costs, change and shift."""


@dataclass(frozen=True)
class Choice:
    """An action as the backup sees it.

    Attributes
    ----------
    action : Action
    arrivals : int array (places,)
        Its arrival from each place: x' normal, places + x' agile, 2 places + position in
        `GROUND`; from sites one of the operator's `sites`, numbered on from there.
    slot : int or None
        Goal whose priority the cost below depends on.
    levels : slice
        Priorities of that goal outside which it is allowed nowhere.
    cost : float array (places, 3, 8 * 2^n)
        h - discount bonus over its priority; inf where not allowed. (places, 1, 8 * 2^n) where
        there is no such goal.
    """

    action: Action
    arrivals: NDArray[np.intp]
    slot: int | None
    levels: slice
    cost: FloatArray


class BellmanOperator:
    """What a sub-MDP's backup is made of, as arrays of one floating type.

    Tables over states have the axes (place, (t, g), (f, r)) and shape (q + n, 3 * 3^n, 8 * 2^n).

    Attributes
    ----------
    cells : tuple of int
        Cell of each place.
    threat : float array (places, 3, 3)
        discount P(t' | t) on arrival.
    price : float array (2, places, 3)
        discount E[p(t', m) | t] on arrival.
    priorities : list of float array (1, 3, 3)
        P(g_j' | g_j).
    failures : float array (3, 2)
        Failure probability of camera, actuator and sensor in normal and agile flight.
    loss : float array (2,)
        P(r_j: 1 -> 0) in flight.
    repair : float array ()
        P(f' = 1) of a repair.
    completion : float array (8,)
    landings : tuple of tuple of int
        Cells an epoch away from each goal's.
    sites : tuple of tuple of (int, int)
        For each goal's site the different pairs of an arrival where the goal is not completed
        and one where it is; these are numbered as the others are, with `landings` for places.
    choices : tuple of Choice
    """

    def __init__(self, sub: SubMdp, dtype: DTypeLike = np.float64) -> None:
        mission, n, q = sub.mission, sub.n, sub.mission.grid.q
        self.sub, self.dtype = sub, np.dtype(dtype)
        self.q, self.places = q, q + n
        self.rows, self.columns = 3 * 3**n, 8 * 2**n
        self.cells = (*range(q), *(mission.goals[j].cell for j in sub.goals))
        self.threat_price = sub.share * np.array(mission.threat.cost)
        threat = threat_matrices(mission)[list(self.cells)]
        self.threat = self._array(mission.discount * threat)
        # Sums over t' in a fixed order, not a matrix product.
        none, low, high = np.moveaxis(self.threat_price.T[:, None, None] * threat, -1, 0)
        self.price = self._array(mission.discount * (none + low + high))
        matrices = priority_matrices(mission)
        self.priorities = [self._array(matrices[j][None]) for j in sub.goals]
        failures = [failure_matrices(mission, agile) for agile in (False, True)]
        self.failures = self._array([[p[0, 1] for p in parts[::-1]] for parts in failures]).T
        self._keep = [range_matrix(mission, agile)[:, 1] for agile in (False, True)]
        self.loss = self._array([1 - keep[1] for keep in self._keep])
        self.repair = self._array(mission.faults.repair_success)
        self.completion = self._array(mission.faults.completion)
        self.hops = mission.grid.next_hops()
        destinations = [action.destination for action in sub.actions]
        self.landings = tuple(
            tuple(np.unique(self.hops[cell, destinations]).tolist()) for cell in self.cells[q:]
        )
        self.sites = tuple(
            tuple(sorted({self._site_arrival(action, slot) for action in sub.actions}))
            for slot in range(n)
        )
        way = sub.share * sub.way
        distance = way * mission.distance_weight * mission.grid.distances()
        self.choices = tuple(self._choice(action, distance) for action in sub.actions)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of W: (places, rows (t, g), columns (f, r))."""
        return self.places, self.rows, self.columns

    def zero(self) -> FloatArray:
        """Return W = 0."""
        return np.zeros(self.shape, dtype=self.dtype)

    def rounding(self, values: FloatArray) -> float:
        """Bound on what rounding adds to one backup of W."""
        largest = max(-float(values.min()), float(values.max()))
        for costs in (self.base_cost, self.price, *(choice.cost for choice in self.choices)):
            largest += float(np.abs(costs).max(initial=0.0, where=np.isfinite(costs)))
        roundings = ROUNDINGS_A_GOAL * self.sub.n + ROUNDINGS
        return 1.01 * roundings * float(np.finfo(self.dtype).eps) / 2 * largest

    def _array(self, values: Any) -> FloatArray:
        return np.array(values, dtype=self.dtype)

    @cached_property
    def base_cost(self) -> FloatArray:
        """b(f, r, g), float array (3^n, 8 * 2^n)."""
        mission, sub = self.sub.mission, self.sub
        faults = sub.share * np.array(mission.faults.cost)
        cost = np.zeros((3**sub.n, 8, 2**sub.n)) + faults[:, None]
        for j, r, g in zip(sub.goals, sub.flags, sub.priorities):
            goal = mission.goals[j]
            by_level = goal.eta * r + goal.delta * (1 - r)
            cost += g[:, None, None] * by_level + mission.range.cost / mission.k * (1 - r)
        return self._array(cost.reshape(3**sub.n, self.columns))

    def _choice(self, action: Action, distance: FloatArray) -> Choice:
        sub = self.sub
        slot = sub.slot(action)
        allowed = sub.allowed(action)
        cost = np.zeros((self.places, *allowed.shape))
        cost += distance[list(self.cells), action.destination][:, None, None, None]
        if action.kind in ('recharge', 'repair'):
            service_cost = sub.share * sub.way * getattr(sub.mission.service_cost, action.kind)
            cost[np.array(self.cells) == sub.mission.grid.service] += service_cost
        if slot is not None:
            cost -= self._bonus(action, slot)
        cost[:, ~allowed] = np.inf
        return Choice(
            action=action,
            arrivals=np.array(self._arrivals(action)),
            slot=slot,
            levels=hull(allowed.any(axis=(1, 2))),
            cost=self._array(cost.reshape(self.places, -1, self.columns)),
        )

    def _bonus(self, action: Action, slot: int) -> FloatArray:
        """Discount E[eta_j g_j' r_j'] on commitment to goal j, over (place, g_j, f, r).

        On a site it is earned only where that site's goal is not completed.
        """
        sub = self.sub
        goal = sub.mission.goals[sub.goals[slot]]
        matrix = np.array(goal.priority_transition)
        g = goal.eta * (matrix[:, 1] + 2 * matrix[:, 2])
        r = self._keep[action.agile][sub.flags[slot]]
        bonus = np.empty((self.places, 3, 8, 2**sub.n))
        bonus[:] = sub.mission.discount * g[:, None, None] * r
        bonus[self.q :] *= 1 - np.array(sub.mission.faults.completion)[:, None]
        return bonus

    def _arrival(self, action: Action, place: int) -> int:
        cell = self.cells[place]
        if on_ground(self.sub.mission, action, cell):
            return 2 * self.places + GROUND.index(action.kind)
        landing = int(self.hops[cell, action.destination])
        slot = self.sub.slot(action)
        if slot is not None and landing == action.destination:
            landing = self.q + slot
        return self.places * action.agile + landing

    def _site_arrival(self, action: Action, slot: int) -> tuple[int, int]:
        """Arrival from a site, where its goal is not completed and where it is."""
        place, landings = self.q + slot, self.landings[slot]
        cell = self.cells[place]
        if on_ground(self.sub.mission, action, cell):
            completed = 2 * len(landings) + GROUND.index(action.kind)
        else:
            landing = landings.index(int(self.hops[cell, action.destination]))
            completed = len(landings) * action.agile + landing
        return self._arrival(action, place), completed

    def _arrivals(self, action: Action) -> list[int]:
        arrivals = [self._arrival(action, cell) for cell in range(self.q)]
        first = 2 * self.places + len(GROUND)
        for slot, site in enumerate(self.sites):
            arrivals.append(first + site.index(self._site_arrival(action, slot)))
            first += len(site)
        return arrivals

    def locate(self, states: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
        """Indices (place, row, column) into W of global states (N, 2k+5), each of shape (N,)."""
        sub = self.sub
        r, g = sub.columns(states)
        place = states[:, -4].copy()
        for slot, j in enumerate(sub.goals):
            on_site = (states[:, -3] == j + 1) & (states[:, -4] == self.cells[self.q + slot])
            place[on_site] = self.q + slot
        n, digits = sub.n, np.arange(sub.n)[::-1]
        row = states[:, -2] * 3**n + g @ 3**digits
        return place, row, (states[:, 0] - 1) * 2**n + r @ 2**digits

    def stage_cost(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """J(s, a) - h(a, l) of global states, shape (N,)."""
        sub, mission = self.sub, self.sub.mission
        r, g = sub.columns(states)
        _, delta = sub.weights
        lost = (delta * g + mission.range.cost / mission.k) * (1 - r)
        committed = sub.weights[0] * g * r
        faults = sub.share * np.array(mission.faults.cost)[states[:, 0] - 1]
        return faults + (lost + committed).sum(axis=1) + self.mode_cost(states)

    def mode_cost(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """p(t, m) - [c > 0] eta_c g_c r_c of global states, shape (N,)."""
        sub = self.sub
        r, g = sub.columns(states)
        committed = states[:, -3, None] == np.array(sub.goals) + 1
        saved = (sub.weights[0] * g * r * committed).sum(axis=1)
        return np.asarray(self.threat_price[states[:, -2], states[:, -1]] - saved)

    def state_values(self, values: FloatArray, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """V(s) of global states, shape (N,)."""
        return values[self.locate(states)] + self.mode_cost(states)


def hull(flags: ArrayLike) -> slice:
    """Smallest slice that holds all true flags; the whole where none is."""
    true = np.flatnonzero(flags)
    return slice(int(true[0]), int(true[-1]) + 1) if true.size else slice(0, np.size(flags))
