"""The whole chain for hours of simulated time, with everything going wrong, watched from outside.

    make bench SCRIPTS=benchmarks/soak.py ARGS='--seed 1 --hours 10'

Base station, manager and bridge fly the simulated autopilot over wires that lose, delay, reorder
and duplicate, while processes are killed, clocks step, sensors, motors and batteries fail, and
pilots take over. What must hold is checked at every step: see `parts/soak/invariants.py`. A seed
that fails says when and why, with the end of the log; it fails again in the same way. Writes
soak.md. Ten hours of a seed take some six minutes of a processor.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
import traceback
import uuid
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # To run without `make`.

from parts import pages
from parts.missions import case_study
from parts.soak.bag import SoakBag
from parts.soak.day import Day
from parts.soak.fate import Fate
from parts.soak.leaks import Leaks, Sample
from parts.soak.work import with_work

from uav_mission_manager import build_policy
from uav_mission_manager.cli.recording_options import add_recording_options, place_of_bags
from uav_mission_manager.policy import Policy
from uav_mission_manager.policy.workers import workers

MEMORY_FOLDER = Path('/dev/shm')
"""Where journals are written in memory: tens of thousands of writes an hour."""


@dataclass(frozen=True)
class Result:
    """How a seed ended: `failure` is empty if all went well; times in seconds, `now` simulated."""

    seed: int
    failure: str
    now: float
    seconds: float
    counts: Counter[str]
    checked: Counter[str]
    samples: list[Sample]

    @property
    def ending(self) -> str:
        """In one line."""
        return f'at {self.now:.2f} s: {self.failure}' if self.failure else 'all held'


def main() -> int:
    """Run the seeds; return 1 if one has failed."""
    parser = pages.parser(__doc__.splitlines()[0])
    parser.add_argument('--seed', type=int, nargs='+', default=[1, 2, 3])
    parser.add_argument('--hours', type=float, default=10.0, help='of simulated time')
    parser.add_argument(
        '--without', nargs='*', default=(), metavar='NAME', help='what shall not happen'
    )
    add_recording_options(
        parser,
        'directory for what the manager decides on, a bag a seed, and its policy sets; default: '
        'a new one, uav-soak-.. in TMPDIR',
    )
    parser.add_argument('--jobs', type=int, default=2, help='processes; default: %(default)s')
    options = parser.parse_args()
    bags = place_of_bags(options, Path(tempfile.gettempdir()) / f'uav-soak-{uuid.uuid4().hex[:8]}')
    if bags is not None:
        for name, policy in zip(('policy', 'other_policy'), both_policies()):
            policy.save(bags / name)
    tasks = [partial(soak, seed, options.hours, options.without, bags) for seed in options.seed]
    with workers(min(options.jobs, len(tasks))) as pool:
        results = list(pool.run(tasks))
    if bags is not None:
        size = sum(file.stat().st_size for file in bags.rglob('*') if file.is_file())
        print(f'bags: {bags}, {size / 1e6:.1f} MB; see mission_replay BAG --policy {bags}/policy')
    file = pages.folder(options) / 'soak.md'
    pages.publish(file, 'The chain for hours, with everything going wrong', _page(results))
    return int(any(result.failure for result in results))


def both_policies() -> tuple[Policy, Policy]:
    """Policies of the case study, and of the same goals and grid with other costs."""
    mission = with_work(case_study(3))
    other = dataclasses.replace(mission, distance_weight=2.0)
    return build_policy(mission, 'exact'), build_policy(other, 'exact')


def soak(
    seed: int, hours: float, without: Sequence[str] = (), record: Path | None = None
) -> Result:
    """Fly one seed; say how it ended."""
    bag = SoakBag(record / f'seed_{seed}') if record else None
    memory = MEMORY_FOLDER if MEMORY_FOLDER.is_dir() else None
    with tempfile.TemporaryDirectory(dir=memory) as name:
        folder, start, failure = Path(name), time.perf_counter(), ''
        day, leaks = Day(both_policies(), folder, seed, bag), Leaks(folder)
        try:
            Fate(day, without).run(hours * 3600.0, partial(_look, seed, leaks))
        except Exception as error:
            failure = f'{type(error).__name__}: {error}'
            print(*day.log, traceback.format_exc(), sep='\n')
        for process in day.processes:
            if process.up:
                process.kill()
        if bag:
            bag.save(day.now)
        seconds = time.perf_counter() - start
    checked = day.invariants.checked
    result = Result(seed, failure, day.now, seconds, day.counts, checked, leaks.samples)
    print(f'seed {seed}: {result.ending}, in {seconds:.0f} s', flush=True)
    return result


def _look(seed: int, leaks: Leaks, now: float) -> None:
    if leaks.look(now):
        print(f'seed {seed}: {now / 3600.0:.1f} h', flush=True)


def _page(results: list[Result]) -> list[str]:
    head = ['', *(f'seed {result.seed}' for result in results)]
    endings = '\n'.join(f'- seed {result.seed}: {result.ending}' for result in results)
    counts = [result.counts for result in results]
    checked = [result.checked for result in results]
    return [
        INTRODUCTION,
        endings,
        f'## Time and memory\n\n{pages.table(head, _costs(results))}',
        f'## What was checked\n\n{pages.table(head, _rows(checked))}',
        f'## What happened\n\n{pages.table(head, _rows(counts))}',
    ]


def _rows(counts: list[Counter[str]]) -> list[list[str]]:
    names = sorted(set().union(*counts))
    return [[name, *(f'{count[name]:,}' for count in counts)] for name in names]


def _costs(results: list[Result]) -> list[list[str]]:
    def row(what: str, *values: str) -> list[str]:
        return [what, *values]

    rows = [
        row('simulated hours', *(f'{result.now / 3600.0:.1f}' for result in results)),
        row('wall time [s]', *(f'{result.seconds:.0f}' for result in results)),
        row('faster than life', *(f'{r.now / r.seconds:.0f}' for r in results)),
    ]
    if all(len(result.samples) > 1 for result in results):
        ends = [(result.samples[0], result.samples[-1]) for result in results]
        rows += [
            row('objects after an hour', *(f'{first.objects:,}' for first, _ in ends)),
            row('objects in the end', *(f'{last.objects:,}' for _, last in ends)),
            row('process after an hour [MiB]', *(f'{a.process / 2**20:.1f}' for a, _ in ends)),
            row('process in the end [MiB]', *(f'{b.process / 2**20:.1f}' for _, b in ends)),
            row('largest journal [KiB]', *(f'{b.journal / 1024:.0f}' for _, b in ends)),
        ]
    return rows


INTRODUCTION = """\
The cores of base station, manager and bridge, with their journals, and the simulated autopilot, in
one process and in simulated time. Storms of five to fifteen minutes, in which everything below
happens at random, and calms by turns; in a calm all that is wanted must get done: pictures at one
goal, a round of waypoints at another, another program's work at the third. The invariants are
checked twenty times a second, on the wires and in the simulator's truth. At its first
violation, or exception, a seed ends."""


if __name__ == '__main__':
    raise SystemExit(main())
