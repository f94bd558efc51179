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
from uav_mission_manager.cli.mission_report.story import SERVED_FOR, Names, StoryRow
from uav_mission_manager.cli.mission_report.waits import CHARGE_JUMP
from uav_mission_manager.console.map_overlay import PRIORITY_WORDS
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import THREAT_LEVELS

JUST_BEFORE = 10.0
"""Time [s] within which a jump of the charge is told with what followed: a choice."""

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
    lines += _turns(record, commands, names)
    if record.refused:
        refused = ', '.join(f'{shown(n, 60)} at {clock(at)}' for at, n in record.refused)
        lines.append(f'Out of reach, or failed: {refused}.')
    lines.append(_who(record, commands))
    if account is not None:
        total = account.paid + account.left
        lines.append(
            f'Cost {total:.1f}: {account.paid:.1f} paid, and {account.left:.1f} expected after '
            f'the end; at the beginning {account.expected:.1f} were expected: see "Cost: expected '
            'and paid".'
        )
    return f'<ul>{"".join(f"<li>{escape(line)}</li>" for line in lines)}</ul>'


def _times(count: int) -> str:
    return {0: 'never', 1: 'once', 2: 'twice'}.get(count, f'{count} times')


def _turns(record: FlightRecord, commands: Sequence[StoryRow], names: Names) -> Iterator[str]:
    """Say where it broke off, or flew agile, and why."""
    turns = []
    for before, row in zip((None, *commands), commands):
        what = _agile(before, row)
        if row.decision.command in SERVED_FOR:
            what = _serviced(record, row, names)
        if what:
            turns.append(f'{clock(row.at)} {what}. Second best: {row.second.partition(";")[0]}.')
    yield from turns[:MOST_TURNS]
    if len(turns) > MOST_TURNS:
        yield f'{len(turns) - MOST_TURNS:,} more times it recharged, was repaired or flew agile.'


def _serviced(record: FlightRecord, row: StoryRow, names: Names) -> str:
    command = row.decision.command
    charge = f'; {_charge(record, row.at)}' if command == 'recharge' else ''
    there = ', in the service cell already' if names.on_site(row.decision) else ''
    return f'It went {SERVED_FOR[command]}{there}: {row.reason}{charge}'


def _agile(before: StoryRow | None, row: StoryRow) -> str:
    command, _, mode = row.decision.command.rpartition(' ')
    if mode != 'agile':
        return ''
    where = 'It flew to base, agile'
    if command != 'none':
        on = 'on ' if before and before.decision.command.startswith(f'{command} ') else ''
        where = f'It went {on}to {shown(command.removeprefix("commit "), 60)}, agile'
    reason, _, threat = row.reason.partition(', threat ')
    if threat in ('', THREAT_LEVELS[0]):
        return f'{where}: {reason}'
    heard = any(text.startswith('threat ') for text in row.news)
    threat = f'threat {threat} {"was heard" if heard else "still counted"}'
    return f'{where}: {threat}' if command != 'none' else f'{where}: {reason}, and {threat}'


def _charge(record: FlightRecord, at: float) -> str:
    """Say the charge at a time, and where it had jumped just before."""
    now, before = record.charge_at(at), record.charge_at(at - JUST_BEFORE)
    if before - now >= CHARGE_JUMP:
        return f'reported charge had fallen suddenly from {_percent(before)} to {_percent(now)}'
    return f'charge {_percent(now)}'


def _percent(charge: float) -> str:
    return 'not known' if math.isnan(charge) else f'{charge:.0%}'


def _who(record: FlightRecord, commands: Sequence[StoryRow]) -> str:
    if not record.in_command:
        return 'Who was in command is not known: no bridge was heard.'
    until = [at for at, _ in record.in_command[1:]]
    others = [
        (at, end, who)
        for (at, who), end in zip(record.in_command, [*until, record.end])
        if who.tone != 'good'
    ]
    if not others:
        first = f'from {clock(commands[0].at)} on' if commands else 'nothing'
        return f'Nobody took command from the manager, which commanded {first}.'
    told = '; '.join(
        f'{who.word} from {clock(at)} to {clock(end)} ({shown(who.why, 120)})'
        for at, end, who in others
    )
    return f'The manager was not in command all the time: {told}.'


def goals_table(
    found: Sequence[WantedGoal],
    names: Names,
    expected: Sequence[Expectation | None],
    count: int,
    slack: float,
) -> str:
    """Return when each goal was asked for and done, beside `count` simulated flights.

    Times are off by `slack` [s] at most.
    """
    if not found:
        return page.note('The manager wanted no goal.')
    heads = ('goal', 'priority', 'asked', 'begun', 'done', 'took', 'expected (median)')
    rows = []
    for request, expectation in zip(found, expected):
        late, begun = request.waited(slack), math.isfinite(request.begun)
        asked = request.asked if late else request.counts
        rows.append(
            (
                names[request.goal],
                PRIORITY_WORDS[request.priority].removesuffix(' priority'),
                clock(asked) + (f', counts from {clock(request.counts)}' if late else ''),
                clock(request.begun) if begun else '',
                _done(request),
                clock(request.over - request.counts) if request.done else '',
                *_expected(expectation),
            )
        )
    return page.table((*heads, 'slower than'), rows, (3, 4, 5, 6, 7)) + (
        page.note(
            f'Expected: of {count:,} flights simulated from where the request counts. They know '
            'no take-off, landing, climb or service time, so a real one looks slower.'
        )
    )


def _done(request: WantedGoal) -> str:
    if request.done:
        return clock(request.over)
    over = math.isfinite(request.over)
    return f'no longer asked for at {clock(request.over)}' if over else 'still open'


def _expected(found: Expectation | None) -> list[str]:
    if found is None:
        return ['', '']
    median = clock(found.median) if math.isfinite(found.median) else 'most never'
    return [median, '' if found.slower is None else f'{1.0 - found.slower:.0%} of them']
