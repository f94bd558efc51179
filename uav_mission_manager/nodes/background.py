"""Work that would hold up a node: in a thread or in a process of its own."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import suppress
from types import coroutine
from typing import Any

from rclpy.node import Node
from rclpy.task import Future

PR_SET_PDEATHSIG = 1
"""Send a signal to this process when its parent dies: linux/prctl.h."""

UNDOING_TIME = 0.4
"""Time [s] that a child has to undo what it has begun: a choice, within a node's time to end."""


class SupersededError(Exception):
    """A later request has taken the place of this one."""


def in_thread(node: Node, work: Callable[[], Any]) -> Future:
    """Run `work` in a thread; await its result in a callback of the node.

    While a callback waits, others of its group do so too, unless the group is reentrant.
    """
    executor: Any = node.executor
    future = Future(executor=executor)

    def run() -> None:
        try:
            future.set_result(work())
        except Exception as error:
            future.set_exception(error)
        with suppress(Exception):  # The node may have ended meanwhile.
            executor.wake()

    threading.Thread(target=run, daemon=True).start()
    return future


class LatestOnly:
    """Runs one work at a time in a thread; of those that wait for it, the latest."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._latest = 0
        self._busy = False

    async def run(self, work: Callable[[], Any]) -> Any:
        """Return what `work` returns.

        Raises
        ------
        SupersededError
            If this was asked for again meanwhile.
        Exception
            What `work` raises.
        """
        self._latest += 1
        number = self._latest
        await self._turn(number)
        if number != self._latest:
            raise SupersededError('a later request took its place')
        self._busy = True
        try:
            result = await in_thread(self._node, work)
        finally:
            self._busy = False
        if number != self._latest:
            raise SupersededError('a later request took its place')
        return result

    @coroutine
    def _turn(self, number: int) -> Generator[None, None, None]:
        """Wait until nothing runs, or a later request is there; the executor looks again."""
        while self._busy and number == self._latest:
            yield


def dying_with_parent() -> Callable[[], None]:
    """Return a `preexec_fn` with which a process dies with this one, however this one ends.

    Start the process in the main thread: Linux takes the end of the thread for that of this one.
    """
    library, parent = ctypes.CDLL(None), os.getpid()

    def prepare() -> None:
        library.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)

    return prepare


class Child:
    """A module of this package as a process of its own, which dies with this one.

    Make it in the main thread, see `dying_with_parent`.
    """

    def __init__(self, module: str, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, '-m', f'uav_mission_manager.{module}', *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors='replace',
            preexec_fn=dying_with_parent(),
        )

    def output(self) -> str:
        """Return what it has printed at its end.

        Raises
        ------
        RuntimeError
            If it has failed: the last line that it says why.
        """
        printed, said = self._process.communicate()
        code = self._process.returncode
        if code < 0:
            raise RuntimeError(f'ended by {signal.Signals(-code).name}')
        if code:
            raise RuntimeError((said.splitlines() or [f'ended with exit code {code}'])[-1])
        return printed

    def end(self) -> None:
        """End it within `UNDOING_TIME`."""
        with suppress(subprocess.TimeoutExpired):
            self._process.send_signal(signal.SIGINT)
            self._process.wait(UNDOING_TIME)
        self._process.kill()
