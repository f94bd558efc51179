"""The mission in factors, none of which grows with 2^k 3^k.

One goal's part of the state is x_j = 2 g_j + r_j, of six values; what the goals share is
y = (place, t, f), the place being the cell or the goal's site while committed to it there (see
`uav_mission_manager.solver.reduced`). Given the action, y and every x_j move independently, but
for completion. An action leads to a place in one of five ways.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.mdp.actions import global_actions
from uav_mission_manager.mdp.dynamics import (
    failure_matrices,
    on_ground,
    priority_matrices,
    range_matrix,
    threat_matrices,
)
from uav_mission_manager.mdp.mission import Mission

FloatArray = NDArray[np.float64]

WAYS = ('normal', 'agile', 'none', 'recharge', 'repair')
"""Flight in two modes, and what there is on the ground."""

LEVELS, FLAGS = np.divmod(np.arange(6), 2)
"""g_j and r_j of each x_j."""

STAKES = LEVELS * FLAGS
"""g_j r_j of each x_j; above 0 where the goal may be committed to."""


class Factors:
    """Small matrices and costs of a mission with k goals, P = q + k places and A actions.

    Attributes
    ----------
    cells : int array (P,)
        Cell of each place.
    landing, way : int array (A, P)
        Place an action leads to where nothing is completed, and how, by position in `WAYS`.
    threat : float array (P, 3, 3)
        P(t' | t) on arrival.
    faults : float array (5, 8, 8)
        P(f' | f) of each way.
    goals : float array (5, k, 6, 6)
        P(x_j' | x_j) of each way.
    achieved : float array (5, 6, 6)
        The same where the goal is completed.
    completion : float array (8,)
    distance : float array (A, P)
        h(a, place).
    cost : float array (k, 6)
        Part of J that x_j decides, as if uncommitted.
    saving : float array (2, k, 6)
        Discounted E[eta_j g_j' r_j'] after a normal and an agile flight: what a commitment saves.
    price : float array (2, P, 3)
        Discounted E[p(t', m') | t] on arrival in each mode.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission, self.k, self.q = mission, mission.k, mission.grid.q
        self.places = self.q + self.k
        self.actions = global_actions(mission)
        self.cells = np.array([*range(self.q), *(goal.cell for goal in mission.goals)])
        self.threat = threat_matrices(mission)[self.cells]
        self.completion = np.array(mission.faults.completion)
        self.faults = _faults(mission)
        flags = [range_matrix(mission, agile) for agile in (False, True)]
        flags += [np.eye(2), np.array([[0.0, 1.0], [0.0, 1.0]]), np.eye(2)]
        priorities = priority_matrices(mission)
        self.goals = np.array([[np.kron(g, r) for g in priorities] for r in flags])
        done = np.zeros((3, 3))
        done[:, 0] = 1
        self.achieved = np.array([np.kron(done, r) for r in flags])
        self._move()
        eta = np.array([[goal.eta] for goal in mission.goals])
        delta = np.array([[goal.delta] for goal in mission.goals])
        lost = delta * LEVELS + mission.range.cost / mission.k
        self.cost = eta * STAKES + lost * (1 - FLAGS)
        self.saving = mission.discount * np.einsum(
            'wjxy,jy->wjx', self.goals[:2], eta * STAKES
        )
        price = np.array(mission.threat.cost)
        self.price = mission.discount * np.einsum('pst,tm->mps', self.threat, price)

    @property
    def strict(self) -> bool:
        """Whether actions are allowed only where they make sense."""
        return self.mission.feasibility == 'strict'

    def action_costs(self, place: int, x: NDArray[np.int64]) -> FloatArray:
        """What the actions add to Q besides what follows and what the state costs, (A, 8, N).

        For x of shape (N, k): the distance less what a commitment saves; inf where an action is
        not allowed.
        """
        costs = np.empty((len(self.actions), 8, len(x)))
        costs[:] = self.distance[:, place, None, None]
        # On a site the goal may be completed, which drops the commitment whatever goal it is to.
        kept = 1 - self.completion if place >= self.q else np.ones(8)
        for action, cost in zip(self.actions, costs):
            if action.kind == 'commit':
                own = x[:, action.goal - 1]
                cost -= kept[:, None] * self.saving[int(action.agile), action.goal - 1, own]
                if self.strict:
                    cost[:, STAKES[own] == 0] = np.inf
                    cost[self.completion == 0] = np.inf
            elif action.kind == 'recharge' and self.strict:
                cost[:, FLAGS[x].all(axis=1)] = np.inf
            elif action.kind == 'repair' and self.strict:
                cost[0] = np.inf
        return costs

    def _move(self) -> None:
        mission, shape = self.mission, (len(self.actions), self.places)
        hops = mission.grid.next_hops()
        distances = mission.distance_weight * mission.grid.distances()
        self.landing, self.way = np.zeros(shape, np.intp), np.zeros(shape, np.intp)
        self.distance = np.zeros(shape)
        for a, action in enumerate(self.actions):
            landing = hops[self.cells, action.destination]
            if action.goal:
                site = self.q + action.goal - 1
                landing = np.where(landing == action.destination, site, landing)
            self.landing[a] = landing
            grounded = [on_ground(mission, action, cell) for cell in self.cells.tolist()]
            self.way[a] = np.where(grounded, _ground(action.kind), int(action.agile))
            self.distance[a] = distances[self.cells, action.destination]
            if action.kind in ('recharge', 'repair'):
                price = getattr(mission.service_cost, action.kind)
                self.distance[a, self.cells == mission.grid.service] += price


def goal_order(mission: Mission) -> list[int]:
    """Goals from 0 in an order that does not depend on how they are numbered or called."""
    keys = [(g.cell, g.eta, g.delta, g.priority_transition) for g in mission.goals]
    return sorted(range(mission.k), key=keys.__getitem__)


def _ground(kind: str) -> int:
    return WAYS.index(kind) if kind in WAYS else 0


def _faults(mission: Mission) -> FloatArray:
    """P(f' | f) of each way; the bits of f - 1 are camera, actuator, sensor from the slowest."""
    flights = []
    for agile in (False, True):
        sensor, actuator, camera = failure_matrices(mission, agile)
        flights.append(np.kron(np.kron(camera, actuator), sensor))
    kept = np.eye(8)
    repaired = (1 - mission.faults.repair_success) * kept
    repaired[:, 0] += mission.faults.repair_success
    return np.stack([*flights, kept, kept, repaired])
