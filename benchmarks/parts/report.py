"""The page benchmarks.md and its picture, from what was measured."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from parts.measure import SINGLE_TOLERANCE, median
from parts.pages import DOCS, table
from parts.peers import TOLERANCE
from parts.pictures import drawing, save
from uav_mission_manager.solver.exact.sweep import MIN_COMPILED_ENTRIES
from uav_mission_manager.solver.submdp import state_count

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
"""Table 2; measured for 1 and 3 goals, extrapolated for the others."""

PAPER_STATES = {4: '2.0e6'}
"""Table 2 where it is not right: 8 * 6^4 * 5 * 8 * 6 = 2,488,320."""

INTRODUCTION = f"""\
The mission is the case study with its first goals, from the fourth on with goals of the
benchmark's own. V is found to within {TOLERANCE:g} in every state. Wall time is the median of
several solves; from seven goals on, and from six with one battery, of one solve. Memory is the
peak above that of the interpreter with its imports. Each measurement runs in its own process."""

Found = dict[str, Any]


def states(k: int) -> int:
    """Number of states of the case study with k goals."""
    return state_count(k, 8, 8)


def sections(found: Found) -> list[str]:
    """Sections of the page."""
    return [
        INTRODUCTION,
        _ours(found),
        _battery(found['battery']),
        _peers(found),
        _sweep(found),
        _alternatives(found['alternatives']),
        _paper(found),
    ]


def before_and_now(found: Found) -> str:
    """Wall times of the exact solver in docs/benchmarks.md and measured now."""
    page = (DOCS / 'benchmarks.md').read_text(encoding='utf-8')
    before = dict(re.findall(r'^\| (\d) \| [\d,]+ \| \*\*(.+?)\*\* \|', page, re.MULTILINE))
    rows = [
        [str(k), before.get(str(k), ''), _seconds(median(ours))]
        for k, ours in found['mixed'].items()
        if 'seconds' in ours
    ]
    return table(['goals', 'docs/benchmarks.md', 'now'], rows)


def _seconds(seconds: float) -> str:
    if seconds < 1:
        return f'{1e3 * seconds:.3g} ms'
    for unit, size in (('years', 3.15576e7), ('days', 86_400.0), ('h', 3600.0), ('min', 60.0)):
        if seconds >= 2 * size:
            return f'{seconds / size:,.3g} {unit}'
    return f'{seconds:.3g} s'


def _mebibytes(memory: float) -> str:
    return f'{memory:,.0f} MiB' if memory >= 10 else f'{memory:.1f} MiB'


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

*Wall* is the default, mixed precision: the first sweeps run in float32, the last ones in float64,
and so do the bounds. *Plain float64* makes all sweeps in float64. *float32 alone*
(`--precision single`) stops at {SINGLE_TOLERANCE:g} or where rounding stops it. Its bound assumes
the worst of every rounding.

{table(head, rows)}"""


def _battery(found: Found) -> str:
    rows = []
    for k, ours in found.items():
        if 'error' in ours:
            rows.append([str(k), ours['error'], *[''] * 6])
            continue
        rows.append(
            [
                str(k),
                f'{ours["states"]:,}',
                f'{states(k):,}',
                f'**{_seconds(median(ours))}**',
                _mebibytes(ours['memory']),
                _mebibytes(ours['predicted']),
                str(ours['sweeps']),
                f'±{ours["bound"]:.1g}',
            ]
        )
    head = [
        'goals',
        'states',
        'with range flags',
        'wall',
        'memory',
        'predicted',
        'sweeps',
        'bound',
    ]
    return f"""## One battery

The same missions with [one battery](mission_file.md#one-battery) of 16 levels in place of a range
flag for each goal: less states from five goals on, and each goal more makes three times as many.

{table(head, rows)}"""


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
                f'{peer["memory"] / max(ours["memory"], 1.0):,.0f} x',
            ]
        )
    head = ['solver', 'goals', 'wall', 'memory', 'iterations', 'time to ours', 'memory to ours']
    return f"""## Other solvers

They need the transition matrices written out: {_count(found, 1)} entries for one goal,
{_count(found, 2)} for two, some 3e9 for three. The time to build and to compile is not counted.
Each result is checked against ours first: V, where a solver returns it to a tolerance, and the
policy. Where ours takes less than 1 MiB, the last column counts 1 MiB.

{table(head, rows)}"""


def _count(found: Found, k: int) -> str:
    """Entries of all transition matrices, in millions."""
    counts = [
        peer['matrix entries']
        for (_, goals), peer in found['peers'].items()
        if goals == k and 'error' not in peer
    ]
    return f'{counts[0] / 1e6:,.1f} million' if counts else 'too many'


def _why(error: str) -> str:
    return 'needs more than 12 GiB' if 'Memory' in error else error


def _sweep(found: Found) -> str:
    speeds, rows = found['speeds'], []
    for k in (3, 4, 5, 6):
        for precision, size in (('double', 8), ('single', 4)):
            ours = found[precision].get(k, {})
            if 'seconds' not in ours:
                continue
            a_sweep = median(ours) / ours['sweeps']
            entries = ours['entries']
            copy = 2 * size * entries / speeds['copy'] / 1e9
            rows.append(
                [
                    str(k),
                    f'float{8 * size}',
                    f'{entries:,}',
                    _seconds(a_sweep),
                    f'{1e9 * a_sweep / entries:.1f} ns',
                    f'{a_sweep / copy:.0f}',
                    f'{a_sweep * speeds[f"add in cache, float{8 * size}"] * 1e9 / entries:.0f}',
                ]
            )
    head = ['goals', 'type', 'entries of W', 'a sweep', 'an entry', 'copies of W', 'adds in cache']
    return f"""## How far from the machine

One processor adds {speeds['add in cache, float64']:.1f}e9 float64 and
{speeds['add in cache, float32']:.1f}e9 float32 a second in cache; memory copies at
{speeds['copy']:.1f} GB/s; a matrix product makes {speeds['product, float64']:.0f} GFLOP/s in
float64 and {speeds['product, float32']:.0f} in float32 on all processors. A sweep as so many
copies of W in memory, and as so many elementwise additions of an entry in the cache of one
processor:

{table(head, rows)}

A sweep needs many operations an entry by its nature, some 70 with three goals and 110 with six:
5 for t and 5 for each g_j; 3 for each r_j and for each part that can fail; 3 for each action. The
rest of the time goes to transposing blocks and to short runs; with one or two goals, to the calls
themselves. Matrix products could take several axes at once. But each BLAS adds in another order,
so policy sets would have other bytes on another machine. The elementwise operations used here give
the same bytes everywhere.

{_compiled(found['compiled'])}"""


def _compiled(found: Found) -> str:
    rows = [
        [
            f'{k}{", one battery" * battery}',
            dtype,
            *(_seconds(both[name]) for name in ('ours', 'compiled', 'compiling')),
            f'{both["ours"] / both["compiled"]:.1f} x',
            'yes' if both['same bits'] else 'no',
        ]
        for (k, battery, dtype), both in found.items()
        if 'error' not in both
    ]
    head = ['goals', 'type', 'numpy', 'compiled', 'compiling', 'gain', 'same bits']
    return f"""\
Compiled code needs no array for each step. Where numba is installed (`pip install '.[fast]'`), it
compiles the sweep of missions of {MIN_COMPILED_ENTRIES:,} entries of W or more; smaller ones are
solved sooner than that takes. The code is kept on disk, so it is compiled once on a machine: the
first solve takes longer by that. A sweep:

{table(head, rows)}"""


def _alternatives(found: Found) -> str:
    rows = [
        [name, *(str(counts.get(name, counts.get('error', ''))) for counts in found.values())]
        for name in next(iter(found.values()))
    ]
    head = ['method', *(f'{k} goal{"s" * (int(k) > 1)}' for k in found)]
    return f"""## Why value iteration

The table counts sweeps until the bounds meet the tolerance. A product with one policy's transition
matrix counts as a sweep too: it saves only the minimum over the actions, since all actions share
the expectations.

{table(head, rows)}

- Value iteration stops when the change is nearly the same in all states. That happens sooner than
  the discount guarantees.
- Modified policy iteration makes no fewer sweeps.
- Gauss-Seidel sweeps use new values at once. Then a constant no longer passes through a sweep
  unchanged, and the bounds become loose.
- Krylov methods (GMRES) meet complex eigenvalues, since the UAV flies in circles.
- Anderson acceleration saves sweeps. From three goals on this hardly outweighs the time for its
  own sums, and it needs three times the memory.
- Starting from the sum of smaller missions (a goal expansion of order 2) saves early, cheap sweeps
  and costs as much.
- Mixed precision gains what the first table shows, with little code, and is the default."""


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

Table 2 of the paper: goals, states and solve time. Figures *in italics* are extrapolated, by
time ~ states^{exponent:.2f}, fitted from three goals on. The paper measured one and three goals.

{table(head, rows)}

![Solve time against states](scaling.svg)

Table 3 of the paper: the global MDP of three goals, and its sub-MDPs of one goal each (here the
time of all three). The paper reports the same actions in all states. Here the goals share one UAV,
so policies recombined from sub-MDPs are not optimal: see [paper.md](paper.md).

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
    return table(['method', 'states', 'ours', 'memory', 'paper', 'memory'], rows)


def draw(found: Found, file: Path) -> None:
    """Draw solve time against states on logarithmic axes."""
    figure, axes = drawing('scaling').subplots(figsize=(7, 4.5))
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
    save(figure, file)
