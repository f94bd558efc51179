"""docs/benchmarks.md and its picture, from what was measured."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from parts.measure import median
from parts.peers import TOLERANCE

PAPER_SECONDS = {
    1: 1.0,
    2: 5.4e1,
    3: 2352.5,
    4: 6.1e4,
    5: 3.3e6,
    6: 1.2e8,
    7: 3.7e9,
    8: 1.2e11,
    9: 3.7e12,
    10: 1.1e14,
}
"""Table 1; measured for 1 and 3 goals, extrapolated for the others."""

PAPER_STATES = {4: '2.0e6'}
"""Table 1 where it is not right: 8 * 6^4 * 5 * 8 * 6 = 2,488,320."""

Found = dict[str, Any]


def states(k: int) -> int:
    """Number of states of the case study with k goals."""
    return 8 * 6**k * (k + 1) * 8 * 6


def write(found: Found, file: Path) -> None:
    """Write the page."""
    sections = [
        _introduction(found['machine']),
        _ours(found),
        _peers(found),
        _sweep(found),
        _alternatives(found['alternatives']),
        _paper(found),
    ]
    file.parent.mkdir(exist_ok=True)
    file.write_text('\n\n'.join(sections) + '\n', encoding='utf-8')


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ['---'] + ['---:'] * (len(head) - 1), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def _seconds(seconds: float) -> str:
    if seconds < 1:
        return f'{1e3 * seconds:.3g} ms'
    for unit, size in (('years', 3.15576e7), ('days', 86_400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2 * size:
            return f'{seconds / size:,.3g} {unit}'
    return f'{seconds:.3g} s'


def _mebibytes(memory: float) -> str:
    return f'{memory:,.0f} MiB' if memory >= 10 else f'{memory:.1f} MiB'


def _introduction(machine: Found) -> str:
    where = f'{machine["processors"]} processors ({machine["processor"]}), Python'
    return f"""# Benchmarks

Written by `make bench` (`benchmarks/solve.py`); the numbers below are of one run on
{where} {machine['python']}, numpy {machine['numpy']}.
The mission is the case study with its first goals, from the fourth on with goals of the
benchmark's own; tolerance {TOLERANCE:g} on V, in every state. Wall time is the
median of five solves, memory the peak above the interpreter with its imports, each measurement
in its own process."""


def _ours(found: Found) -> str:
    rows = []
    for k, ours in found['mixed'].items():
        if 'error' in ours:
            rows.append([str(k), f'{states(k):,}', ours['error'], *[''] * 6])
            continue
        others = [
            _seconds(median(found[name][k])) if 'seconds' in found[name].get(k, {}) else ''
            for name in ('double', 'single')
        ]
        bound = found['single'].get(k, {}).get('bound')
        rows.append(
            [
                str(k),
                f'{states(k):,}',
                f'**{_seconds(median(ours))}**',
                _mebibytes(ours['memory']),
                str(ours['sweeps']),
                f'{states(k) * ours["sweeps"] / median(ours):.2g}',
                *others,
                f'±{bound:.1g}' if bound else '',
            ]
        )
    head = [
        'goals',
        'states',
        'wall',
        'memory',
        'sweeps',
        'states/s, a sweep',
        'plain float64',
        'float32 alone',
        'its bound',
    ]
    return f"""## The exact solver

*Wall* is the default, mixed precision: early sweeps in float32, the rest and the bounds in
float64. *Plain float64* is value iteration without that, the reference. *float32 alone*
(`--precision single`) stops at 1e-3 or where rounding stops it; its bound counts every rounding
at its worst; the true error is below 1e-3 for one to four goals.

{_table(head, rows)}"""


def _peers(found: Found) -> str:
    rows = []
    for (name, k), peer in found['peers'].items():
        ours = found['mixed'][k]
        if 'error' in peer:
            rows.append([name, str(k), _why(peer['error']), '', '', '', ''])
            continue
        rows.append(
            [
                name,
                str(k),
                _seconds(median(peer)),
                _mebibytes(peer['memory']),
                str(peer['sweeps'] or ''),
                f'{median(peer) / median(ours):,.0f} x',
                f'{peer["memory"] / max(ours["memory"], 0.1):,.0f} x',
            ]
        )
    head = ['solver', 'goals', 'wall', 'memory', 'iterations', 'time to ours', 'memory to ours']
    return f"""## Other solvers

They need the transition matrices written out: 1 million entries for one goal, 58 million for
two, 3e9 for three. Building these is not counted in their time, compiling neither. Each result
is checked against ours first: V, where a solver returns it within a tolerance, and its policy.

{_table(head, rows)}"""


def _why(error: str) -> str:
    return 'needs more than 12 GiB' if 'Memory' in error else error


def _sweep(found: Found) -> str:
    machine, rows = found['machine'], []
    for k in (3, 4, 5, 6):
        for precision, size in (('double', 8), ('single', 4)):
            ours = found[precision].get(k, {})
            if 'seconds' not in ours:
                continue
            a_sweep = median(ours) / ours['sweeps']
            entries = (8 + k) * 24 * 6**k
            copy = 2 * size * entries / machine['copy'] / 1e9
            rows.append(
                [
                    str(k),
                    f'float{8 * size}',
                    f'{entries:,}',
                    _seconds(a_sweep),
                    f'{1e9 * a_sweep / entries:.1f} ns',
                    f'{a_sweep / copy:.0f}',
                    f'{a_sweep * machine[f"add in cache, float{8 * size}"] * 1e9 / entries:.0f}',
                ]
            )
    head = ['goals', 'type', 'entries of W', 'a sweep', 'an entry', 'copies of W', 'adds in cache']
    return f"""## How far from the machine

One processor adds {machine['add in cache, float64']:.1f}e9 float64 and
{machine['add in cache, float32']:.1f}e9 float32 a second in cache; memory copies at
{machine['copy']:.1f} GB/s; a matrix product makes {machine['product, float64']:.0f} GFLOP/s in
float64 and {machine['product, float32']:.0f} in float32 on all processors. A sweep as so many
copies of W in memory, and as so many elementwise additions of an entry in the cache of one
processor:

{_table(head, rows)}

A sweep needs some 100 elementwise operations an entry by its nature: 5 for each g_j and for t,
1.5 in each mode for each r_j and each part that can fail, and the minimum over the actions. What
is beyond that goes to transposing blocks, to short runs and, below three goals, to the calls
themselves. Products with fused axes would take something off a sweep's expectations, by sums
whose order differs from one BLAS to the next: policy sets would no longer have the same bytes
everywhere, which the elementwise operations give (numpy 1.26 to 2.4, with and without AVX-512).

{_compiled(found['compiled'])}"""


def _compiled(found: Found) -> str:
    rows = [
        [
            f'{k}',
            dtype,
            *(_seconds(half[name]) for name in ('ours', 'compiled', 'compiling')),
            'yes' if half['same bits'] else 'no',
        ]
        for (k, dtype), half in found.items()
        if 'error' not in half
    ]
    head = ['goals', 'type', 'numpy', 'compiled', 'compiling', 'same bits']
    return f"""Compiled code can fuse what numpy must do array by array. The first half of a sweep,
the expectation over t' and g' (numpy's with that on completion, the kernel without):

{_table(head, rows)}

All of a sweep compiled that way should gain as much; this was not tried. The package stays with
numpy, which every ROS installation has: one to four goals are solved sooner than such code is
compiled, and six in less than a minute."""


def _alternatives(found: Found) -> str:
    rows = [
        [name, *(str(counts.get(name, counts.get('error', ''))) for counts in found.values())]
        for name in next(iter(found.values()))
    ]
    head = ['way', *(f'{k} goal{"s" * (int(k) > 1)}' for k in found)]
    return f"""## Why value iteration

Sweeps, or products with one policy's transitions, until the bounds meet the tolerance:

{_table(head, rows)}

The bounds need only the spread of the change to vanish, and that shrinks faster
than the discount guarantees. Modified policy iteration makes no fewer sweeps, and spares
only the minimum: the expectations are shared by all actions, so one policy
costs as many. Gauss-Seidel orders lose the bounds, for they do not pass a constant on evenly.
Krylov methods and Chebyshev polynomials meet complex eigenvalues (the UAV flies in rounds).
Anderson acceleration saves sweeps, but for three goals and more hardly
what its own tables and sums cost, and it triples the memory. Starting from the sum of smaller
missions (goal expansion of order 2) saves some of the early, cheap sweeps and costs as much.
Mixed precision gains what the first table shows for hardly any code, and is kept."""


def _fit(found: Found) -> tuple[float, float]:
    """Exponent and factor of wall = factor * states^exponent, from three goals on."""
    times = {k: median(o) for k, o in found['mixed'].items() if 'seconds' in o}
    points = [(states(k), seconds) for k, seconds in times.items() if k > 2]
    exponent, intercept = np.polyfit(*np.log(np.array(points)).T, 1)
    return float(exponent), math.exp(intercept)


def _paper(found: Found) -> str:
    exponent, factor = _fit(found)
    rows = []
    for k in range(1, 11):
        ours = found['mixed'].get(k, {})
        measured = 'seconds' in ours
        seconds = median(ours) if measured else factor * states(k) ** exponent
        rows.append(
            [
                str(k),
                f'{states(k):,}',
                PAPER_STATES.get(k, ''),
                _seconds(seconds) if measured else f'*{_seconds(seconds)}*',
                _seconds(PAPER_SECONDS[k]),
                f'{PAPER_SECONDS[k] / seconds:,.2g}',
            ]
        )
    head = ['goals', 'states', "paper's count", 'ours', 'paper', 'factor']
    return f"""## The paper's tables

Table 1: goals, states and solve time; *in italics* what is extrapolated, ours with the fitted
exponent {exponent:.2f} (time ~ states^{exponent:.2f}, from three goals on). The paper measured
one and three goals.

{_table(head, rows)}

![Solve time against states](scaling.svg)

Table 2: the global MDP of three goals and the goal-wise sub-MDPs (here all three of them). The
paper reports the same actions in all states. Here the goals share one UAV, so that policies
recombined from sub-MDPs are not optimal.

{_comparison(found)}"""


def _comparison(found: Found) -> str:
    whole, parts = found['mixed'][3], found['goal wise']
    rows = [
        [name, f'{ours["states"]:,}', _seconds(median(ours)), _mebibytes(ours['memory']), *paper]
        for name, ours, paper in (
            ('global', whole, ('2,352.5 s', '890 MB')),
            ('decomposed', parts, ('1.0 s', '42 MB')),
        )
    ]
    return _table(['method', 'states', 'ours', 'memory', 'paper', 'memory'], rows)


def draw(found: Found, file: Path) -> None:
    """Draw solve time against states on logarithmic axes."""
    import matplotlib as mpl

    mpl.use('svg')
    from matplotlib import pyplot

    pyplot.rcParams.update({'svg.hashsalt': 'scaling', 'svg.fonttype': 'none'})
    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    goals = [k for k, ours in found['mixed'].items() if 'seconds' in ours]
    exponent, factor = _fit(found)
    span = np.array([states(3), states(10)], dtype=float)
    axes.loglog(
        [states(k) for k in PAPER_SECONDS],
        PAPER_SECONDS.values(),
        'o--',
        color='0.6',
        fillstyle='none',
        label='paper, extrapolated',
    )
    axes.loglog(
        [states(1), states(3)],
        [PAPER_SECONDS[1], PAPER_SECONDS[3]],
        'o',
        color='0.4',
        label='paper, measured',
    )
    names = [name for name, k in found['peers'] if k == 1]
    for name in names:
        points = [
            (states(k), median(found['peers'][name, k]))
            for k in (1, 2)
            if 'seconds' in found['peers'][name, k]
        ]
        if points:
            axes.loglog(*zip(*points), '.-', lw=0.8, ms=4, label=name)
    axes.loglog(span, factor * span**exponent, ':', color='black')
    axes.loglog(
        [states(k) for k in goals],
        [median(found['mixed'][k]) for k in goals],
        's-',
        color='black',
        lw=2,
        label='exact solver',
    )
    for k in goals:
        axes.annotate(
            f'{k}',
            (states(k), median(found['mixed'][k])),
            xytext=(4, -11),
            textcoords='offset points',
            fontsize=8,
            color='black',
        )
    axes.set(xlabel='states (numbers: goals)', ylabel='wall time [s]')
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(file, metadata={'Date': None})
