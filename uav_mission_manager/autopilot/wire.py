"""A TCP connection and a serial device, for a thread to open and use."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import termios

import serial

OPENING_TIMEOUT = 5.0
"""Time [s] that a TCP peer has to answer: a choice."""

SILENT_PEER_TIMEOUT = 10.0
"""Time [s] after which a TCP connection whose peer confirms nothing is given up: a choice."""


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
