"""How much memory there is, asked before anything is allocated."""

from __future__ import annotations

import os
from pathlib import Path

SMALL_BYTES = 1 << 26
"""Bytes that any machine has, a choice: asking for them takes longer than a small solve."""


class MissionSizeError(ValueError):
    """A mission too large for what is asked of it; the message says what to use instead."""


def fits(needed: int) -> bool:
    """Whether so many bytes can be had."""
    return needed <= SMALL_BYTES or needed <= available_bytes()


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


def size_text(count: int) -> str:
    """Return a number of bytes for people."""
    if count >= 2**50:
        return f'{count / 2**30:.1e} GiB'
    return f'{count / 2**30:,.1f} GiB' if count >= 2**30 else f'{count / 2**20:,.0f} MiB'
