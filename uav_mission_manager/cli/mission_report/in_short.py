"""The first lines of a flight's report: what became of what was asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape

from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.cli.mission_report.account import Account
from uav_mission_manager.cli.mission_report.flight_record import FlightRecord
from uav_mission_manager.cli.mission_report.goals_done import Expectation, WantedGoal
from uav_mission_manager.cli.mission_report.page import clock
from uav_mission_manager.cli.mission_report.story import CHARGE_JUMP, Names, StoryRow
from uav_mission_manager.console.map_overlay import PRIORITY_WORDS
from uav_mission_manager.echo import shown

JUST_BEFORE = 10.0
"""Time [s] within which a jump of the charge is told with what followed: a choice."""


TURNS = {
    'RECHARGE': 'It went to recharge',
    'GO FOR REPAIR': 'It went for repair',
    'EVAD': 'It flew agile, for a threat',
}
"""What is told of commands with such a word."""

MOST_TURNS = 12
"""Commands that are told here, at most: a choice; the story has all."""


def in_short(
    record: FlightRecord,
    commands: Sequence[StoryRow],
    found: Sequence[WantedGoal],
    names: Names,
    account: Account | None,
) -> str:
    """Return the flight in a few lines: what was done, why it turned back, who was in command."""
    air = sum(leg.end - leg.start for leg in record.legs)
    lines = [
        f'In the air {_times(len(record.legs))}, for {clock(air)} min in all; '
        f'{record.way():,.0f} m of track.'
    ]
    done = [f'{shown(name, 60)} at {clock(at)}' for at, name in record.completed]
    lines.append(f'Done: {", ".join(done) or "nothing"}.')
    missed = [
        names[r.goal] + (f' (given up at {clock(r.over)})' if math.isfinite(r.over) else '')
        for r in found
        if not r.done
    ]
    if missed:
        lines.append(f'Asked for and not done: {", ".join(missed)}.')
    lines += _turns(record, commands)
    if record.refused:
        refused = ', '.join(f'{shown(n, 60)} at {clock(at)}' for at, n in record.refused)
        lines.append(f'Out of reach, or failed: {refused}.')
    lines.append(_who(record))
    if account is not None:
        total = account.paid + account.left
        lines.append(
            f'Cost {total:.1f}, and {account.expected:.1f} were expected at the beginning; '
            'the last section says what made the difference.'
        )
    return f'<ul>{"".join(f"<li>{escape(line)}</li>" for line in lines)}</ul>'


def _times(count: int) -> str:
    return {0: 'never', 1: 'once', 2: 'twice'}.get(count, f'{count} times')


def _turns(record: FlightRecord, commands: Sequence[StoryRow]) -> Iterator[str]:
    """Say where it broke off, or flew agile, and why."""
    turns = []
    for row in commands:
        for word, what in TURNS.items():
            if word in row.text:
                charge = f'; {_charge(record, row.at)}' if word == 'RECHARGE' else ''
                turns.append(
                    f'{clock(row.at)} {what}: {row.reason}{charge}. Second best: {row.second}.'
                )
    yield from turns[:MOST_TURNS]
    if len(turns) > MOST_TURNS:
        yield f'{len(turns) - MOST_TURNS:,} more times it recharged, was repaired or flew agile.'


def _charge(record: FlightRecord, at: float) -> str:
    """Say the charge at a time, and where it had jumped just before."""
    now, before = record.charge_at(at), record.charge_at(at - JUST_BEFORE)
    jumped = abs(now - before) >= CHARGE_JUMP
    text = f'charge {_percent(now)}'
    return f'{text}, which was {_percent(before)} a moment before' if jumped else text


def _percent(charge: float) -> str:
    return 'not known' if math.isnan(charge) else f'{charge:.0%}'


def _who(record: FlightRecord) -> str:
    if not record.in_command:
        return 'Who was in command is not known: no bridge was heard.'
    others = [(at, who) for at, who in record.in_command if who.tone != 'good']
    if not others:
        return 'The manager was in command all the time.'
    told = '; '.join(f'{who.word} from {clock(at)} ({shown(who.why, 120)})' for at, who in others)
    return f'The manager was not in command all the time: {told}.'


def goals_table(
    found: Sequence[WantedGoal], names: Names, expected: Sequence[Expectation | None], count: int
) -> str:
    """Return when each goal was asked for and done, beside `count` simulated flights."""
    if not found:
        return page.note('The manager wanted no goal.')
    heads = ('goal', 'priority', 'wanted from', 'over at', '', 'took', 'expected (median)')
    rows = []
    for request, expectation in zip(found, expected):
        over = math.isfinite(request.over)
        rows.append(
            (
                names[request.goal],
                PRIORITY_WORDS[request.priority].removesuffix(' priority'),
                clock(request.asked),
                clock(request.over) if over else '',
                'done' if request.done else 'no longer asked for' if over else 'still open',
                clock(request.over - request.asked) if request.done else '',
                *_expected(expectation),
            )
        )
    return page.table((*heads, 'simulated flights that took longer'), rows, (2, 3, 5, 6, 7)) + (
        page.note(
            f'Expected: of {count:,} simulated flights from the state in which the manager began '
            "to want the goal, with the mission's chances of faults, threats and other requests. "
            'They know of no take-off, landing, climb or work at the service cell.'
        )
    )


def _expected(found: Expectation | None) -> list[str]:
    if found is None:
        return ['', '']
    median = clock(found.median) if math.isfinite(found.median) else 'most never'
    return [median, '' if found.slower is None else f'{found.slower:.0%}']
