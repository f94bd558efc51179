"""The clock that time-outs run on, and a watch over the one that messages are stamped with."""

from __future__ import annotations

import math
from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

WATCH_PERIOD = 0.5
"""Time [s] between two looks at a clock: a choice, soon enough for a person to be told."""

STANDING_TIME = 2.0
"""Time [s] without any progress after which a clock stands: a choice, far above the period of
`/clock` in any simulation."""

JUMP = 1.0
"""Difference [s] between the steps of two clocks that is a jump: a choice, less than any time-out
by default and more than a busy machine delays a look."""

FASTEST_SIMULATION = 100.0
"""How much faster than the real one simulated time may run: a choice; beyond it is a jump."""

LONGEST_STEP = 3.0
"""Time [s] between two looks up to which a node was at work: a choice, above the period of its
slowest timer."""

TOLD_TIME = 60.0
"""Time [s] for which a jump is told: a choice, for a person to see it."""


def safety_clock() -> Clock:
    """Return the clock of timers and time-outs: it cannot be set, and no simulation stops it."""
    return Clock(clock_type=ClockType.STEADY_TIME)


def seconds(clock: Clock) -> float:
    """Return the time of a clock [s]."""
    return float(clock.now().nanoseconds) * 1e-9


class WorkingTime:
    """The time [s] in which a node was at work, to tell who is late by.

    A node that stood still heard nobody: of a pause between two looks `LONGEST_STEP` counts.

    Parameters
    ----------
    clock : callable
        Returns the time [s] of a clock that never goes back.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._last, self._missed = clock, clock(), 0.0

    def __call__(self) -> float:
        """Return it; to be asked more often than `LONGEST_STEP`."""
        now = self._clock()
        self._missed += max(now - self._last - LONGEST_STEP, 0.0)
        self._last = now
        return now - self._missed


class ClockComparison:
    """Compares a clock with a steady one.

    Attributes
    ----------
    problem : str
        What is wrong with the clock; empty if nothing.
    """

    def __init__(self) -> None:
        self.problem = ''
        self._last: tuple[float, float] | None = None
        self._went_at = self._jumped_at = -math.inf

    def look(self, time: float, steady: float, simulated: bool) -> None:
        """Take the times [s] of both clocks at one moment."""
        if self._last is None:
            self._went_at = steady
        else:
            step, real = time - self._last[0], steady - self._last[1]
            # Simulated time may run at any pace, even stand for a while, but never back.
            least, most = (0.0, FASTEST_SIMULATION * real) if simulated else (real, real)
            if step:
                self._went_at = steady
            # The first time that is heard of a simulation, or its last, is no jump.
            if not least - JUMP <= step <= most + JUMP and 0.0 not in (time, self._last[0]):
                self._jumped_at = steady
                self.problem = f'the clock jumped by {step - (0.0 if simulated else real):+.1f} s'
        self._last = time, steady
        if steady - self._went_at >= STANDING_TIME:
            self.problem = 'the clock stands'
        elif self.problem and steady - self._jumped_at >= TOLD_TIME:
            self.problem = ''


class ClockWatch(ClockComparison):
    """Watches the clock of a node, which the messages of others are stamped with, too."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        self._node, self._steady = node, safety_clock()
        node.create_timer(WATCH_PERIOD, self._look, clock=self._steady)

    def _look(self) -> None:
        before = self.problem
        simulated = bool(self._node.get_parameter('use_sim_time').value)
        self.look(seconds(self._node.get_clock()), seconds(self._steady), simulated)
        if self.problem and self.problem != before:
            self._node.get_logger().warning(self.problem)
