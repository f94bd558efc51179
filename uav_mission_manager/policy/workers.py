"""Where independent sub-problems are solved: here, in processes, or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context
from typing import Any

Task = Callable[..., Any]
"""A sub-problem: called without arguments it returns its result."""


@dataclass(frozen=True)
class Workers:
    """Who runs tasks.

    Attributes
    ----------
    run : callable
        Returns an iterator over the results of tasks, in their order.
    here : bool
        Whether that is in this process; elsewhere tasks and results are pickled.
    """

    run: Callable[[Sequence[Task]], Iterator[Any]]
    here: bool = False


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
            yield Workers(
                lambda tasks: (future.result() for future in client.map(_call, tasks, pure=False))
            )
    elif jobs == 1:
        yield Workers(lambda tasks: (task() for task in tasks), here=True)
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context('spawn')) as pool:
            yield Workers(lambda tasks: pool.map(_call, tasks))


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
