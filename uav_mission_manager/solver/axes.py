"""Expectations along one axis of a table, as lists of elementwise steps between given arrays.

A step is a function and its arguments. Small tables are swept by lists made once, where making
the views would take longer than the arithmetic; large ones block by block.

Only correctly rounded elementwise operations in a fixed order are used, never a matrix product:
every machine, numpy and BLAS computes the same bits. The arrays are NumPy's or CuPy's, all of one
kind; for CuPy's, what takes several steps is one (`uav_mission_manager.solver.fused`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from uav_mission_manager.mdp.arrays import IndexArray, RealArray
from uav_mission_manager.solver import fused

ArrayStep = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function and its arguments, the array that it fills among them."""


def run_steps(steps: Iterable[ArrayStep]) -> None:
    """Take the steps in their order."""
    for function, arguments in steps:
        function(*arguments)


def mix(
    source: RealArray, matrices: RealArray, out: RealArray, scratch: RealArray
) -> list[ArrayStep]:
    """Expectation out[b, i] = sum_j P[b, i, j] source[b, j].

    `source`, `out` and `scratch` have shape (before, n, ...), `matrices` (before, n, n), or
    (1, n, n) where all are the same.
    """
    if matrices.shape[-1] == 3 and not isinstance(out, np.ndarray):
        values, mixed = ([table[:, j] for j in range(3)] for table in (source, out))
        alike = out.size // (3 * len(matrices))
        return [(fused.run, (fused.MIX, *values, matrices, alike, *mixed))]
    weights = matrices.reshape(*matrices.shape, *(1,) * (source.ndim - 2))
    steps: list[ArrayStep] = [(np.multiply, (weights[:, :, 0], source[:, 0, None], out))]
    for j in range(1, matrices.shape[-1]):
        steps.append((np.multiply, (weights[:, :, j], source[:, j, None], scratch)))
        steps.append((np.add, (out, scratch, out)))
    return steps


def drift(
    values: RealArray, towards: RealArray, probability: RealArray, scratch: RealArray
) -> list[ArrayStep]:
    """Expectation over a change that cannot be undone: values += p (towards - values)."""
    if not isinstance(values, np.ndarray):
        return [(fused.run, (fused.DRIFT, towards, probability, values))]
    return [
        (np.subtract, (towards, values, scratch)),
        (np.multiply, (scratch, probability, scratch)),
        (np.add, (values, scratch, values)),
    ]


def fall(
    values: RealArray, probabilities: RealArray, before: RealArray, scratch: RealArray
) -> list[ArrayStep]:
    """Expectation, in place, over a fall by d steps along axis 2, to the first entry at most.

    `values`, `before` and `scratch` have shape (modes, lines, n, ..), `probabilities` (modes, D)
    for d = 0..D-1 < n.
    """
    if not isinstance(values, np.ndarray):
        levels, after = values.shape[2], math.prod(values.shape[3:])
        counts = values.size // len(values), levels, after, probabilities.shape[1]
        falling = fused.FALL, before, probabilities, *counts, values
        return [(np.copyto, (before, values)), (fused.run, falling)]
    weights = probabilities.T.reshape(probabilities.shape[1], -1, *(1,) * (values.ndim - 1))
    steps: list[ArrayStep] = [
        (np.copyto, (before, values)),
        (np.multiply, (before, weights[0], values)),
    ]
    for d, weight in enumerate(weights[1:], 1):
        product, lowest, others = scratch[:, :, :-d], values[:, :, :d], values[:, :, d:]
        steps += [
            (np.multiply, (before[:, :, :-d], weight, product)),
            # All that would fall further stays at the first entry.
            (np.add, (lowest, product[:, :, :1], lowest)),
            (np.add, (others, product, others)),
        ]
    return steps


def gather(source: RealArray, rows: IndexArray, out: RealArray) -> ArrayStep:
    """Step out[i] = source[rows[i]]; `source` in one piece."""
    # mode='raise' would go through a buffer; CuPy, which has no modes, never raises.
    modes = ('clip',) if isinstance(source, np.ndarray) else ()
    return source.take, (rows, 0, out, *modes)
