"""What is to happen when."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable


class Agenda:
    """Actions at their times [s]."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._due: list[tuple[float, int, Callable[[], object]]] = []
        self._count = 0
        self.now = 0.0

    def at(self, time: float, action: Callable[[], object]) -> None:
        """Do something at a time."""
        self._count += 1
        heapq.heappush(self._due, (time, self._count, action))

    def after(self, shortest: float, longest: float, action: Callable[[], object]) -> None:
        """Do something so many seconds from now."""
        self.at(self.now + self._rng.uniform(shortest, longest), action)

    def run(self, now: float) -> None:
        """Do what is due."""
        self.now = now
        while self._due and self._due[0][0] <= now:
            heapq.heappop(self._due)[2]()

    def finish(self) -> None:
        """Do all that is left, now."""
        while self._due:
            heapq.heappop(self._due)[2]()
