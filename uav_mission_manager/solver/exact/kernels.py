"""The backup, compiled by numba.

These make the same operations in the same order as the elementwise steps of
`uav_mission_manager.solver.exact.expectations` and `.sweep`, so W has the same bits. But they need
no array for each step: what a row (t, g) of all cells needs stays in the fastest cache until the
row is done. Loops run along the columns, which lie side by side.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from numba import njit

from uav_mission_manager.mdp.dynamics import ON_GROUND

MIXED_BYTES = 1 << 18
"""What `mix_axes` works on at a time: a choice; second caches hold it."""

SHORT = 16
"""Columns side by side that are too few for a loop of their own: a choice."""

GROUND = len(ON_GROUND)


def _kept(function):
    """Compile a function once a machine if numba finds a place to keep it, else once a process."""
    compiled = njit(nogil=True)(function)
    with suppress(RuntimeError):
        compiled.enable_caching()
    return compiled


@_kept
def mix_axes(source, out, matrices):
    """Expectation along m axes of three of tables (blocks, 3^m, columns), outermost first."""
    blocks, rows, columns = source.shape
    width = min(columns, max(32, MIXED_BYTES // (rows * source.itemsize)))
    scratch = np.empty((rows, width), source.dtype)
    for block in range(blocks):
        for first in range(0, columns, width):
            count = min(width, columns - first)
            for row in range(rows):
                _copy(source[block, row, first : first + count], scratch[row])
            after = rows
            for m in matrices:
                after //= 3
                p, q, r = m[0, 0], m[0, 1], m[0, 2]
                s, t, u = m[1, 0], m[1, 1], m[1, 2]
                v, w, x = m[2, 0], m[2, 1], m[2, 2]
                for start in range(0, rows, 3 * after):
                    for row in range(start, start + after):
                        one, two = scratch[row], scratch[row + after]
                        three = scratch[row + 2 * after]
                        for j in range(count):
                            a, b, c = one[j], two[j], three[j]
                            one[j] = p * a + q * b + r * c
                            two[j] = s * a + t * b + u * c
                            three[j] = v * a + w * b + x * c
            for row in range(rows):
                _copy(scratch[row, :count], out[block, row, first:])


@njit(nogil=True)
def _copy(source, out):
    """Copy a line to the start of another."""
    for j in range(len(source)):
        out[j] = source[j]


@_kept
def back_up(values, first, further, expected, completed, inner, tables):
    """Back up a block of rows from `first` on; return the least and the largest change."""
    q, rows, columns = values.shape
    n, joint, height = len(completed), rows // 3, 3 ** len(inner)
    for cell in range(q):
        block = expected[cell, first : first + height].reshape(1, height, columns)
        mix_axes(block, block, inner)
    flown = np.empty((2, q + n, columns), values.dtype)
    arrived = np.empty((2 * q + GROUND + 2 * n, columns), values.dtype)
    least, room = np.empty(columns, values.dtype), np.empty((q + n) * columns, values.dtype)
    low, high = np.full_like(least, np.inf), np.full_like(least, -np.inf)
    priorities = np.zeros(n + 1, np.int64)  # The last is that of actions without a goal.
    for row in range(first, first + height):
        t, g = row // joint, row % joint
        for cell in range(q):
            _copy(expected[cell, row], flown[0, cell])
        after = joint
        for slot in range(n):
            after //= 3
            priorities[slot] = g // after % 3
            without = row // (3 * after) * after + row % after
            _copy(completed[slot, without], flown[0, q + slot])
        _fly(flown[0].reshape(-1), flown[1].reshape(-1), room, tables)
        _arrive(arrived, flown, tables.price[:, :, t].copy(), tables)
        _stay(
            arrived[2 * q :], expected[tables.base, row], expected[tables.service, row], t, tables
        )
        for cell in range(q):
            _choose(least, cell, arrived, priorities, tables)
            cost = tables.base_cost[cell % len(tables.base_cost), g]
            _replace(values[cell, row], least, cost, further, low, high)
    return low.min(), high.max()


@njit(nogil=True)
def _fly(normal, agile, room, tables):
    """Expectation over a flight in both modes, in place; `normal` has what there is before."""
    for step in range(tables.alike):
        _change(normal, step, 0, room, tables)
    _copy(normal, agile)
    for step in range(tables.alike, len(tables.changes)):
        _change(normal, step, 0, room, tables)
        _change(agile, step, 1, room, tables)


@njit(nogil=True)
def _change(values, step, mode, before, tables):
    """Expectation over one change in flight, in place."""
    after, left = tables.changes[step, 0], tables.changes[step, 1]
    chances = tables.chances[mode, step]
    if after == 0:
        _drain(values, tables.drain[mode], len(tables.recharged), before)
    elif after < SHORT and left == 1:
        _change_next(values, after, chances, before)
    else:
        p = chances[left * after]
        for start in range(0, len(values), 2 * after):
            stays = values[start + left * after : start + (1 + left) * after]
            goes = values[start + (1 - left) * after : start + (2 - left) * after]
            for j in range(after):
                stays[j] += (goes[j] - stays[j]) * p


@njit(nogil=True)
def _change_next(values, after, chances, before):
    """Do the same in long loops where few columns lie together; half of the chances are 0."""
    _copy(values, before)
    p = chances[after:]
    for start in range(0, len(values), len(chances)):
        x, y, goes = values[start + after :], before[start + after :], before[start:]
        for j in range(len(p)):
            x[j] = y[j] + (goes[j] - y[j]) * p[j]


@njit(nogil=True)
def _drain(values, drain, levels, before):
    """Expectation over the levels that are drained, in place."""
    for j in range(len(values)):
        before[j] = values[j]
        values[j] *= drain[0]
    for d in range(1, len(drain)):
        p, higher = drain[d], values[d:]
        for j in range(len(higher)):
            higher[j] += before[j] * p
    # There the lowest levels read the line before theirs; nothing is drained below level 0.
    for start in range(0, len(values), levels):
        for b in range(len(drain) - 1):
            left = before[start + b] * drain[0]
            for d in range(1, len(drain)):
                left += before[start + max(b - d, 0)] * drain[d]
            values[start + b] = left


@njit(nogil=True)
def _arrive(arrived, flown, price, tables):
    """Arrivals by flight, and those that may complete a goal."""
    n = len(tables.goal_cells)
    q = len(flown[0]) - n
    for mode in range(2):
        for cell in range(q):
            p, x, into = price[mode, cell], flown[mode, cell], arrived[mode * q + cell]
            for j in range(len(into)):
                into[j] = x[j] + p
        for slot in range(n):
            cell = tables.goal_cells[slot]
            p, into = price[mode, cell], arrived[2 * q + GROUND + 2 * slot + mode]
            x, y = arrived[mode * q + cell], flown[mode, q + slot]
            completion = tables.completion[slot]
            for j in range(len(into)):
                into[j] = x[j] + (y[j] + p - x[j]) * completion[j]


@njit(nogil=True)
def _stay(arrived, base, service, t, tables):
    """Arrivals on the ground: parked, recharged, repaired."""
    parked, recharged, repaired = arrived[0], arrived[1], arrived[2]
    of_base, of_service = tables.price[0, tables.base, t], tables.price[0, tables.service, t]
    levels, p = len(tables.recharged), tables.repair
    for j in range(len(base)):
        parked[j] = base[j] + of_base
    for start in range(0, len(base), levels):
        for b in range(levels):
            recharged[start + b] = service[start + tables.recharged[b]] + of_service
        for b in range(levels):
            here = service[start + b]
            repaired[start + b] = here + (service[b] - here) * p + of_service


@njit(nogil=True)
def _choose(least, cell, arrived, priorities, tables):
    """Fill `least` with the least Q in a cell, but for what f, r, b and g cost."""
    slots, spans, arrivals, costs = tables.slots, tables.spans, tables.arrivals, tables.costs
    least[:] = np.inf
    for a in range(len(slots)):
        level = priorities[slots[a]]
        first, last = spans[a, level, 0], spans[a, level, 1]
        x = arrived[arrivals[cell, a], first:last]
        y, lower = costs[cell, a, level, first:last], least[first:last]
        for j in range(len(lower)):
            q = x[j] + y[j]
            lower[j] = q if q < lower[j] else lower[j]


@njit(nogil=True)
def _replace(old, least, cost, further, low, high):
    """Replace a row of W; widen the range of changes."""
    for j in range(len(old)):
        new = least[j] + cost[j]
        change = new - old[j]
        low[j] = change if change < low[j] else low[j]
        high[j] = change if change > high[j] else high[j]
        old[j] = new + change * further
