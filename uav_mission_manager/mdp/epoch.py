"""What happens in an hour or lasts for seconds, as probabilities of an epoch.

An epoch is a step from one cell to the next, or a stay of the same length:

    length = cell_size / speed                                                  [s]

There are two rules, both without memory, as the model has to be:

    an event that comes with a rate lambda     p = 1 - exp(-lambda * length)
    a state that lasts for a mean D            p = length / D

The first is the probability that a Poisson process has an event in an epoch. By the second the
state lasts for a geometric number of epochs with the mean D / length, so what it costs is what it
costs in the D seconds that it is meant to last. Sampling an exponential duration at the end of
each epoch would round it up, by half an epoch in the mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from uav_mission_manager.mdp.fields import Bad
from uav_mission_manager.mdp.mission import Row

SECONDS_PER_MINUTE = 60.0
"""Seconds in a minute: costs of a person's making are per minute."""

SECONDS_PER_HOUR = 3600.0
"""Seconds in an hour: rates are per hour, and the capacity of a battery is in ampere hours."""

LIKELIEST_EVENT = 0.5
"""Largest probability of an event that a rate may give: a choice. Above it several a epoch are
frequent, and the model knows of one."""


@dataclass(frozen=True)
class Epoch:
    """The length of an epoch, and what it makes of rates, durations and costs.

    All methods raise `Bad` where the length is unknown, or too great for the number.

    Attributes
    ----------
    cell_size : float
        Width of a cell [m].
    speed : float or None
        Cruise speed [m/s], None if it is unknown.
    """

    cell_size: float
    speed: float | None

    @property
    def length(self) -> float:
        """Length of an epoch [s]."""
        if self.speed is None:
            raise Bad('needs energy.speed, by which the length of an epoch is known')
        length = self.cell_size / self.speed
        if not 0 < length < math.inf:
            raise Bad(f'cannot be had per epoch of {length:g} s')
        return length

    def __str__(self) -> str:
        """Say how long it is, and why."""
        return f'an epoch of {self.length:.6g} s ({self.cell_size:g} m at {self.speed:g} m/s)'

    def event(self, per_hour: float) -> float:
        """Return the probability that a Poisson process has an event in an epoch.

        Raises `Bad` where it is above `LIKELIEST_EVENT`.
        """
        probability = -math.expm1(-per_hour * (self.length / SECONDS_PER_HOUR))
        if probability > LIKELIEST_EVENT:
            raise Bad(
                f'{per_hour:.6g} an hour is a probability of {probability:.3g} in {self}, '
                f'above {LIKELIEST_EVENT:g}: too coarse'
            )
        return _rounded(probability)

    def failure(self, mean_hours: float) -> float:
        """Return the probability that a part fails in an epoch, of its mean time to it [h]."""
        return self.event(1 / mean_hours)

    def jump(self, level: int, per_hour: Sequence[float]) -> Row:
        """Return the probabilities of each level after an epoch.

        Events come independently, each with a rate [1/h] and a level to which it leads; the first
        one in the epoch counts.

        Parameters
        ----------
        level : int
            The level before.
        per_hour : sequence of float
            Rates by the level that they lead to; that of `level` itself is 0.
        """
        total = sum(per_hour)
        probability = self.event(total)
        row = [probability * rate / total if rate else 0.0 for rate in per_hour]
        row[level] = 1 - probability
        return tuple(row)

    def end(self, mean: float) -> float:
        """Return the probability that what lasts for a mean time [s] ends with an epoch.

        Raises `Bad` where the mean is shorter than an epoch.
        """
        if mean < self.length:
            raise Bad(f'{mean:.6g} s is shorter than {self}')
        return _rounded(self.length / mean)

    def minute(self, cost: float) -> float:
        """Return what an epoch costs of a cost per minute."""
        scaled = cost * (self.length / SECONDS_PER_MINUTE)
        if not math.isfinite(scaled):
            raise Bad(f'{cost:.6g} a minute is too large for {self}')
        return scaled


def _rounded(probability: float) -> float:
    """Round to 12 digits: the last ones of an exponential differ between processors."""
    return float(f'{probability:.12g}')
