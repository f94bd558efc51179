"""Value iteration with guaranteed bounds.

W_{n+1} = T W_n, with T the Bellman backup, converges to W* at the rate of the discount. Since
W_{n+1} + gamma/(1-gamma) min(d) <= W* <= W_{n+1} + gamma/(1-gamma) max(d), d = W_{n+1} - W_n
(MacQueen 1966; Puterman 1994, theorem 6.6.3), the sweeps stop as soon as these bounds are
close, long before the values stand still, and the result is shifted to their middle. Rounding
adds at most e to each entry of T W, hence e/(1-gamma) to the bounds.

Early sweeps need few digits. With mixed precision they run in float32, at half the cost, until
d is spread no wider than rounding may be to blame for; the sweeps in float64 go on from there,
and the bounds are theirs alone. The sweeps of the last precision end at the latest when the
spread shrinks by less than the discount, which exact arithmetic guarantees. Other ways to fewer
or cheaper sweeps were measured (docs/benchmarks.md) and gain less.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.exact.sweep import Sweeper
from uav_mission_manager.solver.memory import check_memory
from uav_mission_manager.solver.reduced import BellmanOperator
from uav_mission_manager.solver.submdp import SubMdp

PRECISIONS: dict[str, tuple[Any, ...]] = {
    'mixed': (np.float32, np.float64),
    'double': (np.float64,),
    'single': (np.float32,),
}
"""Floating types of the sweeps: mixed is the fast way to float64, double the plain one."""

MIXED = 1 << 14
"""Entries of W from which float32 sweeps pay."""


@dataclass(frozen=True)
class Solution:
    """The solved sub-MDP.

    Attributes
    ----------
    sub : SubMdp
    value : float array (q + n, 3 * 3^n, 8 * 2^n)
        W over place, (t, g), (f, r): see `uav_mission_manager.solver.reduced`.
    lower, upper : float
        Guaranteed offsets: V + lower <= V* <= V + upper in every state, rounding included.
    residual : float
        Sup norm of the last change beyond a constant, (max(d) - min(d)) / 2.
    iterations : int
        Sweeps.
    converged : bool
        Whether the bounds but for rounding met the tolerance.
    actions : uint8 array like value, or None
        Numbers of the best actions, where asked for.
    """

    sub: SubMdp
    value: FloatArray
    lower: float
    upper: float
    residual: float
    iterations: int
    converged: bool
    actions: NDArray[np.uint8] | None = None

    @property
    def policy_loss_bound(self) -> float:
        """Bound on V^pi - V* of the policy greedy in V (Puterman 1994, theorem 6.6.3)."""
        return self.upper - self.lower


def value_iteration(
    sub: SubMdp,
    tolerance: float = 1e-7,
    max_iterations: int = 100_000,
    on_sweep: Callable[[int, float], None] | None = None,
    *,
    precision: str = 'mixed',
    threads: int | None = None,
    start: tuple[int, FloatArray] | None = None,
    on_values: Callable[[int, FloatArray], None] | None = None,
    with_actions: bool = False,
) -> Solution:
    """Solve a sub-MDP from W_0 = 0.

    Parameters
    ----------
    sub : SubMdp
    tolerance : float
        Largest distance of V from V*, in cost.
    max_iterations : int
        Sweeps after which to give up; the result then says `converged=False`.
    on_sweep : callable, optional
        Called after each sweep with its number and the distance bound reached.
    precision : {'mixed', 'double', 'single'}
        See `PRECISIONS`.
    threads : int, optional
        At most this many; all processors by default.
    start : (int, float array), optional
        Sweeps already made and the W they reached, to go on from.
    on_values : callable, optional
        Called after each sweep with its number and W, which is not to be kept or changed.
    with_actions : bool
        Whether to find the best actions too.

    Raises
    ------
    ValueError
        If tolerance, max_iterations or threads is not above 0, or no such precision exists.
    MissionSizeError
        If the memory does not suffice.
    """
    _check(tolerance, max_iterations, precision, threads)
    threads = processors() if threads is None else threads
    check_memory(sub, PRECISIONS[precision][-1], threads)
    iterations, values = start or (0, None)

    def report(bound: float, reached: FloatArray) -> bool:
        """Whether that was the last sweep allowed."""
        nonlocal iterations
        iterations += 1
        if on_sweep is not None:
            on_sweep(iterations, bound)
        if on_values is not None:
            on_values(iterations, reached)
        return iterations >= max_iterations

    for dtype in _types(sub, precision, values):
        if iterations < max_iterations:
            run = _Run(sub, dtype, values, threads)
            values = None  # Not to hold two.
            low, high = run.sweep(tolerance, report, last=dtype is PRECISIONS[precision][-1])
            values = run.sweeper.values
    return run.solution(low, high, iterations, tolerance, with_actions)


def _check(tolerance: float, max_iterations: int, precision: str, threads: int | None) -> None:
    if not tolerance > 0 or max_iterations < 1:
        raise ValueError(
            f'tolerance {tolerance} and max_iterations {max_iterations} must be above 0'
        )
    if threads is not None and threads < 1:
        raise ValueError(f'threads {threads} must be above 0')
    if precision not in PRECISIONS:
        raise ValueError(f'precision {precision!r} is none of {", ".join(PRECISIONS)}')


class _Run:
    """Sweeps in one floating type."""

    def __init__(self, sub: SubMdp, dtype: Any, values: FloatArray | None, threads: int) -> None:
        self.operator = BellmanOperator(sub, dtype)
        self.gain = sub.mission.discount / (1 - sub.mission.discount)
        start = self.operator.zero() if values is None else values.astype(dtype)
        self.sweeper = Sweeper(self.operator, start, threads)

    def sweep(
        self, tolerance: float, report: Callable[[float, FloatArray], bool], last: bool
    ) -> tuple[float, float]:
        """Sweep until the bounds meet the tolerance or rounding stops them; the last change."""
        operator, values = self.operator, self.sweeper.values
        spread = np.inf
        while True:
            low, high = self.sweeper.backup()
            previous, spread = spread, high - low
            bound = self.gain * spread / 2
            if last:
                stalled = spread > (1 + operator.sub.mission.discount) / 2 * previous
            else:
                stalled = spread / 2 <= operator.rounding(values)
            if report(bound, values) or bound <= tolerance or stalled:
                return low, high

    def solution(
        self, low: float, high: float, iterations: int, tolerance: float, with_actions: bool
    ) -> Solution:
        """W shifted to the middle of its bounds."""
        sub, values = self.operator.sub, self.sweeper.values
        values += values.dtype.type(self.gain * (high + low) / 2)
        bound = self.gain * (high - low) / 2
        rounding = self.operator.rounding(values) / (1 - sub.mission.discount)
        return Solution(
            sub=sub,
            value=values,
            lower=-bound - rounding,
            upper=bound + rounding,
            residual=(high - low) / 2,
            iterations=iterations,
            converged=bound <= tolerance,
            actions=self.sweeper.greedy() if with_actions else None,
        )


def processors() -> int:
    """Processors that this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _types(sub: SubMdp, precision: str, values: FloatArray | None) -> tuple[Any, ...]:
    """Floating types still to sweep in."""
    types = PRECISIONS[precision]
    if values is not None:
        return types[types.index(values.dtype.type) :]
    return types if sub.entries >= MIXED else types[-1:]
