"""Where the manager waited before something counted: the end of a danger, a change of mind."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from uav_mission_manager.cli.mission_report.flight_record import FlightRecord
from uav_mission_manager.cli.mission_report.page import clock
from uav_mission_manager.console.heard import HeardDecision
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS

CHARGE_JUMP = 0.1
"""Change of the charge between two messages that is told: a choice, minutes of flight."""


def charge_jumps(record: FlightRecord) -> Iterator[tuple[float, float, float]]:
    """Yield where the charge jumps: when, from and to which charge."""
    for (_, was), (at, charge) in pairwise(record.charges):
        if abs(charge - was) >= CHARGE_JUMP:
            yield at, was, charge


def ends_of_dangers(record: FlightRecord) -> Iterator[tuple[float, str]]:
    """Yield when a danger ceased to count, where its end had been heard some time before."""
    decided, lost = [each for each in record.decided if each.decision.state], 0.0
    for (_, before), (at, after) in pairwise(decided):
        if _fewer(after, before):
            lost = at
        ended = [*_ended(record, before, after)]
        if _fewer(before, after) and before.levels == 1:  # A charge in the state does not wait.
            risen = [t for t, old, new in charge_jumps(record) if new > old and t > lost]
            ended.append(('the new charge counts now: heard', risen))
        for text, heard in ended:
            times = [t for t in heard if t <= at]
            if times and at - times[-1] > record.slack:
                yield at, f'{text} at {clock(times[-1])}, {at - times[-1]:.0f} s before'


def _ended(
    record: FlightRecord, before: HeardDecision, after: HeardDecision
) -> Iterator[tuple[str, list[float]]]:
    """Yield each danger that counts less than before, and when its end was heard."""
    was, now = before.named, after.named
    if now.t < was.t:
        threat = THREAT_LEVELS[now.t]
        yield f'threat {threat} counts now: heard', _told(record, f'threat heard: {threat}')
    failed, fails = int(was.f) - 1, int(now.f) - 1
    if fails != failed and fails & failed == fails:
        fault = f'fault mode {FAULT_MODES[fails]}'
        yield f'{fault} counts now: heard', _told(record, fault)


def _fewer(first: HeardDecision, second: HeardDecision) -> bool:
    """Whether a goal that is in range at the second was not at the first."""
    return any(r < other for r, other in zip(first.in_range, second.in_range))


def _told(record: FlightRecord, text: str) -> list[float]:
    return [each.at for each in record.happened if each.line.text == text]
