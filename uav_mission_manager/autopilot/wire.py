"""A TCP connection or a serial device, opened in a thread and again when it is lost."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import termios
import threading
from collections.abc import Callable
from typing import Any

import serial

REOPEN_PERIOD = 2.0
"""Time [s] between two tries to open what is not there: a choice."""

OPENING_TIMEOUT = 5.0
"""Time [s] that a TCP peer has to answer: a choice."""

SILENT_PEER_TIMEOUT = 10.0
"""Time [s] after which a TCP connection whose peer confirms nothing is given up: a choice."""

MAX_BACKLOG_TIME = 1.0
"""Time [s] in which a peer sends on what it had to keep back while nobody read: a choice. At
1 MB/s this is a megabyte, minutes of what is asked for."""


class Attempts:
    """Tries in a thread, again and again, until something opens; then hands it over."""

    def __init__(self, name: str, action: Callable[[], Any], pause: float = 0.0) -> None:
        self._name, self._action = name, action
        self._lock, self._ended = threading.Lock(), threading.Event()
        self.result: Any = None
        self.error = ''
        threading.Thread(target=self._run, args=(pause,), daemon=True).start()

    def end(self) -> None:
        """Close what has opened, or what may still open."""
        with self._lock:
            self._ended.set()
            if hasattr(self.result, 'close'):
                self.result.close()

    def _run(self, pause: float) -> None:
        while not self._ended.wait(pause):
            pause = REOPEN_PERIOD
            try:
                result = self._action()
            except (OSError, ValueError) as error:  # A ValueError is a name that cannot be one.
                self.error = retried(self._name, error)
                continue
            with self._lock:
                if not self._ended.is_set():
                    self.result = result
                elif hasattr(result, 'close'):
                    result.close()
            return


def retried(name: str, error: Exception) -> str:
    """Return what is wrong with a port that is tried again."""
    why = getattr(error, 'strerror', None) or error
    return f'{name}: {why}; tried again every {REOPEN_PERIOD:.0f} s'


class TcpWire:
    """A TCP connection; it raises OSError when it is lost."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.create_connection(address, OPENING_TIMEOUT)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        silence = round(1000 * SILENT_PEER_TIMEOUT)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, silence)

    def recv(self, size: int) -> bytes:
        """Return what has arrived, b'' if nothing has."""
        try:
            data = self._socket.recv(size)
        except BlockingIOError:
            return b''
        if not data:
            raise ConnectionError('closed by the peer')
        return data

    def write(self, data: bytes) -> None:
        """Send what the connection takes now."""
        with contextlib.suppress(BlockingIOError):
            self._socket.send(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class SerialWire:
    """A serial device that no other program has open; it raises OSError when it is lost."""

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._serial = serial.Serial(device, baud, timeout=0, exclusive=True)
        except serial.SerialException as error:
            if error.errno is None:
                raise
            busy = error.errno in (errno.EAGAIN, errno.EBUSY)
            why = 'another program has it open' if busy else os.strerror(error.errno)
            raise OSError(error.errno, why) from None

    def recv(self, size: int) -> bytes:
        """Return what has arrived, b'' if nothing has."""
        return bytes(self._serial.read(size))

    def write(self, data: bytes) -> None:
        """Send what the device takes now."""
        with contextlib.suppress(BlockingIOError):  # pyserial's own would wait, or spin.
            os.write(self._serial.fileno(), data)

    def close(self) -> None:
        """Close the device, without waiting for what it has not sent."""
        with contextlib.suppress(OSError, termios.error):
            self._serial.reset_output_buffer()
        self._serial.close()


class ReopenedPort:
    """A wire that is opened in a thread, and again when it is lost.

    Parameters
    ----------
    name : str
        What it is called when something is wrong.
    open_wire : callable
        Opens it; raises OSError.
    at_once : bool
        Try once in the caller's thread; only what is not there yet is waited for.
    """

    last_address = None
    backlog_time = MAX_BACKLOG_TIME

    def __init__(self, name: str, open_wire: Callable[[], Any], *, at_once: bool = False) -> None:
        self._name, self._open = name, open_wire
        self._wire: Any = None
        self._attempts: Attempts | None = None
        self.error = ''
        if at_once:
            try:
                self._wire = open_wire()
            except OSError as error:
                if error.errno != errno.ENOENT:
                    raise
                self._lose(error)
        else:
            self._attempts = Attempts(name, open_wire)

    def recv(self, size: int) -> bytes:
        """Return what has arrived, b'' if nothing has or nothing is open."""
        return self._do(lambda wire: wire.recv(size)) or b''

    def write(self, data: bytes) -> None:
        """Send, if it is open."""
        self._do(lambda wire: wire.write(data))

    def close(self) -> None:
        """Close it, and stop trying to open it."""
        if self._attempts is not None:
            self._attempts.end()
        if self._wire is not None:
            self._wire.close()

    def _do(self, action: Callable[[Any], Any]) -> Any:
        if self._attempts is not None:
            if self._attempts.result is None:
                self.error = self._attempts.error or self.error
                return None
            if self._attempts.error:
                self.error = ''
            self._wire, self._attempts = self._attempts.result, None
        try:
            result = action(self._wire)
        except OSError as error:
            self._lose(error)
            return None
        if result:
            self.error = ''  # Not before: a peer may open only to close again.
        return result

    def _lose(self, error: OSError) -> None:
        if self._wire is not None:
            self._wire.close()
        self._wire, self.error = None, retried(self._name, error)
        self._attempts = Attempts(self._name, self._open, REOPEN_PERIOD)
