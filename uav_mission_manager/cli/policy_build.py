"""`policy_build`: solve a mission file and write its policy set."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from uav_mission_manager.cli.errors import one_line_errors
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.policy import (
    DEFAULT,
    NAMES,
    ORDER,
    Checkpoint,
    Policy,
    build_policy,
)
from uav_mission_manager.solver import PRECISIONS


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog='policy_build', description='Solve a mission and write its policy set.'
    )
    parser.add_argument('mission', help='mission file (YAML)')
    parser.add_argument('--out', required=True, help='directory of the policy set')
    parser.add_argument('--method', choices=NAMES, default=DEFAULT, help='default: %(default)s')
    parser.add_argument(
        '--order',
        type=int,
        default=ORDER,
        help='expansion: most goals looked at together in full; a mission of no more is solved '
        'exactly; default: %(default)s',
    )
    parser.add_argument(
        '--max-states',
        type=int,
        metavar='T',
        help='T_max: most states of a cluster of goals; default: those of ORDER goals',
    )
    parser.add_argument(
        '--certificate',
        action=argparse.BooleanOptionalAction,
        help='bound the cost of the policy from below and above; default: for an expansion',
    )
    parser.add_argument(
        '--tolerance',
        type=float,
        default=1e-7,
        help='largest distance of V from V* of each sub-MDP, in cost; default: %(default)g',
    )
    parser.add_argument(
        '--precision',
        choices=PRECISIONS,
        default='mixed',
        help='floating type: double with early sweeps in single (mixed), double or single; single '
        'halves the memory; default: %(default)s',
    )
    parser.add_argument(
        '--jobs',
        type=int,
        metavar='N',
        help='processes for independent sub-problems, default: 1; for the exact solution threads, '
        'default: all processors',
    )
    parser.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='solve the sub-problems on a Dask cluster, such as tcp://127.0.0.1:8786',
    )
    parser.add_argument(
        '--resume',
        action='store_true',
        help='for solves of minutes: leave a checkpoint beside DIR once a minute, and go on from '
        'one that is there',
    )
    parser.add_argument('--json', action='store_true', help='print the summary as JSON')
    options = parser.parse_args(args)
    with one_line_errors('policy_build'):
        return _build(options)


def _build(options: argparse.Namespace) -> int:
    start = time.perf_counter()
    policy = _solve(options)
    summary = {
        **policy.info,
        'seconds': round(time.perf_counter() - start, 3),
        'bytes': sum(file.stat().st_size for file in Path(options.out).iterdir()),
        'out': options.out,
    }
    print(json.dumps(summary) if options.json else _describe(policy, summary))
    return 0


def _solve(options: argparse.Namespace) -> Policy:
    """Build the policy set behind a progress bar."""
    mission = load_mission(options.mission)
    checkpoint = None
    if options.resume:
        checkpoint = Checkpoint(options.out, mission, 'exact', options.precision)
    console = Console(stderr=True)
    columns = TextColumn('{task.description}'), BarColumn(), TimeRemainingColumn()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        policy = build_policy(
            mission,
            options.method,
            options.tolerance,
            _bar(progress, options),
            order=options.order,
            max_states=options.max_states,
            certificate=options.certificate,
            precision=options.precision,
            jobs=options.jobs,
            scheduler=options.scheduler,
            checkpoint=checkpoint,
        )
    policy.save(options.out)
    if checkpoint is not None:
        checkpoint.remove()
    return policy


def _bar(progress: Progress, options: argparse.Namespace) -> Callable[[int, int, float], None]:
    """Progress of each sub-MDP's bound, on a logarithmic scale."""
    tasks: dict[int, tuple[TaskID, float]] = {}

    def on_sweep(position: int, sweep: int, bound: float) -> None:
        if position not in tasks:
            tasks[position] = (progress.add_task(''), bound)
        task, first = tasks[position]
        done = _decades(first, bound) / max(_decades(first, options.tolerance), 1e-9)
        text = f'sub-MDP {position + 1}: sweep {sweep}, within {bound:.1e} of V*'
        if not sweep:
            done, text = 1.0, f'sub-problem {position + 1}: done'
        progress.update(task, completed=100 * min(done, 1.0), description=text)

    return on_sweep


def _decades(first: float, bound: float) -> float:
    return math.log10(first / bound) if first > 0 < bound else 0.0


def _describe(policy: Policy, summary: dict) -> str:
    sizes = sorted(set(summary['sub_mdp_states']))
    lines = [
        f'{summary["out"]}: policy of mission {summary["mission"]}, method {policy.method}',
        f'  states      {summary["states"]:,} in the mission, {summary["goals"]} goals',
        f'  sub-MDPs    {summary["sub_mdps"]} of {", ".join(f"{n:,}" for n in sizes)} states',
        f'  sweeps      {", ".join(map(str, summary["iterations"]))}',
        f'  residual    {summary["residual"]:.2e}',
        _quality(policy.method, summary),
        f'  time        {summary["seconds"]} s',
        f'  size        {summary["bytes"]:,} bytes, digest {summary["digest"][:12]}',
    ]
    if summary.get('gap') is not None:
        gap, error = summary['gap'], summary['gap_error']
        lines.insert(-2, f'  certified   on average within {gap:.2%} +- {error:.2%} of V*')
    return '\n'.join(lines)


def _quality(method: str, summary: dict) -> str:
    if method == 'exact':
        return f'  bounds      V{summary["lower"]:+.2e} <= V* <= V{summary["upper"]:+.2e}'
    if method == 'expansion':
        fit = f'{summary["features"]:,} features in {summary["points"]:,} design points'
        return f'  fit         {fit}{"" if summary["converged"] else ", NOT CONVERGED"}'
    return f'  solved to   {summary["upper"]:.2e}, summed over the sub-MDPs'


if __name__ == '__main__':
    raise SystemExit(main())
