"""A flight in the order in which it happened: events, and each command with its reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from uav_mission_manager.cli.mission_report.alternatives import other_destination, then_and_now
from uav_mission_manager.cli.mission_report.flight_record import AirTime, FlightRecord
from uav_mission_manager.cli.mission_report.goals_done import WantedGoal
from uav_mission_manager.cli.mission_report.page import clock
from uav_mission_manager.cli.mission_report.waits import charge_jumps, ends_of_dangers
from uav_mission_manager.console.heard import HeardDecision
from uav_mission_manager.console.map_overlay import PRIORITY_WORDS
from uav_mission_manager.console.words import headline
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Mission

TAKE_OFF_TIME = 20.0
"""Time [s] within which a vehicle still takes off after it was told otherwise: a choice."""

LEAST_WAIT = 1.0
"""Time [s] from which it is told that a change of mind waited: a choice."""

SERVED_FOR = {'recharge': 'to recharge', 'repair': 'for repair'}
"""Commands to the service cell, and what is told of them."""

NOT_DECIDED = HeardDecision('')
"""Before anything is decided."""


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
    decision : HeardDecision
        Of a command.
    """

    at: float
    kind: str
    text: str
    number: int = 0
    news: tuple[str, ...] = ()
    reason: str = ''
    second: str = ''
    cost: str = ''
    decision: HeardDecision = NOT_DECIDED


class Names:
    """Names of goals and commands; of goals their numbers where the mission is not known."""

    def __init__(self, mission: Mission | None) -> None:
        self.mission = mission
        self._base = mission.grid.base if mission else None
        self._service = mission.grid.service if mission else None
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

    def place(self, decision: HeardDecision) -> str:
        """Say where the vehicle was at a decision; '' where that is not known."""
        if not decision.state:
            return ''
        cell = int(decision.named.l)
        stations = {self._service: 'in the service cell', self._base: 'in the base cell'}
        return stations.get(cell, f'in cell {cell}')

    def on_site(self, decision: HeardDecision) -> bool:
        """Whether the command is to be on the ground in the cell where the vehicle is."""
        service = decision.command in SERVED_FOR
        station = self._service if service else self._base
        stays = service or decision.command.startswith('none ')
        return stays and bool(decision.state) and decision.named.l == station


def story(record: FlightRecord, names: Names, found: Sequence[WantedGoal]) -> list[StoryRow]:
    """Return what happened, in order; of one moment first what was heard, then the command."""
    commands = list(command_rows(record, names))
    events = [
        *_authorities(record),
        *(StoryRow(each.at, each.line.level, each.line.text) for each in record.happened),
        *_requests(record, names, found),
        *_jumps(record),
        *_flights(record, names, [row for row in commands if row.number]),
        *(StoryRow(at, '', text) for at, text in ends_of_dangers(record)),
    ]
    return sorted([*events, *commands], key=lambda row: (row.at, row.number > 0))


def _requests(
    record: FlightRecord, names: Names, found: Sequence[WantedGoal]
) -> Iterator[StoryRow]:
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
        late = [each.counts for each in found if each.asked == at and each.waited(record.slack)]
        if late:
            text += f'; counts from {clock(late[0])} on, {late[0] - at:.0f} s later'
        yield StoryRow(at, '', text)


def _jumps(record: FlightRecord) -> Iterator[StoryRow]:
    """Tell where the charge jumps: a battery that was changed, or is not what it said it was."""
    for at, was, charge in charge_jumps(record):
        text = f'reported charge {"fell" if charge < was else "rose"} suddenly'
        if charge > was and not record.in_air(at):
            text = 'battery recharged or replaced: charge'
        tone = 'warning' if charge < was else ''
        yield StoryRow(at, tone, f'{text} from {was:.0%} to {charge:.0%}')


def _flights(
    record: FlightRecord, names: Names, commands: Sequence[StoryRow]
) -> Iterator[StoryRow]:
    for leg in record.legs:
        up, down = (names.place(record.decided_at(at)) for at in leg)
        begun = _begun_before(leg, names, commands)
        yield StoryRow(leg.start, '', ' '.join(filter(None, ('took off', up))) + begun)
        if leg.end < record.end:
            yield StoryRow(leg.end, '', ' '.join(filter(None, ('landed', down))))


def _begun_before(leg: AirTime, names: Names, commands: Sequence[StoryRow]) -> str:
    """Say for which command it took off where the one in force wants it on the ground there."""
    given = [row for row in commands if row.at <= leg.start][-2:]
    if len(given) < 2 or leg.start - given[1].at > TAKE_OFF_TIME:
        return ''
    before, now = given
    if names.on_site(before.decision) or not names.on_site(now.decision):
        return ''
    return f': begun for command {before.number}, before {now.number} came'


def _authorities(record: FlightRecord) -> Iterator[StoryRow]:
    for number, (at, who) in enumerate(record.in_command):
        if number or who.tone != 'good':
            tone = '' if who.tone == 'good' else who.tone
            why = '' if who.tone == 'good' else f': {who.why}'
            yield StoryRow(at, tone, f'in command: {who.word}{why}')


def command_rows(record: FlightRecord, names: Names) -> Iterator[StoryRow]:
    """Yield the commands, each where it differs from the one before."""
    number, last, since, previous = 0, None, NOT_DECIDED, NOT_DECIDED
    wish, wished_at = '', 0.0
    for at, decision in record.decided:
        if decision.command == last:
            since = since if since.state else decision
            previous = decision
            kept = decision.runner_up if decision.margin < 0 else ''
            if kept != wish:
                wish, wished_at = kept, at
            continue
        last, before = decision.command, since
        since = decision if decision.state else since
        if not decision.command:
            yet = '' if number else ' yet'
            yield StoryRow(at, 'warning', f'no command{yet}', reason=decision.reason)
            continue
        number += 1
        reason = decision.reason.partition('; expected cost')[0]
        news = _since(before, decision, names)
        row = StoryRow(
            at,
            'command',
            names.command(decision.command, decision),
            number,
            tuple(_untold(news, reason, record, at)),
            reason,
            _second(decision, names),
            f'{min(decision.values):.4g}' if decision.values else '',
            decision,
        )
        late = at - wished_at if wish == decision.command else 0.0
        more = (*_turned(before, previous, decision, names), *_waited(late))
        yield _landing(replace(row, news=(*row.news, *more)), record)
        previous, wish = decision, ''


def _untold(news: Sequence[str], reason: str, record: FlightRecord, at: float) -> Iterator[str]:
    """Leave out what the reason says already, or that a goal just completed is done."""
    motive = reason.partition(', threat ')[0]
    told = {reason, motive.replace(' has ', ': ', 1)}
    for when, name in record.completed:
        if abs(when - at) <= record.slack:
            told.add(_over(shown(name, 60)))
    for text in news:
        fault = text.startswith('fault ') and reason == f'fault mode {text.rpartition(" ")[2]}'
        if text not in told and not fault:
            yield text


def _waited(seconds: float) -> Iterator[str]:
    if seconds >= LEAST_WAIT:
        yield f'decided {seconds:.0f} s before; a change of mind waits'


def _landing(row: StoryRow, record: FlightRecord) -> StoryRow:
    """Say what it does in the base cell while it is in the air."""
    if row.text != 'STAY AT BASE' or not record.in_air(row.at):
        return row
    text = 'in the air: goes on to the base point and lands'
    return replace(row, text='LAND AT BASE', news=(*row.news, text))


def _turned(
    before: HeardDecision, previous: HeardDecision, now: HeardDecision, names: Names
) -> Iterator[str]:
    """Say what made the difference where nothing has changed but the place."""
    known = before.state and previous.state and now.state
    if names.mission is None or not known or any(state_news(before, now, names)):
        return
    found = then_and_now(names.mission, previous, now)
    if found and previous.named.l != now.named.l:
        (new_then, old_then), (new, old) = found
        charge = f' at charge {previous.named.b[0]}' if previous.levels > 1 else ''
        yield (
            f'this costs {new:.4g} from there, {names.command(previous.command, now)} {old:.4g}; '
            f'from cell {previous.named.l}{charge} it was {new_then:.4g} and {old_then:.4g}'
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
    text = f'{text}, {decision.margin:.3g} more'
    other = names.mission and other_destination(names.mission, decision)
    if other:
        text = f'the same{_mode(decision.runner_up)}, {decision.margin:.3g} more'
        text += f'; {names.command(other[0], decision)}, {other[1]:.3g}'
    return text


def _mode(command: str) -> str:
    return ' agile' if command.endswith(' agile') else ', not agile'


def _comparable(before: HeardDecision, after: HeardDecision) -> bool:
    """Whether both were decided in a state, of the same variables."""
    return bool(before.state and after.state) and before.space == after.space


def _over(goal: str) -> str:
    """Of a goal without a priority any more: a state does not say why."""
    return f'{goal}: done, or no longer wanted'


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
            yield f'{names[j]}: {PRIORITY_WORDS[later]}' if later else _over(names[j])
    if was.t != now.t:
        yield f'threat {THREAT_LEVELS[was.t]} → {THREAT_LEVELS[now.t]}'
