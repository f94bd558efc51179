"""What the machine can do: copies of memory and matrix products, as numpy has them."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable

import numpy as np


def best(work: Callable[[], object], repeats: int = 7) -> float:
    """Least wall time of some calls [s]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def machine() -> dict[str, float | str]:
    """Processor, copy and add in GB/s of memory read and written, products in GFLOP/s."""
    large, cached = 1 << 24, 1 << 14
    a, b, c = (np.ones(large) for _ in range(3))
    found: dict[str, float | str] = {
        'processor': _processor(),
        'processors': len(os.sched_getaffinity(0)),
        'python': platform.python_version(),
        'numpy': np.__version__,
        'copy': 2 * 8 * large / best(lambda: np.copyto(a, b)) / 1e9,
        'add': 3 * 8 * large / best(lambda: np.add(a, b, out=c)) / 1e9,
    }
    for name in ('float64', 'float32'):
        x, y, z = (np.ones(cached, name) for _ in range(3))
        loop = best(lambda x=x, y=y, z=z: [np.add(x, y, out=z) for _ in range(200)])
        found[f'add in cache, {name}'] = cached * 200 / loop / 1e9
        square, out = np.ones((1500, 1500), name), np.empty((1500, 1500), name)
        product = best(lambda square=square, out=out: np.matmul(square, square, out=out))
        found[f'product, {name}'] = 2 * 1500**3 / product / 1e9
    return found


def _processor() -> str:
    with open('/proc/cpuinfo', encoding='utf-8') as lines:
        names = [line.split(':')[1].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.processor()
