"""A flight in the order in which it happened: events, and each command with its reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from uav_mission_manager.cli.mission_report.flight_record import Decided, FlightRecord
from uav_mission_manager.console.heard import HeardDecision
from uav_mission_manager.console.map_overlay import PRIORITY_WORDS
from uav_mission_manager.console.words import headline
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Mission

CHARGE_JUMP = 0.1
"""Change of the charge between two messages that is told: a choice, minutes of flight."""


@dataclass(frozen=True)
class StoryRow:
    """A line of the story.

    Attributes
    ----------
    at : float
        When [s].
    kind : str
        `command`, or the tone of an event: '', `warning`, `danger`.
    text : str
    number : int
        Of a command, from 1; 0 of an event.
    news : tuple of str
        What had changed since the command before.
    reason : str
    second : str
        The second best, and what it would have cost more.
    cost : str
        What was expected to be paid from there on.
    """

    at: float
    kind: str
    text: str
    number: int = 0
    news: tuple[str, ...] = ()
    reason: str = ''
    second: str = ''
    cost: str = ''


class Names:
    """Names of goals and commands; of goals their numbers where the mission is not known."""

    def __init__(self, mission: Mission | None) -> None:
        self._base = mission.grid.base if mission else None
        self._names = [shown(goal.name, 60) for goal in mission.goals] if mission else []

    def __getitem__(self, position: int) -> str:
        """Return the name of a goal, counted from 0."""
        known = position < len(self._names)
        return self._names[position] if known else f'goal {position + 1}'

    def wanted(self, priorities: Sequence[int]) -> str:
        """Say which goals have which priority."""
        found = [f'{self[j]} {PRIORITY_WORDS[g]}' for j, g in enumerate(priorities) if 0 < g < 3]
        return ', '.join(found)

    def command(self, command: str, decision: HeardDecision) -> str:
        """Return a command, in what was decided, in large words."""
        return headline(command, bool(decision.state) and decision.named.l == self._base)


def story(record: FlightRecord, names: Names) -> list[StoryRow]:
    """Return what happened, in order; of one moment first what was heard, then the command."""
    events = [
        *_authorities(record),
        *(StoryRow(each.at, each.line.level, each.line.text) for each in record.happened),
        *_requests(record, names),
        *_jumps(record),
        *_flights(record),
    ]
    rows = [*events, *command_rows(record.decided, names)]
    return sorted(rows, key=lambda row: (row.at, row.number > 0))


def _requests(record: FlightRecord, names: Names) -> Iterator[StoryRow]:
    """Tell what was asked for, but not that a goal just completed is not asked for any more."""
    before: tuple[int, ...] = ()
    for at, asked in record.asked:
        was = before if len(before) == len(asked) else (0,) * len(asked)
        raised = any(g > earlier for g, earlier in zip(asked, was))
        lowered = {names[j] for j, (g, earlier) in enumerate(zip(asked, was)) if g < earlier}
        done = {shown(n, 60) for t, n in record.completed if abs(t - at) <= record.slack}
        before = asked
        if lowered and not raised and lowered <= done:
            continue
        text = f'{"asked for" if raised else "still asked for"}: {names.wanted(asked)}'
        if not any(asked):
            text = 'no goal is asked for any more' if any(was) else 'no goal is asked for'
        yield StoryRow(at, '', text)


def _jumps(record: FlightRecord) -> Iterator[StoryRow]:
    """Tell where the charge jumps: a battery that was changed, or is not what it said it was."""
    for (_, was), (at, charge) in pairwise(record.charges):
        if abs(charge - was) >= CHARGE_JUMP:
            tone = 'warning' if charge < was else ''
            yield StoryRow(at, tone, f'charge of the battery jumps from {was:.0%} to {charge:.0%}')


def _flights(record: FlightRecord) -> Iterator[StoryRow]:
    for leg in record.legs:
        yield StoryRow(leg.start, '', 'took off')
        if leg.end < record.end:
            yield StoryRow(leg.end, '', 'landed')


def _authorities(record: FlightRecord) -> Iterator[StoryRow]:
    for number, (at, who) in enumerate(record.in_command):
        if number or who.tone != 'good':
            tone = '' if who.tone == 'good' else who.tone
            why = '' if who.tone == 'good' else f': {who.why}'
            yield StoryRow(at, tone, f'in command: {who.word}{why}')


def command_rows(decided: Sequence[Decided], names: Names) -> Iterator[StoryRow]:
    """Yield the commands, each where it differs from the one before."""
    number, last, since = 0, None, HeardDecision('')
    for at, decision in decided:
        if decision.command == last:
            since = since if since.state else decision
            continue
        last, before = decision.command, since
        since = decision if decision.state else since
        if not decision.command:
            yield StoryRow(at, 'warning', 'no command', reason=decision.reason)
            continue
        number += 1
        reason = decision.reason.partition('; expected cost')[0]
        news = _since(before, decision, names)
        yield StoryRow(
            at,
            'command',
            names.command(decision.command, decision),
            number,
            tuple(text for text in news if text != reason),
            reason,
            _second(decision, names),
            f'{min(decision.values):.4g}' if decision.values else '',
        )


def _since(before: HeardDecision, after: HeardDecision, names: Names) -> tuple[str, ...]:
    """Say what has changed since the command before: if nothing else, where the vehicle is."""
    news = tuple(state_news(before, after, names))
    if not news and _comparable(before, after) and before.named.l != after.named.l:
        return (f'in cell {after.named.l} by now',)
    return news


def _second(decision: HeardDecision, names: Names) -> str:
    if not decision.runner_up:
        return 'nothing else was allowed'
    text = names.command(decision.runner_up, decision)
    if decision.margin < 0:
        return f'{text}, {-decision.margin:.3g} less, after a wait'
    return f'{text}, {decision.margin:.3g} more'


def _comparable(before: HeardDecision, after: HeardDecision) -> bool:
    """Whether both were decided in a state, of the same variables."""
    return bool(before.state and after.state) and before.space == after.space


def state_news(before: HeardDecision, after: HeardDecision, names: Names) -> Iterator[str]:
    """Say what has changed from state to state, but for what the vehicle does itself."""
    if not _comparable(before, after):
        return
    was, now = before.named, after.named
    if was.f != now.f:
        yield f'fault {FAULT_MODES[was.f - 1]} → {FAULT_MODES[now.f - 1]}'
    flags = list(enumerate(zip(before.in_range, after.in_range)))
    lost = [names[j] for j, (earlier, later) in flags if earlier > later]
    back = [names[j] for j, (earlier, later) in flags if earlier < later]
    if lost:
        yield f'out of range: {", ".join(lost)}'
    if back:
        yield f'in range again: {", ".join(back)}'
    for j, (earlier, later) in enumerate(zip(was.g.tolist(), now.g.tolist())):
        if earlier != later:
            yield f'{names[j]}: {PRIORITY_WORDS[later]}{"" if later else " any more"}'
    if was.t != now.t:
        yield f'threat {THREAT_LEVELS[was.t]} → {THREAT_LEVELS[now.t]}'
