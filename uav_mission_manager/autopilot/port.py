"""Where MAVLink comes in and goes out: UDP, TCP, a serial device; never blocking, never printing.

pymavlink's own UDP, TCP and serial ports sleep and print when a peer is gone, let two programs
listen on one port and do not say who sent what. Its others are used as they are. A UDP socket with
a numeric address cannot wait; all else, the search for a name too, is left to a thread.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
import stat
import time
from collections.abc import Iterator
from typing import Any

from uav_mission_manager.autopilot.threaded_port import PORT_ERRORS, PORT_READ_BYTES, ThreadedPort
from uav_mission_manager.autopilot.wire import SerialWire, TcpWire
from uav_mission_manager.echo import quoted

MAX_PORT_READS = 200
"""Reads from a port at a time, at most, so that this ends however much arrives. A choice: at 20
looks a second 4,000 datagrams a second, a hundred times more than the bridge asks for."""

UDP_PEER_TIMEOUT = 10.0
"""Time [s] after which a silent UDP peer is forgotten: a choice."""

MAX_UDP_PEERS = 16
"""How many UDP peers hear what is sent to all: a choice, so that forged addresses do no harm."""

LOOPBACK = '127.0.0.1'
"""The address of `localhost`; nobody has to search for it."""

DEFAULT_BAUD_RATE = 115200
"""Symbols a second of a serial device, where none are given: pymavlink's default."""

PYMAVLINK_PROTOCOLS = ('tcpin', 'udpbcast', 'mcast')
"""Kinds of connection that pymavlink's own port serves."""

PROTOCOLS = ('udpin', 'udp', 'udpout', 'tcp', *PYMAVLINK_PROTOCOLS)
"""Kinds of connection, besides a serial device's path."""


def read_port(port: Any) -> Iterator[bytes]:
    """Yield what has arrived at a pymavlink port, up to `MAX_PORT_READS` times."""
    for _ in range(MAX_PORT_READS):
        data = port.recv(PORT_READ_BYTES)
        if not data:
            return
        yield data


def open_port(connection: str) -> Any:
    """Open a pymavlink connection string, or begin to.

    Returns
    -------
    object
        With `recv(size)`, `write(data)` and `close()`, none of which waits; `last_address`, whence
        the last data came; `error`, what is wrong, else ''.

    Raises
    ------
    ValueError
        It can never work; says which connection and why in one line.
    """
    if _numeric(connection.partition(':')[0]):
        connection = f'udpin:{connection}'  # pymavlink's short form.
    try:
        return _open(connection)
    except PORT_ERRORS as error:
        why: Any = error
        if isinstance(error, OSError):
            taken = f'another program listens on {connection.partition(":")[2]}'
            why = taken if error.errno == errno.EADDRINUSE else error.strerror or error
        raise ValueError(f'MAVLink connection {quoted(connection)}: {why}') from error


def _open(connection: str) -> Any:
    protocol, colon, rest = connection.partition(':')
    if connection.startswith('/'):
        return _serial_port(connection)
    if not colon or protocol not in PROTOCOLS:
        known = ', '.join(f'{name}:' for name in PROTOCOLS)
        raise ValueError(f'none of {known} nor the path of a serial device')
    if protocol == 'mcast':
        return _pymavlink_port(connection)
    listens = protocol in ('udpin', 'udp', 'tcpin')
    address = _host_and_port(rest, anywhere=listens)
    if listens and address[0] and not _numeric(address[0]):
        raise ValueError(f'{address[0]} is not an address of this machine in numbers')
    if protocol in ('udpin', 'udp'):
        return UdpPort(listen=address)
    if protocol == 'udpout' and _numeric(address[0]):
        return UdpPort(destination=address)
    if protocol == 'udpout':
        return ThreadedPort(address[0], lambda: UdpPort(destination=_resolve(address)))
    if protocol == 'tcp':
        return ThreadedPort(connection, lambda: TcpWire(address))
    return _pymavlink_port(connection)


def _pymavlink_port(connection: str) -> ThreadedPort:
    def opened() -> Any:
        from pymavlink import mavutil  # It takes a tenth of the bridge's start, and few need it.

        return mavutil.mavlink_connection(connection)

    return ThreadedPort(connection, opened, at_once=True)


def _numeric(host: str) -> bool:
    """Whether an address needs no search: numbers, or this machine itself."""
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        return host == 'localhost'
    return True


def _host_and_port(text: str, *, anywhere: bool) -> tuple[str, int]:
    host, _, port = text.partition(':')
    if not (host or anywhere) or not (port.isascii() and port.isdigit()):
        raise ValueError('not of the form PROTOCOL:HOST:PORT')
    if not 1 <= int(port[:6]) <= 65535:
        raise ValueError(f'port {port} is not one of 1 to 65535')
    return LOOPBACK if host == 'localhost' else host, int(port)


def _serial_port(connection: str) -> ThreadedPort:
    device, baud = connection, str(DEFAULT_BAUD_RATE)
    if ',' in connection and not os.path.exists(connection):
        device, _, baud = connection.rpartition(',')
    if not (baud.isascii() and baud.isdigit() and int(baud[:9]) > 0):
        raise ValueError(f'{quoted(baud)} is not a baud rate')
    if not device.startswith('/dev/') and not os.path.exists(device):
        raise ValueError('no such device')
    if os.path.exists(device) and not stat.S_ISCHR(os.stat(device).st_mode):
        raise ValueError('not a serial device')
    return ThreadedPort(device, lambda: SerialWire(device, int(baud)), at_once=True)


class UdpPort:
    """A UDP socket of its own: no other program can listen on its port.

    Parameters
    ----------
    listen, destination : tuple of str and int
        Where it listens, or where it sends to from the start: one of the two, in numbers.
    """

    def __init__(
        self,
        *,
        listen: tuple[str, int] | None = None,
        destination: tuple[str, int] | None = None,
    ) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peers: dict[Any, float] = {}
        self.error = ''  # What is wrong, '' if nothing is.
        self.last_address: Any = None
        self._destination = destination
        if listen is not None:
            try:
                self._socket.bind(listen)
            except OSError:
                self._socket.close()
                raise

    def recv(self, size: int) -> bytes:
        """Return a datagram, b'' if there is none."""
        for _ in range(MAX_PORT_READS):
            try:
                data, self.last_address = self._socket.recvfrom(max(size, PORT_READ_BYTES))
            except BlockingIOError:
                break
            self._remember(self.last_address)
            if data:
                return data
        return b''

    def write(self, data: bytes) -> None:
        """Send to all peers."""
        if self._destination is not None:
            self.write_to(data, self._destination)
            return
        now = time.monotonic()
        self._peers = {
            peer: heard for peer, heard in self._peers.items() if now - heard <= UDP_PEER_TIMEOUT
        }
        for peer in self._peers:
            self.write_to(data, peer)

    def write_to(self, data: bytes, address: Any) -> None:
        """Send to one address."""
        try:
            self._socket.sendto(data, address)
            self.error = ''
        except BlockingIOError:
            pass
        except OSError as error:
            self.error = f'{address[0]}: {error.strerror or error}'

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _remember(self, peer: Any) -> None:
        self._peers[peer] = time.monotonic()
        if len(self._peers) > MAX_UDP_PEERS:
            del self._peers[min(self._peers, key=self._peers.__getitem__)]


def _resolve(address: tuple[str, int]) -> Any:
    return socket.getaddrinfo(*address, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
