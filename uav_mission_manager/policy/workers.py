"""Where independent sub-problems are solved: here, in processes, or on a Dask cluster."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from multiprocessing import active_children, get_context, parent_process
from typing import Any

Task = Callable[..., Any]
"""A sub-problem: called without arguments it returns its result."""


@dataclass(frozen=True)
class Workers:
    """Who runs tasks.

    Attributes
    ----------
    each : callable
        Returns an iterator over numbers and results of tasks, as they end.
    here : bool
        Whether that is in this process; elsewhere tasks and results are pickled.
    """

    each: Callable[[Sequence[Task]], Iterator[tuple[int, Any]]]
    here: bool = False

    def run(
        self, tasks: Sequence[Task], ended: Callable[[int], object] = lambda number: None
    ) -> Iterator[Any]:
        """Iterate over the results of tasks, in their order; `ended` is told whose is there."""
        waiting: dict[int, Any] = {}
        following = 0
        for number, result in self.each(tasks):
            ended(number)
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1


@contextmanager
def workers(jobs: int = 1, scheduler: str | None = None) -> Iterator[Workers]:
    """Provide workers.

    Parameters
    ----------
    jobs : int
        Processes; with one the tasks run here.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers have this package, to use instead. A task whose
        worker is lost runs again on another.

    Raises
    ------
    ValueError
        If jobs is below 1, or Dask's `distributed` is not installed.
    OSError
        If there is no scheduler at the address.
    """
    if jobs < 1:
        raise ValueError(f'jobs {jobs} must be above 0')
    if scheduler is not None:
        with _client(scheduler) as client:
            yield Workers(partial(_on_cluster, client))
    elif jobs == 1:
        yield Workers(lambda tasks: ((n, task()) for n, task in enumerate(tasks)), here=True)
    else:
        with _pool(jobs) as pool:
            yield Workers(partial(_in_pool, pool))


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Provide processes that end with this one, and at once where it gives up."""
    context = get_context('spawn')
    with _deaf_children():
        pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_end_with_parent)
    with pool:
        try:
            yield pool
        except BaseException:
            for process in active_children():
                process.terminate()
            raise


def _in_pool(pool: ProcessPoolExecutor, tasks: Sequence[Task]) -> Iterator[tuple[int, Any]]:
    with _deaf_children():
        numbers = {pool.submit(_call, task): number for number, task in enumerate(tasks)}
    for future in as_completed(numbers):
        yield numbers[future], future.result()


def _on_cluster(client: Any, tasks: Sequence[Task]) -> Iterator[tuple[int, Any]]:
    futures = client.map(_call, tasks, pure=False)
    numbers = {future.key: number for number, future in enumerate(futures)}
    for future in import_module('distributed').as_completed(futures, loop=client.loop):
        yield numbers[future.key], future.result()


@contextmanager
def _deaf_children() -> Iterator[None]:
    """Let processes that are started in here not hear what a terminal tells all of them.

    This one ends the others.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """End this process when the one that started it has died: nobody will ask it any more."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _client(address: str) -> Any:
    try:
        distributed: Any = import_module('distributed')
    except ImportError:
        raise ValueError(
            'a scheduler needs the Python package distributed: pip install distributed'
        ) from None
    return distributed.Client(address, timeout='10s', set_as_default=False)


def _call(task: Task) -> Any:
    return task()
