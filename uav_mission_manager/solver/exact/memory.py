"""Whether the exact solution fits, before anything is allocated."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.solver import memory
from uav_mission_manager.solver.exact.device import CPU, Device
from uav_mission_manager.solver.exact.sweep import block_shape, is_compiled
from uav_mission_manager.solver.submdp import SubMdp

MIXED_TABLES, ROW_TABLES = 5, 20
"""Tables of a block that a thread works with, of the exogenous expectation and of the rest:
counted, about."""

COMPILER_BYTES = 206 << 20
"""What numba takes to compile the sweep in both precisions: measured."""


def needed_bytes(sub: SubMdp, dtype: DTypeLike, threads: int, device: Device = CPU) -> int:
    """Memory of the device that value iteration needs: W, its expectation, b, costs, scratch."""
    q, rows, columns = sub.shape
    entries = 2 * sub.entries + sub.n * rows // 3 * columns + _cost_entries(sub)
    if device.on_gpu:
        return int((entries + _gpu_scratch_entries(sub, device)) * np.dtype(dtype).itemsize)
    cells, width, height = block_shape(sub)
    scratch = MIXED_TABLES * cells * rows * width + ROW_TABLES * q * height * columns
    compiler = COMPILER_BYTES if is_compiled(sub) else 0
    return int((entries + threads * scratch) * np.dtype(dtype).itemsize) + compiler


def _gpu_scratch_entries(sub: SubMdp, device: Device) -> int:
    """Entries that work on large blocks takes, at most: there it counts."""
    q, rows, columns = sub.shape
    cells, width, height = block_shape(sub, device)
    mixed = rows * width * (3 * cells + sub.n)
    flights = (7 if sub.mission.range.charge else 3) * (q + sub.n)
    arrivals, completions, choice, prices = 2 * q + 3 + 2 * sub.n, 2 * sub.n, 7 * q, 3 * q * rows
    return mixed + height * columns * (flights + arrivals + completions + choice) + prices


def kept_bytes(sub: SubMdp, dtype: DTypeLike) -> int:
    """Memory of the machine that a solution made on a card needs: W, its actions, b, the costs."""
    return (sub.entries + _cost_entries(sub)) * np.dtype(dtype).itemsize + sub.entries


def _cost_entries(sub: SubMdp) -> int:
    """Entries of b and of the actions' costs."""
    q, rows, columns = sub.shape
    differing = q if sub.mission.range.charge else 1
    return differing * rows // sub.threats * columns + 3 * (len(sub.numbers) + 1) * q * columns


def shortage(sub: SubMdp, dtype: DTypeLike, threads: int, device: Device = CPU) -> str:
    """What value iteration lacks memory for, in words; empty where it fits."""
    whose = ' of the card' if device.on_gpu else ''
    needs = [(needed_bytes(sub, dtype, threads, device), device, whose)]
    if device.on_gpu:
        needs.append((kept_bytes(sub, dtype), CPU, ''))
    for needed, where, whose in needs:
        if needed > memory.SMALL_BYTES and needed > (available := where.available_bytes()):
            return (
                f'the exact solution needs {memory.size_text(needed)} of memory{whose}, '
                f'{memory.size_text(available)} are free'
            )
    return ''


def check_memory(sub: SubMdp, dtype: DTypeLike, threads: int, device: Device = CPU) -> None:
    """Raise `MissionSizeError` where value iteration in this floating type does not fit."""
    lacking = shortage(sub, dtype, threads, device)
    if not lacking:
        return
    instead = ''
    if np.dtype(dtype) != np.float32 and not shortage(sub, np.float32, threads, device):
        single = needed_bytes(sub, np.float32, threads, device)
        instead = f"precision 'single' ({memory.size_text(single)}) or "
    raise memory.MissionSizeError(
        f'mission {sub.mission.name}: {sub.n} goals on {sub.mission.grid.q} cells make '
        f"{sub.states:,} states; {lacking}: use {instead}method 'expansion'"
    )
