"""The page's server: in a thread of its own, for those who may see it."""

from __future__ import annotations

import hmac
import ipaddress
import logging
import socket
import threading
from typing import Any
from urllib.parse import parse_qs, urlsplit

import uvicorn
from fastapi import FastAPI
from nicegui import ui

from uav_mission_manager.console.fleet import Fleet
from uav_mission_manager.console.page import define_page
from uav_mission_manager.console.playback import Playback

PAGE_CLOSING_TIME = 0.5
"""Time [s] in which the server ends: a choice, within a node's time to end."""

COOKIE = 'console_token'
"""Name of the cookie that a browser shows instead of the token."""


def is_loopback(host: str) -> bool:
    """Whether an address is this machine's own, which nobody else reaches."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens. Raises `OSError` with the address and why it cannot."""
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()  # Who is told of the page may come before its server has begun.
    except OSError as error:
        listener.close()
        raise OSError(f'host {host}, port {port}: {error.strerror or error}') from error
    return listener


class Gate:
    """Lets those in who know the token, and no page that comes from elsewhere.

    Parameters
    ----------
    app : ASGI application
    token : str
        Empty where only this machine is served; the name by which it is asked for then counts.
    """

    def __init__(self, app: Any, token: str) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve, refuse, or exchange a token in the address for a cookie."""
        if scope['type'] not in ('http', 'websocket'):
            await self._app(scope, receive, send)
            return
        headers = {
            key.decode('latin-1'): value.decode('latin-1') for key, value in scope['headers']
        }
        query = parse_qs(scope['query_string'].decode('latin-1'))
        given = query.get('token', [''])[0]
        if not _from_here(headers, bool(self._token)):
            await _answer(scope, send, 403, 'asked for by another name or from another page')
        elif not self._token or self._known(_cookie(headers)):
            await self._app(scope, receive, send)
        elif self._known(given) and scope['type'] == 'http':
            cookie = f'{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/'
            await _answer(
                scope, send, 303, '', ((b'location', b'/'), (b'set-cookie', cookie.encode()))
            )
        else:
            await _answer(scope, send, 401, 'add ?token=TOKEN to the address')

    def _known(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _from_here(headers: dict[str, str], has_token: bool) -> bool:
    """Whether the browser asks by this machine's own name, and not for a page from elsewhere.

    Who knows the token may call the machine by any name.
    """
    host, origin = headers.get('host', ''), headers.get('origin', '')
    name = host if host.endswith(']') else host.rpartition(':')[0] or host
    if not has_token and not is_loopback(name.strip('[]')):
        return False
    return not origin or urlsplit(origin).netloc == host


def _cookie(headers: dict[str, str]) -> str:
    pairs = (part.strip().partition('=') for part in headers.get('cookie', '').split(';'))
    return next((value for name, _, value in pairs if name == COOKIE), '')


async def _answer(
    scope: Any, send: Any, status: int, text: str, more: tuple[tuple[bytes, bytes], ...] = ()
) -> None:
    if scope['type'] == 'websocket':
        await send({'type': 'websocket.close', 'code': 1008})
        return
    headers = [(b'content-type', b'text/plain; charset=utf-8'), *more]
    await send({'type': 'http.response.start', 'status': status, 'headers': headers})
    await send({'type': 'http.response.body', 'body': text.encode()})


class PageServer:
    """Serves the page in a thread until it is closed."""

    def __init__(
        self,
        fleet: Fleet,
        listener: socket.socket,
        token: str = '',
        playback: Playback | None = None,
    ) -> None:
        app = FastAPI(openapi_url=None)
        define_page(fleet, playback)
        ui.run_with(app, show_welcome_message=False, tailwind=False, reconnect_timeout=10.0)
        logging.getLogger('nicegui').setLevel(logging.WARNING)
        config = uvicorn.Config(Gate(app, token), log_level='warning', lifespan='on')
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listener],), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread: one that still serves while the interpreter ends can crash it."""
        # That those who look at the page are left at once is no error.
        logging.getLogger('uvicorn.error').setLevel(logging.CRITICAL)
        self._server.should_exit = self._server.force_exit = True
        self._thread.join(PAGE_CLOSING_TIME)
