"""The console's page: from a topic to the pixels, and what the node takes of a processor.

    make bench SCRIPTS=benchmarks/page.py

Vehicles send what manager, bridge and base station send, as often as they do. One battery changes
every now and then; the browser notes when it has painted the new charge. Writes page.md; ends with
exit code 1 where it takes longer than it may. About two minutes; needs Chromium.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rclpy
from parts import pages
from parts.page_traffic import Traffic
from playwright.sync_api import Page, sync_playwright
from rclpy.executors import SingleThreadedExecutor

sys.path.insert(0, str(pages.ROOT / 'test' / 'integration'))

from ros_helpers import ros_domain

from uav_mission_manager.nodes.transport import without_shared_memory

MOST_DELAY = {1: 0.2, 20: 0.5}
"""Time [s] within which 95 % of the changes shall be painted, by the number of vehicles."""

MOST_LOAD = {1: 0.2, 20: 0.2}
"""Share of a processor that the node may take, by the number of vehicles."""

SAMPLES = 60
"""Changes that are timed: a choice."""

GAPS = 0.3, 0.7
"""Time [s] between two changes: a choice, that no period of the page fits into."""

LIMIT = 60.0
"""Time [s] after which something is missing."""

CLOCK_TICKS = os.sysconf('SC_CLK_TCK')

NOTE_PAINTED = """() => {
  window.painted = {};
  const look = () => {
    const part = document.querySelector('.fact .value');
    const text = part ? part.textContent : '';
    if (text && !(text in window.painted)) {
      window.painted[text] = 0;
      requestAnimationFrame(() => requestAnimationFrame(() => {
        window.painted[text] = Date.now();
      }));
    }
  };
  new MutationObserver(look).observe(document.body,
    {subtree: true, childList: true, characterData: true});
}"""
"""Notes when each charge is on the screen: after the frame in which it was drawn."""

POLICY = pages.ROOT / 'policies' / 'case_study'


def main() -> int:
    """Run the benchmark."""
    options = pages.parser(__doc__.splitlines()[0]).parse_args()
    load = os.getloadavg()[0]
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    without_shared_memory()
    with ros_domain() as domain:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        rclpy.init()
        measured = {count: _measure(count) for count in MOST_DELAY}
        rclpy.shutdown()
    rows, good = [], True
    for count, (delays, share) in measured.items():
        late, most = float(np.percentile(delays, 95)), MOST_DELAY[count]
        good = good and late <= most and share <= MOST_LOAD[count]
        rows.append(
            [
                count,
                *(f'{1e3 * value:.0f}' for value in (np.median(delays), late, most)),
                f'{share:.0%}',
                f'{MOST_LOAD[count]:.0%}',
            ]
        )
    head = ['vehicles', 'median [ms]', '95 % are below [ms]', 'at most [ms]']
    table = pages.table([*head, 'of a processor', 'at most'], rows)
    note = f'{SAMPLES} changes each; load of the machine before: {load:.2f}.'
    sections = [INTRODUCTION, f'{table}\n\n{note}']
    pages.publish(pages.folder(options) / 'page.md', 'The page', sections)
    return int(not good)


INTRODUCTION = """\
Time from a message on `battery_state` to the frame in which a browser has painted the new charge,
and what the node takes of one processor meanwhile, with one page open. The vehicles send what
manager, bridge and base station do, as often as they do: position ten times a second."""


def _measure(count: int) -> tuple[np.ndarray, float]:
    """Times [s] from topic to pixel, and the node's share of a processor."""
    traffic = Traffic(count)
    executor = SingleThreadedExecutor()
    executor.add_node(traffic)
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            _console(Path(folder)) as (address, pid),
            sync_playwright() as playwright,
        ):
            browser = playwright.chromium.launch(
                executable_path=shutil.which('chromium'), args=['--no-sandbox']
            )
            page = browser.new_page(viewport={'width': 1366, 'height': 768})
            page.goto(address)
            _until(lambda: _vehicles(page) >= count, executor)
            _spin(executor, 5.0)
            page.evaluate(NOTE_PAINTED)
            found = _sample(traffic, executor, page, pid)
            browser.close()
            return found
    finally:
        executor.shutdown()
        traffic.destroy_node()


def _vehicles(page: Page) -> int:
    tiles = page.locator('.tile').count()
    return tiles or int('/v' in (page.locator('.vehicle').first.text_content() or ''))


def _sample(
    traffic: Traffic, executor: SingleThreadedExecutor, page: Page, pid: int
) -> tuple[np.ndarray, float]:
    chance, sent = random.Random(0), {}
    start, before = time.monotonic(), _processor_time(pid)
    for number in range(SAMPLES):
        _spin(executor, chance.uniform(*GAPS))
        charge = 0.3 + 0.01 * number
        sent[f'{charge:.0%}'] = time.time()
        traffic.send_charge(charge)
    share = (_processor_time(pid) - before) / (time.monotonic() - start)
    _spin(executor, 2.0)
    painted = page.evaluate('window.painted')
    missing = [text for text in sent if not painted.get(text)]
    if missing:
        raise RuntimeError(f'never painted: {missing}')
    return np.array([painted[text] / 1e3 - at for text, at in sent.items()]), share


def _processor_time(pid: int) -> float:
    """Time [s] that a process has had of processors."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS


def _spin(executor: SingleThreadedExecutor, duration: float) -> None:
    end = time.monotonic() + duration
    while (left := end - time.monotonic()) > 0.0:
        executor.spin_once(timeout_sec=left)


def _until(condition, executor: SingleThreadedExecutor) -> None:
    end = time.monotonic() + LIMIT
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f'not all vehicles within {LIMIT:g} s')
        _spin(executor, 0.2)


@contextmanager
def _console(folder: Path) -> Iterator[tuple[str, int]]:
    """Start the node; give the page's address and the id of the process."""
    log = folder / 'console.log'
    words = ['--ros-args', '-p', f'policy:={POLICY}', '-p', 'port:=0']
    with log.open('wb') as output:
        process = subprocess.Popen(
            [sys.executable, '-m', 'uav_mission_manager.nodes.console', *words],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, 'ROS_HOME': str(folder)},
        )
    try:
        end = time.monotonic() + LIMIT
        while not (found := re.search(r'page: (http\S+)', log.read_text())):
            if time.monotonic() > end or process.poll() is not None:
                raise RuntimeError(log.read_text())
            time.sleep(0.1)
        yield found[1], process.pid
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


if __name__ == '__main__':
    raise SystemExit(main())
