"""Nodes that are killed at random and started again at once: nothing is lost, nothing done twice.

    make bench SCRIPTS=benchmarks/kills.py ARGS='--kills 200 --seed 1'

Simulated vehicles with their nodes, each chain in a namespace of its own, fly missions that a
crew asks for, cancels, holds, takes over and breaks, while manager, bridge and base station die.
Writes kills.md and prints what must not be; then the exit code is 1. About 25 minutes.
"""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from parts import pages

sys.path.insert(0, str(pages.ROOT / 'test' / 'integration'))

from parts.kills.chain import KILLED, LISTENING_TIME, SPEEDUP, Chain
from parts.kills.crew import EPISODES, Crew
from parts.kills.watch import Watch
from ros_helpers import Ros, ros_domain

GIVEN = ((), (1, 0, 0))
"""`priorities` that base stations are started with, again each time, by chain."""

POLL_PERIOD = 0.01
"""Time [s] between two looks at the chains, at most."""


def main() -> int:
    """Run the benchmark."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument(
        '--kills', type=int, default=200, help='of each node; default: %(default)s'
    )
    parser.add_argument('--seed', type=int, default=1, help='default: %(default)s')
    parser.add_argument('--chains', type=int, default=2, help='default: %(default)s')
    parser.add_argument(
        '--life', type=float, default=8.0, help='mean, of one node [s]; default: %(default)s'
    )
    parser.add_argument('--episodes', nargs='+', choices=EPISODES, default=(), metavar='EPISODE')
    parser.add_argument('--forget', choices=KILLED, help='this one loses its journal each time')
    parser.add_argument('--keep', type=Path, help='folder for logs and journals')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ros_domain() as domain:
        ros = Ros(domain, options.keep or Path(folder))
        begin = time.monotonic()
        try:
            crews = fly(ros, options)
        finally:
            ros.close()
        minutes = (time.monotonic() - begin) / 60.0
    violations = [text for crew in crews for text in crew.watch.violations]
    counts = sum((crew.watch.counts for crew in crews), Counter())
    if not options.forget:
        pages.publish(
            pages.folder(options) / 'kills.md', 'Kills', _sections(counts, violations, minutes)
        )
    print(*violations, f'{len(violations)} violations', sep='\n')
    return int(bool(violations))


def fly(ros: Ros, options: object) -> list[Crew]:
    """Fly until each node has been killed as often as asked for."""
    begin, crews = time.monotonic(), []
    for number in range(options.chains):
        chain = Chain(ros, number + 1, GIVEN[number % len(GIVEN)])
        watch = Watch(chain, lambda: time.monotonic() - begin)
        kills = options.kills * (number + 1) // options.chains - (
            options.kills * number // options.chains
        )
        chance = random.Random(f'{options.seed} {number}')
        crews.append(
            Crew(chain, watch, chance, kills, options.life, options.forget, options.episodes)
        )
    try:
        while not all(crew.over for crew in crews):
            ros.executor.spin_once(timeout_sec=POLL_PERIOD)
            for crew in crews:
                crew.step()
    finally:
        for crew in crews:
            crew.chain.close()
            crew.watch.step()
    return crews


def _sections(counts: Counter[str], violations: list[str], minutes: float) -> list[str]:
    rows = sorted(counts.items(), key=lambda row: (not row[0].startswith('kills'), row[0]))
    return [
        INTRODUCTION,
        pages.table(['what', 'times'], rows),
        f'{len(violations)} violations in {minutes:.0f} minutes at load {os.getloadavg()[0]:.1f}.',
    ]


INTRODUCTION = f"""\
{', '.join(KILLED)} are killed at random moments and started again at once, and a crew meanwhile
asks for goals, cancels, holds and resumes, takes over as a pilot, and breaks motor and camera.
What is watched is what a third party hears: the topics, and the vehicle on a second MAVLink link.
Simulated time runs {SPEEDUP:g} times as fast as the clock, and nodes listen {LISTENING_TIME:g} s
for another one of their kind."""


if __name__ == '__main__':
    raise SystemExit(main())
