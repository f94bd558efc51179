"""One measurement, in a process of its own: wall time, peak memory, and whether it is right."""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from parts.alternatives import ALTERNATIVES, Counted
from parts.compiled import compiled
from parts.explicit import explicit
from parts.machine import speeds
from parts.missions import case_study, with_battery
from parts.peers import PEERS, TOLERANCE
from uav_mission_manager.mdp import Mission
from uav_mission_manager.mdp.arrays import FloatArray, IntArray
from uav_mission_manager.policy.prediction import exact_bytes
from uav_mission_manager.solver.exact import AxisModel, LookAhead, value_iteration
from uav_mission_manager.solver.submdp import goal_sub_mdps, whole_mission

PEER_MEMORY = 12 << 30
"""Address space that another solver may take [bytes]."""

CHECKED_STATES = 10_000
"""States in which a result is checked."""

SINGLE_TOLERANCE = 1e-3
"""Tolerance of float32 alone, which rounding keeps from a smaller one, in cost."""


def apart(what: str, timeout: float, **arguments: Any) -> dict[str, Any]:
    """Measure in a fresh process; {'error': why} where that fails."""
    command = [sys.executable, sys.argv[0], '--measure', json.dumps([what, arguments])]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return {'error': f'not done in {timeout:.0f} s'}
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f'ended with code {done.returncode}']
        return {'error': lines[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def measure(what: str, arguments: dict[str, Any]) -> dict[str, Any]:
    """Take a measurement in this process."""
    return {
        'ours': ours,
        'peer': peer,
        'goal wise': goal_wise,
        'alternatives': alternatives,
        'speeds': speeds,
        'compiled': compiled,
    }[what](**arguments)


def ours(k: int, precision: str, repeats: int, battery: bool = False) -> dict[str, Any]:
    """The exact solver, the set-up of its tables included; with range flags or one battery."""
    mission = case_study(k)
    sub = whole_mission(with_battery(mission) if battery else mission)
    tolerance = SINGLE_TOLERANCE if precision == 'single' else TOLERANCE
    before = _peak()
    solution, seconds = _timed(
        lambda: value_iteration(sub, tolerance, precision=precision), repeats
    )
    return {
        'states': sub.states,
        'entries': sub.entries,
        'seconds': seconds,
        'memory': _peak() - before,
        'predicted': exact_bytes(sub, precision) / 2**20,
        'sweeps': solution.iterations,
        'bound': solution.upper,
    }


def goal_wise(k: int, repeats: int) -> dict[str, Any]:
    """The paper's sub-MDPs of one goal, all of them."""
    subs = goal_sub_mdps(case_study(k))
    before = _peak()
    _, seconds = _timed(lambda: [value_iteration(sub, TOLERANCE) for sub in subs], repeats)
    return {'states': subs[0].states, 'seconds': seconds, 'memory': _peak() - before}


def peer(k: int, name: str, repeats: int) -> dict[str, Any]:
    """Another solver; its model is built before the clock runs, but counted in its memory."""
    resource.setrlimit(resource.RLIMIT_AS, (PEER_MEMORY, PEER_MEMORY))
    mission = case_study(k)
    before = _peak()
    model = explicit(mission)
    solve = PEERS[name](model)
    (value, policy, sweeps), seconds = _timed(solve, repeats, warm=True)
    memory = _peak() - before
    off, loss = _check(mission, model.states, value, policy)
    if off > 2 * TOLERANCE or loss > 10 * TOLERANCE:
        raise SystemExit(f'wrong: V off by {off:.1e}, policy by {loss:.1e}')
    return {
        'states': len(model.states),
        'matrix entries': sum(matrix.nnz for matrix in model.transitions),
        'seconds': seconds,
        'memory': memory,
        'sweeps': sweeps,
        'off': off,
        'loss': loss,
    }


def alternatives(k: int) -> dict[str, int]:
    """Sweeps of each alternative."""
    model = explicit(case_study(k))
    counts = {}
    for name, run in ALTERNATIVES.items():
        counted = Counted(model)
        run(counted)
        counts[name] = counted.sweeps
    return counts


def _check(
    mission: Mission, states: IntArray, value: FloatArray | None, policy: IntArray
) -> tuple[float, float]:
    """Distance of V from ours (0 where none is given), and what its actions lose in ours."""
    chosen = np.random.default_rng(0).permutation(len(states))[:CHECKED_STATES]
    solution = value_iteration(whole_mission(mission), 1e-9)
    model = AxisModel(solution.sub)
    q = LookAhead(model, solution.value).q_values(states[chosen])
    loss = q[np.arange(len(q)), policy[chosen] - 1] - q.min(axis=1)
    off = 0.0
    if value is not None:
        exact = model.state_values(solution.value, states[chosen])
        off = float(np.abs(value[chosen] - exact).max())
    return off, float(loss.max())


def _timed(work: Callable[[], Any], repeats: int, warm: bool = False) -> tuple[Any, list[float]]:
    """Last result and all wall times [s]; one call before them to compile where `warm`."""
    if warm:
        work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return result, times


def _peak() -> float:
    """Most memory this process has held [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def median(found: dict[str, Any]) -> float:
    """Median wall time of a measurement [s]."""
    return statistics.median(found['seconds'])
