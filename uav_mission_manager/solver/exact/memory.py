"""Whether the exact solution fits, before anything is allocated."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.solver import memory
from uav_mission_manager.solver.exact.sweep import MAX_BLOCK_ENTRIES
from uav_mission_manager.solver.submdp import SubMdp

SCRATCH_TABLES = 10
"""Tables of a block of rows of all cells that a thread works with: counted, about."""


def needed_bytes(sub: SubMdp, dtype: DTypeLike, threads: int) -> int:
    """Memory that value iteration needs: W, its expectation, b, the costs and scratch."""
    q, rows, columns = sub.shape
    costs = 3 * (len(sub.numbers) + 1) * q * columns
    block = max(2 * MAX_BLOCK_ENTRIES, q * columns)
    base_costs = rows // sub.threats * columns
    entries = 2 * sub.entries + sub.n * rows // 3 * columns + base_costs + costs
    return int((entries + threads * SCRATCH_TABLES * block) * np.dtype(dtype).itemsize)


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
