"""The backup, compiled by numba.

These make the same operations in the same order as the elementwise steps of
`uav_mission_manager.solver.exact.expectations` and `.sweep`, so W has the same bits. But they need
no array for each step: what a row (t, g) of all cells needs stays in the fastest cache until the
row is done. Loops run along the columns, which lie side by side.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from uav_mission_manager.mdp.dynamics import ON_GROUND

MIXED_BYTES = 1 << 18
"""What `mix_axes` works on at a time: a choice; second caches hold it."""

GROUND = len(ON_GROUND)


@njit(nogil=True)
def mix_axes(source, out, matrices):
    """Expectation along m axes of three of tables (blocks, 3^m, columns), outermost first."""
    blocks, rows, columns = source.shape
    width = min(columns, max(32, MIXED_BYTES // (rows * source.itemsize)))
    scratch = np.empty((rows, width), source.dtype)
    for block in range(blocks):
        for first in range(0, columns, width):
            count = min(width, columns - first)
            for row in range(rows):
                for j in range(count):
                    scratch[row, j] = source[block, row, first + j]
            after = rows
            for m in matrices:
                after //= 3
                p, q, r = m[0, 0], m[0, 1], m[0, 2]
                s, t, u = m[1, 0], m[1, 1], m[1, 2]
                v, w, x = m[2, 0], m[2, 1], m[2, 2]
                for start in range(0, rows, 3 * after):
                    for one in range(start, start + after):
                        two, three = one + after, one + 2 * after
                        for j in range(count):
                            a, b, c = scratch[one, j], scratch[two, j], scratch[three, j]
                            scratch[one, j] = p * a + q * b + r * c
                            scratch[two, j] = s * a + t * b + u * c
                            scratch[three, j] = v * a + w * b + x * c
            for row in range(rows):
                for j in range(count):
                    out[block, row, first + j] = scratch[row, j]


@njit(nogil=True)
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
            for j in range(columns):
                flown[0, cell, j] = expected[cell, row, j]
        after = joint
        for slot in range(n):
            after //= 3
            priorities[slot] = g // after % 3
            without = row // (3 * after) * after + row % after
            for j in range(columns):
                flown[0, q + slot, j] = completed[slot, without, j]
        _fly(flown[0].reshape(-1), flown[1].reshape(-1), room, tables)
        _arrive(arrived, flown, tables.price[:, :, t].copy(), tables)
        _stay(
            arrived[2 * q :], expected[tables.base, row], expected[tables.service, row], t, tables
        )
        for cell in range(q):
            _choose(
                least,
                arrived,
                priorities,
                tables.slots,
                tables.spans,
                tables.arrivals[cell],
                tables.costs[cell],
            )
            cost = tables.base_cost[cell % len(tables.base_cost), g]
            _replace(values[cell, row], least, cost, further, low, high)
    return low.min(), high.max()


@njit(nogil=True)
def _fly(normal, agile, room, tables):
    """Expectation over a flight in both modes, in place; `normal` has what there is before."""
    changes, levels = tables.changes, len(tables.recharged)
    normal_chances, agile_chances = tables.chances[0], tables.chances[1]
    normal_drain, agile_drain = tables.drain[0], tables.drain[1]
    for step in range(tables.alike):
        _change(normal, changes[step], normal_chances[step], normal_drain, levels, room)
    for j in range(len(normal)):
        agile[j] = normal[j]
    for step in range(tables.alike, len(changes)):
        _change(normal, changes[step], normal_chances[step], normal_drain, levels, room)
        _change(agile, changes[step], agile_chances[step], agile_drain, levels, room)


@njit(nogil=True)
def _change(values, change, p, drain, levels, before):
    """Expectation over one change in flight, in place."""
    after, left = change
    if after == 0:
        _drain(values, drain, levels, before)
        return
    for start in range(0, len(values), 2 * after):
        stays = values[start + left * after : start + (1 + left) * after]
        goes = values[start + (1 - left) * after : start + (2 - left) * after]
        for j in range(after):
            stays[j] += (goes[j] - stays[j]) * p


@njit(nogil=True)
def _drain(values, drain, levels, before):
    """Expectation over the levels that are drained, in place."""
    for j in range(len(values)):
        before[j] = values[j]
        values[j] *= drain[0]
    for d in range(1, len(drain)):
        p = drain[d]
        for start in range(0, len(values), levels):
            x, y = values[start : start + levels], before[start : start + levels]
            for b in range(d):
                x[b] += y[0] * p
            for b in range(levels - d):
                x[b + d] += y[b] * p


@njit(nogil=True)
def _arrive(arrived, flown, price, tables):
    """Arrivals by flight, and those that may complete a goal."""
    n = len(tables.goal_cells)
    q = len(flown[0]) - n
    for mode in range(2):
        for cell in range(q):
            p = price[mode, cell]
            for j in range(flown.shape[2]):
                arrived[mode * q + cell, j] = flown[mode, cell, j] + p
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
def _choose(least, arrived, priorities, slots, spans, arrivals, costs):
    """Fill `least` with the least Q, but for what f, r, b and g cost."""
    least[:] = np.inf
    for a in range(len(slots)):
        level, arrival = priorities[slots[a]], arrivals[a]
        for j in range(spans[a, level, 0], spans[a, level, 1]):
            q = arrived[arrival, j] + costs[a, level, j]
            least[j] = q if q < least[j] else least[j]


@njit(nogil=True)
def _replace(old, least, cost, further, low, high):
    """Replace a row of W; widen the range of changes."""
    for j in range(len(old)):
        new = least[j] + cost[j]
        change = new - old[j]
        low[j] = change if change < low[j] else low[j]
        high[j] = change if change > high[j] else high[j]
        old[j] = new + change * further
