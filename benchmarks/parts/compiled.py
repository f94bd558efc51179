"""What compiled code would gain: the expectation over t' and g', fused by numba."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from parts.machine import best
from parts.missions import case_study
from uav_mission_manager.solver.exact import AxisModel, Sweeper
from uav_mission_manager.solver.submdp import whole_mission

COLUMNS_AT_A_TIME = 64
"""Columns (f, r) that the kernel works on together, to stay in the cache."""


def expect(values: Any, out: Any, threat: Any, priorities: Any, scratch: Any) -> None:
    """Fill `out` with the expectation of W over t' and g', some columns at a time."""
    cells, rows, columns = values.shape
    joint, width = rows // 3, scratch.shape[1]
    for x in range(cells):
        for first in range(0, columns, width):
            for row in range(joint):
                for j in range(width):
                    a = values[x, row, first + j]
                    b = values[x, row + joint, first + j]
                    c = values[x, row + 2 * joint, first + j]
                    for t in range(3):
                        p = threat[x, t]
                        scratch[t * joint + row, j] = p[0] * a + p[1] * b + p[2] * c
            after = joint
            for p in priorities:
                after //= 3
                for start in range(0, rows, 3 * after):
                    for low in range(start, start + after):
                        for j in range(width):
                            a, b = scratch[low, j], scratch[low + after, j]
                            c = scratch[low + 2 * after, j]
                            scratch[low, j] = p[0, 0] * a + p[0, 1] * b + p[0, 2] * c
                            scratch[low + after, j] = p[1, 0] * a + p[1, 1] * b + p[1, 2] * c
                            scratch[low + 2 * after, j] = p[2, 0] * a + p[2, 1] * b + p[2, 2] * c
            out[x, :, first : first + width] = scratch


def compiled(k: int, dtype: str) -> dict[str, Any]:
    """Seconds of that half of a sweep, compiled and as it is, and whether the bits agree."""
    import numba

    model = AxisModel(whole_mission(case_study(k)), dtype)
    sweeper = Sweeper(model, model.zero())
    for _ in range(5):
        sweeper.backup()
    out = np.empty(model.shape, dtype)
    scratch = np.empty((model.rows, min(COLUMNS_AT_A_TIME, model.columns)), dtype)
    kernel = numba.njit(nogil=True)(expect)
    arguments = sweeper.values, out, model.threat, np.concatenate(model.priorities), scratch
    start = time.perf_counter()
    kernel(*arguments)
    compiling = time.perf_counter() - start
    ours = best(sweeper.expect)
    return {
        'compiling': compiling,
        'compiled': best(lambda: kernel(*arguments)),
        'ours': ours,
        'same bits': bool(np.array_equal(out, sweeper.expected.open)),
    }
