"""How fast and how small the exact solver is, beside other solvers and the paper.

    make bench                      one to six goals, peers for one and two; some minutes
    make bench ARGS='--goals 8'     up to eight goals; half an hour, 16 GiB

Writes docs/benchmarks.md and docs/scaling.svg.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from parts.measure import apart, measure
from parts.peers import PEERS
from parts.report import draw, write

DOCS = Path(__file__).resolve().parents[1] / 'docs'


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        '--goals',
        type=int,
        choices=range(4, 9),
        default=6,
        help='most goals, 4 to 8; default: %(default)s',
    )
    parser.add_argument('--repeats', type=int, default=5, help='of each; default: %(default)s')
    parser.add_argument('--timeout', type=float, default=120, help='of each peer [s]')
    parser.add_argument('--measure', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(*json.loads(options.measure))))
        return 0
    found = _run(options)
    write(found, DOCS / 'benchmarks.md')
    draw(found, DOCS / 'scaling.svg')
    return 0


def _run(options: argparse.Namespace) -> dict[str, Any]:
    """All measurements, one process after the other."""
    found: dict[str, Any] = {'machine': _measure('machine', 300)}
    for precision in ('mixed', 'double', 'single'):
        found[precision] = {
            k: _measure(
                'ours',
                36_000,
                k=k,
                precision=precision,
                repeats=options.repeats if k < 6 or (k == 6 and precision == 'mixed') else 1,
            )
            for k in range(1, options.goals + 1)
            if k <= 6 or precision == 'mixed'
        }
    found['goal wise'] = _measure('goal wise', 300, k=3, repeats=options.repeats)
    found['peers'] = {
        (name, k): _measure('peer', options.timeout, k=k, name=name, repeats=options.repeats)
        for k in (1, 2)
        for name in PEERS
    }
    found['compiled'] = {
        (k, dtype): _measure('compiled', 300, k=k, dtype=dtype)
        for k in (3, 5)
        for dtype in ('float64', 'float32')
    }
    found['alternatives'] = {k: _measure('alternatives', 900, k=k) for k in (1, 2)}
    return found


def _measure(what: str, timeout: float, **arguments: Any) -> dict[str, Any]:
    result = apart(what, timeout, **arguments)
    print(what, arguments, result, file=sys.stderr, flush=True)
    return result


if __name__ == '__main__':
    raise SystemExit(main())
