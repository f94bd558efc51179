"""The machine: its name for the pages, and how fast numpy copies, adds and multiplies on it."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np


def machine() -> str:
    """Processors, Python and NumPy, in words."""
    count = len(os.sched_getaffinity(0))
    return (
        f'{count} processor{"s" * (count > 1)} ({_processor()}), '
        f'Python {platform.python_version()}, NumPy {np.__version__}'
    )


def _processor() -> str:
    lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
    names = [line.split(':')[1].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.processor()


def best(work: Callable[[], object], repeats: int = 7) -> float:
    """Least wall time of some calls [s]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def speeds() -> dict[str, float]:
    """Copies of memory in GB/s read and written, additions in 1e9/s, products in GFLOP/s."""
    large, cached = 1 << 24, 1 << 14
    a, b = (np.ones(large) for _ in range(2))
    found = {'copy': 2 * 8 * large / best(lambda: np.copyto(a, b)) / 1e9}
    for name in ('float64', 'float32'):
        x, y, z = (np.ones(cached, name) for _ in range(3))
        loop = best(lambda x=x, y=y, z=z: [np.add(x, y, out=z) for _ in range(200)])
        found[f'add in cache, {name}'] = cached * 200 / loop / 1e9
        square, out = np.ones((1500, 1500), name), np.empty((1500, 1500), name)
        product = best(lambda square=square, out=out: np.matmul(square, square, out=out))
        found[f'product, {name}'] = 2 * 1500**3 / product / 1e9
    return found
