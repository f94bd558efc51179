"""The numbers of faults in a mission file, of polynomials of measured effectiveness.

A healthy part has an effectiveness of 100 %, and a failed one another, the same for all parts:

    completion(nominal)    mean of the parts' polynomials at 100 %
    completion(f)          completion(nominal) times completion(part) / completion(nominal), of
                           each failed part, as if they hindered each other in nothing
    cost(f)                sum of cost(part) of the failed parts
    rate of a part         its failures an hour at 100 %

Of a part that was not measured, the mission file says completion(part) and cost(part).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from uav_mission_manager.learning.calibration import WHOLE, PolynomialFit
from uav_mission_manager.learning.estimates import Path, field_name
from uav_mission_manager.learning.measurements import MEASURED_PARTS
from uav_mission_manager.learning.posterior import Posterior
from uav_mission_manager.mdp import FAULT_MODES, Mission
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR
from uav_mission_manager.solver.evaluation.forecast import epoch_length

Fits = Mapping[tuple[str, str], PolynomialFit]
"""Polynomials by part and quantity."""


@dataclass(frozen=True)
class FaultNumber:
    """One number of the section `faults`.

    Attributes
    ----------
    path : tuple of str and int
        Its field.
    found : Posterior
        What the polynomials give, with an interval where one polynomial gives it alone.
    value : float
        What a mission file may have of it, in the field's unit.
    old : float
        What the file has.
    clipped : str
        Which limit it was brought to; empty if it lies within.
    fit : PolynomialFit or None
        The polynomial that gives it alone.
    extrapolated : bool
        Whether a polynomial was read beyond what was measured.
    """

    path: Path
    found: Posterior
    value: float
    old: float
    clipped: str
    fit: PolynomialFit | None
    extrapolated: bool

    @property
    def field(self) -> str:
        """Its name, such as `faults.completion[1]`."""
        return field_name(self.path)


def fault_numbers(
    fits: Fits, mission: Mission, data: Mapping[str, Any], failed_at: float
) -> list[FaultNumber]:
    """Return the numbers of a mission file that the polynomials give.

    Parameters
    ----------
    fits : mapping
    mission, data : Mission, mapping
        The mission and its file, as it was read.
    failed_at : float
        Effectiveness [%] of a failed part.

    Raises
    ------
    Bad
        If the length of an epoch is needed and the file does not tell it.
    """
    return [
        *_completions(fits, mission, data['faults'], failed_at),
        *_rates(fits, mission, data['faults']),
        *_costs(fits, mission, data['faults'], failed_at),
    ]


def _completions(
    fits: Fits, mission: Mission, given: Mapping[str, Any], failed_at: float
) -> Iterator[FaultNumber]:
    known = {
        part: fits[part, 'completion'] for part in MEASURED_PARTS if (part, 'completion') in fits
    }
    if not known:
        return
    old = mission.faults.completion
    whole = [fit(WHOLE) for fit in known.values()]
    nominal = Posterior(*(sum(numbers) / len(whole) for numbers in zip(*whole)))
    possible, _ = _clipped(nominal.value, 0.0, 1.0)
    ratios = [
        _ratio(_clipped(known[part](failed_at).value, 0.0, 1.0)[0], possible)
        if part in known
        else _ratio(old[1 << bit], old[0])
        for bit, part in enumerate(MEASURED_PARTS)
    ]
    key = 'done_in' if 'done_in' in given else 'completion'
    for f in range(len(FAULT_MODES)):
        failed = [bit for bit in range(len(MEASURED_PARTS)) if f >> bit & 1]
        if failed and not any(MEASURED_PARTS[bit] in known for bit in failed):
            continue
        fit = _alone(known, failed)
        value = possible * math.prod(ratios[bit] for bit in failed)
        found = fit(failed_at) if fit else Posterior(value, math.nan, math.nan)
        if not failed:
            found = nominal
        clipped, limit = _clipped(found.value, 0.0, 1.0)
        at = failed_at if failed else WHOLE
        beyond = any(known[p].extrapolates(at) for p in _measured(known, failed))
        written = clipped
        if key == 'done_in':
            written = epoch_length(mission) / clipped if clipped else math.inf
        path: Path = ('faults', key, f)
        before = math.inf if given[key][f] == 'never' else float(given[key][f])
        yield FaultNumber(path, found, written, before, limit, fit, beyond)


def _measured(known: Mapping[str, PolynomialFit], failed: Sequence[int]) -> list[str]:
    """Return the parts whose polynomials a fault mode is of; all of them where none failed."""
    return [part for part in known if not failed or MEASURED_PARTS.index(part) in failed]


def _alone(known: Mapping[str, PolynomialFit], failed: Sequence[int]) -> PolynomialFit | None:
    return known.get(MEASURED_PARTS[failed[0]]) if len(failed) == 1 else None


def _ratio(value: float, of: float) -> float:
    return value / of if of else 0.0


def _rates(fits: Fits, mission: Mission, given: Mapping[str, Any]) -> Iterator[FaultNumber]:
    key = 'mtbf' if 'mtbf' in given else 'rate'
    for part in MEASURED_PARTS:
        fit = fits.get((part, 'failures_per_hour'))
        if fit is None:
            continue
        found, old = fit(WHOLE), float(given[key][part])
        rate, limit = _clipped(found.value, 0.0, math.inf)
        if key == 'rate':
            value = -math.expm1(-rate * epoch_length(mission) / SECONDS_PER_HOUR)
        elif rate:
            value = 1 / rate
        else:
            value, limit = old, 'the old one: a mean time has an end'
        beyond = fit.extrapolates(WHOLE)
        yield FaultNumber(('faults', key, part), found, value, old, limit, fit, beyond)


def _costs(
    fits: Fits, mission: Mission, given: Mapping[str, Any], failed_at: float
) -> Iterator[FaultNumber]:
    known = {part: fits[part, 'cost'] for part in MEASURED_PARTS if (part, 'cost') in fits}
    old = [float(value) for value in given['cost']]
    costs = [
        known[part](failed_at).value if part in known else old[1 << bit]
        for bit, part in enumerate(MEASURED_PARTS)
    ]
    for f in range(1, len(FAULT_MODES)):
        failed = [bit for bit in range(len(MEASURED_PARTS)) if f >> bit & 1]
        if not any(MEASURED_PARTS[bit] in known for bit in failed):
            continue
        fit, value = _alone(known, failed), sum(costs[bit] for bit in failed)
        found = fit(failed_at) if fit else Posterior(value, math.nan, math.nan)
        clipped, limit = _clipped(value, 0.0, math.inf)
        beyond = any(known[p].extrapolates(failed_at) for p in _measured(known, failed))
        yield FaultNumber(('faults', 'cost', f), found, clipped, old[f], limit, fit, beyond)


def _clipped(value: float, low: float, high: float) -> tuple[float, str]:
    clipped = min(max(value, low), high)
    return clipped, '' if clipped == value else f'{clipped:g}'
