"""Where the manager waited before something counted: the end of a danger, a change of mind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

from uav_mission_manager.cli.mission_report.flight_record import FlightRecord
from uav_mission_manager.cli.mission_report.page import clock
from uav_mission_manager.console.heard import HeardDecision
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS

CHARGE_JUMP = 0.1
"""Change of the charge between two messages that is told: a choice, minutes of flight."""

News = Callable[[HeardDecision, HeardDecision], tuple[str, ...]]
"""What has changed between two decisions, in words."""


def charge_jumps(record: FlightRecord) -> Iterator[tuple[float, float, float]]:
    """Yield where the charge jumps: when, from and to which charge."""
    for (_, was), (at, charge) in pairwise(record.charges):
        if abs(charge - was) >= CHARGE_JUMP:
            yield at, was, charge


def ends_of_dangers(record: FlightRecord, news: News) -> Iterator[tuple[float, str]]:
    """Yield when a danger ceased to count, where its end had been heard some time before."""
    decided = [each for each in record.decided if each.decision.state]
    for (_, before), (at, after) in pairwise(decided):
        for text, heard in _ended(record, before, after, news):
            times = [t for t in heard if t <= at]
            if times and at - times[-1] > record.slack:
                yield at, f'{text} at {clock(times[-1])}, {at - times[-1]:.0f} s before'


def _ended(
    record: FlightRecord, before: HeardDecision, after: HeardDecision, news: News
) -> Iterator[tuple[str, list[float]]]:
    """Yield each danger that counts less than before, and when its end was heard."""
    was, now = before.state, after.state
    if now[-2] < was[-2]:
        threat = THREAT_LEVELS[now[-2]]
        yield f'threat {threat} counts now: heard', _told(record, f'threat heard: {threat}')
    failed, fails = was[0] - 1, now[0] - 1
    if fails != failed and fails & failed == fails:
        fault = f'fault mode {FAULT_MODES[fails]}'
        yield f'{fault} counts now: heard', _told(record, fault)
    if any(text.startswith('in range again') for text in news(before, after)):
        risen = [at for at, old, new in charge_jumps(record) if new > old]
        yield 'the new charge counts now: heard', risen


def _told(record: FlightRecord, text: str) -> list[float]:
    return [each.at for each in record.happened if each.line.text == text]
