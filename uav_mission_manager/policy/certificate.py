"""What a policy set proves of its policy's cost; `uav_mission_manager.policy.certify` makes it."""

from __future__ import annotations

from dataclasses import dataclass

from uav_mission_manager.solver import LowerBound


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
        Mean of V^pi / L - 1 over the states looked at, and its standard error; None where L is 0
        in one of them that costs something.
    """

    bound: LowerBound
    offset: float
    coverage: float
    confidence: float
    gap: float | None
    gap_error: float | None

    @property
    def holds(self) -> str:
        """Where the upper bound holds, in words."""
        if self.coverage == 1:
            return 'everywhere'
        return f'in {self.coverage:.1%} of states, confidence {self.confidence:.0%}'
