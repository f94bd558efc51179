"""The exact cost V^pi of a policy, in every state.

A policy that does not look at c and m has a cost of the form of V (see
`uav_mission_manager.solver.reduced`), with W^pi = T_pi W^pi in place of W = T W: the backup takes
the policy's action where value iteration takes the best. The bounds of
`uav_mission_manager.solver.span_bounds` hold for T_pi as they do for T.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.mdp.arrays import FloatArray, IntArray, RealArray
from uav_mission_manager.mdp.states import StateSpace
from uav_mission_manager.solver.exact.axis_model import AxisModel
from uav_mission_manager.solver.exact.memory import check_memory
from uav_mission_manager.solver.exact.sweep import ActionTable, Sweeper
from uav_mission_manager.solver.exact.value_iteration import MIN_MIXED_ENTRIES, sweep
from uav_mission_manager.solver.span_bounds import SpanBounds
from uav_mission_manager.solver.submdp import SubMdp
from uav_mission_manager.solver.threads import processors

MAX_ASKED_STATES = 1 << 16
"""States for which a policy is asked at once, at most: a choice."""


@dataclass(frozen=True)
class Evaluation:
    """The cost of a policy.

    Attributes
    ----------
    model : AxisModel
    value : float array (q, T * 3^n, 8 * 2^n)
        W^pi.
    lower, upper : float
        Guaranteed offsets: V + lower <= V^pi <= V + upper in every state, rounding included.
    iterations : int
        Sweeps.
    """

    model: AxisModel
    value: RealArray
    lower: float
    upper: float
    iterations: int

    def state_values(self, states: IntArray) -> FloatArray:
        """V^pi(s) of global states (N, 2k+5), shape (N,)."""
        return self.model.state_values(self.value, states)


def representatives(sub: SubMdp, entries: ArrayLike | None = None) -> IntArray:
    """A global state for each entry of W, by its flat index; of all entries by default.

    Shape (N, 2k+5). c = 0 and m = 0; goals not tracked are achieved and out of range.
    """
    n, q = sub.n, sub.mission.grid.q
    chosen = np.arange(sub.entries) if entries is None else np.asarray(entries)
    digits = np.unravel_index(chosen, (q, sub.threats, *(3,) * n, 8, *(2,) * n))
    cell, t, g, f, r = digits[0], digits[1], digits[2 : 2 + n], digits[2 + n], digits[3 + n :]
    space = StateSpace.of(sub.mission)
    states = np.zeros((len(chosen), len(space.shape)), np.int64)
    s = space.split(states)
    for j, flags, levels in zip(sub.goals, r, g):
        s.r[:, j], s.g[:, j] = flags, levels
    s.f[:], s.l[:], s.t[:] = f + 1, cell, t
    return states


def tabulate(sub: SubMdp, act: Callable[[IntArray], IntArray]) -> ActionTable:
    """Action numbers of a policy for every entry of W, shape as W.

    Of a policy that looks at c or m, as `best_value` does at c, this is the one that acts as if
    uncommitted and in normal mode.
    """
    numbers = np.empty(sub.entries, np.uint8)
    for first in range(0, sub.entries, MAX_ASKED_STATES):
        chunk = np.arange(first, min(first + MAX_ASKED_STATES, sub.entries))
        numbers[chunk] = act(representatives(sub, chunk))
    return numbers.reshape(sub.shape)


def evaluate(
    sub: SubMdp,
    actions: NDArray[np.integer],
    tolerance: float = 1e-9,
    threads: int | None = None,
) -> Evaluation:
    """Evaluate a policy from W_0 = 0, in float32 as long as that is precise enough.

    Parameters
    ----------
    sub : SubMdp
    actions : int array (q, T * 3^n, 8 * 2^n)
        Its global action numbers, such as `tabulate` finds.
    tolerance : float
        Largest distance of V from V^pi, in cost, but for rounding.
    threads : int, optional
        At most this many; all processors by default.

    Raises
    ------
    ValueError
        If tolerance or threads is not above 0, or an action is not allowed where it is given.
    MissionSizeError
        If the memory does not suffice.
    """
    threads = processors() if threads is None else threads
    if not tolerance > 0 or threads < 1:
        raise ValueError(f'tolerance {tolerance} and threads {threads} must be above 0')
    check_memory(sub, np.float64, threads)
    numbers = _checked(sub, actions)
    values: RealArray = np.zeros(numbers.shape)
    iterations = 0

    def stop(bounds: SpanBounds, reached: RealArray) -> bool:
        nonlocal iterations
        iterations += 1
        if not np.isfinite(bounds.high):
            raise ValueError(_not_allowed(sub, numbers, reached))
        return bounds.distance <= tolerance

    for dtype in (np.float32, np.float64)[sub.entries < MIN_MIXED_ENTRIES :]:
        model = AxisModel(sub, dtype)
        sweeper = Sweeper(model, values.astype(dtype), threads, numbers)
        bounds = sweep(sweeper, stop, last=dtype is np.float64)
        values = sweeper.values
    values += bounds.middle
    distance = bounds.distance + bounds.accumulated(model.rounding(values))
    return Evaluation(model, values, -distance, distance, iterations)


def _checked(sub: SubMdp, actions: NDArray[np.integer]) -> ActionTable:
    if np.shape(actions) != sub.shape:
        raise ValueError(f'actions have shape {np.shape(actions)}, not {sub.shape}')
    return np.clip(actions, 0, 255).astype(np.uint8)  # Not 257 for 1.


def _not_allowed(sub: SubMdp, numbers: ActionTable, values: RealArray) -> str:
    entry = np.flatnonzero(~np.isfinite(values))[:1]
    state = representatives(sub, entry)[0].tolist()
    return f'action {numbers.flat[entry[0]]} is not allowed in state {state}'
