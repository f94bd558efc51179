"""Threads: how many there are, work shared among them, and one each for linear algebra.

OpenBLAS starts as many threads as there are processors. They fight with each other as soon as
something else runs, which has made builds thirty times slower, and they add up in another order
each time, so that no two results are the same bits. So whoever calls a matrix product that
matters does so within `single_threaded_blas`, and shares the work among threads of its own.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from typing import TypeVar

try:
    from threadpoolctl import threadpool_limits
except ImportError:  # rosdep has no key for it; builds are right without it, only slower.
    threadpool_limits = None

_Item = TypeVar('_Item')
_Result = TypeVar('_Result')


def processors() -> int:
    """Processors that this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Let linear algebra use one thread a call meanwhile."""
    with threadpool_limits(1, user_api='blas') if threadpool_limits else nullcontext():
        yield


def share(
    work: Callable[[int, _Item], _Result], items: Sequence[_Item], threads: int
) -> list[_Result]:
    """Results of work(thread, item), in no order, of items that idle threads take one by one."""
    queue = iter(items)

    def each(thread: int) -> list[_Result]:
        return [work(thread, item) for item in queue]

    if threads == 1:
        return each(0)
    with ThreadPoolExecutor(threads) as pool:
        try:
            return [result for part in pool.map(each, range(threads)) for result in part]
        finally:
            for _ in queue:  # After an error or Ctrl-C no further item is begun.
                pass
