"""The exact solution on a CUDA card: time, memory, and whether it is right.

    pip install '.[gpu]'
    make bench SCRIPTS=benchmarks/gpu.py

Writes gpu.md, where there is a card. It ends after `--minutes` (8), with what was solved until
then, the largest missions first.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from parts import pages
from parts.missions import case_study, with_battery

from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.exact import (
    AxisModel,
    LookAhead,
    Solution,
    find_device,
    value_iteration,
)
from uav_mission_manager.solver.exact.memory import needed_bytes, shortage
from uav_mission_manager.solver.progress import Report
from uav_mission_manager.solver.submdp import SubMdp, whole_mission

TOLERANCE = 1e-6
"""Largest distance of the values from V*."""

MOST_COMPARED = 6
"""Most goals that NumPy solves too."""

READ_ENTRIES = 2 * 10**9
"""Entries of W that the backups of single states may read, for each mission: some seconds."""


class OutOfTimeError(Exception):
    """The minutes are over."""


@dataclass(frozen=True)
class Case:
    """A mission and how it is solved."""

    goals: int
    battery: bool
    precision: str

    def sub(self) -> SubMdp:
        """Return the sub-MDP of all goals."""
        mission = case_study(self.goals)
        return whole_mission(with_battery(mission) if self.battery else mission)


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--flags', type=int, nargs='*', default=[6, 7, 8, 9])
    parser.add_argument('--battery', type=int, nargs='*', default=[8, 10, 12])
    parser.add_argument('--precision', nargs='+', default=['mixed', 'double'])
    parser.add_argument('--minutes', type=float, default=8.0)
    options = parser.parse_args()
    end = time.monotonic() + 60 * options.minutes
    try:
        card = _card()
    except ValueError as error:
        print(f'nothing is measured: {error}')
        return 0
    print(card, flush=True)
    print(_compiled_in(), flush=True)
    rows = []
    for case in _cases(options):
        rows.append([str(entry) for entry in _row(case, end)])
        print(*rows[-1], flush=True)
    compared = [_compared(battery) for battery in (False, True) if time.monotonic() < end]
    sections = [f'{card}.', INTRODUCTION, pages.table(HEAD, rows), '\n'.join(compared)]
    pages.publish(pages.folder(options) / 'gpu.md', 'On a card', sections)
    return 0


HEAD = ['goals', 'states', 'precision', 'time [s]', 'sweeps', 'bound', 'memory', 'counted', 'off']

INTRODUCTION = f"""\
The case study with more goals, with range flags or one battery, solved to {TOLERANCE:g}.
*Time* is that of values and actions, from the mission to arrays in the machine's memory. *Memory*
is what CuPy had of the card in the end, *counted* what the solver asks for before it begins.
*Off* is by how much V and its backup differ at most, relative to what the bound allows, in states
drawn evenly: backups of single states, on the processors."""


def _cases(options: argparse.Namespace) -> list[Case]:
    """Large missions first."""
    return [
        case
        for precision in options.precision
        for case in sorted(
            [Case(k, False, precision) for k in options.flags]
            + [Case(k, True, precision) for k in options.battery],
            key=lambda case: -case.sub().entries,
        )
    ]


def _row(case: Case, end: float) -> list[Any]:
    sub, gpu = case.sub(), find_device('gpu')
    name = f'{case.goals}, {"battery" if case.battery else "flags"}'
    dtype = np.float32 if case.precision == 'single' else np.float64
    counted = f'{needed_bytes(sub, dtype, 1, gpu) / 2**30:.1f} GiB'
    known = [name, f'{sub.states:,}', case.precision]
    lacking = shortage(sub, dtype, 1, gpu)
    if lacking:
        return [*known, lacking, '', '', '', counted, '']
    gpu.release()
    try:
        solution, seconds = _solved(sub, case.precision, end)
    except OutOfTimeError as error:
        return [*known, error, '', '', '', counted, '']
    memory = gpu.namespace.get_default_memory_pool().total_bytes() / 2**30
    figures = [f'{seconds:.1f}', solution.iterations, f'{solution.upper:.1e}', f'{memory:.1f} GiB']
    return [*known, *figures, counted, f'{_off(solution):.2f}']


def _solved(sub: SubMdp, precision: str, end: float) -> tuple[Solution, float]:
    """Solution and seconds. Raises `OutOfTimeError`."""

    def look(report: Report) -> None:
        if time.monotonic() > end:
            raise OutOfTimeError(f'out of time, {report.text}')

    start = time.perf_counter()
    solution = value_iteration(
        sub, TOLERANCE, progress=look, precision=precision, with_actions=True, device='gpu'
    )
    return solution, time.perf_counter() - start


def _off(solution: Solution) -> float:
    """Largest |min_a Q(s, a) - V(s)| of some states, over what V's distance from V* allows."""
    sub, model = solution.sub, AxisModel(solution.sub)
    count = max(1, min(200, READ_ENTRIES // sub.entries))
    states = StateSpace.of(sub.mission).draw(count, np.random.default_rng(0))
    values = model.state_values(solution.value, states)
    off = np.abs(LookAhead(model, solution.value).q_values(states).min(axis=1) - values)
    return float(off.max() / ((1 + sub.mission.discount) * solution.upper))


def _compared(battery: bool) -> str:
    """Say whether the card computes the bits that NumPy does."""
    case = Case(MOST_COMPARED, battery, 'double')
    here, there = (
        value_iteration(
            case.sub(), TOLERANCE, precision=case.precision, with_actions=True, device=device
        )
        for device in ('cpu', 'gpu')
    )
    what = 'one battery' if battery else 'range flags'
    off = float(np.abs(here.value - there.value).max())
    actions = int((here.actions != there.actions).sum())
    line = (
        f'- {case.goals} goals with {what}, by NumPy and by the card: values differ by {off:.1e} '
        f'at most, of bounds of {here.upper:.1e}; {actions:,} of {here.actions.size:,} actions do.'
    )
    print(line, flush=True)
    return line


def _compiled_in() -> str:
    """CuPy compiles a kernel the first time it meets one, and keeps it in a folder."""
    start = time.perf_counter()
    for battery in (False, True):
        for precision in ('mixed', 'double'):
            _solved(Case(4, battery, precision).sub(), precision, np.inf)
    return f'kernels compiled, or found, in {time.perf_counter() - start:.1f} s'


def _card() -> str:
    """Card, memory, driver and CuPy, in words. Raises `ValueError`."""
    cupy = find_device('gpu').namespace
    runtime = cupy.cuda.runtime
    found = runtime.getDeviceProperties(runtime.getDevice())
    return (
        f'{found["name"].decode()}, {found["totalGlobalMem"] / 2**30:.0f} GiB, '
        f'CUDA driver {runtime.driverGetVersion()}, CuPy {cupy.__version__}'
    )


if __name__ == '__main__':
    raise SystemExit(main())
