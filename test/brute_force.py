"""Reference model: every state, action and successor written out; policy iteration.

It reads the parsed mission file itself and shares no code, no array layout and no algorithm with
the package. Only tests use it: it holds the transition matrix the solver never forms.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

SENSOR, ACTUATOR, CAMERA = 1, 2, 4
IMPROVEMENT = 1e-12
"""Gain, relative to the largest cost, below which policy iteration calls two actions equal."""


def independent(*marginals):
    """Outcomes of independent variables, each a list of (value, probability): [(values, p)].

    A variable may name a value more than once.
    """
    outcomes = [((), 1.0)]
    for marginal in marginals:
        total = dict.fromkeys((value for value, p in marginal if p > 0), 0.0)
        for value, p in marginal:
            if p > 0:
                total[value] += p
        outcomes = [((*values, v), p * q) for values, p in outcomes for v, q in total.items()]
    return outcomes


class BruteForce:
    """The mission's MDP, states as tuples (f, r_1.., g_1.., l, c, t, m).

    With a charge (f, b, g_1.., l, c, t, m).
    """

    threats = 3

    def __init__(self, document):
        self.document = document
        self.goals = document['goals']
        self.k = len(self.goals)
        self.rows, self.cols = document['grid']['rows'], document['grid']['cols']
        self.base, self.service = document['grid']['base'], document['grid']['service']
        self.actions = range(1, 2 * self.k + 5)
        self.charge = document['range'].get('charge')
        self.levels = self.charge.get('levels', 16) if self.charge else None

    @cached_property
    def states(self):
        k, cells = self.k, self.rows * self.cols
        ranges = [range(self.levels)] if self.charge else [range(2)] * k
        axes = [range(1, 9), *ranges, *[range(3)] * k, range(cells), range(k + 1)]
        return list(itertools.product(*axes, range(self.threats), range(2)))

    def split(self, state):
        """(f, (r_1..), (g_1..), l, c, t, m)."""
        k, first = self.k, 2 if self.charge else 1 + self.k
        flags = state[1:first]
        if self.charge:
            flags = tuple(self.in_range(state[1], state[-4], j) for j in range(k))
        return (state[0], flags, state[first : first + k], *state[first + k :])

    def metres(self, a, b):
        size = self.document['grid'].get('cell_size', 50.0)
        (row, col), (other_row, other_col) = divmod(a, self.cols), divmod(b, self.cols)
        return size * math.sqrt((row - other_row) ** 2 + (col - other_col) ** 2)

    def in_range(self, level, cell, j):
        energy, goal = self.document['energy'], self.goals[j]['cell']
        soc = level / self.levels - self.charge.get('reserve', 0.1)
        hours = soc * energy['capacity'] * energy['voltage'] / energy['power']
        reach = 3600.0 * hours * energy['speed'] - energy['wind_penalty'] * energy['wind']
        reach -= energy['payload_penalty'] * energy['payload']
        return int(reach >= self.metres(cell, goal) + self.metres(goal, self.service))

    def drained(self, agile):
        """(levels, probability) of one epoch in flight."""
        mode = 'agile' if agile else 'normal'
        if 'drain' in self.charge:
            return list(enumerate(self.charge['drain'][mode]))
        energy, prefix = self.document['energy'], 'agile_' if agile else ''
        speed = energy.get(prefix + 'speed', energy['speed'])
        power = energy.get(prefix + 'power', energy['power'])
        joule = power * self.document['grid'].get('cell_size', 50.0) / speed
        mean = self.levels * joule / (energy['capacity'] * energy['voltage'] * 3600.0)
        noise, outcomes = self.charge.get('noise', 0.2), []
        for factor, p in ((1 - noise, 0.25), (1.0, 0.5), (1 + noise, 0.25)):
            levels = min(mean * factor, self.levels)
            below = math.floor(levels)
            outcomes += [(below, p * (below + 1 - levels)), (below + 1, p * (levels - below))]
        return outcomes

    def effect(self, action):
        """(kind, agile, c', destination) of a global action."""
        k, cells = self.k, [goal['cell'] for goal in self.goals]
        if action == 1:
            return 'none', 0, 0, self.base
        if action <= k + 1:
            return 'commit', 0, action - 1, cells[action - 2]
        if action == k + 2:
            return 'none', 1, 0, self.base
        if action <= 2 * k + 2:
            return 'commit', 1, action - k - 2, cells[action - k - 3]
        return 'recharge' if action == 2 * k + 3 else 'repair', 0, 0, self.service

    def allowed(self, state, action):
        if self.document.get('feasibility') == 'paper':
            return True
        f, r, g, *_ = self.split(state)
        kind, _, goal, _ = self.effect(action)
        if kind == 'commit':
            return g[goal - 1] > 0 and r[goal - 1] == 1 and self.completion(f, goal) > 0
        if kind == 'recharge':
            return state[1] < self.levels - 1 if self.charge else 0 in r
        return f > 1 if kind == 'repair' else True

    def completion(self, f, goal):
        common = self.document['faults']['completion']
        return self.goals[goal - 1].get('completion', common)[f - 1]

    def steps(self, a, b):
        return abs(a // self.cols - b // self.cols) + abs(a % self.cols - b % self.cols)

    def next_cell(self, cell, destination):
        if cell == destination:
            return cell
        closer = [
            n
            for n in range(self.rows * self.cols)
            if self.steps(n, cell) == 1
            and self.steps(n, destination) == self.steps(cell, destination) - 1
        ]
        return min(closer)

    def cost(self, state, action):
        doc = self.document
        f, r, g, cell, c, t, m = self.split(state)
        kind, _, _, destination = self.effect(action)
        total = 0.0
        for j, goal in enumerate(self.goals):
            total += goal['eta'] * g[j] * r[j] * (0 if c == j + 1 else 1)
            total += goal['delta'] * g[j] * (1 - r[j])
            total += doc['range']['cost'] / self.k * (1 - r[j])
        south = cell // self.cols - destination // self.cols
        east = cell % self.cols - destination % self.cols
        total += doc['distance_weight'] * math.sqrt(south**2 + east**2)
        if cell == self.service and kind in ('recharge', 'repair'):
            total += doc.get('service_cost', {}).get(kind, 0.0)
        if self.charge and state[1] == 0 and not self.on_ground(state, action):
            total += self.charge['empty_cost']
        return total + doc['faults']['cost'][f - 1] + doc['threat']['cost'][t][m]

    def on_ground(self, state, action):
        kind, agile, _, destination = self.effect(action)
        return state[-4] == destination and not agile and kind != 'commit'

    def fault_outcomes(self, f, agile):
        """(f', probability) of one epoch in flight."""
        faults = self.document['faults']
        bits = []
        for part, bit in (('sensor', SENSOR), ('actuator', ACTUATOR), ('camera', CAMERA)):
            rate = faults['rate'][part]
            if agile:
                rate = min(1.0, rate * faults['agile_factor'][part])
            bits.append([(bit, 1.0)] if (f - 1) & bit else [(bit, rate), (0, 1.0 - rate)])
        return [(1 + sum(values), p) for values, p in independent(*bits)]

    def health_outcomes(self, state, action):
        """(f', probability) and, a goal each, (r_j', probability), or of the charge (b', ..)."""
        if self.charge:
            return self.fault_outcomes_by(state, action), [self.charge_outcomes(state, action)]
        f, r, _, cell, *_ = self.split(state)
        kind, agile, _, _ = self.effect(action)
        if kind == 'none' and not agile and cell == self.base:
            return [(f, 1.0)], [[(flag, 1.0)] for flag in r]
        if kind == 'recharge' and cell == self.service:
            return [(f, 1.0)], [[(1, 1.0)] for _ in r]
        if kind == 'repair' and cell == self.service:
            success = self.document['faults'].get('repair_success', 1.0)
            return [(1, success), (f, 1.0 - success)], [[(flag, 1.0)] for flag in r]
        loss = self.document['range']['loss']['agile' if agile else 'normal']
        flags = [[(0, loss), (1, 1.0 - loss)] if flag else [(0, 1.0)] for flag in r]
        return self.fault_outcomes(f, agile), flags

    def fault_outcomes_by(self, state, action):
        f, (kind, agile, _, _) = state[0], self.effect(action)
        if not self.on_ground(state, action):
            return self.fault_outcomes(f, agile)
        success = self.document['faults'].get('repair_success', 1.0) if kind == 'repair' else 0.0
        return [(1, success), (f, 1.0 - success)]

    def charge_outcomes(self, state, action):
        b, (kind, agile, _, _) = state[1], self.effect(action)
        if not self.on_ground(state, action):
            return [(max(b - d, 0), p) for d, p in self.drained(agile)]
        gained = self.charge.get('rate', self.levels) if kind == 'recharge' else 0
        return [(min(b + gained, self.levels - 1), 1.0)]

    def threat_outcomes(self, t, cell):
        threat = self.document['threat']
        if t:
            return list(enumerate(threat['from_low' if t == 1 else 'from_high']))
        onset = threat.get('zones', {}).get(cell, threat['onset'])
        high = threat['high_share']
        return [(0, 1 - onset), (1, onset * (1 - high)), (2, onset * high)]

    def priority_outcomes(self, j, level):
        common = self.document.get('priority_transition')
        return list(enumerate(self.goals[j].get('priority_transition', common)[level]))

    def goal_on_site(self, state, action):
        """Number of the goal that the action commits to if the UAV is on its cell, else 0."""
        kind, _, goal, destination = self.effect(action)
        return goal if kind == 'commit' and state[-4] == destination else 0

    def successors(self, state, action):
        """Every (state', probability) of one epoch."""
        f, _, g, cell, _, t, _ = self.split(state)
        _, agile, commitment, destination = self.effect(action)
        faults, flags = self.health_outcomes(state, action)
        after = self.next_cell(cell, destination)
        threats = self.threat_outcomes(t, after)
        on_site = self.goal_on_site(state, action)
        done = self.completion(f, on_site) if on_site else 0.0
        outcomes = []
        for completed, weight in ((True, done), (False, 1.0 - done)):
            if weight == 0:
                continue
            goals = [self.priority_outcomes(j, g[j]) for j in range(self.k)]
            if completed:
                goals[on_site - 1] = [(0, 1.0)]
            c = 0 if completed else commitment
            outcomes += [
                ((*values, after, c, threat, agile), weight * p * q)
                for values, p in independent(faults, *flags, *goals)
                for threat, q in threats
                if q > 0
            ]
        return outcomes


@dataclass(frozen=True)
class Solution:
    """Q of all states, shape (N, 2k+4), inf where not allowed, and the states, shape (N, 2k+5)."""

    states: np.ndarray
    q: np.ndarray

    @property
    def v(self):
        return self.q.min(axis=1)


def matrices(model):
    """Costs (N, A), the successor rows as one CSR matrix, and the row of each (state, action).

    States that differ only in what `successors` does not read share a row.
    """
    number = {state: i for i, state in enumerate(model.states)}
    shape = (len(model.states), len(model.actions))
    costs, row_of = np.full(shape, np.inf), np.zeros(shape, dtype=int)
    known, indptr, columns, data = {}, [0], [], []
    for (i, state), action in itertools.product(enumerate(model.states), model.actions):
        if not model.allowed(state, action):
            continue
        costs[i, action - 1] = model.cost(state, action)
        key = (*state[:-3], state[-2], action)
        if key not in known:
            known[key] = len(known)
            after, p = zip(*model.successors(state, action))
            columns.extend(map(number.__getitem__, after))
            data.extend(p)
            indptr.append(len(data))
        row_of[i, action - 1] = known[key]
    rows = sparse.csr_matrix((data, columns, indptr), shape=(len(known), shape[0]))
    return costs, rows, row_of


def evaluate(costs, rows, row_of, discount):
    """Cost of a policy: V = J + discount R W, W = U V, U its distinct rows, R who uses which."""
    used, position = np.unique(row_of, return_inverse=True)
    n = len(used)
    users = sparse.csr_matrix((np.ones(len(costs)), (np.arange(len(costs)), position.ravel())))
    system = sparse.identity(n) - discount * (rows[used] @ users)
    expected = linalg.spsolve(system.tocsc(), rows[used] @ costs)
    return costs + discount * users @ expected


def solve(model):
    """Policy iteration to the end: no action beats the policy's own any more."""
    costs, rows, row_of = matrices(model)
    discount = model.document['discount']
    everyone = np.arange(len(costs))
    policy = np.zeros(len(costs), dtype=int)
    for _ in range(200):
        v = evaluate(costs[everyone, policy], rows, row_of[everyone, policy], discount)
        q = costs + discount * (rows @ v)[row_of]
        better = q.min(axis=1) < q[everyone, policy] - IMPROVEMENT * np.abs(v).max()
        if not better.any():
            return Solution(np.array(model.states), q)
        policy = np.where(better, q.argmin(axis=1), policy)
    raise ArithmeticError('policy iteration did not end')
