"""The page of what was learned: what changed, how sure it is, and what it does to the policy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from typing import NamedTuple

from uav_mission_manager.cli.mission_report import page
from uav_mission_manager.echo import shown
from uav_mission_manager.learning import LEVEL_TEXT, LearnedNumber, NewMission, PolicyEffect
from uav_mission_manager.learning.new_mission import short
from uav_mission_manager.mdp.epoch import SECONDS_PER_HOUR

HEAD = ('number', 'was', 'is', f'{LEVEL_TEXT} interval', 'seen', 'of', '')
"""Heads of the table of numbers."""


@dataclass(frozen=True)
class Learning:
    """All that was learned, and of what.

    Attributes
    ----------
    bags : list of str
    file : str
        The mission file that was the prior.
    weight : float
        Events that it was worth.
    epochs, flown : int
        Epochs that were counted, and those in the air.
    seconds_per_epoch : float
        Length of an epoch [s].
    learned : list of LearnedNumber
    new : NewMission
    effect : PolicyEffect or None
        What it does to the policy; None where that was not solved, and `unsolved` says why.
    unsolved : str
    certificates : list of str
        What is certified before and after.
    """

    bags: list[str]
    file: str
    weight: float
    epochs: int
    flown: int
    seconds_per_epoch: float
    learned: list[LearnedNumber]
    new: NewMission
    effect: PolicyEffect | None
    unsolved: str
    certificates: list[str]


class ReportSection(NamedTuple):
    """A part of the page: lines of text, and a table, which may be empty."""

    title: str
    lines: list[str]
    rows: list[tuple[str, ...]]


def sections(learning: Learning) -> list[ReportSection]:
    """Return what there is to say."""
    numbers, bags = list(_rows(learning.learned)), len(learning.bags)
    hours = learning.epochs * learning.seconds_per_epoch / SECONDS_PER_HOUR
    energy = learning.new.mission.energy
    assert energy is not None  # Without a speed nothing was counted.
    used = energy.power * learning.seconds_per_epoch / SECONDS_PER_HOUR
    lines = [
        f'Counted: {learning.epochs:,} epochs, {hours:.3g} h, {learning.flown:,} of them in the '
        f'air, of {bags} {"bag" if bags == 1 else "bags"}. '
        f'{shown(learning.file)} is worth {learning.weight:g} events in each row.',
        f'A cell takes {learning.seconds_per_epoch:.3g} s, and {used:.3g} Wh, in normal flight.',
    ]
    if not numbers:
        lines.append('Nothing was seen of which a number could be learned.')
    return [
        ReportSection(f'What flights say of {shown(learning.new.mission.name)}', lines, numbers),
        ReportSection('What it does to the policy', list(_policy_lines(learning)), []),
    ]


def as_markdown(report: list[ReportSection]) -> str:
    """Return the page as Markdown, which a terminal shows as well."""
    parts = []
    for title, lines, rows in report:
        parts += [f'# {title}', *lines]
        if rows:
            table = [HEAD, ('---',) * len(HEAD), *rows]
            parts.append('\n'.join(f'| {" | ".join(row)} |' for row in table))
    return '\n\n'.join(parts) + '\n'


def as_html(report: list[ReportSection]) -> str:
    """Return the page as HTML."""
    first, *others = report
    body = [*_html(first)]
    for section in others:
        body += [f'<h2>{escape(section.title)}</h2>', *_html(section)]
    return page.page(first.title, body)


def _html(section: ReportSection) -> Iterator[str]:
    yield from (f'<p>{escape(line)}</p>' for line in section.lines)
    if section.rows:
        yield page.table(HEAD, section.rows, range(1, 6))


def _rows(learned: list[LearnedNumber]) -> Iterator[tuple[str, ...]]:
    for estimate in learned:
        value, low, high = estimate.posterior
        # The file's number outside of the interval: more than chance.
        remark = '' if low <= estimate.old <= high else 'the file was off'
        yield (
            estimate.field,
            short(estimate.old),
            short(value),
            f'{short(low)} to {short(high)}',
            f'{estimate.seen:g}',
            f'{estimate.of:g}',
            remark,
        )


def _policy_lines(learning: Learning) -> Iterator[str]:
    found = learning.effect
    if found is None:
        yield f'Not compared: {learning.unsolved}.'
    else:
        yield (
            f'The action changes in {found.changed:,} of {found.states:,} states, and in '
            f'{found.flown_changed:.1%} of those that the old policy flies through.'
        )
        yield (
            'Exact expected cost in the new model, from base with all goals of high priority: '
            f'{found.old_cost:.6g} with the old policy, {found.new_cost:.6g} with the new one. '
            f'The old model had promised {found.expected:.6g}.'
        )
        yield (
            f'Over all states the old policy costs {found.mean_loss:.2%} more on average, '
            f'{found.largest_loss:.2%} at most. Both costs are exact to 1e-6, so nothing is lost '
            'in certainty.'
        )
    yield from learning.certificates
