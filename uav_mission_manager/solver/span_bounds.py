"""Bounds on a fixed point W* = T W* from the change that one backup makes.

T is monotone and shifts with constants, T(W + c) = T W + discount c, as a Bellman backup does,
greedy or of a fixed policy. With d = T W - W (MacQueen 1966; Puterman 1994, theorem 6.6.3)

    T W + gain min(d) <= W* <= T W + gain max(d),    gain = discount / (1 - discount).

So the sweeps stop when the span max(d) - min(d) is small, long before the values stand still, and
the result is shifted to the middle of its bounds. In exact arithmetic the span shrinks by the
discount at least. Where rounding adds at most e to an entry of T W, it adds at most
e / (1 - discount) to the bounds.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SpanBounds:
    """Bounds from the least and the largest change of a backup.

    Attributes
    ----------
    low, high : float
        min(d) and max(d).
    discount : float
    """

    low: float
    high: float
    discount: float

    @property
    def span(self) -> float:
        """max(d) - min(d)."""
        return self.high - self.low

    @property
    def gain(self) -> float:
        """The factor discount / (1 - discount)."""
        return self.discount / (1 - self.discount)

    @property
    def middle(self) -> float:
        """What to add to T W for the middle of its bounds."""
        return self.gain * (self.high + self.low) / 2

    @property
    def distance(self) -> float:
        """Largest distance of W* from that middle, but for rounding."""
        return self.gain * self.span / 2

    @property
    def residual(self) -> float:
        """Sup norm of the change beyond a constant."""
        return self.span / 2

    @property
    def lowest(self) -> float:
        """What to add to T W for the lower bound."""
        return self.gain * self.low

    def stalled(self, previous: float) -> bool:
        """Whether the span shrank from `previous` by less than exact arithmetic guarantees."""
        return not self.span <= (1 + self.discount) / 2 * previous

    def accumulated(self, rounding: float) -> float:
        """What a rounding error of at most `rounding` in every backup adds to the bounds."""
        return rounding / (1 - self.discount)
