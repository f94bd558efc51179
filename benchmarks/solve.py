"""How fast and how small the exact solver is, beside other solvers and the paper.

    make bench SCRIPTS=benchmarks/solve.py                     one to seven goals, peers for two
    make bench SCRIPTS=benchmarks/solve.py ARGS='--goals 8'    eight goals too
    make bench SCRIPTS=benchmarks/solve.py ARGS='--charge'     eight and ten goals with one battery

Writes benchmarks.md and scaling.svg. About a quarter of an hour on two idle processors.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from parts import pages, report
from parts.measure import apart, measure
from parts.peers import PEERS

EXPLICIT_GOALS = (1, 2)
"""Numbers of goals whose transition matrices fit in memory."""

PRECISION_GOALS = 6
"""Most goals that are solved in every precision; more in the default one alone."""

BATTERY_GOALS, MORE_BATTERY_GOALS = (3, 6), (3, 6, 8, 10)
"""Numbers of goals that are solved with one battery, and with `--charge`."""

REPEATED_GOALS = 5
"""Most goals that are solved several times in every precision; one more in the default one."""


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument(
        '--goals',
        type=int,
        choices=range(4, 9),
        default=7,
        help='most goals, 4 to 8; default: %(default)s',
    )
    parser.add_argument('--charge', action='store_true', help='one battery with 8 and 10 goals')
    parser.add_argument('--repeats', type=int, default=5, help='of each; default: %(default)s')
    parser.add_argument('--timeout', type=float, default=120, help='of each peer [s]')
    parser.add_argument('--measure', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(*json.loads(options.measure))))
        return 0
    found = _run(options)
    print(report.before_and_now(found))
    folder = pages.folder(options)
    pages.publish(folder / 'benchmarks.md', 'Benchmarks', report.sections(found))
    report.draw(found, folder / 'scaling.svg')
    return 0


def _run(options: argparse.Namespace) -> dict[str, Any]:
    """All measurements, one process after the other."""
    return {
        'speeds': _measure('speeds', 300),
        **{precision: _ours(precision, options) for precision in ('mixed', 'double', 'single')},
        'battery': {
            k: _measure(
                'ours', 36_000, k=k, precision='mixed', repeats=_repeats(k, options), battery=True
            )
            for k in (MORE_BATTERY_GOALS if options.charge else BATTERY_GOALS)
        },
        'goal wise': _measure('goal wise', 300, k=3, repeats=options.repeats),
        'peers': {
            (name, k): _measure('peer', options.timeout, k=k, name=name, repeats=options.repeats)
            for k in EXPLICIT_GOALS
            for name in PEERS
        },
        'compiled': {
            (k, battery, dtype): _measure('compiled', 300, k=k, battery=battery, dtype=dtype)
            for k, battery in ((6, False), (7, True))
            for dtype in ('float64', 'float32')
        },
        'alternatives': {k: _measure('alternatives', 900, k=k) for k in EXPLICIT_GOALS},
    }


def _ours(precision: str, options: argparse.Namespace) -> dict[int, dict[str, Any]]:
    """The exact solver in one precision, by number of goals."""
    default = precision == 'mixed'
    most = options.goals if default else min(options.goals, PRECISION_GOALS)
    repeated = REPEATED_GOALS + default
    return {
        k: _measure(
            'ours',
            36_000,
            k=k,
            precision=precision,
            repeats=options.repeats if k <= repeated else 1,
        )
        for k in range(1, most + 1)
    }


def _repeats(k: int, options: argparse.Namespace) -> int:
    return options.repeats if k <= REPEATED_GOALS else 1


def _measure(what: str, timeout: float, **arguments: Any) -> dict[str, Any]:
    result = apart(what, timeout, **arguments)
    print(what, arguments, result, file=sys.stderr, flush=True)
    return result


if __name__ == '__main__':
    raise SystemExit(main())
