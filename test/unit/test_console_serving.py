"""Who gets the console's page."""

from __future__ import annotations

import asyncio
import socket

import pytest

from uav_mission_manager.console.serving import COOKIE, Gate, is_loopback, listening_socket

HERE = {'host': '127.0.0.1:8080'}


async def inside(scope, receive, send):
    await send({'type': 'http.response.start', 'status': 200, 'headers': []})
    await send({'type': 'http.response.body', 'body': b'page'})


def ask(headers, token='', query='', kind='http'):
    """Return what the gate sends, and its headers."""
    sent = []

    async def send(message):
        sent.append(message)

    scope = {
        'type': kind,
        'headers': [(key.encode(), value.encode()) for key, value in headers.items()],
        'query_string': query.encode(),
    }
    asyncio.run(Gate(inside, token)(scope, None, send))
    return sent[0], dict(sent[0].get('headers', ()))


@pytest.mark.parametrize('host', ['127.0.0.1:8080', 'localhost:8080', '[::1]:8080', '127.0.0.2'])
def test_this_machine_is_let_in(host):
    assert ask({'host': host})[0]['status'] == 200


@pytest.mark.parametrize(
    'headers',
    [
        {'host': 'evil.example'},
        {'host': 'evil.example:8080'},
        {'host': '127.0.0.1.evil.example'},
        {},
        {**HERE, 'origin': 'http://evil.example'},
        {**HERE, 'origin': 'null'},
    ],
)
@pytest.mark.parametrize('kind', ['http', 'websocket'])
def test_a_page_from_elsewhere_is_not(headers, kind):
    """By a name that leads here, or by a request of a browser that shows another page."""
    answer, _ = ask(headers, kind=kind)
    assert answer.get('status') == 403 or answer['type'] == 'websocket.close'


def test_the_own_page_may_open_its_socket():
    assert ask({**HERE, 'origin': 'http://127.0.0.1:8080'}, kind='websocket')[0]['status'] == 200


@pytest.mark.parametrize('cookie', ['', f'{COOKIE}=wrong', f'{COOKIE}=', 'other=secret'])
@pytest.mark.parametrize('query', ['', 'token=wrong', 'token='])
def test_without_the_token_nobody_is_let_in(cookie, query):
    assert ask({**HERE, 'cookie': cookie}, 'secret', query)[0]['status'] == 401


def test_the_token_is_exchanged_for_a_cookie_that_no_script_and_no_other_page_gets():
    answer, headers = ask(HERE, 'secret', 'token=secret')
    assert (answer['status'], headers[b'location']) == (303, b'/')
    cookie = headers[b'set-cookie'].decode()
    assert {'HttpOnly', 'SameSite=Strict'} <= set(cookie.split('; '))
    given = cookie.partition(';')[0]
    assert ask({'host': 'drone.example', 'cookie': f'a=b; {given}'}, 'secret')[0]['status'] == 200


@pytest.mark.parametrize('cookie', ['', f'{COOKIE}=wrong'])
def test_a_socket_needs_the_cookie(cookie):
    answer, _ = ask({**HERE, 'cookie': cookie}, 'secret', 'token=secret', 'websocket')
    assert answer['type'] == 'websocket.close'


@pytest.mark.parametrize(
    ('host', 'own'),
    [
        ('127.0.0.1', True),
        ('127.0.0.2', True),
        ('::1', True),
        ('localhost', True),
        ('0.0.0.0', False),
        ('::', False),
        ('192.168.1.2', False),
        ('localhost.evil.example', False),
    ],
)
def test_what_only_this_machine_reaches(host, own):
    assert is_loopback(host) == own


def test_a_port_in_use_is_named():
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=f'host 127.0.0.1, port {port}: Address already in use'):
            listening_socket('127.0.0.1', port)


def test_who_comes_before_the_server_has_begun_waits_for_it():
    with listening_socket('127.0.0.1', 0) as listener:
        socket.create_connection(listener.getsockname(), timeout=5).close()
