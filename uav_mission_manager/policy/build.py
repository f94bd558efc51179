"""Making policies: from a mission, and from a policy set."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.expansion_policy import ExpansionPolicy
from uav_mission_manager.policy.policy import METHODS, Policy
from uav_mission_manager.policy.store import PolicyError, read_policy_set
from uav_mission_manager.solver import (
    Clusters,
    LookAhead,
    certificate,
    cluster_states,
    fit_expansion,
    value_iteration,
)

NAMES = ('exact', 'expansion', *(name for name in METHODS if name != 'exact'))
"""Methods of `build_policy`."""

ORDER = 2
"""Most goals of an expansion's clusters in fine, by default."""


def build_policy(
    mission: Mission,
    method: str = 'exact',
    tolerance: float = 1e-7,
    on_sweep: Callable[[int, int, float], None] | None = None,
    *,
    precision: str = 'mixed',
    threads: int | None = None,
    checkpoint: Checkpoint | None = None,
    order: int = ORDER,
    max_states: int | None = None,
) -> Policy:
    """Solve a mission.

    Parameters
    ----------
    mission : Mission
    method : {'exact', 'expansion', 'split', 'highest_priority', 'best_value'}
    tolerance : float
        Largest distance of each sub-MDP's V from its optimum, in cost; an expansion is fitted to
        a tolerance of its own.
    on_sweep : callable, optional
        Called with the sub-MDP's position, the sweep and the distance bound reached.
    precision, threads
        See `uav_mission_manager.solver.value_iteration`.
    checkpoint : Checkpoint, optional
        Where to go on from and to leave word from time to time; not for an expansion.
    order : int
        Most goals of an expansion's clusters in fine; one more in coarse.
    max_states : int, optional
        T_max: most states of a cluster; as many as `order` goals make by default.

    Raises
    ------
    ValueError
        If there is no such method or precision, or order or max_states are too small.
    MissionSizeError
        If the memory does not suffice.
    """
    if method not in NAMES:
        raise ValueError(f'method {method!r} is none of {", ".join(NAMES)}')
    if method == 'expansion':
        if max_states is None:
            max_states = cluster_states(mission, order, 6)
        clusters = Clusters.up_to(mission, order, max_states)
        sweeps = None if on_sweep is None else partial(on_sweep, 0)
        expansion = fit_expansion(mission, clusters, on_sweep=sweeps)
        return ExpansionPolicy(expansion, certificate(mission, max_states))
    solutions = []
    for position, sub in enumerate(METHODS[method].decompose(mission)):

        def report(sweep: int, bound: float, position: int = position) -> None:
            if on_sweep is not None:
                on_sweep(position, sweep, bound)

        solutions.append(
            value_iteration(
                sub,
                tolerance,
                on_sweep=report,
                precision=precision,
                threads=threads,
                start=checkpoint.load(position) if checkpoint else None,
                on_values=partial(checkpoint.save, position) if checkpoint else None,
                with_actions=method == 'exact' and not LookAhead.tabulates(sub),
            )
        )
    return Policy(mission, method, solutions)


def load_policy(directory: str | Path, mission: Mission | None = None) -> Policy:
    """Read a policy set.

    Parameters
    ----------
    directory : path
    mission : Mission, optional
        Refuse a policy for goals of other names or cells, or for another grid, than this one's.

    Raises
    ------
    PolicyError
        If it is broken or for another mission.
    """
    contents, digest = read_policy_set(Path(directory))
    if contents.method not in NAMES or (contents.method == 'expansion') != bool(
        contents.expansion
    ):
        raise PolicyError(f'{directory}: method: {contents.method!r} is unknown')
    subs = tuple(solution.sub for solution in contents.solutions)
    if not contents.expansion and subs != METHODS[contents.method].decompose(contents.mission):
        raise PolicyError(f'{directory}: sub_mdps: are not those of method {contents.method!r}')
    if mission is not None:
        for what, wanted in _geography(mission).items():
            found = _geography(contents.mission)[what]
            if found != wanted:
                raise PolicyError(f'{directory}: mission.{what}: {found} are not {wanted}')
    if contents.expansion is not None:
        return ExpansionPolicy(contents.expansion, contents.bound, digest)
    return Policy(contents.mission, contents.method, contents.solutions, digest)


def _geography(mission: Mission) -> dict[str, object]:
    """Return what a command means on the ground: weights may differ, these must not."""
    return {'goals': [(goal.name, goal.cell) for goal in mission.goals], 'grid': mission.grid}
