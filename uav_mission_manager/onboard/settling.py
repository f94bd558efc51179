"""Inputs settle before they count: quickly towards danger, slowly away from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace

FAULT_DANGERS = ('sensor', 'actuator', 'camera')
"""The dangers of a fault mode f: one for each bit of f - 1, from the lowest."""

THREAT_DANGERS = ('threat low', 'threat high')
"""The dangers of a threat t: the first t of them."""


@dataclass(frozen=True)
class Dangers:
    """Dangers by name. One counts as soon as it is reported, and for a while after its end.

    Attributes
    ----------
    reported : set of str
        Those that were there when last reported on.
    ended : mapping of str to float
        Time [s] since when another one, that counts still, is there no more.
    """

    reported: frozenset[str] = frozenset()
    ended: Mapping[str, float] = field(default_factory=dict)

    @property
    def counted(self) -> frozenset[str]:
        """Those to reckon with."""
        return self.reported.union(self.ended)

    def report(self, there: Set[str], among: Set[str], now: float) -> Dangers:
        """Take which of the dangers `among` are there; of the others nothing is said."""
        over = (self.reported & among) - there
        ended = {name: time for name, time in self.ended.items() if name not in there}
        return Dangers((self.reported - among) | there, {**ended, **dict.fromkeys(over, now)})

    def without(self, gone: Set[str]) -> Dangers:
        """Forget dangers of what is there no more."""
        ended = {name: time for name, time in self.ended.items() if name not in gone}
        return Dangers(self.reported - gone, ended)

    def settle(self, now: float, seconds: float) -> Dangers:
        """Forget those that ended `seconds` ago; a time to come is that of another boot."""
        ended = {name: min(time, now) for name, time in self.ended.items()}
        return Dangers(self.reported, {n: t for n, t in ended.items() if now - t < seconds})


@dataclass(frozen=True)
class GoalRequest:
    """Priorities that are asked for, and the id of the request."""

    priorities: tuple[int, ...]
    id: str


@dataclass(frozen=True)
class Wish:
    """What is asked for and does not count yet.

    Attributes
    ----------
    pending : GoalRequest or None
    changed_at : float
        Time [s] of the last change of what is asked for, whether it counts or not.
    """

    pending: GoalRequest | None = None
    changed_at: float = -math.inf

    def lasts(self, now: float, seconds: float) -> bool:
        """Whether the last change is `seconds` ago."""
        return now - self.changed_at >= seconds

    def settle(self, now: float) -> Wish:
        """Take a time to come for that of another boot."""
        return replace(self, changed_at=min(self.changed_at, now))
