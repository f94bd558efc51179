"""Ports over real sockets and pseudo-terminals: they wait, say what is wrong, share nothing."""

from __future__ import annotations

import os
import pty
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink import mavutil

from uav_mission_manager.autopilot import threaded_port
from uav_mission_manager.autopilot.port import MAX_UDP_PEERS, open_port
from uav_mission_manager.autopilot.threaded_port import (
    CLOSING_TIME,
    FIRST_TRY_TIME,
    MAX_CHUNKS,
    ThreadedPort,
)


@pytest.fixture
def open_it() -> Iterator[Callable[[str], Any]]:
    ports = []

    def build(connection: str) -> Any:
        ports.append(open_port(connection))
        return ports[-1]

    yield build
    for port in ports:
        port.close()


@pytest.fixture
def soon(monkeypatch):
    monkeypatch.setattr(threaded_port, 'REOPEN_PERIOD', 0.05)


def until(value: Callable[[], Any]) -> Any:
    """Wait for something true, and return it."""
    end = time.monotonic() + 20.0
    while not (found := value()):
        assert time.monotonic() < end
        time.sleep(0.005)
    return found


def bound(kind: int = socket.SOCK_DGRAM, port: int = 0) -> socket.socket:
    found = socket.socket(socket.AF_INET, kind)
    if kind == socket.SOCK_STREAM:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    found.bind(('127.0.0.1', port))
    found.settimeout(20.0)
    return found


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with bound(kind) as probe:
        return probe.getsockname()[1]


@pytest.mark.parametrize(
    ('connection', 'why'),
    [
        ('', 'none of udpin:'),
        ('nonsense', 'none of udpin:'),
        ('ftp:127.0.0.1:14550', 'none of udpin:'),
        ('udpin:127.0.0.1:99999', 'port 99999 is not one of 1 to 65535'),
        ('udpin:127.0.0.1:0', 'port 0 is not'),
        ('tcp:127.0.0.1:' + '9' * 5000, 'is not one of 1 to 65535'),
        ('tcp:127.0.0.1:-1', 'not of the form PROTOCOL:HOST:PORT'),
        ('tcp::5760', 'not of the form'),
        ('udpin:14550', 'not of the form'),
        ('udpout:a:b:14550', 'not of the form'),
        ('tcpin:127.0.0.1', 'not of the form'),
        ('udpin:192.0.2.1:14550', 'assign'),
        ('mcast:x', 'invalid literal'),
        ('/tmp/nothing/there', 'no such device'),
        ('/dev/ttyACM0,fast', "'fast' is not a baud rate"),
        ('/dev/null', 'ioctl'),
        ('/etc/passwd', 'not a serial device'),
        ('udpin:drone:14550', 'drone is not an address of this machine in numbers'),
        ('tcpin:drone:14550', 'drone is not an address'),
    ],
)
def test_what_can_never_work_is_refused_in_one_line(connection, why, capfd):
    with pytest.raises(ValueError, match='MAVLink connection') as caught:
        open_port(connection)
    assert why in str(caught.value)
    assert '\n' not in str(caught.value)
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize('connection', ['udpin:127.0.0.1:{}', '127.0.0.1:{}', 'udpin:0.0.0.0:{}'])
def test_a_port_has_one_listener(open_it, connection):
    port = free_port()
    open_it(f'udpin:127.0.0.1:{port}')
    with pytest.raises(ValueError, match=f'another program listens on .*:{port}$'):
        open_port(connection.format(port))


def test_nor_shares_it_with_a_listener_that_would_share(open_it):
    port = free_port()
    other = mavutil.mavlink_connection(f'udpin:127.0.0.1:{port}')
    with pytest.raises(ValueError, match=f'another program listens on 127.0.0.1:{port}'):
        open_port(f'udpin:127.0.0.1:{port}')
    other.close()
    open_it(f'udpin:127.0.0.1:{port}')
    with pytest.raises(OSError, match='in use'):
        mavutil.mavlink_connection(f'udpin:127.0.0.1:{port}')


def test_udp_sends_to_all_or_to_one_and_says_who_sent(open_it):
    number = free_port()
    port = open_it(f'udpin:127.0.0.1:{number}')
    first, second = bound(), bound()
    for peer in (first, second):
        peer.sendto(b'', ('127.0.0.1', number))
        peer.sendto(b'hello', ('127.0.0.1', number))
        assert until(lambda: port.recv(100)) == b'hello'
        assert port.last_address == peer.getsockname()
    port.write(b'all')
    port.write_to(b'one', second.getsockname())
    port.write(b'end')
    assert [first.recv(9), first.recv(9)] == [b'all', b'end']
    assert [second.recv(9), second.recv(9), second.recv(9)] == [b'all', b'one', b'end']
    first.close()
    second.close()


def test_a_flood_of_addresses_costs_no_memory(open_it):
    number = free_port()
    port = open_it(f'udpin:127.0.0.1:{number}')
    for _ in range(3 * MAX_UDP_PEERS):
        with bound() as peer:
            peer.sendto(b'x', ('127.0.0.1', number))
        until(lambda: port.recv(100))
    assert len(port._peers) == MAX_UDP_PEERS


@pytest.mark.parametrize('host', ['127.0.0.1', 'localhost'])
def test_udpout_speaks_first(open_it, host):
    peer = bound()
    port = open_it(f'udpout:{host}:{peer.getsockname()[1]}')
    peer.settimeout(0.01)

    def answered() -> bytes:
        port.write(b'hello')
        try:
            data, address = peer.recvfrom(100)
        except TimeoutError:
            return b''
        peer.sendto(b'answer', address)
        return data

    assert until(answered) == b'hello'
    assert until(lambda: port.recv(100)) == b'answer'
    peer.close()


def test_an_unknown_host_is_said_and_looked_for_again(open_it, soon, monkeypatch):
    def unknown(*_):
        raise socket.gaierror(-2, 'Name or service not known')

    real = socket.getaddrinfo
    monkeypatch.setattr(socket, 'getaddrinfo', unknown)
    peer = bound()
    port = open_it(f'udpout:drone:{peer.getsockname()[1]}')
    until(lambda: 'drone: Name or service not known; tried again' in port.error)
    monkeypatch.setattr(socket, 'getaddrinfo', lambda _, *other: real('127.0.0.1', *other))

    def sent() -> bool:
        port.write(b'hello')
        return not port.error

    until(sent)
    assert peer.recv(9) == b'hello'
    peer.close()


def test_what_is_no_name_is_said(open_it):
    port = open_it('tcp:' + 'a' * 70 + ':5760')
    assert 'tried again' in until(lambda: port.recv(100) or port.error)


def test_a_tcp_peer_is_waited_for_and_found_again(open_it, soon, capfd):
    number = free_port(socket.SOCK_STREAM)
    port = open_it(f'tcp:127.0.0.1:{number}')
    until(lambda: port.recv(100) or port.error)
    refused = f'tcp:127.0.0.1:{number}: Connection refused; tried again every 0 s'
    errors = {port.error}
    time.sleep(0.2)
    port.write(b'nobody hears')
    errors.add(port.error)
    assert errors == {refused}
    for _ in range(2):
        with bound(socket.SOCK_STREAM, number) as server:
            server.listen()
            peer, _ = server.accept()
        peer.settimeout(20.0)
        peer.sendall(b'hello')
        assert until(lambda: port.recv(100)) == b'hello'
        assert port.error == ''
        port.write(b'answer')
        assert peer.recv(100) == b'answer'
        peer.close()
        until(lambda: port.recv(100) or 'closed by the peer' in port.error)
    assert capfd.readouterr() == ('', '')


def test_opening_waits_for_nobody(open_it, monkeypatch):
    started = time.monotonic()

    def nobody(*_):
        time.sleep(3.0)
        raise TimeoutError('timed out')

    monkeypatch.setattr(socket, 'create_connection', nobody)
    port = open_it('tcp:127.0.0.1:5760')
    assert port.recv(100) == b''
    port.close()
    assert time.monotonic() - started < 2.0


def test_a_tcp_peer_that_takes_nothing_does_not_block(open_it):
    server = bound(socket.SOCK_STREAM)
    server.listen()
    port = open_it(f'tcp:127.0.0.1:{server.getsockname()[1]}')
    peer, _ = server.accept()
    peer.sendall(b'hello')
    assert until(lambda: port.recv(100)) == b'hello'
    for _ in range(2000):
        port.write(bytes(10000))
    assert port.error == ''
    peer.close()
    server.close()


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


@pytest.mark.parametrize('name', ['usb-x:1.0-port0', 'pci-0000:00:14.0-usb', 'plain', 'a,b'])
@pytest.mark.parametrize('baud', ['', ',57600'])
def test_a_serial_device_whatever_its_path(open_it, terminal, tmp_path, name, baud):
    ours, device = terminal
    (tmp_path / name).symlink_to(device)
    port = open_it(f'{tmp_path / name}{baud}')
    os.write(ours, b'hello')
    assert until(lambda: port.recv(100)) == b'hello'
    port.write(b'answer')
    assert os.read(ours, 100) == b'answer'
    with pytest.raises(ValueError, match='another program has it open'):
        open_port(device)


def test_a_serial_device_that_is_not_there_is_waited_for(open_it):
    port = open_it('/dev/serial/by-id/usb-x:1.0-port0')
    missing = '/dev/serial/by-id/usb-x:1.0-port0: No such file or directory'
    assert port.error == f'{missing}; tried again every 2 s'
    assert port.recv(100) == b''
    port.write(b'nobody hears')


def test_a_serial_device_is_found_again(open_it, soon, terminal, tmp_path):
    ours, theirs = pty.openpty()
    device = tmp_path / 'usb-x:1.0-port0'
    device.symlink_to(os.ttyname(theirs))
    port = open_it(str(device))
    os.close(theirs)
    os.close(ours)
    until(lambda: port.recv(100) or port.error)
    assert 'tried again' in port.error
    device.unlink()
    until(lambda: port.recv(100) or 'No such file' in port.error)
    device.symlink_to(terminal[1])

    def heard() -> bytes:
        os.write(terminal[0], b'.')  # What is there before it is opened is thrown away.
        return port.recv(1)

    assert b'.' in until(heard)
    assert port.error == ''


def test_a_serial_device_that_takes_nothing_does_not_block(open_it, terminal):
    port = open_it(terminal[1])
    started = time.monotonic()
    for _ in range(200):
        port.write(bytes(1000))
    port.close()
    assert time.monotonic() - started < 5.0


@pytest.mark.parametrize('protocol', ['udpbcast', 'tcpin', 'mcast'])
def test_other_kinds_are_pymavlinks(open_it, protocol):
    port = open_it(
        f'{protocol}:{"239.255.145.50" if protocol == "mcast" else "127.0.0.1"}:{free_port()}'
    )
    assert port.recv(100) == b''
    assert port.error == ''


def test_a_pipe_is_no_serial_device(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(ValueError, match='not a serial device'):
        open_port(str(tmp_path / 'pipe'))


# Wires that wait for ever


class StuckWire:
    """A wire each of whose calls, or one of them, waits until the test is over."""

    def __init__(self, over: threading.Event, stuck: str) -> None:
        self._over, self._stuck = over, stuck
        self.closed = False
        self._call('open')

    def _call(self, name: str) -> None:
        if self._stuck == name:
            self._over.wait(60.0)

    def recv(self, size: int) -> bytes:
        self._call('recv')
        return b'.'

    def write(self, data: bytes) -> None:
        self._call('write')

    def close(self) -> None:
        self._call('close')
        self.closed = True


@pytest.mark.parametrize('at_once', [False, True])
@pytest.mark.parametrize('stuck', ['open', 'recv', 'write', 'close'])
def test_whatever_waits_for_ever_nobody_waits_for_it(stuck, at_once):
    over = threading.Event()
    started = time.monotonic()
    port = ThreadedPort('stuck', lambda: StuckWire(over, stuck), at_once=at_once)
    for _ in range(2000):
        port.write(bytes(100))
        port.recv(100)
    if stuck == 'open' and at_once:
        assert port.error == 'stuck: does not open'
    if stuck in ('write', 'close'):
        assert until(lambda: port.recv(100)) == b'.'
    port.close()
    over.set()
    assert time.monotonic() - started < FIRST_TRY_TIME + CLOSING_TIME + 1.0


class TakenWire:
    """A wire that nothing comes from, and that takes data only while it is `free`."""

    def __init__(self) -> None:
        self.free = threading.Event()
        self.taken: list[bytes] = []

    def recv(self, size: int) -> bytes:
        return b''

    def write(self, data: bytes) -> None:
        self.free.wait(20.0)
        self.taken.append(data)

    def close(self) -> None:
        pass


def test_what_a_wire_did_not_take_in_time_is_never_sent(monkeypatch):
    monkeypatch.setattr(threaded_port, 'MAX_SENDING_DELAY', 0.2)
    wire = TakenWire()
    port = ThreadedPort('slow', lambda: wire, at_once=True)
    until(lambda: port._wire)
    port.write(b'taken')
    until(lambda: not port._waiting)
    port.write(b'old')
    time.sleep(0.3)
    wire.free.set()
    until(lambda: not port._waiting)
    port.write(b'new')
    until(lambda: len(wire.taken) == 2)
    assert wire.taken == [b'taken', b'new']
    port.close()


def test_what_nobody_reads_fills_no_memory():
    port = ThreadedPort('flood', lambda: StuckWire(threading.Event(), ''))
    until(lambda: len(port._arrived) == MAX_CHUNKS)
    time.sleep(0.1)
    assert len(port._arrived) == MAX_CHUNKS
    port.close()


def test_a_wire_is_closed_before_close_returns():
    wires = []

    def open_wire() -> StuckWire:
        wires.append(StuckWire(threading.Event(), ''))
        return wires[-1]

    port = ThreadedPort('quick', open_wire)
    until(lambda: port.recv(100))
    port.close()
    assert [wire.closed for wire in wires] == [True]
