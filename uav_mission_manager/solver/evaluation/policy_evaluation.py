"""The exact cost V^pi of a policy, in every state.

A policy that looks at c and m only through the place (see `uav_mission_manager.solver.reduced`)
has a cost of the form of V, with W^pi = T_pi W^pi in place of W = T W: the backup takes the
policy's action where value iteration takes the best. T_pi is monotone and shifts with constants
as T does, so that the bounds of `uav_mission_manager.solver.exact.value_iteration` hold alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uav_mission_manager.solver.axes import FloatArray
from uav_mission_manager.solver.exact.sweep import Sweeper
from uav_mission_manager.solver.exact.value_iteration import MIXED, processors
from uav_mission_manager.solver.memory import check_memory
from uav_mission_manager.solver.reduced import BellmanOperator
from uav_mission_manager.solver.submdp import SubMdp

CHUNK = 1 << 16
"""States for which a policy is asked at a time."""


@dataclass(frozen=True)
class Evaluation:
    """The cost of a policy.

    Attributes
    ----------
    operator : BellmanOperator
    value : float array (q + n, 3 * 3^n, 8 * 2^n)
        W^pi.
    lower, upper : float
        Guaranteed offsets: V + lower <= V^pi <= V + upper in every state, rounding included.
    iterations : int
        Sweeps.
    """

    operator: BellmanOperator
    value: FloatArray
    lower: float
    upper: float
    iterations: int

    def state_values(self, states: NDArray[np.int64]) -> NDArray[np.float64]:
        """V^pi(s) of global states (N, 2k+5), shape (N,)."""
        return self.operator.state_values(self.value, states)


def representatives(sub: SubMdp, entries: ArrayLike | None = None) -> NDArray[np.int64]:
    """A global state for each entry of W, by its flat index; of all entries by default.

    Shape (N, 2k+5). Off the sites c = 0; m = 0; goals not tracked are achieved and out of range.
    """
    n, k, q = sub.n, sub.mission.k, sub.mission.grid.q
    chosen = np.arange(sub.entries) if entries is None else np.asarray(entries)
    digits = np.unravel_index(chosen, (q + n, 3, *(3,) * n, 8, *(2,) * n))
    place, t, g, f, r = digits[0], digits[1], digits[2 : 2 + n], digits[2 + n], digits[3 + n :]
    states = np.zeros((len(chosen), 2 * k + 5), np.int64)
    for j, flags, levels in zip(sub.goals, r, g):
        states[:, 1 + j], states[:, 1 + k + j] = flags, levels
    sites = np.array([sub.mission.goals[j].cell for j in sub.goals], np.int64)
    states[:, 0] = f + 1
    states[:, -4] = np.concatenate([np.arange(q), sites])[place]
    states[:, -3] = np.concatenate([np.zeros(q, np.int64), np.array(sub.goals) + 1])[place]
    states[:, -2] = t
    return states


def tabulate(
    sub: SubMdp, act: Callable[[NDArray[np.int64]], NDArray[np.int64]]
) -> NDArray[np.uint8]:
    """Action numbers of a policy for every entry of W, shape as W.

    Of a policy that looks at c or m off the sites, as `best_value` does at c, this is the one
    that acts there as if uncommitted and in normal mode.
    """
    numbers = np.empty(sub.entries, np.uint8)
    for first in range(0, sub.entries, CHUNK):
        chunk = np.arange(first, min(first + CHUNK, sub.entries))
        numbers[chunk] = act(representatives(sub, chunk))
    return numbers.reshape(-1, 3 * 3**sub.n, 8 * 2**sub.n)


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
    actions : int array (q + n, 3 * 3^n, 8 * 2^n)
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
    gain = sub.mission.discount / (1 - sub.mission.discount)
    values: FloatArray = np.zeros(numbers.shape)
    iterations = 0
    for dtype in (np.float32, np.float64)[sub.entries < MIXED :]:
        operator = BellmanOperator(sub, dtype)
        sweeper = Sweeper(operator, values.astype(dtype), threads, numbers)
        spread, stalled = np.inf, False
        while gain * spread / 2 > tolerance and not stalled:
            low, high = sweeper.backup()
            iterations += 1
            if not np.isfinite(high):
                raise ValueError(_not_allowed(sub, numbers, sweeper.values))
            previous, spread = spread, high - low
            # In exact arithmetic the spread shrinks at least by the discount.
            stalled = spread > (1 + sub.mission.discount) / 2 * previous
            stalled |= dtype is np.float32 and spread / 2 <= operator.rounding(sweeper.values)
        values = sweeper.values
    values += gain * (high + low) / 2
    rounding = operator.rounding(values) / (1 - sub.mission.discount)
    bound = gain * spread / 2 + rounding
    return Evaluation(operator, values, -bound, bound, iterations)


def _checked(sub: SubMdp, actions: NDArray[np.integer]) -> NDArray[np.uint8]:
    shape = sub.mission.grid.q + sub.n, 3 * 3**sub.n, 8 * 2**sub.n
    if np.shape(actions) != shape:
        raise ValueError(f'actions have shape {np.shape(actions)}, not {shape}')
    return np.clip(actions, 0, 255).astype(np.uint8)  # Not 257 for 1.


def _not_allowed(sub: SubMdp, numbers: NDArray[np.uint8], values: FloatArray) -> str:
    entry = np.flatnonzero(~np.isfinite(values))[:1]
    state = representatives(sub, entry)[0].tolist()
    return f'action {numbers.flat[entry[0]]} is not allowed in state {state}'
