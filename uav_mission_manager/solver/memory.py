"""Whether a mission fits, before anything is allocated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.solver.exact.sweep import BLOCK
from uav_mission_manager.solver.submdp import SubMdp

SCRATCH = 24 * BLOCK
"""Entries of a thread's scratch, about."""

SMALL = 1 << 26
"""Bytes that any machine has; asking how many there are takes longer than a small solve."""


class MissionSizeError(ValueError):
    """A mission whose exact solution does not fit; the message says what to use instead."""


def needed_bytes(sub: SubMdp, dtype: DTypeLike, threads: int) -> int:
    """Memory that value iteration needs for W, its expectation and b."""
    q, n = sub.mission.grid.q, sub.n
    table = sub.entries // (q + n)
    # A goal's cell has four neighbours and itself to go on from, with a third of the entries.
    landings = n * min(5, q) / 3
    entries = table * (2 * (q + n) + landings + 2 / 3) + threads * SCRATCH
    return int(entries * np.dtype(dtype).itemsize)


def available_bytes() -> int:
    """Memory that this process may still use."""
    try:
        lines = Path('/proc/meminfo').read_text().splitlines()
        free = 1024 * next(int(line.split()[1]) for line in lines if 'MemAvailable' in line)
    except (OSError, StopIteration):
        free = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES')
    group = Path('/sys/fs/cgroup')
    try:
        limit = int((group / 'memory.max').read_text())
        return min(free, limit - int((group / 'memory.current').read_text()))
    except (OSError, ValueError):  # No control group, or one without a limit ('max').
        return free


def check_memory(sub: SubMdp, dtype: DTypeLike, threads: int) -> None:
    """Raise `MissionSizeError` where value iteration in this floating type does not fit."""
    needed = needed_bytes(sub, dtype, threads)
    if needed <= SMALL or needed <= (available := available_bytes()):
        return
    single, instead = needed_bytes(sub, np.float32, threads), ''
    if single < min(needed, available):
        instead = f"precision 'single' ({_size(single)}) or "
    raise MissionSizeError(
        f'mission {sub.mission.name}: {sub.n} goals on {sub.mission.grid.q} cells make '
        f'{sub.states:,} states; the exact solution needs {_size(needed)} of memory, '
        f"{_size(available)} are free: use {instead}method 'expansion'"
    )


def _size(count: int) -> str:
    return f'{count / 2**30:,.1f} GiB' if count >= 2**30 else f'{count / 2**20:,.0f} MiB'
