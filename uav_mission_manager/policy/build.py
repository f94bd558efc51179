"""Making policies: from a mission, and from a policy set.

Algorithm 1 (`uav_mission_manager.solver.decomposition`) makes the plan of every build: one block
of all goals or, out of core, several; single goals; or clusters of goals. A builder solves the
plan's sub-MDPs, and the policy recombines them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy import prediction
from uav_mission_manager.policy.certify import certify
from uav_mission_manager.policy.checkpoint import Checkpoint
from uav_mission_manager.policy.exact_policy import ExactPolicy
from uav_mission_manager.policy.expansion_policy import ExpansionPolicy
from uav_mission_manager.policy.policy import Policy
from uav_mission_manager.policy.prediction import (
    DEFAULT_ORDER,
    obstacle_to_exact,
    states_in_full,
)
from uav_mission_manager.policy.recombined_policy import RECOMBINATIONS, RecombinedPolicy
from uav_mission_manager.policy.store import PolicyError, read_policy_set
from uav_mission_manager.policy.workers import Task, Workers, workers
from uav_mission_manager.solver import memory
from uav_mission_manager.solver.bounds import covering, lower_bound
from uav_mission_manager.solver.decomposition.decompose import decompose
from uav_mission_manager.solver.decomposition.plan import Plan
from uav_mission_manager.solver.exact import (
    LookAhead,
    find_device,
    solve_blocks,
    value_iteration,
)
from uav_mission_manager.solver.expansion import Clusters, Expansion, fit_expansion
from uav_mission_manager.solver.progress import Progress, Report, ignore
from uav_mission_manager.solver.submdp import whole_mission

DEFAULT_METHOD = 'auto'
"""Method of `build_policy` where none is asked for."""

EXACT = 'exact solution'  # In reports of progress.
CALIBRATION_SECONDS = 2.0
"""Time after which the sweeps made so far tell how long the rest will take [s]: a choice."""


@dataclass(frozen=True)
class Job:
    """What to build, as `build_policy` was asked."""

    mission: Mission
    tolerance: float
    progress: Progress
    order: int
    max_states: int | None
    certificate: bool | None
    precision: str
    jobs: int | None
    scheduler: str | None
    checkpoint: Checkpoint | None
    device: str


def build_policy(
    mission: Mission,
    method: str = DEFAULT_METHOD,
    tolerance: float = 1e-7,
    progress: Progress = ignore,
    *,
    order: int = DEFAULT_ORDER,
    max_states: int | None = None,
    certificate: bool | None = None,
    precision: str = 'mixed',
    jobs: int | None = None,
    scheduler: str | None = None,
    checkpoint: Checkpoint | None = None,
    device: str = 'cpu',
) -> Policy:
    """Solve a mission.

    Parameters
    ----------
    mission : Mission
    method : {'auto', 'exact', 'expansion', 'split', 'highest_priority', 'best_value'}
        `auto` is exact where that fits in memory and is estimated to take less than two minutes,
        else an expansion; `Policy.reason` says why.
    tolerance : float
        Largest distance of each sub-MDP's V from its optimum, in cost; an expansion is fitted to
        a tolerance of its own.
    progress : Progress
        Is told how far each task has come.
    order : int
        Most goals of an expansion's clusters in full.
    max_states : int, optional
        T_max: most states of a sub-MDP. By default the exact solution is one sub-MDP in memory;
        with fewer states it is solved block by block, in files. The clusters of an expansion have
        as many states as `order` goals by default.
    certificate : bool, optional
        Whether to bound the policy's cost; by default that of an expansion is. An exact policy
        has bounds of its own.
    precision
        See `uav_mission_manager.solver.exact.value_iteration`.
    jobs : int, optional
        Processes for independent sub-problems, one by default; of the exact solution threads, all
        processors by default.
    scheduler : str, optional
        Address of a Dask scheduler, see `uav_mission_manager.policy.workers`.
    checkpoint : Checkpoint, optional
        The exact solution is resumed from there, and saved there about once a minute.
    device : {'cpu', 'gpu'}
        Where the exact solution is made, in one sub-MDP: on the processors, or on a CUDA card.

    Raises
    ------
    ValueError
        If there is no such method, precision or device, or a number is out of its range.
    MissionSizeError
        If the memory does not suffice.
    """
    if method not in BUILDERS:
        raise ValueError(f'method {quoted(method)} is none of {", ".join(BUILDERS)}')
    if not 0 < tolerance < np.inf:
        raise ValueError(f'tolerance {tolerance} must be a number above 0')
    if order < 1:
        raise ValueError(f'order {order} must be at least 1')
    for name, value in (('max_states', max_states), ('jobs', jobs)):
        if value is not None and value < 1:
            raise ValueError(f'{name} {value} must be above 0')
    if checkpoint is not None and method not in ('auto', 'exact'):
        raise ValueError(f'method {quoted(method)} cannot be resumed from a checkpoint; exact can')
    if device != 'cpu':
        _check_device(device, method, max_states)
    how = (order, max_states, certificate, precision, jobs, scheduler, checkpoint, device)
    job = Job(mission, tolerance, progress, *how)
    return BUILDERS[method](job)


def _check_device(device: str, method: str, max_states: int | None) -> None:
    if method not in ('auto', 'exact'):
        raise ValueError(f'device {quoted(device)} is of no use to method {quoted(method)}')
    if max_states is not None:
        raise ValueError(f'device {quoted(device)} solves in one piece: leave max_states out')
    find_device(device)


def _auto(job: Job) -> Policy:
    """Exact where it fits and is quick enough, else an expansion."""
    patient = job.checkpoint is not None
    reason = obstacle_to_exact(job.mission, job.max_states, job.precision, patient, job.device)
    if not reason:
        clock = _Clock(job)
        try:
            policy: Policy = _exact(replace(job, progress=clock))
        except _TooSlowError as error:
            reason = str(error)
            job.progress(Report(0, 1.0, 'given up', EXACT))
        else:
            policy.reason = 'exact: it fits in memory and takes less than two minutes'
            return policy
    try:
        policy = _expansion(job)
    except memory.MissionSizeError as error:
        raise memory.MissionSizeError(f'{error}; not solved exactly because {reason}') from error
    policy.reason = f'expansion: {reason}'
    return policy


class _TooSlowError(Exception):
    """The exact solution takes too long."""


class _Clock:
    """Progress that ends an exact solution which the first sweeps show to take too long.

    It counts from the first sweep on: before it the sweep may have been compiled.
    """

    def __init__(self, job: Job) -> None:
        self.job, self.start, self.done = job, math.inf, 0.0

    def __call__(self, report: Report) -> None:
        self.job.progress(report)
        if math.isinf(self.start):
            self.start, self.done = time.monotonic(), report.done
        elapsed = time.monotonic() - self.start
        if self.job.checkpoint is None and elapsed > CALIBRATION_SECONDS:
            seconds = elapsed / max(report.done - self.done, 1e-3)
            if (
                seconds > prediction.MAX_EXACT_SECONDS
                and seconds - elapsed > prediction.MAX_EXACT_SECONDS / 4
            ):
                raise _TooSlowError(
                    f'the exact solution would take about {seconds / 60:,.0f} minutes, '
                    f'by its first {report.step} sweeps'
                )


def _exact(job: Job) -> ExactPolicy:
    mission, checkpoint = job.mission, job.checkpoint
    sub = whole_mission(mission)
    max_states = sub.states if job.max_states is None else job.max_states
    plan = decompose(mission, max_states, 'blocks')
    progress = _named(job.progress, EXACT)
    if len(plan.parts) > 1:
        if checkpoint is not None:
            raise ValueError('a solution block by block cannot be resumed from a checkpoint')
        solution = solve_blocks(sub, plan.regions, job.tolerance, progress=progress)
        return ExactPolicy(plan, solution)
    solution = value_iteration(
        sub,
        job.tolerance,
        progress=progress,
        precision=job.precision,
        threads=job.jobs,
        start=checkpoint.load() if checkpoint else None,
        on_values=checkpoint.save if checkpoint else None,
        with_actions=not LookAhead.tabulates(sub),
        device=job.device,
    )
    return ExactPolicy(plan, solution)


def _expansion(job: Job) -> ExpansionPolicy:
    mission = job.mission
    max_states = job.max_states or states_in_full(mission, job.order)
    clusters = Clusters.up_to(mission, job.order, max_states)
    with workers(job.jobs or 1, job.scheduler) as pool:
        fit = partial(fit_expansion, mission, clusters)
        names = ['fit of the expansion']
        tasks: list[Task] = [fit]
        certified = job.certificate is None or job.certificate
        if certified:
            upper = _announced(job, 'upper bound')
            names.append('lower bound')
            tasks.append(partial(lower_bound, mission, covering(mission, max_states)))
        results = _run(job, pool, names, tasks)
        policy = ExpansionPolicy(_plan(results[0], max_states), results[0])
        if certified:
            policy.certificate = certify(policy, results[1], pool, upper)
    return policy


def _plan(expansion: Expansion, max_states: int) -> Plan:
    """Score the clusters of an expansion, all of which are used."""
    mission, groups = expansion.mission, expansion.clusters.groups
    goals = [cluster for group in groups for cluster in group.clusters]
    clusters = list(zip(goals, expansion.clusters.states(mission)))
    return decompose(mission, max_states, 'clusters', overlap=1.0, clusters=clusters)


def _recombined(method: str, job: Job) -> RecombinedPolicy:
    mission = job.mission
    max_states = job.max_states or states_in_full(mission, 1)
    plan = decompose(mission, max_states, 'goal')
    by_goals = {sub.goals: sub for sub in RECOMBINATIONS[method].sub_mdps(mission)}
    subs = [by_goals[goals] for goals in sorted(part.goals for part in plan.parts)]
    with workers(job.jobs or 1, job.scheduler) as pool:
        solve = partial(value_iteration, precision=job.precision, threads=1)
        names = [f'sub-MDP of {mission.goals[sub.goals[0]].name}' for sub in subs]
        tasks: list[Task] = [partial(solve, sub, job.tolerance) for sub in subs]
        if job.certificate:
            upper = _announced(job, 'upper bound')
            names.append('lower bound')
            limit = job.max_states or states_in_full(mission, job.order)
            tasks.append(partial(lower_bound, mission, covering(mission, limit)))
        results = _run(job, pool, names, tasks)
        policy = RecombinedPolicy(method, plan, results[: len(subs)])
        if job.certificate:
            policy.certificate = certify(policy, results[-1], pool, upper)
    return policy


def _run(job: Job, pool: Workers, names: list[str], tasks: list[Task]) -> list[Any]:
    """Results of tasks that take `progress`; elsewhere than here only their end is reported."""
    reports = [_announced(job, name) for name in names]
    if pool.here:
        tasks = [partial(task, progress=report) for task, report in zip(tasks, reports)]
    return list(pool.run(tasks, lambda number: reports[number](Report(0, 1.0, 'done'))))


def _announced(job: Job, name: str) -> Progress:
    """Progress of a task that is reported before it begins, for the whole work to be known."""
    progress = _named(job.progress, name)
    progress(Report(0, 0.0, 'not done yet'))
    return progress


def _named(progress: Progress, task: str) -> Progress:
    """Progress of one task of several."""

    def named(report: Report) -> None:
        progress(replace(report, task=task))

    return named


BUILDERS: dict[str, Callable[[Job], Policy]] = {
    'auto': _auto,
    'exact': _exact,
    'expansion': _expansion,
    **{method: partial(_recombined, method) for method in RECOMBINATIONS},
}
"""What makes a policy, by method."""

METHODS = tuple(BUILDERS)
"""Methods of `build_policy`."""

POLICY_KINDS: dict[str, type[Policy]] = {
    'exact': ExactPolicy,
    'expansion': ExpansionPolicy,
    **dict.fromkeys(RECOMBINATIONS, RecombinedPolicy),
}
"""What a saved policy is read as, by the method that made it."""


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
    if contents.method not in POLICY_KINDS:
        raise PolicyError(f'{shown(directory)}: method: {quoted(contents.method)} is unknown')
    if mission is not None:
        for what, wanted in mission.geography().items():
            found = contents.mission.geography()[what]
            if found != wanted:
                raise PolicyError(
                    f'{shown(directory)}: mission.{what}: {shown(found)} are not {shown(wanted)}'
                )
    try:
        return POLICY_KINDS[contents.method].from_set(contents, digest)
    except PolicyError as error:
        raise PolicyError(f'{shown(directory)}: {error}') from error
