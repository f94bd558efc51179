"""What a build will take, before it starts: `auto` decides by it, and people are told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uav_mission_manager.mdp.mission import Mission
from uav_mission_manager.policy.recombined_policy import RECOMBINATIONS
from uav_mission_manager.solver.exact.device import find_device
from uav_mission_manager.solver.exact.memory import needed_bytes, shortage
from uav_mission_manager.solver.exact.value_iteration import PRECISIONS
from uav_mission_manager.solver.expansion import Clusters
from uav_mission_manager.solver.expansion.fit import fit_bytes
from uav_mission_manager.solver.submdp import SubMdp, sub_mdp_states, whole_mission
from uav_mission_manager.solver.threads import processors

DEFAULT_ORDER = 3
"""Most goals of an expansion's clusters in full where nothing else is asked for: a choice."""

MAX_EXACT_SECONDS = 120.0
"""Longest exact solution that `auto` waits for [s]: a choice."""

MIN_ENTRY_SECONDS = 4e-9
"""Time that a sweep takes for an entry of W at the least [s]; measured 14 to 35 ns."""

MIN_SWEEPS = 40
"""Sweeps that an exact solution takes at the least; measured 40 for one goal, 110 for seven."""

LIKELY_ENTRY_SECONDS = 2.5e-8
"""Time that a sweep takes for an entry of W [s]: the middle of what was measured."""

LIKELY_SWEEPS = 110
"""Sweeps that a solution takes: what was measured for seven goals, at a discount of 0.95."""


@dataclass(frozen=True)
class Prediction:
    """What one method is expected to take.

    Attributes
    ----------
    method : str
    sub_mdps : int
        Sub-MDPs that are solved.
    states : int
        States of the largest of them, of c and m too.
    unknowns : int
        Numbers that are solved for, altogether: the states without c and m, which drop out, or the
        coefficients of an expansion.
    memory : int
        Bytes that are needed at a time.
    seconds : float or None
        Time that it takes, very roughly; None where nothing tells.
    """

    method: str
    sub_mdps: int
    states: int
    unknowns: int
    memory: int
    seconds: float | None


def states_in_full(mission: Mission, order: int = DEFAULT_ORDER) -> int:
    """Most states of a cluster that holds so many goals in full."""
    return sub_mdp_states(mission, min(order, mission.k))


def exact_bytes(sub: SubMdp, precision: str = 'mixed') -> int:
    """Memory that the exact solution of a sub-MDP needs on this machine."""
    return needed_bytes(sub, _last_type(precision), processors())


def _last_type(precision: str) -> type[np.floating[Any]]:
    return PRECISIONS.get(precision, (np.float64,))[-1]


def obstacle_to_exact(
    mission: Mission,
    max_states: int | None = None,
    precision: str = 'mixed',
    patient: bool = False,
    device: str = 'cpu',
) -> str:
    """Why the exact solution is out of the question, empty where it is not.

    Parameters
    ----------
    mission : Mission
    max_states : int, optional
        T_max: most states of a sub-MDP.
    precision
        See `uav_mission_manager.solver.exact.value_iteration`.
    patient : bool
        Whether it may take as long as it likes.
    device : {'cpu', 'gpu'}
        How long a card takes, its first sweeps tell.
    """
    sub = whole_mission(mission)
    if max_states is not None and sub.states > max_states:
        return f'the {sub.states:,} states are more than T_max = {max_states:,}'
    place = find_device(device)
    lacking = shortage(sub, _last_type(precision), processors(), place)
    if lacking:
        return lacking
    seconds = sub.entries * MIN_ENTRY_SECONDS * MIN_SWEEPS
    if seconds > MAX_EXACT_SECONDS and not patient and not place.on_gpu:
        return f'the exact solution would take more than {seconds / 60:,.0f} minutes'
    return ''


def likely_seconds(sub: SubMdp) -> float:
    """Time that value iteration takes for a sub-MDP [s], to a factor of three or so."""
    return sub.entries * LIKELY_ENTRY_SECONDS * LIKELY_SWEEPS


def predictions(mission: Mission) -> tuple[Prediction, ...]:
    """Predict what each method takes, with the defaults of `build_policy`."""
    whole = whole_mission(mission)
    found = [_solved('exact', (whole,)), _expansion(mission)]
    found += [
        _solved(method, recombination.sub_mdps(mission))
        for method, recombination in RECOMBINATIONS.items()
    ]
    return tuple(found)


def _solved(method: str, subs: tuple[SubMdp, ...]) -> Prediction:
    """Sub-MDPs that are solved exactly, one after the other."""
    return Prediction(
        method,
        len(subs),
        max(sub.states for sub in subs),
        sum(sub.entries for sub in subs),
        max(map(exact_bytes, subs)),
        sum(map(likely_seconds, subs)),
    )


def _expansion(mission: Mission) -> Prediction:
    clusters = Clusters.up_to(mission, DEFAULT_ORDER, states_in_full(mission))
    states = clusters.states(mission)
    conditions = 8 * mission.range.levels
    unknowns = mission.grid.q * conditions * len(mission.threat.levels) * clusters.features
    needed = fit_bytes(mission, clusters)
    return Prediction('expansion', len(states), max(states), unknowns, needed, None)
