# PYTHON_ARGCOMPLETE_OK
"""`policy_build`: solve a mission file and write its policy set."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from uav_mission_manager.cli.errors import CommandParser, one_line_errors
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.policy import (
    DEFAULT_METHOD,
    DEFAULT_ORDER,
    METHODS,
    Checkpoint,
    Policy,
    build_policy,
)
from uav_mission_manager.solver.exact import DEVICES, PRECISIONS
from uav_mission_manager.solver.progress import Progress as ProgressProtocol
from uav_mission_manager.solver.progress import Report


def main(args: list[str] | None = None) -> int:
    """Run the command."""
    with one_line_errors('policy_build'):
        return _build(_parser().parse_args(args))


def _parser() -> CommandParser:
    parser = CommandParser(
        prog='policy_build', description='Solve a mission and write its policy set.'
    )
    parser.add_argument('mission', help='mission file (YAML)')
    parser.add_argument('--out', required=True, help='directory of the policy set')
    parser.add_argument(
        '--method',
        choices=METHODS,
        default=DEFAULT_METHOD,
        help='auto: exact where that fits in memory and takes less than two minutes, else '
        'expansion; default: %(default)s',
    )
    parser.add_argument(
        '--order',
        type=int,
        default=DEFAULT_ORDER,
        help='expansion: most goals looked at together in full; default: %(default)s',
    )
    parser.add_argument(
        '--max-states',
        type=int,
        metavar='T',
        help='T_max: most states of a sub-MDP. exact: solve block by block, in files; expansion: '
        'default: the states of ORDER goals',
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
        '--device',
        choices=DEVICES,
        default='cpu',
        help='where the exact solution is made: on the processors, or on a CUDA card (pip install '
        "'.[gpu]'); default: %(default)s",
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
    return parser


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
    columns = TextColumn('{task.description}', markup=False), BarColumn(), TimeRemainingColumn()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        policy = build_policy(
            mission,
            options.method,
            options.tolerance,
            _bars(progress),
            order=options.order,
            max_states=options.max_states,
            certificate=options.certificate,
            precision=options.precision,
            jobs=options.jobs,
            scheduler=options.scheduler,
            checkpoint=checkpoint,
            device=options.device,
        )
    policy.save(options.out)
    if checkpoint is not None:
        checkpoint.remove()
    return policy


def _bars(progress: Progress) -> ProgressProtocol:
    """One bar for each part under way and, if there are several, one in which they count alike."""
    whole = progress.add_task('', visible=False)
    bars: dict[str, TaskID] = {}
    shares: dict[str, float] = {}

    def show(report: Report) -> None:
        if report.task not in bars:
            bars[report.task] = progress.add_task('', visible=False)
        shares[report.task] = report.done
        alone = len(shares) == 1
        progress.update(
            bars[report.task],
            completed=100 * report.done,
            description=f'{report.task}: {report.text}',
            visible=alone or 0 < report.done < 1,
        )
        ended = sum(share == 1 for share in shares.values())
        progress.update(
            whole,
            completed=100 * sum(shares.values()) / len(shares),
            description=f'{ended} of {len(shares)} parts done',
            visible=not alone,
        )

    return show


def _describe(policy: Policy, summary: dict[str, Any]) -> str:
    lines = [
        f'{shown(summary["out"])}: policy of mission {summary["mission"]}, method {policy.method}',
        f'  states      {summary["states"]:,} in the mission, {summary["goals"]} goals',
        *_plan_lines(policy),
        f'  sweeps      {", ".join(map(str, summary["iterations"]))}',
        f'  residual    {summary["residual"]:.2e}',
        _quality(policy.method, summary),
        *_certificate_lines(summary),
        f'  time        {summary["seconds"]} s',
        f'  size        {summary["bytes"]:,} bytes, digest {summary["digest"][:12]}',
    ]
    if policy.reason:
        lines.insert(1, f'  why         {policy.reason}')
    lines += [f'WARNING: {warning}' for warning in policy.warnings]
    return '\n'.join(lines)


MAX_SHOWN_PARTS = 8
"""Sub-MDPs of a plan that the summary names, at most: a choice."""


def _plan_lines(policy: Policy) -> list[str]:
    """The sub-MDPs of the plan: type, goals, states, score."""
    parts, names = policy.plan.parts, [goal.name for goal in policy.mission.goals]
    lines = [f'  plan        {len(parts)} sub-MDPs of at most {policy.plan.max_states:,} states']
    for number, part in enumerate(parts[:MAX_SHOWN_PARTS], 1):
        goals = shown(', '.join(names[j] for j in part.goals))
        lines.append(
            f'    {number:3d}  {part.kind:<8}  {part.states:>13,} states  '
            f'score {part.score:.3f}  {goals}'
        )
    if len(parts) > MAX_SHOWN_PARTS:
        lines.append(f'         and {len(parts) - MAX_SHOWN_PARTS} more: see manifest.json')
    return lines


def _certificate_lines(summary: dict[str, Any]) -> list[str]:
    lines = []
    for name, where in (('gap', 'evenly drawn'), ('flown_gap', 'flown')):
        if summary.get(name) is not None:
            gap, error = summary[name], summary[f'{name}_error']
            lines.append(
                f'  certified   on average within {gap:.2%} +- {error:.2%} of V* '
                f'over the states {where}'
            )
    return lines


def _quality(method: str, summary: dict[str, Any]) -> str:
    if method == 'exact':
        return f'  bounds      V{summary["lower"]:+.2e} <= V* <= V{summary["upper"]:+.2e}'
    if method == 'expansion':
        fit = f'{summary["features"]:,} features in {summary["points"]:,} design points'
        return f'  fit         {fit}{"" if summary["converged"] else ", NOT CONVERGED"}'
    return f'  solved to   {summary["upper"]:.2e}, summed over the sub-MDPs'


if __name__ == '__main__':
    raise SystemExit(main())
