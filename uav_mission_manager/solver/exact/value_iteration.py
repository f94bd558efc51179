"""Value iteration with guaranteed bounds.

W_{n+1} = T W_n, with T the Bellman backup, converges to W* at the rate of the discount. The
sweeps stop on the bounds of `uav_mission_manager.solver.span_bounds`, long before the values stand
still, and the result is shifted to their middle. Where they come closer but slowly, some go
further (`uav_mission_manager.solver.exact.stride`).

Early sweeps need few digits. With mixed precision they run in float32, at half the cost, until
the span is no wider than rounding may be to blame for; the sweeps in float64 go on from there,
and the bounds are theirs alone. The sweeps of the last precision end at the latest when the span
shrinks by less than exact arithmetic guarantees. Other ways to fewer or cheaper sweeps were
measured (docs/benchmarks.md) and gain less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from uav_mission_manager.mdp.arrays import RealArray
from uav_mission_manager.solver.exact.axis_model import AxisModel
from uav_mission_manager.solver.exact.device import find_device
from uav_mission_manager.solver.exact.memory import check_memory
from uav_mission_manager.solver.exact.stride import Stride
from uav_mission_manager.solver.exact.sweep import ActionTable, Sweeper
from uav_mission_manager.solver.progress import Progress, Report, ignore, share_of_decades
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import SubMdp
from uav_mission_manager.solver.threads import processors

PRECISIONS: dict[str, tuple[Any, ...]] = {
    'mixed': (np.float32, np.float64),
    'double': (np.float64,),
    'single': (np.float32,),
}
"""Floating types of the sweeps: mixed is the fast way to float64, double the plain one."""

MIN_MIXED_ENTRIES = 1 << 14
"""Entries of W from which early sweeps in float32 pay: measured."""


@dataclass(frozen=True)
class Solution:
    """The solved sub-MDP.

    Attributes
    ----------
    sub : SubMdp
    value : float array (q, T * 3^n, 8 * 2^n)
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
    value: RealArray
    lower: float
    upper: float
    residual: float
    iterations: int
    converged: bool
    actions: ActionTable | None = None

    @classmethod
    def at_middle(
        cls,
        model: AxisModel,
        values: RealArray,
        bounds: SpanBounds,
        iterations: int,
        tolerance: float,
    ) -> Solution:
        """Shift W, in place, to the middle of the bounds that its last backup gives."""
        values += values.dtype.type(bounds.middle)
        distance = bounds.distance + bounds.accumulated(model.rounding(values))
        return cls(
            sub=model.sub,
            value=values,
            lower=-distance,
            upper=distance,
            residual=bounds.residual,
            iterations=iterations,
            converged=bounds.distance <= tolerance,
        )

    @property
    def policy_loss_bound(self) -> float:
        """Bound on V^pi - V* of the policy greedy in V (Puterman 1994, theorem 6.6.3)."""
        return self.upper - self.lower


def value_iteration(
    sub: SubMdp,
    tolerance: float = 1e-7,
    max_iterations: int = 100_000,
    progress: Progress = ignore,
    *,
    precision: str = 'mixed',
    threads: int | None = None,
    start: tuple[int, RealArray] | None = None,
    on_values: Callable[[int, Callable[[], RealArray]], None] | None = None,
    with_actions: bool = False,
    device: str = 'cpu',
) -> Solution:
    """Solve a sub-MDP from W_0 = 0.

    Parameters
    ----------
    sub : SubMdp
    tolerance : float
        Largest distance of V from V*, in cost.
    max_iterations : int
        Sweeps after which to give up; the result then says `converged=False`.
    progress : Progress
        Is told of each sweep.
    precision : {'mixed', 'double', 'single'}
        See `PRECISIONS`.
    threads : int, optional
        At most this many; all processors by default.
    start : (int, float array), optional
        Sweeps already made and the W they reached, to go on from.
    on_values : callable, optional
        Called after each sweep with its number and a function that returns W, which is not to be
        kept or changed; from a card it is fetched whenever it is asked for.
    with_actions : bool
        Whether to find the best actions too.
    device : {'cpu', 'gpu'}
        Where to sweep: on the processors, or on a CUDA card by CuPy. The solution is in the
        machine's memory.

    Raises
    ------
    ValueError
        If tolerance, max_iterations or threads is not above 0, or no such precision or device
        exists.
    MissionSizeError
        If the memory does not suffice.
    """
    _check(tolerance, max_iterations, precision, threads)
    threads = processors() if threads is None else threads
    place = find_device(device)
    check_memory(sub, PRECISIONS[precision][-1], threads, place)
    iterations, values = start or (0, None)
    first = 0.0

    def stop(bounds: SpanBounds, reached: RealArray) -> bool:
        """Whether that was the last sweep that is needed or allowed."""
        nonlocal iterations, first
        iterations, first = iterations + 1, first or bounds.distance
        done = share_of_decades(first, bounds.distance, tolerance)
        text = f'sweep {iterations}, within {bounds.distance:.1e} of V*'
        progress(Report(iterations, done, text))
        if on_values is not None:
            on_values(iterations, lambda: place.take_back(reached))
        return iterations >= max_iterations or bounds.distance <= tolerance

    swept: tuple[Sweeper, SpanBounds] | None = None
    for dtype in _types(sub, precision, values):
        if iterations < max_iterations:
            swept = None  # Not to hold the tables of two.
            place.release()
            model = AxisModel(sub, dtype, place)
            values = model.zero() if values is None else place.copy(values, dtype)
            sweeper = Sweeper(model, values, threads)
            swept = sweeper, sweep(sweeper, stop, last=dtype is PRECISIONS[precision][-1])
            del sweeper, model
    assert swept is not None
    sweeper, bounds = swept
    solution = Solution.at_middle(sweeper.model, sweeper.values, bounds, iterations, tolerance)
    actions = sweeper.greedy() if with_actions else None
    return replace(solution, value=place.take_back(solution.value), actions=actions)


def sweep(
    sweeper: Sweeper, stop: Callable[[SpanBounds, RealArray], bool], last: bool
) -> SpanBounds:
    """Sweep in one floating type until told to stop, or until rounding is all that changes.

    Parameters
    ----------
    sweeper : Sweeper
    stop : callable
        Given the bounds reached and W, whether that was the last sweep; one that goes further
        is followed by another.
    last : bool
        Whether no better precision follows.

    Returns
    -------
    SpanBounds
        Of the last sweep.
    """
    model, values, span = sweeper.model, sweeper.values, np.inf
    stride = Stride(model.sub.mission)
    while True:
        further = stride.further
        bounds = SpanBounds(*sweeper.backup(further), model.sub.mission.discount)
        stalled = bounds.stalled(span) if last else bounds.residual <= model.rounding(values)
        # Bounds are of a W that is a backup, and no more.
        if (stop(bounds, values) or stalled) and not further:
            return bounds
        stride.note(bounds)
        span = np.inf if further else bounds.span


def _check(tolerance: float, max_iterations: int, precision: str, threads: int | None) -> None:
    if not tolerance > 0 or max_iterations < 1:
        raise ValueError(
            f'tolerance {tolerance} and max_iterations {max_iterations} must be above 0'
        )
    if threads is not None and threads < 1:
        raise ValueError(f'threads {threads} must be above 0')
    if precision not in PRECISIONS:
        raise ValueError(f'precision {precision!r} is none of {", ".join(PRECISIONS)}')


def _types(sub: SubMdp, precision: str, values: RealArray | None) -> tuple[Any, ...]:
    """Floating types still to sweep in."""
    types = PRECISIONS[precision]
    if values is not None:
        return types[types.index(values.dtype.type) :]
    return types if sub.entries >= MIN_MIXED_ENTRIES else types[-1:]
