"""The console's page during the demo."""

from __future__ import annotations

import re
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from uav_mission_manager.cli.demo.stack import NAMESPACE, end_processes, start_process
from uav_mission_manager.cli.errors import look_for_interruption, undisturbed
from uav_mission_manager.console import DEFAULT_PORT

MAX_PAGE_TIME = 30.0
"""Time [s] that the page may take until it is there; the demo flies without it then: a choice."""


@contextmanager
def serve_page(policies: Sequence[Path], logs: Path) -> Iterator[str]:
    """Serve the page until the flights are over; give a line that says where, or why not."""
    logs.mkdir(parents=True, exist_ok=True)
    log = logs / 'console.log'
    parameters = f'policy:={":".join(map(str, policies))}', f'port:={_free_port()}'
    process = start_process(
        log,
        tempfile.mkdtemp(prefix='ros-home-', dir=logs),
        'nodes.console',
        *('--ros-args', '-r', f'__ns:={NAMESPACE}'),
        *(word for parameter in parameters for word in ('-p', parameter)),
    )
    limit = time.monotonic() + MAX_PAGE_TIME
    try:
        while time.monotonic() < limit and process.poll() is None:
            if found := re.search(r'page: (http\S+)', log.read_text(errors='replace')):
                yield f'The flights on a page: {found[1]}'
                return
            time.sleep(0.1)
            look_for_interruption()
        said = log.read_text(errors='replace').splitlines() or ['it does not start']
        yield f'No page: {said[-1]}'
    finally:
        with undisturbed():
            end_processes([process])


def _free_port() -> int:
    """Return the console's own port; any other one, 0, where that is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(('127.0.0.1', DEFAULT_PORT))
        except OSError:
            return 0
    return DEFAULT_PORT
