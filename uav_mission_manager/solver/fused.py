"""Several elementwise steps in one, for arrays of a card.

A card's time goes into reading and writing arrays, and NumPy's operations leave each result in
one. An expression here makes the operations of some steps of `uav_mission_manager.solver.axes` and
of the exact sweep, in the same order, while the numbers are at hand. Each operation is rounded as
NumPy's is, never joined with the next, so the bits are the same.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

MIX = (
    'T a, T b, T c, raw T weights, uint32 alike',
    'T x, T y, T z',
    """
    const T* w = &weights[(unsigned int) i / alike * 9];
    x = w[0] * a + w[1] * b + w[2] * c;
    y = w[3] * a + w[4] * b + w[5] * c;
    z = w[6] * a + w[7] * b + w[8] * c;
    """,
)
"""`mix` for three values: a, b, c are the source's, x, y, z the result's; so many entries in a
row have the same matrix."""

DRIFT = 'T towards, T probability', 'T values', 'values += (towards - values) * probability;'
"""`drift`."""

FALL = (
    'raw T before, raw T weights, uint32 alike, uint32 levels, uint32 after, uint32 steps',
    'T values',
    """
    const unsigned int level = (unsigned int) i / after % levels;
    const T* w = &weights[(unsigned int) i / alike * steps];
    T sum = before[i] * w[0];
    for (unsigned int d = 1; d < steps; ++d)
        sum += before[i - (d < level ? d : level) * after] * w[d];
    values = sum;
    """,
)
"""`fall` of a copy of the values by fewer than so many steps; `after` entries to the next level,
`alike` in each mode."""

BACK_UP = (
    'raw T arrived, raw int32 arrivals, raw T costs, raw uint8 levels, T base, T worst, '
    'uint32 actions, uint32 first, uint32 rows, uint32 columns',
    'T old, T change',
    """
    const unsigned int size = rows * columns, cell = (unsigned int) i / size;
    const unsigned int within = (unsigned int) i % size, column = within % columns;
    const unsigned char* level = &levels[(first + within / columns) * (size_t) actions];
    const unsigned int at = cell * actions;
    T least = worst;
    for (unsigned int a = 0; a < actions; ++a) {
        const T q = arrived[arrivals[at + a] * (size_t) size + within]
            + costs[((at + a) * 3 + level[a]) * (size_t) columns + column];
        least = q < least ? q : least;
    }
    const T backup = least + base;
    change = backup - old;
    old = backup;
    """,
)
"""Least Q over the actions of E on each arrival and what the action costs at the `levels` of its
goal's priority, which replaces the `old` W."""


def run(expression: tuple[str, str, str], *arguments: Any) -> None:
    """Evaluate an expression on arrays of a card, for each entry of those that are not `raw`."""
    _kernel(import_module('cupy'), *expression)(*arguments)


@cache
def _kernel(cupy: Any, inputs: str, outputs: str, operation: str) -> Any:
    options = ('--fmad=false',)  # No product is added to a sum before it is rounded.
    return cupy.ElementwiseKernel(inputs, outputs, operation, 'fused', options=options)
