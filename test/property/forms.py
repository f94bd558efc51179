"""The forms of the model: Q (N, 2k+4) of a mission, a W and states (N, 2k+5) in each.

W is an array over l, t, g_1.., f, r_1.., or with a charge over l, t, g_1.., f, b.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from uav_mission_manager.mdp import (
    StateSpace,
    allowed_actions,
    cost,
    dynamics,
    global_actions,
    stage_costs,
)
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.solver.bounds.cluster_mdp import ClusterMdp
from uav_mission_manager.solver.exact import AxisModel, LookAhead, Sweeper, look_ahead
from uav_mission_manager.solver.expansion import Clusters, Expansion, ExpansionLookAhead
from uav_mission_manager.solver.expansion.basis import Basis
from uav_mission_manager.solver.reduced import ReducedMission
from uav_mission_manager.solver.submdp import whole_mission


def by_matrices(mission, w, states):
    """From `mdp` alone, with one product of matrices an action."""
    q = np.where(allowed_actions(mission, states), 0.0, np.inf)
    for i, state in enumerate(states):
        for action in global_actions(mission):
            expected = sum(
                weight * probability * value_of(mission, w, after)
                for weight, outcomes in outcomes_of(mission, state, action)
                for after, probability in outcomes.items()
            )
            j = stage_costs(mission, state, [action.number])[0]
            q[i, action.number - 1] += j + mission.discount * expected
    return q


def value_of(mission, w, state):
    s = StateSpace.of(mission).split(np.array(state))
    value = cost.threat_costs(mission)[s.t, s.m] + w[(s.l, s.t, *s.g, s.f - 1, *s.r, *s.b)]
    if s.c:
        j = s.c - 1
        value -= cost.commitment_savings(mission)[j, s.g[j], RangeFlags(mission)(s)[j]]
    return value


def outcomes_of(mission, state, action):
    """(weight, {s': P(s')}) where the action's goal is completed, and where it is not."""
    space = StateSpace.of(mission)
    s = space.split(state)
    a, regime = action.number - 1, dynamics.regimes(mission)[action.number - 1, s.l]
    after = int(dynamics.landings(mission)[a, s.l])
    faults = dynamics.fault_matrices(mission)[regime, s.f - 1]
    ranges = [
        *dynamics.range_matrices(mission)[regime, s.r],
        *dynamics.charge_matrices(mission)[regime, s.b],
    ]
    priorities = dynamics.priority_matrices(mission)[np.arange(mission.k), s.g]
    threats = dynamics.threat_matrices(mission)[after, s.t]
    done = 0.0
    if dynamics.may_complete(mission)[a, s.l]:
        done = dynamics.completion_probabilities(mission)[action.goal, s.f - 1]
    for weight, completed in ((done, True), (1 - done, False)):
        rows = priorities.copy()
        if completed and action.goal is not None:
            rows[action.goal] = 1.0, 0.0, 0.0
        commitment = 0 if completed else action.commitment
        outcomes = {}
        for f, *rest, t in itertools.product(
            range(8), *map(range, space.ranges), *[range(3)] * mission.k, range(3)
        ):
            r, g = rest[: len(space.ranges)], rest[len(space.ranges) :]
            p = faults[f] * math.prod(row[x] for row, x in zip(ranges, r))
            p *= math.prod(row[x] for row, x in zip(rows, g)) * threats[t]
            if p * weight > 0:
                next_state = (f + 1, *r, *g, after, commitment, t, int(action.agile))
                outcomes[next_state] = p
        yield weight, outcomes


def by_x(mission, w):
    """W over l, t, z, x_1.., with x_j = 2 g_j + r_j, or x_j = g_j and z = (f, b)."""
    k = mission.k
    if mission.range.charge is not None:
        w = w.reshape(*w.shape[: 2 + k], -1)
        return w.transpose(0, 1, 2 + k, *range(2, 2 + k))
    axes = [0, 1, 2 + k, *itertools.chain(*((2 + j, 3 + k + j) for j in range(k)))]
    return w.transpose(axes).reshape(len(w), 3, 8, *(6,) * k)


def by_reduced_mission(mission, w, states):
    """From the factors of `ReducedMission`."""
    reduced, k, table = ReducedMission(whole_mission(mission)), mission.k, by_x(mission, w)
    s, x = reduced.split(states), reduced.x(states)
    q = np.empty((len(states), 2 * k + 4))
    for i in range(len(states)):
        cell, t, z = s.l[i], s.t[i], reduced.z(states)[i]
        q[i] = reduced.action_costs(cell, x[i : i + 1], np.array([z]))[:, 0, 0]
        for a, slot in enumerate(reduced.slots):
            after, regime = reduced.landings[a, cell], reduced.regimes[a, cell]
            rows = [reduced.goals[regime, j, x[i, j]] for j in range(k)]
            done = reduced.completion[slot, z] if reduced.completes[a, cell] else 0.0
            rows[slot] = done * reduced.completed[regime, x[i, slot]] + (1 - done) * rows[slot]
            expected = np.tensordot(reduced.threat[after, t], table[after], 1)
            expected = np.tensordot(reduced.conditions[regime, z], expected, 1)
            for row in rows:
                expected = np.tensordot(row, expected, 1)
            q[i, a] += reduced.price[reduced.agile[a], after, t] + mission.discount * expected
    return q + reduced.state_costs(states)[:, None]


def along_axes(model, w):
    """W as the exact solution has it."""
    return np.ascontiguousarray(w.reshape(model.shape))


def by_tables(mission, w, states):
    """From the exact solution's tables of E[W]."""
    model = AxisModel(whole_mission(mission))
    ahead = LookAhead(model, along_axes(model, w))
    assert ahead.table is not None
    return ahead.q_values(states)


def by_successors(mission, w, states):
    """From the exact solution's sums over successors, made where tables would be too large."""
    model = AxisModel(whole_mission(mission))
    kept, look_ahead.MAX_TABLED_ENTRIES = look_ahead.MAX_TABLED_ENTRIES, 0
    try:
        ahead = LookAhead(model, along_axes(model, w))
    finally:
        look_ahead.MAX_TABLED_ENTRIES = kept
    assert ahead.table is None
    return ahead.q_values(states)


def by_cluster(mission, w, states):
    """From the lower bound's cluster of all goals."""
    mdp = ClusterMdp(whole_mission(mission), np.float64)
    reduced = mdp.reduced
    z_values, x_values = reduced.z_values, reduced.x_values
    ahead = mdp.ahead(by_x(mission, w).reshape(len(w), 3 * z_values, -1).swapaxes(1, 2))
    s, column = reduced.split(states), reduced.x(states) @ x_values ** np.arange(mission.k)[::-1]
    mode, costs = z_values * s.t + reduced.z(states), mdp.costs({})
    tables = (mdp.q_values(cell, ahead, costs).reshape(-1, *mdp.shape[1:]) for cell in s.l)
    q = [table[:, x, i] for table, x, i in zip(tables, column, mode)]
    own = mdp.state_costs[s.l % len(mdp.state_costs), column, mode]
    own = own + reduced.mode_costs(states)
    return np.array(q) + own[:, None]


def by_expansion(mission, w, states):
    """From an expansion with clusters of all goals, in which every W has its coefficients."""
    clusters = Clusters.up_to(mission, mission.k, 10**9)
    basis = Basis(ReducedMission(whole_mission(mission)), clusters)
    x = np.indices((basis.reduced.x_values,) * mission.k).reshape(mission.k, -1).T
    theta = np.linalg.solve(basis.now(x).T, by_x(mission, w).reshape(-1, len(x)).T).T
    theta = theta.reshape(len(w), 3, -1, basis.size).astype(np.float32)
    ahead = ExpansionLookAhead(Expansion(mission, clusters, theta, 0, 0, 0.0, True))
    return ahead.q_values(states)


SINGLE, DOUBLE = {'rtol': 1e-6, 'atol': 2e-3}, {'rtol': 1e-11, 'atol': 1e-9}
"""Tolerances of forms in single and in double precision, of W up to 100."""

FORMS = {
    'matrices': (by_matrices, DOUBLE),
    'reduced mission': (by_reduced_mission, DOUBLE),
    'exact, by tables': (by_tables, DOUBLE),
    'exact, by successors': (by_successors, DOUBLE),
    'cluster of the lower bound': (by_cluster, DOUBLE),
    'expansion': (by_expansion, SINGLE),
}


def backed_up(mission, w):
    """T W by one sweep of the exact solution, over l, t, g_1.., f, r_1.."""
    model = AxisModel(whole_mission(mission))
    sweeper = Sweeper(model, along_axes(model, w).copy(), 1)
    sweeper.backup()
    return sweeper.values.reshape(w.shape)
