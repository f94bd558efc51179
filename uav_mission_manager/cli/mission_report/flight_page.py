"""The report of a flight: what was asked, done, when and why, and what had been expected."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from datetime import datetime
from html import escape

from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.cli.mission_report.account import Account, account_of
from uav_mission_manager.cli.mission_report.charge import CHARGE_STYLE, charge_svg, leg_charges
from uav_mission_manager.cli.mission_report.flight_record import FlightRecord
from uav_mission_manager.cli.mission_report.goals_done import expectations, requests, simulated
from uav_mission_manager.cli.mission_report.in_short import goals_table, in_short
from uav_mission_manager.cli.mission_report.page import clock
from uav_mission_manager.cli.mission_report.story import Names, StoryRow, story
from uav_mission_manager.cli.mission_report.track_map import TRACK_STYLE, time_legend, track_map
from uav_mission_manager.cli.replay_view import DIGITS
from uav_mission_manager.console.heard import HeardEpoch
from uav_mission_manager.console.timeline import block_svg, row_names
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Energy, Mission
from uav_mission_manager.policy import Policy

MOST_STORY_ROWS = 1500
"""Lines of the story: a choice, forty printed pages; commands come before events."""

STRIP_COLUMNS = 20
"""Decisions beside each other in the timeline: what fits on A4."""

MOST_COLUMNS = 1000
"""Decisions in the timeline, at most: a choice, fifty strips."""

SHOWN_SURPRISES = 8
"""Surprises that are listed: a choice."""

TOO_FAST = 2.0
"""Speed over the mission's from which a recording is said to be faster than life: a choice; agile
flight is no faster."""


def flight_page(record: FlightRecord, bag: str, policy: Policy | None) -> str:
    """Return the report of a flight.

    Parameters
    ----------
    record : FlightRecord
    bag : str
        Where it is from, as people call it.
    policy : Policy or None
        What it was flown by; without it there is no map, and nothing to compare with.
    """
    mission = policy.mission if policy else None
    names = Names(mission)
    account = account_of(record, mission, names) if mission else None
    rows = story(record, names)
    commands = [row for row in rows if row.number]
    found = requests(record, [goal.name for goal in mission.goals]) if mission else []
    title = f'Flight of {record.vehicle or "/"}' + (f': {shown(mission.name)}' if mission else '')
    return page.page(
        title,
        (
            f'<style>{TRACK_STYLE}{CHARGE_STYLE}</style>',
            _head(record, bag, policy),
            '<h2>In short</h2>',
            in_short(record, commands, found, names, account),
            goals_table(found, names, expectations(found, policy), simulated(policy))
            if policy
            else '',
            '<h2>What happened, in order</h2>',
            _story_table(rows, record.speedup),
            *_map(record, mission, commands),
            '<h2>Each decision</h2>',
            *_timeline(record, names),
            *_battery(record, mission.energy if mission else None, commands),
            *(_costs(account) if mission else ()),
        ),
    )


def _head(record: FlightRecord, bag: str, policy: Policy | None) -> str:
    began = datetime.fromtimestamp(record.began).astimezone()
    length = f'{clock(record.end)} min'
    if record.speedup != 1.0:
        length += f', recorded {record.speedup:g} times faster than life'
    flown = ', '.join(digest[:DIGITS] for digest in record.flown_by if digest) or 'not known'
    entries = [
        ('bag', shown(bag)),
        ('recorded', f'{began:%Y-%m-%d %H:%M:%S %z}'),
        ('length', length),
        ('flown by', f'policy set {flown}'),
    ]
    text = page.facts(entries)
    if policy is None:
        return text + page.note(
            'Without --policy there is no map, and nothing to hold times, energy and costs by.'
        )
    if set(record.flown_by) - {policy.digest}:
        text += page.note(
            f'The policy set given is {policy.digest[:DIGITS]}, not the one that was flown: map, '
            'times and costs are by the mission that it was built from.'
        )
    energy, speed = policy.mission.energy, record.usual_speed()
    if energy is not None and speed > TOO_FAST * energy.speed:
        text += page.note(
            f'By the clock of the bag it flew at {speed:.0f} m/s, and the mission says '
            f'{energy.speed:g} m/s. If it was recorded in simulation faster than life, say so by '
            '--speedup: times and energies below are wrong by as much.'
        )
    return text


def _story_table(rows: Sequence[StoryRow], speedup: float) -> str:
    kept = rows
    if len(rows) > MOST_STORY_ROWS:
        kept = [row for row in rows if row.kind][:MOST_STORY_ROWS]
    lines = '\n'.join(map(_story_row, kept))
    text = (
        '<table class="story"><thead><tr><th class=n>time</th><th></th><th>what</th>'
        '<th>why</th><th>second best, by expected cost</th><th class=n>cost</th></tr></thead>'
        f'<tbody>\n{lines}\n</tbody></table>'
    )
    text += page.note(
        'Commands are numbered, with what had changed since the command before in italics; the '
        'numbers are on the map and in the picture of the battery. Cost: what the policy expected '
        'to pay from there on; second best: what that would have been expected to cost more. '
        'EVADING, EVADE: in agile mode, dearer to fly and safer under a threat.'
    )
    text += page.note(
        'Three things wait for some seconds, unless danger rises: the end of a danger, a request '
        'soon after another one, and a change of mind soon after the last. They are seconds of '
        f'the recording{_as_long(speedup)}.'
    )
    if len(kept) < len(rows):
        text += page.note(f'{len(rows) - len(kept):,} of {len(rows):,} lines are left out.')
    return text


def _as_long(speedup: float) -> str:
    return '' if speedup == 1.0 else f', which are {speedup:g} times as many here'


def _story_row(row: StoryRow) -> str:
    time, what = f'<td class=n>{clock(row.at)}</td>', escape(shown(row.text, 300))
    if not row.number:
        why = f': {escape(shown(row.reason, 300))}' if row.reason else ''
        return (
            f'<tr class="{row.kind or "event"}">{time}<td></td>'
            f'<td class="what" colspan="4">{what}{why}</td></tr>'
        )
    news = f'<br><em>{escape("; ".join(row.news))}</em>' if row.news else ''
    return (
        f'<tr class="command">{time}<td><span class="no">{row.number}</span></td>'
        f'<td class="what">{what}</td><td>{escape(shown(row.reason, 300))}{news}</td>'
        f'<td>{escape(shown(row.second))}</td><td class=n>{escape(row.cost)}</td></tr>'
    )


def _map(
    record: FlightRecord, mission: Mission | None, commands: Sequence[StoryRow]
) -> Iterator[str]:
    if mission is None:
        return
    yield '<h2>Where</h2>'
    yield track_map(mission, record, commands)
    yield f'<ul class="legend"><li>{time_legend(record.end, f"0:00 to {clock(record.end)}")}</li>'
    yield '<li>numbers in frames: where the command of that number was given</li></ul>'


def _timeline(record: FlightRecord, names: Names) -> Iterator[str]:
    decided = [each for each in record.decided if each.decision.state][:MOST_COLUMNS]
    if not decided:
        yield page.note('Nothing was decided.')
        return
    space = decided[0].decision.space
    rows = escape('\n'.join(row_names([names[j] for j in range(space.k)], space.levels)))
    charge = '' if space.levels == 1 else f'level of the charge (0 to {space.levels - 1}), '
    yield page.note(
        'A column for each decision that differs from the one before in state or command: '
        f'priorities of the goals (out: out of range), {charge}goal committed to, cell, threat, '
        'mode, parts that have failed (S sensor, A actuator, C camera).'
    )
    for first in range(0, len(decided), STRIP_COLUMNS):
        part = decided[first : first + STRIP_COLUMNS]
        epochs = [
            HeardEpoch(number, clock(each.at), each.decision)
            for number, each in enumerate(part, first + 1)
        ]
        yield f'<div class="strip"><div></div><div class="note">{clock(part[0].at)} to '
        yield f'{clock(part[-1].at)}</div><div class="timeline-names">{rows}</div>'
        yield f'{block_svg(epochs, space)}</div>'
    if len(record.decided) > len(decided):
        yield page.note(f'{len(record.decided):,} decisions in all.')


def _battery(
    record: FlightRecord, energy: Energy | None, commands: Sequence[StoryRow]
) -> Iterator[str]:
    yield '<h2>Battery</h2>'
    if not record.charges:
        yield page.note('No battery was heard.')
        return
    yield charge_svg(record, energy, commands)
    if energy is None:
        yield page.note('Line: the worst battery. Shaded: in the air.')
        return
    yield page.note(
        "Line: the worst battery. Shaded: in the air. Dashed: the mission's energy model from "
        f'each take-off on, {energy.power:g} W in the air from {energy.capacity:g} Ah at '
        f'{energy.voltage:g} V.'
    )
    heads = ['took off', 'landed', 'in the air', 'charge', 'drawn', 'by the model', 'difference']
    found = leg_charges(record, energy)
    rows = [
        (
            clock(each.leg.start),
            clock(each.leg.end) if each.leg.end < record.end else 'not yet',
            clock(each.leg.end - each.leg.start),
            f'{each.first:.0%} to {each.last:.0%}',
            f'{each.drawn:.1f} Wh',
            f'{each.planned:.1f} Wh',
            f'{each.drawn - each.planned:+.1f} Wh',
        )
        for each in found
    ]
    if len(found) > 1:
        air = sum(each.leg.end - each.leg.start for each in found)
        drawn, planned = sum(e.drawn for e in found), sum(e.planned for e in found)
        sums = f'{drawn:.1f} Wh', f'{planned:.1f} Wh', f'{drawn - planned:+.1f} Wh'
        rows.append(('all', '', clock(air), '', *sums))
    yield page.table(heads, rows, range(7))


def _costs(account: Account | None) -> Iterator[str]:
    yield '<h2>Cost: expected and paid</h2>'
    if account is None:
        yield page.note('Not known: it is shorter than an epoch, or the mission has no speed.')
        return
    total = account.paid + account.left
    yield page.table(
        ('', 'cost'),
        [
            (
                f'expected at {clock(account.start)}, V of the first state',
                f'{account.expected:.2f}',
            ),
            (
                f'paid in {account.epochs:,} epochs of {account.seconds:.3g} s, discounted',
                f'{account.paid:.2f}',
            ),
            ('V of the last state, discounted: still to be paid', f'{account.left:.2f}'),
            ('paid and still to be paid, less expected', f'{total - account.expected:+.2f}'),
        ],
        (1,),
    )
    yield f'<h3>What made the difference</h3>{_surprises_table(account)}'
    yield page.note(
        "By the mission's costs, discounted to the first decision: what each piece of news added "
        'to what had been expected a moment before. News that the model holds for unlikely weigh '
        'more; without news a flight is cheaper than expected, unless it is slower than the model.'
    )


def _surprises_table(account: Account) -> str:
    rows = [
        ('' if math.isnan(s.at) else clock(s.at), s.text, f'{s.cost:+.2f}')
        for s in account.surprises[:SHOWN_SURPRISES]
    ]
    rest = account.surprises[SHOWN_SURPRISES:]
    if rest:
        rows.append(('', f'{len(rest)} more', f'{sum(s.cost for s in rest):+.2f}'))
    return page.table(('time', 'news', 'cost'), rows, (0, 2))
