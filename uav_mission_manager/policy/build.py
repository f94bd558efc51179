"""Making policies: from a mission, and from a policy set."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy.certify import certify
from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.expansion_policy import ExpansionPolicy
from uav_mission_manager.policy.policy import METHODS, Policy
from uav_mission_manager.policy.store import PolicyError, read_policy_set
from uav_mission_manager.policy.workers import Task, workers
from uav_mission_manager.solver import (
    Clusters,
    LookAhead,
    cluster_states,
    covering,
    fit_expansion,
    lower_bound,
    value_iteration,
)

NAMES = ('exact', 'expansion', *(name for name in METHODS if name != 'exact'))
"""Methods of `build_policy`."""

DEFAULT = 'expansion'

ORDER = 3
"""Most goals of an expansion's clusters in full, by default."""

OnSweep = Callable[[int, int, float], None]


def build_policy(
    mission: Mission,
    method: str = DEFAULT,
    tolerance: float = 1e-7,
    on_sweep: OnSweep | None = None,
    *,
    order: int = ORDER,
    max_states: int | None = None,
    certificate: bool | None = None,
    precision: str = 'mixed',
    jobs: int | None = None,
    scheduler: str | None = None,
    checkpoint: Checkpoint | None = None,
) -> Policy:
    """Solve a mission.

    Parameters
    ----------
    mission : Mission
    method : {'exact', 'expansion', 'split', 'highest_priority', 'best_value'}
        An expansion of a mission that is one cluster by itself is the exact solution.
    tolerance : float
        Largest distance of each sub-MDP's V from its optimum, in cost; an expansion is fitted to
        a tolerance of its own.
    on_sweep : callable, optional
        Called with the sub-MDP's position, the sweep and the distance bound reached, as far as
        sub-MDPs are solved in this process, and with 0 and 0.0 when one is done elsewhere.
    order : int
        Most goals of an expansion's clusters in full.
    max_states : int, optional
        T_max: most states of a cluster; as many as `order` goals make by default.
    certificate : bool, optional
        Whether to bound the policy's cost; by default that of an expansion is.
    precision
        See `uav_mission_manager.solver.exact.value_iteration`.
    jobs : int, optional
        Processes for independent sub-problems, one by default; of the exact solution threads, all
        processors by default.
    scheduler : str, optional
        Address of a Dask scheduler, see `uav_mission_manager.policy.workers`.
    checkpoint : Checkpoint, optional
        Where the exact solution goes on from and leaves word from time to time.

    Raises
    ------
    ValueError
        If there is no such method or precision, or a number is out of its range.
    MissionSizeError
        If the memory does not suffice.
    """
    if method not in NAMES:
        raise ValueError(f'method {method!r} is none of {", ".join(NAMES)}')
    if max_states is None:
        max_states = cluster_states(mission, max(order, 1))
    if method == 'expansion':
        clusters = Clusters.up_to(mission, order, max_states)
        if any(group.n == group.detail == mission.k for group in clusters.groups):
            method = 'exact'
    if method == 'exact':
        return _exact(mission, tolerance, on_sweep, precision, jobs, checkpoint)
    if checkpoint is not None:
        raise ValueError(f'method {method!r} leaves no checkpoint to go on from; exact does')
    if certificate is None:
        certificate = method == 'expansion'
    with workers(1 if jobs is None else jobs, scheduler) as pool:
        report = on_sweep if pool.here else None
        if method == 'expansion':
            on_fit = report and partial(report, 0)
            tasks: list[Task] = [partial(fit_expansion, mission, clusters, on_sweep=on_fit)]
        else:
            tasks = _goal_wise(mission, method, tolerance, precision, report)
        if certificate:
            tasks.append(partial(lower_bound, mission, covering(mission, max_states)))
        results = []
        for position, result in enumerate(pool.run(tasks)):
            results.append(result)
            if on_sweep is not None and not pool.here:
                on_sweep(position, 0, 0.0)
        bound = results.pop() if certificate else None
        fitted = method == 'expansion'
        policy = ExpansionPolicy(*results) if fitted else Policy(mission, method, results)
        if bound is not None:
            policy.certificate = certify(policy, bound, pool)
    return policy


def _goal_wise(
    mission: Mission, method: str, tolerance: float, precision: str, on_sweep: OnSweep | None
) -> list[Task]:
    """Solve each of a method's sub-MDPs."""
    return [
        partial(
            value_iteration,
            sub,
            tolerance,
            on_sweep=on_sweep and partial(on_sweep, position),
            precision=precision,
            threads=1,
        )
        for position, sub in enumerate(METHODS[method].decompose(mission))
    ]


def _exact(
    mission: Mission,
    tolerance: float,
    on_sweep: OnSweep | None,
    precision: str,
    threads: int | None,
    checkpoint: Checkpoint | None,
) -> Policy:
    (sub,) = METHODS['exact'].decompose(mission)
    solution = value_iteration(
        sub,
        tolerance,
        on_sweep=partial(on_sweep, 0) if on_sweep else None,
        precision=precision,
        threads=threads,
        start=checkpoint.load(0) if checkpoint else None,
        on_values=partial(checkpoint.save, 0) if checkpoint else None,
        with_actions=not LookAhead.tabulates(sub),
    )
    return Policy(mission, 'exact', [solution])


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
        return ExpansionPolicy(contents.expansion, digest, contents.certificate)
    return Policy(
        contents.mission, contents.method, contents.solutions, digest, contents.certificate
    )


def _geography(mission: Mission) -> dict[str, object]:
    """Return what a command means on the ground: weights may differ, these must not."""
    return {'goals': [(goal.name, goal.cell) for goal in mission.goals], 'grid': mission.grid}
