"""What a policy set proves of its policy's cost; `uav_mission_manager.policy.certify` makes it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from uav_mission_manager.solver.bounds import LowerBound


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
    """

    bound: LowerBound
    offset: float
    coverage: float
    confidence: float
    gap: float | None
    gap_error: float | None
    flown_gap: float | None
    flown_gap_error: float | None

    @property
    def holds(self) -> str:
        """Where the upper bound holds, in words."""
        if self.coverage == 1:
            return 'everywhere'
        return f'in {self.coverage:.1%} of states, confidence {self.confidence:.0%}'

    def summary(self) -> dict[str, Any]:
        """Return its numbers by name, without the bound's tables."""
        names = [field.name for field in fields(self) if field.name != 'bound']
        return {name: getattr(self, name) for name in names}
