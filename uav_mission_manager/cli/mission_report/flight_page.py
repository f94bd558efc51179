"""The report of a flight: what was asked, done, when and why, and what had been expected."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from datetime import datetime
from html import escape

from uav_mission_manager.cli.check.html_page import ground_legend
from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.cli.mission_report.account import Account, account_of, as_dear
from uav_mission_manager.cli.mission_report.charge import CHARGE_STYLE, charge_svg, leg_charges
from uav_mission_manager.cli.mission_report.flight_record import FlightRecord
from uav_mission_manager.cli.mission_report.goals_done import (
    WantedGoal,
    expectations,
    requests,
    simulated,
)
from uav_mission_manager.cli.mission_report.in_short import goals_table, in_short
from uav_mission_manager.cli.mission_report.legend import how_to_read
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

SHOWN_SURPRISES, MOST_SURPRISES = 8, 30
"""Surprises that are listed: choices; more than the first where the rest has more weight."""

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
    found = requests(record, [goal.name for goal in mission.goals]) if mission else []
    rows = story(record, names, found)
    commands = [row for row in rows if row.number]
    title = f'Flight of {record.vehicle or "/"}' + (f': {shown(mission.name)}' if mission else '')
    return page.page(
        title,
        (
            f'<style>{TRACK_STYLE}{CHARGE_STYLE}</style>',
            _head(record, bag, policy),
            '<h2>In short</h2>',
            in_short(record, commands, found, names, account),
            _goals(record, policy, found, names) if policy else '',
            '<h2>What happened, in order</h2>',
            _story_table(rows),
            *_map(record, mission, commands),
            '<h2>Each decision</h2>',
            *_timeline(record, names),
            *_battery(record, mission.energy if mission else None, commands),
            *(_costs(account, policy) if policy else ()),
            how_to_read(mission, account, record.speedup),
        ),
    )


def _goals(record: FlightRecord, policy: Policy, found: list[WantedGoal], names: Names) -> str:
    expected = expectations(found, policy)
    return goals_table(found, names, expected, simulated(policy), record.slack)


def _head(record: FlightRecord, bag: str, policy: Policy | None) -> str:
    began = datetime.fromtimestamp(record.began).astimezone()
    length = f'{clock(record.end)} min'
    if record.speedup != 1.0:
        length += f' of a simulation at {record.speedup:g} times the speed of life'
    flown = ', '.join(digest[:DIGITS] for digest in record.flown_by if digest) or 'not known'
    entries = [
        ('bag', shown(bag)),
        ('recorded', f'{began:%Y-%m-%d %H:%M:%S %z}'),
        ('length', length),
        ('flown by', f'policy set with fingerprint {flown}'),
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


def _story_table(rows: Sequence[StoryRow]) -> str:
    kept = rows
    if len(rows) > MOST_STORY_ROWS:
        kept = [row for row in rows if row.kind][:MOST_STORY_ROWS]
    lines = '\n'.join(map(_story_row, kept))
    text = (
        '<table class="story"><thead><tr><th class=n>time</th><th></th><th>what</th>'
        '<th>why</th><th>second best, by expected cost</th><th class=n>cost</th></tr></thead>'
        f'<tbody>\n{lines}\n</tbody></table>'
    )
    if len(kept) < len(rows):
        text += page.note(f'{len(rows) - len(kept):,} of {len(rows):,} lines are left out.')
    return text


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
    yield f'<li>numbers in frames: commands</li>{ground_legend(mission)}</ul>'


def _timeline(record: FlightRecord, names: Names) -> Iterator[str]:
    decided = [each for each in record.decided if each.decision.state][:MOST_COLUMNS]
    if not decided:
        yield page.note('Nothing was decided.')
        return
    space = decided[0].decision.space
    rows = escape('\n'.join(row_names([names[j] for j in range(space.k)], space.levels)))
    charge = '' if space.levels == 1 else f'level of the charge (0 to {space.levels - 1}), '
    yield page.note(
        f'{len(decided):,} times state or command changed, a column each: '
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


def _battery(
    record: FlightRecord, energy: Energy | None, commands: Sequence[StoryRow]
) -> Iterator[str]:
    yield '<h2>Battery</h2>'
    if not record.charges:
        yield page.note('No battery was heard.')
        return
    yield charge_svg(record, energy, commands)
    line = f'the worst of {record.batteries} batteries' if record.batteries > 1 else 'charge'
    if energy is None:
        yield page.note(f'Line: {line}. Shaded: in the air.')
        return
    yield page.note(
        f"Line: {line}. Shaded: in the air. Dashed: the mission's energy model from "
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


def _costs(account: Account | None, policy: Policy) -> Iterator[str]:
    yield '<h2>Cost: expected and paid</h2>'
    if account is None:
        yield page.note('Not known: it is shorter than an epoch, or the mission has no speed.')
        return
    total = account.paid + account.left
    more = total - account.expected
    yield page.table(
        ('', 'cost'),
        [
            (f'expected at {clock(account.start)}, the start', f'{account.expected:.2f}'),
            (
                f'paid in {account.epochs:,} epochs of {account.seconds:.3g} s',
                f'{account.paid:.2f}',
            ),
            ('still to come after the end, as expected there', f'{account.left:.2f}'),
            (
                f'together {total:.2f}: {"less" if more < 0 else "more"} than expected by',
                f'{more:+.2f}',
            ),
        ],
        (1,),
    )
    yield page.note(_luck(account, policy))
    yield f'<h3>What made the difference</h3>{_surprises_table(account)}'
    yield page.note(
        'What each piece of news added to what had been expected a moment before: the more, the '
        'less likely the model holds it. Epochs without any are cheap: the model expects some.'
    )


def _luck(account: Account, policy: Policy) -> str:
    """Say whether it was the policy that made it so dear."""
    text, count = '', simulated(policy)
    if account.at_least > 0.0:
        text = f'No policy could have expected less than {account.at_least:.2f} at the start. '
    if (share := as_dear(account, policy, count)) is not None:
        text += (
            f'Of {count:,} simulated flights as long, by the same policy from the same state, '
            f'{share:.0%} cost as much or more.'
        )
    return text


def _surprises_table(account: Account) -> str:
    count = SHOWN_SURPRISES
    costs = [surprise.cost for surprise in account.surprises]
    while count < min(len(costs), MOST_SURPRISES) and abs(sum(costs[count:])) > abs(
        costs[count - 1]
    ):
        count += 1
    rows = [
        ('' if math.isnan(s.at) else clock(s.at), s.text, f'{s.cost:+.2f}')
        for s in account.surprises[:count]
    ]
    if costs[count:]:
        rows.append(('', f'{len(costs[count:])} more', f'{sum(costs[count:]):+.2f}'))
    return page.table(('time', 'news', 'cost'), rows, (0, 2))
