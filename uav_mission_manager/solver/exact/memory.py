"""Whether the exact solution fits, before anything is allocated."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.solver import memory
from uav_mission_manager.solver.exact.sweep import block_shape, is_compiled
from uav_mission_manager.solver.submdp import SubMdp

MIXED_TABLES, ROW_TABLES = 5, 20
"""Tables of a block that a thread works with, of the exogenous expectation and of the rest:
counted, about."""


COMPILER_BYTES = 206 << 20
"""What numba takes to compile the sweep in both precisions: measured."""


def needed_bytes(sub: SubMdp, dtype: DTypeLike, threads: int) -> int:
    """Memory that value iteration needs: W, its expectation, b, the costs and scratch."""
    q, rows, columns = sub.shape
    costs = 3 * (len(sub.numbers) + 1) * q * columns
    differing = q if sub.mission.range.charge else 1
    base_costs = differing * rows // sub.threats * columns
    entries = 2 * sub.entries + sub.n * rows // 3 * columns + base_costs + costs
    cells, width, height = block_shape(sub)
    scratch = MIXED_TABLES * cells * rows * width + ROW_TABLES * q * height * columns
    compiler = COMPILER_BYTES if is_compiled(sub) else 0
    return int((entries + threads * scratch) * np.dtype(dtype).itemsize) + compiler


def check_memory(sub: SubMdp, dtype: DTypeLike, threads: int) -> None:
    """Raise `MissionSizeError` where value iteration in this floating type does not fit."""
    needed = needed_bytes(sub, dtype, threads)
    if memory.fits(needed):
        return
    single, available = needed_bytes(sub, np.float32, threads), memory.available_bytes()
    instead = ''
    if single < min(needed, available):
        instead = f"precision 'single' ({memory.size_text(single)}) or "
    raise memory.MissionSizeError(
        f'mission {sub.mission.name}: {sub.n} goals on {sub.mission.grid.q} cells make '
        f'{sub.states:,} states; the exact solution needs {memory.size_text(needed)} of memory, '
        f"{memory.size_text(available)} are free: use {instead}method 'expansion'"
    )
