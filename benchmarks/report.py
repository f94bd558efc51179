"""Reports: how long they take, and how large they are.

    make bench SCRIPTS=benchmarks/report.py

The flight is the one of the tests, and the same again and again. Writes report_times.md; ends with
exit code 1 where a report takes longer than it may, or is larger. About two minutes.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from parts import pages
from parts.missions import case_study
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from uav_mission_manager import build_policy
from uav_mission_manager.cli.mission_report import main as report

MOST_SECONDS, MOST_BYTES = 30.0, 5_000_000
"""Time [s] and size that a report may take."""

BAG = pages.ROOT / 'test' / 'bags' / 'case_study'
POLICY = str(pages.ROOT / 'policies' / 'case_study')
SPEEDUP = 8
REPEATS = (1, 10, 60)
"""How often the flight is flown: a choice, up to seven hours."""

GOALS = ((1, 'exact'), (3, 'exact'), (5, 'exact'), (5, 'expansion'), (10, 'split'))
"""Goals and methods of the policy sets."""


def main() -> int:
    """Run the benchmark."""
    options = pages.parser(__doc__.splitlines()[0]).parse_args()
    load = os.getloadavg()[0]
    rows, good = [], True
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for count in REPEATS:
            bag = repeated(folder / f'bag{count}', count)
            arguments = [str(bag), '--policy', POLICY, f'--speedup={SPEEDUP}']
            with Reader(bag) as reader:
                minutes = reader.duration * 1e-9 * SPEEDUP / 60
            rows.append((f'flight of {minutes:.0f} minutes', *measured(folder, arguments)))
        for goals, method in GOALS:
            policy = folder / f'{method}{goals}'
            build_policy(case_study(goals), method, certificate=False).save(policy)
            name = f'policy set, {goals} goal{"s" * (goals > 1)}, {method}'
            rows.append((name, *measured(folder, [str(policy)])))
    for _, seconds, size in rows:
        good = good and seconds <= MOST_SECONDS and size <= MOST_BYTES
    found = pages.table(
        ('report of', 'time [s]', 'size [MB]'),
        [(name, f'{seconds:.1f}', f'{size / 1e6:.2f}') for name, seconds, size in rows],
    )
    head = (
        'Wall time of [`mission_report`](report.md) in a warm process, and size of the file. It '
        f'may take\n{MOST_SECONDS:g} s and {MOST_BYTES / 1e6:g} MB. The flights are one of the '
        'demo, repeated.'
    )
    load_text = f'Load of the machine before: {load:.2f}.'
    file = pages.folder(options) / 'report_times.md'
    pages.publish(file, 'How long reports take', [head, found, load_text])
    return 0 if good else 1


def measured(folder: Path, arguments: list[str]) -> tuple[float, int]:
    """Time [s] and size of a report."""
    out = folder / 'report.html'
    began = time.perf_counter()
    with redirect_stdout(StringIO()):
        report([*arguments, '--out', str(out)])
    return time.perf_counter() - began, out.stat().st_size


def repeated(folder: Path, count: int) -> Path:
    """Write the flight so many times into one bag."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    with Reader(BAG) as reader, writer:
        connections = {
            each.topic: writer.add_connection(each.topic, each.msgtype, typestore=store)
            for each in reader.connections
        }
        for number in range(count):
            later = number * (reader.duration + 10**9)
            for connection, at, data in reader.messages():
                writer.write(connections[connection.topic], at + later, data)
    return folder


if __name__ == '__main__':
    sys.exit(main())
