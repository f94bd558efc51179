"""A node's process ends on SIGINT, SIGTERM or SIGHUP within a second, whatever it is doing."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from importlib.util import find_spec

NODES = (
    *('manager', 'base_station', 'fleet', 'mavlink_bridge', 'solver'),
    *('mission_record', 'console'),
)
"""Commands of this package that are nodes."""

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a node to end: Ctrl-C, a service manager, a terminal that was closed."""

ORDERLY_TIME = 0.7
"""Time [s] that a running node has to close what it has open: a choice, within a second."""


def node_run() -> str:
    """Return which node this process was started as, by its command or `python -m`; '' is none."""
    program = sys.argv[0] if sys.argv else ''
    if program == '-m':  # While Python looks for the module.
        program = sys.orig_argv[sys.orig_argv.index('-m') + 1].rpartition('.')[2]
    name = os.path.basename(program)
    return name if name in NODES else ''


def need_ros(command: str) -> None:
    """End the command in one line where there is no ROS 2 to import."""
    if find_spec('rclpy') is None:
        sys.exit(
            f"{command}: ROS 2 is not there: source its setup.bash, or pip install '.[ros]' where "
            'this package is from'
        )


class Ending:
    """Watches for the signals that end this process; there is one, `ENDING`.

    Python handles a signal between two steps of the main thread, which may be a minute apart in
    a long calculation. So a thread ends the process if the main thread does not.

    Attributes
    ----------
    begun : bool
        Whether a signal has come. The main thread is to end by itself then.
    orderly : bool
        Whether to give it time to do so. While a node starts there is nothing to close.
    """

    def __init__(self) -> None:
        self.begun = self.orderly = False
        self._watched = False

    def watch(self) -> None:
        """Begin to watch, in the main thread; a second call changes nothing."""
        if self._watched:
            return
        self._watched = True
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in ENDING_SIGNALS:
            # `nohup` asks to outlive the terminal.
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._on_signal)
        threading.Thread(target=self._end, args=(reader,), daemon=True).start()

    @staticmethod
    def close() -> None:
        """Ignore further signals: what is left of the process ends by itself."""
        for number in ENDING_SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def _on_signal(self, *_: object) -> None:
        self.begun = True

    def _end(self, reader: int) -> None:
        while os.read(reader, 1)[0] not in ENDING_SIGNALS:
            pass
        self.begun = True
        if self.orderly:
            time.sleep(ORDERLY_TIME)
        os._exit(0)


ENDING = Ending()
"""How this process ends."""
