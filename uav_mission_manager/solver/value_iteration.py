"""Value iteration with guaranteed bounds.

V_{n+1} = T V_n, with T the Bellman backup, converges to V* at the rate of the discount. Since
V_{n+1} + gamma/(1-gamma) min(d) <= V* <= V_{n+1} + gamma/(1-gamma) max(d), d = V_{n+1} - V_n
(MacQueen 1966; Puterman 1994, theorem 6.6.3), the sweeps stop as soon as these bounds are
close, long before the values stand still, and the result is shifted to their middle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.solver.bellman import BellmanOperator, Value
from uav_mission_manager.solver.submdp import SubMdp


@dataclass(frozen=True)
class Solution:
    """The solved sub-MDP.

    Attributes
    ----------
    sub : SubMdp
    value : Value
    lower, upper : float
        Guaranteed offsets: V + lower <= V* <= V + upper in every state.
    residual : float
        Sup norm of the last change beyond a constant, (max(d) - min(d)) / 2.
    iterations : int
        Sweeps.
    converged : bool
        Whether upper - lower met the tolerance.
    """

    sub: SubMdp
    value: Value
    lower: float
    upper: float
    residual: float
    iterations: int
    converged: bool

    @property
    def policy_loss_bound(self) -> float:
        """Bound on V^pi - V* of the policy greedy in V (Puterman 1994, theorem 6.6.3)."""
        return self.upper - self.lower


def value_iteration(
    sub: SubMdp,
    tolerance: float = 1e-7,
    max_iterations: int = 100_000,
    on_sweep: Callable[[int, float], None] | None = None,
) -> Solution:
    """Solve a sub-MDP from V_0 = 0.

    Parameters
    ----------
    sub : SubMdp
    tolerance : float
        Largest distance of V from V*, in cost.
    max_iterations : int
        Sweeps after which to give up; the result then says `converged=False`.
    on_sweep : callable, optional
        Called after each sweep with its number and the distance bound reached.

    Returns
    -------
    Solution

    Raises
    ------
    ValueError
        If tolerance or max_iterations is not above 0.
    """
    if not tolerance > 0 or max_iterations < 1:
        raise ValueError(
            f'tolerance {tolerance} and max_iterations {max_iterations} must be above 0'
        )
    operator = BellmanOperator(sub)
    discount = sub.mission.discount
    value = operator.zero()
    for iterations in range(1, max_iterations + 1):
        previous, value = value, operator.look_ahead(value).backup()
        low, high = _change(value, previous)
        half = discount / (1 - discount) * (high - low) / 2
        if on_sweep is not None:
            on_sweep(iterations, half)
        if half <= tolerance:
            break
    shift = discount / (1 - discount) * (high + low) / 2
    return Solution(
        sub=sub,
        value=Value(value.free + shift, value.on_site + shift),
        lower=-half,
        upper=half,
        residual=(high - low) / 2,
        iterations=iterations,
        converged=half <= tolerance,
    )


def _change(value: Value, previous: Value) -> tuple[float, float]:
    free: NDArray[np.float64] = value.free - previous.free
    on_site: NDArray[np.float64] = value.on_site - previous.on_site
    return (
        min(float(free.min()), float(on_site.min())),
        max(float(free.max()), float(on_site.max())),
    )
