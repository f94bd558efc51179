"""The likeliest next state of a state and an action."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uav_mission_manager.mdp import Mission, StateSpace, dynamics, global_actions


def likeliest_next(
    mission: Mission, state: Sequence[int], number: int
) -> tuple[tuple[int, ...], float]:
    """Return the likeliest next state, and its probability.

    Given whether a goal is completed, the variables change independently of each other, so that
    each takes its own likeliest value; of several the lowest one.

    Parameters
    ----------
    mission : Mission
    state : sequence of int
        [f r.. g.. l c t m].
    number : int
        Of the action, from 1.
    """
    return max(_outcomes(mission, state, number), key=lambda outcome: outcome[1])


def _outcomes(
    mission: Mission, state: Sequence[int], number: int
) -> Iterator[tuple[tuple[int, ...], float]]:
    """Yield the likeliest state where no goal is completed, and where one is."""
    space, action = StateSpace.of(mission), global_actions(mission)[number - 1]
    s = space.split(space.check(state)[0])
    f, cell = int(s.f) - 1, int(s.l)
    regime = dynamics.regimes(mission)[number - 1, cell]
    landing = dynamics.landings(mission)[number - 1, cell]
    chance = 0.0
    if action.goal is not None and dynamics.may_complete(mission)[number - 1, cell]:
        chance = float(dynamics.completion_probabilities(mission)[action.goal, f])
    for completed, probability in (False, 1.0 - chance), (True, chance):
        after = np.zeros(len(space.names), np.int64)
        to = space.split(after)
        rows = [
            (to.f, dynamics.fault_matrices(mission)[regime, f]),
            (to.t, dynamics.threat_matrices(mission)[landing, int(s.t)]),
        ]
        ranges = dynamics.range_matrices(mission)[regime]
        rows += [(to.r[j : j + 1], ranges[r]) for j, r in enumerate(s.r.tolist())]
        charge = dynamics.charge_matrices(mission)[regime]
        rows += [(to.b[j : j + 1], charge[b]) for j, b in enumerate(s.b.tolist())]
        priorities = dynamics.priority_matrices(mission)
        rows += [
            (to.g[j : j + 1], priorities[j, g])
            for j, g in enumerate(s.g.tolist())
            if not (completed and j == action.goal)
        ]
        for variable, chances in rows:
            variable[...] = chances.argmax()
            probability *= float(chances.max())
        to.f[...] += 1
        to.l[...], to.m[...] = landing, int(action.agile)
        to.c[...] = 0 if completed else action.commitment
        yield tuple(after.tolist()), probability
