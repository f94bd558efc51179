"""A port whose wire is opened, read and written by a thread: whatever waits, waits there."""

from __future__ import annotations

import contextlib
import errno
import termios
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

REOPEN_PERIOD = 2.0
"""Time [s] between two tries to open what is not there: a choice."""

FIRST_TRY_TIME = 1.0
"""Time [s] that the first try to open has, where its caller wants to know how it ends: a choice.
What takes longer may still open."""

IO_PERIOD = 0.01
"""Time [s] between two looks at a wire on which nothing comes: a choice, five looks in each of the
bridge's."""

MAX_CHUNKS = 200
"""Pieces of data that wait for the reader, or for the wire, at most: a choice, a hundred times
what a look of the bridge brings."""

PORT_READ_BYTES = 4096
"""Bytes of a read, at most. A choice; a MAVLink 2 message has no more than 280."""

MAX_SENDING_DELAY = 1.0
"""Time [s] after which what a wire did not take is out of date, and never sent: a choice, after
which a command is repeated."""

MAX_BACKLOG_TIME = 1.0
"""Time [s] in which a peer sends on what it had to keep back while nobody read: a choice. At
1 MB/s this is a megabyte, minutes of what is asked for."""

CLOSING_TIME = 0.3
"""Time [s] that a wire has to close, for whoever opens it next: a choice, well within the second
in which a node ends."""

PORT_ERRORS = (OSError, ValueError, OverflowError, ImportError, SystemExit, termios.error)
"""What a wire raises that cannot be opened or is lost; a ValueError is a name that cannot be
one."""


class ThreadedPort:
    """A wire of `recv(size)`, `write(data)` and `close()`, opened again when it is lost.

    No call waits, however long the wire does; only `close` gives it a moment.

    Parameters
    ----------
    name : str
        What it is called when something is wrong.
    open_wire : callable
        Opens it; it and the wire may raise `PORT_ERRORS`.
    at_once : bool
        Raise what is wrong with the first try, if that is soon known; only what is not there yet
        is waited for.

    Attributes
    ----------
    last_address : object
        Whence the last data came, None where the wire does not say.
    """

    backlog_time = MAX_BACKLOG_TIME

    def __init__(self, name: str, open_wire: Callable[[], Any], *, at_once: bool = False) -> None:
        self._name, self._open = name, open_wire
        self._wire: Any = None
        self._error = ''
        self._not_opened: BaseException | None = None
        self._arrived: deque[tuple[bytes, Any]] = deque()
        self._waiting: deque[tuple[float, bytes, Any]] = deque(maxlen=MAX_CHUNKS)
        self._tried, self._ended = threading.Event(), threading.Event()
        self.last_address: Any = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        if at_once and not self._tried.wait(FIRST_TRY_TIME):
            self._error = f'{name}: does not open'
        why = self._not_opened
        if at_once and why is not None and getattr(why, 'errno', None) != errno.ENOENT:
            self.close()
            raise why

    @property
    def error(self) -> str:
        """What is wrong, '' if nothing is."""
        return self._error or getattr(self._wire, 'error', '')

    def recv(self, size: int) -> bytes:
        """Return what has arrived in one piece, b'' if nothing has or nothing is open."""
        if not self._arrived:
            return b''
        data, self.last_address = self._arrived.popleft()
        return data

    def write(self, data: bytes) -> None:
        """Send, if it is open and takes it in time."""
        self.write_to(data, None)

    def write_to(self, data: bytes, address: Any) -> None:
        """Send to one address, where the wire knows several."""
        if self._wire is not None:
            self._waiting.append((time.monotonic(), data, address))

    def close(self) -> None:
        """Close it, and stop trying to open it."""
        self._ended.set()
        self._thread.join(CLOSING_TIME)

    def _run(self) -> None:
        pause = 0.0
        while not self._ended.wait(pause):
            pause, wire = REOPEN_PERIOD, None
            try:
                wire = self._open()
                if self._not_opened is not None or not self._tried.is_set():
                    self._error = ''  # Else not yet: a peer may open only to close again.
                self._not_opened = None
                self._tried.set()
                self._serve(wire)
            except PORT_ERRORS as error:
                self._not_opened = error if wire is None else None
                why = getattr(error, 'strerror', None) or error
                self._error = f'{self._name}: {why}; tried again every {REOPEN_PERIOD:.0f} s'
                self._tried.set()
            self._wire = None
            if wire is not None:
                with contextlib.suppress(*PORT_ERRORS):
                    wire.close()

    def _serve(self, wire: Any) -> None:
        self._waiting.clear()
        self._wire = wire
        while not self._ended.is_set():
            data = wire.recv(PORT_READ_BYTES) if len(self._arrived) < MAX_CHUNKS else b''
            if data:
                self._error = ''
                self._arrived.append((bytes(data), getattr(wire, 'last_address', None)))
            self._send_waiting(wire)
            if not data:
                self._ended.wait(IO_PERIOD)

    def _send_waiting(self, wire: Any) -> None:
        while self._waiting:
            since, data, address = self._waiting.popleft()
            if time.monotonic() - since > MAX_SENDING_DELAY:
                continue
            if address is not None and hasattr(wire, 'write_to'):
                wire.write_to(data, address)
            else:
                wire.write(data)
