"""What a policy set proves of its policy's cost; `uav_mission_manager.policy.certify` makes it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from uav_mission_manager.solver.bounds import LowerBound

LARGE_MEAN_GAP = 0.15
"""Mean gap above which a certificate warns; a choice: twice that of ten goals."""

LARGE_GAP = 0.25
"""Gap in a single state above which it warns. Measured: 0.07 to 0.11 in sound expansions of three
goals, 0.57 in one that loses 16 % somewhere."""

SHOWN_DIFFERENCE = 1e-4
"""Difference of two gaps from which on they are shown differently."""


def gap_text(gap: float | None) -> str:
    """Say how large a gap is proved to be, at most; None is not proved."""
    return 'not known' if gap is None else f'{gap:.2%}'


def worsening(gap: str, was: float | None, now: float | None) -> str:
    """Say so if a gap is proved to be larger now, or not any more; '' if it is not."""
    if was is None or (now is not None and now < was + SHOWN_DIFFERENCE):
        return ''
    return f'the {gap} is certified worse, {gap_text(now)} for {gap_text(was)}'


@dataclass(frozen=True)
class Certificate:
    """Bounds on V* and V^pi.

    Attributes
    ----------
    bound : LowerBound
    offset : float
        V^pi(s) <= V'(s) + offset.
    coverage, confidence : float
        In at least this share of the states, with this confidence; 1 by exact evaluation.
    gap, gap_error : float or None
        Mean of V^pi / L - 1 over evenly drawn states, and its standard error; None where L is 0
        in one of them that costs something.
    flown_gap, flown_gap_error : float or None
        The same over the states that are flown: the policy's discounted occupancy from base.
    largest_gap : float or None
        Largest V^pi / L - 1 of all states, by exact evaluation; None where that was not made.
    """

    bound: LowerBound
    offset: float
    coverage: float
    confidence: float
    gap: float | None
    gap_error: float | None
    flown_gap: float | None
    flown_gap_error: float | None
    largest_gap: float | None

    @property
    def holds(self) -> str:
        """Where the upper bound holds, in words."""
        if self.coverage == 1:
            return 'everywhere'
        return f'in {self.coverage:.1%} of states, confidence {self.confidence:.0%}'

    @property
    def warning(self) -> str:
        """Why the policy may be far from the optimum, empty where it is shown to be near."""
        gaps = [gap for gap in (self.gap, self.flown_gap) if gap is not None]
        if not gaps:
            return (
                'the certificate shows nothing: its lower bound is 0 where the policy costs more'
            )
        largest = self.largest_gap or 0.0
        if max(gaps) <= LARGE_MEAN_GAP and largest <= LARGE_GAP:
            return ''
        worst = f', {largest:.0%} in the worst state' if largest else ''
        return (
            'the certificate cannot show that the policy is near the optimum: the gap is '
            f'{max(gaps):.0%} on average{worst}; try a higher order, or method exact if it fits'
        )

    def summary(self) -> dict[str, Any]:
        """Return its numbers by name, without the bound's tables."""
        names = [field.name for field in fields(self) if field.name != 'bound']
        return {name: getattr(self, name) for name in names}
