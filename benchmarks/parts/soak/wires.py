"""What lies between the processes: datagrams that get lost, late, twice; messages in order."""

from __future__ import annotations

import heapq
import random
from collections import deque
from dataclasses import dataclass
from typing import Any

HEADER = 10
"""Bytes of a MAVLink 2 header, which noise spares: a wrong length swallows the next frames."""


@dataclass(frozen=True)
class Quality:
    """How bad a wire is.

    Attributes
    ----------
    loss, twice, noise : float
        Probability that a datagram is lost, is duplicated, has a wrong byte.
    delay : float
        Longest time on the way [s]; each takes its own, so they overtake each other.
    """

    loss: float = 0.0
    twice: float = 0.0
    noise: float = 0.0
    delay: float = 0.02


class Wire:
    """Datagrams one way.

    Attributes
    ----------
    quality : Quality
    cut : bool
        Whether nothing gets through.
    """

    def __init__(self, rng: random.Random) -> None:
        self.quality, self.cut = Quality(), False
        self._rng = rng
        self._on_the_way: list[tuple[float, int, Any, bytes]] = []
        self._count = 0

    def send(self, label: Any, data: bytes, now: float) -> None:
        """Send a datagram; the label is for who watches, None where the data are spoilt."""
        quality, rng = self.quality, self._rng
        if self.cut or rng.random() < quality.loss:
            return
        if rng.random() < quality.noise:
            place = rng.randrange(HEADER, len(data))
            data = data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]
            label = None
        for _ in range(2 if rng.random() < quality.twice else 1):
            self._count += 1
            due = now + rng.uniform(0.0, quality.delay)
            heapq.heappush(self._on_the_way, (due, self._count, label, data))

    def arrived(self, now: float) -> list[tuple[Any, bytes]]:
        """Return what has come through, with its labels."""
        found = []
        while self._on_the_way and self._on_the_way[0][0] <= now:
            _, _, label, data = heapq.heappop(self._on_the_way)
            if not self.cut:
                found.append((label, data))
        return found


class Topic:
    """Messages from one process to one other, in order, as DDS keeps them.

    Parameters
    ----------
    rng : random.Random
    loss : float
        Probability that a message is lost, where its quality of service allows that.
    depth : int
        Messages kept for a reader that is late, at most.
    latched : bool
        Whether a reader that comes later hears the last message of a writer that lives.
    """

    def __init__(
        self, rng: random.Random, loss: float = 0.0, depth: int = 5, *, latched: bool = False
    ) -> None:
        self._rng, self._loss, self._latched = rng, loss, latched
        self._last: Any = None
        self._due = 0.0
        self._on_the_way: deque[tuple[float, Any]] = deque(maxlen=depth)

    def publish(self, message: Any, now: float) -> None:
        """Send a message: within milliseconds mostly, half a second now and then."""
        self._last = message
        if self._rng.random() < self._loss:
            return
        slow = self._rng.random() < 0.01
        self._due = max(self._due, now + self._rng.uniform(0.0, 0.5 if slow else 0.02))
        self._on_the_way.append((self._due, message))

    def take(self, now: float) -> list[Any]:
        """Return what has arrived."""
        found = []
        while self._on_the_way and self._on_the_way[0][0] <= now:
            found.append(self._on_the_way.popleft()[1])
        return found

    def reader_starts(self, now: float) -> None:
        """Begin with nothing but what is latched."""
        self._on_the_way.clear()
        if self._latched and self._last is not None:
            self._on_the_way.append((now, self._last))

    def writer_dies(self) -> None:
        """Forget what was latched."""
        self._last = None
