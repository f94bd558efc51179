"""The battery over the time, beside what the mission's energy model expects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from uav_mission_manager.cli.mission_report.flight_record import AirTime, FlightRecord
from uav_mission_manager.cli.mission_report.page import clock
from uav_mission_manager.cli.mission_report.story import StoryRow
from uav_mission_manager.mdp import Energy
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR

CHART_WIDTH, CHART_HEIGHT, CHART_LEFT, CHART_TOP = 900, 240, 44, 22
"""Size of the picture and of its margins, in its own units."""

MOST_CHARGES = 1500
"""Points of the line of charge: a choice, more than a page has dots."""

MARK_ROOM = 16.0
"""Least distance of two numbers of commands in the picture."""

CHARGE_STYLE = """
.charge .air{fill:#dce8f4}.charge .measured{fill:none;stroke:var(--craft);stroke-width:2.2}
.charge .plan{fill:none;stroke:var(--danger);stroke-width:1.8;stroke-dasharray:6 4}
.charge .axis{stroke:var(--line);fill:none}.charge text{font-size:12px;text-anchor:start;
fill:var(--dim)}
.charge .at{stroke:var(--dim);stroke-width:.7;stroke-dasharray:1 3}
.charge text.mark{fill:var(--craft);font-weight:700}
"""


@dataclass(frozen=True)
class LegCharge:
    """What one time in the air took of the battery.

    Attributes
    ----------
    leg : AirTime
    first, last : float
        Charge at its beginning and end, 0 to 1.
    drawn, planned : float
        Energy [Wh]: by the change of the charge, and by the power of the mission.
    """

    leg: AirTime
    first: float
    last: float
    drawn: float
    planned: float


def leg_charges(record: FlightRecord, energy: Energy) -> list[LegCharge]:
    """Return what each time in the air took; none where the charge was never heard."""
    if not record.charges:
        return []
    full, found = energy.capacity * energy.voltage, []
    for leg in record.legs:
        first, last = map(record.charge_at, leg)
        hours = (leg.end - leg.start) / SECONDS_PER_HOUR
        found.append(LegCharge(leg, first, last, (first - last) * full, hours * energy.power))
    return found


def charge_svg(record: FlightRecord, energy: Energy | None, commands: Sequence[StoryRow]) -> str:
    """Draw the charge over the time, with the plan from each take-off on and the commands."""
    end = max(record.end, 1e-9)

    def x(at: float) -> float:
        return CHART_LEFT + (CHART_WIDTH - CHART_LEFT - 10) * at / end

    def y(charge: float) -> float:
        return CHART_TOP + (CHART_HEIGHT - CHART_TOP - 24) * (1.0 - charge)

    parts = [
        f'<svg class="charge" viewBox="0 0 {CHART_WIDTH} {CHART_HEIGHT}" role="img" '
        'aria-label="charge of the battery over the time">'
    ]
    for leg in record.legs:
        width = x(leg.end) - x(leg.start)
        parts.append(
            f'<rect class="air" x="{x(leg.start):.1f}" y="{CHART_TOP}" width="{width:.1f}" '
            f'height="{y(0.0) - CHART_TOP:.1f}"/>'
        )
    for charge in (0.0, 0.25, 0.5, 0.75, 1.0):
        parts.append(f'<path class="axis" d="M{CHART_LEFT} {y(charge):.1f}H{CHART_WIDTH - 10}"/>')
        parts.append(f'<text x="4" y="{y(charge) + 4:.1f}">{charge:.0%}</text>')
    for share in range(7):
        at = end * share / 6
        left = min(x(at), CHART_WIDTH - 40)
        parts.append(f'<text x="{left:.1f}" y="{CHART_HEIGHT - 6}">{clock(at)}</text>')
    parts += _marks(commands, x, y(0.0))
    plan = []
    if energy is not None:
        for each in leg_charges(record, energy):
            last = each.first - each.planned / (energy.capacity * energy.voltage)
            start, stop = each.leg
            plan.append(
                f'<path class="plan" d="M{x(start):.1f} {y(each.first):.1f}'
                f'L{x(stop):.1f} {y(max(last, 0.0)):.1f}"/>'
            )
    line = ' '.join(f'{x(at):.1f},{y(charge):.1f}' for at, charge in _thinned(record.charges))
    measured = f'<polyline class="measured" points="{line}"/>'
    return ''.join((*parts, measured, *plan, '</svg>'))


def _thinned(charges: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """Leave out what lies between equal charges, and of very many all but some."""
    step = max(len(charges) // MOST_CHARGES, 1)
    for place, (at, charge) in enumerate(charges):
        same = 0 < place < len(charges) - 1 and (
            charges[place - 1][1] == charge == charges[place + 1][1]
        )
        if not same and (place % step == 0 or place == len(charges) - 1):
            yield at, charge


def _marks(
    commands: Sequence[StoryRow], x: Callable[[float], float], bottom: float
) -> Iterator[str]:
    """Number the commands along the top, as many as there is room for."""
    last = -MARK_ROOM
    for row in commands:
        place = x(row.at)
        yield f'<path class="at" d="M{place:.1f} {CHART_TOP}V{bottom:.1f}"/>'
        if place - last >= MARK_ROOM:
            yield f'<text class="mark" x="{place - 4:.1f}" y="{CHART_TOP - 6}">{row.number}</text>'
            last = place
