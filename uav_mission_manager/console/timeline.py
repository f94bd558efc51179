"""The timeline: a column for each epoch, a row for each variable, as in the paper's Case I.

It is drawn in blocks of epochs, of which only the last one changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape

import numpy as np

from uav_mission_manager.console.heard import HeardEpoch
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS, Mission, StateSpace
from uav_mission_manager.onboard import parse_command

BLOCK = 50
"""Epochs of a block: a choice, of a few tens of kilobytes."""

COLUMN_WIDTH, ROW_HEIGHT = 30, 19
"""Width of an epoch and height of a row [px]: choices, of numbers that can be read."""

MOST_GOAL_ROWS = 8
"""Goals that have a row of their own: a choice; of more the first ones are shown."""

SHORT_FAULTS = ('', 'S', 'A', 'SA', 'C', 'SC', 'AC', 'SAC')
"""Fault modes as letters of the parts that have failed, in the order of `FAULT_MODES`."""

SHORT_COMMANDS = {
    '': 'no',
    'none normal': 'B',
    'none agile': 'B!',
    'recharge': 'C',
    'repair': 'R',
}
"""Commands without a goal, as the letters of a policy's maps; agile with an exclamation mark."""

TIMELINE_STYLE = f"""
.timeline text{{font:600 12px system-ui,sans-serif;text-anchor:middle;fill:var(--ink)}}
.timeline .rule{{stroke:var(--line)}}.timeline .head{{font-weight:400;fill:var(--dim)}}
.timeline .t-1{{fill:var(--warning)}}.timeline .t-2{{fill:var(--danger)}}
.timeline .g-1{{fill:var(--low)}}.timeline .g-2{{fill:var(--high)}}
.timeline .c-1,.timeline .m-1{{fill:var(--craft)}}.timeline .f-1{{fill:var(--fault)}}
.timeline .r-1{{fill:var(--stale)}}.timeline .none-1{{fill:var(--danger)}}
.timeline .d-1{{fill:var(--warning)}}.timeline text.on{{fill:#fff}}
.timeline text.on-light{{fill:#1d1c1a}}
.timeline-names{{font:600 12px/{ROW_HEIGHT}px system-ui,sans-serif;color:var(--ink)}}
"""


def row_names(goals: Sequence[str], levels: int = 1, other: bool = False) -> tuple[str, ...]:
    """Names of the rows, top down, below the one with the numbers of the epochs.

    With several `levels` of the charge it has a row, too, and with `other` there is one for what
    another policy would have done.
    """
    wanted = tuple(f'{shown(goal, 16)}' for goal in goals[:MOST_GOAL_ROWS])
    charge = ('charge',) if levels > 1 else ()
    rows = *wanted, *charge, 'commitment', 'cell', 'threat', 'agile', 'fault'
    return (*rows, 'other policy') if other else rows


def blocks(epochs: Sequence[HeardEpoch]) -> list[Sequence[HeardEpoch]]:
    """Cut epochs into blocks, each at multiples of `BLOCK`: an old block stays as it is."""
    found: dict[int, list[HeardEpoch]] = {}
    for epoch in epochs:
        found.setdefault((epoch.number - 1) // BLOCK, []).append(epoch)
    return list(found.values())


def block_svg(
    epochs: Sequence[HeardEpoch],
    space: StateSpace,
    others: Mapping[int, str] | None = None,
    mission: Mission | None = None,
) -> str:
    """Return a block as one `svg` element.

    Parameters
    ----------
    epochs : sequence of HeardEpoch
    space : StateSpace
        Of their states.
    others : mapping, optional
        Commands of another policy by the numbers of the epochs in which it decides otherwise.
    mission : Mission, optional
        Tells the numbers of the goals in these commands.
    """
    rows = [*_rows(epochs, space)]
    if others is not None:
        rows.append([_other_cell(others.get(epoch.number), mission) for epoch in epochs])
    width, height = COLUMN_WIDTH * len(epochs), ROW_HEIGHT * (len(rows) + 1)
    rules = ''.join(f'M0 {ROW_HEIGHT * row}h{width}' for row in range(1, len(rows) + 1))
    parts = [
        f'<svg class="timeline" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="epochs {epochs[0].number} to {epochs[-1].number}">',
        f'<path class="rule" d="{rules}"/>',
        *_heads(epochs, height, others or {}),
    ]
    for row, cells in enumerate(rows, 1):
        parts += _runs(cells, row)
    return ''.join((*parts, '</svg>'))


def _heads(epochs: Sequence[HeardEpoch], height: int, others: Mapping[int, str]) -> Iterator[str]:
    """Numbers of the epochs, each with all that is known of it as a tooltip."""
    for column, epoch in enumerate(epochs):
        x = COLUMN_WIDTH * column
        decision = epoch.decision
        state = decision.space.text(decision.state) if decision.state else 'not known'
        title = f'{epoch.time_of_day}  {shown(epoch.command) or "no command"}  state {state}'
        if epoch.number in others:
            title += f'  other policy: {shown(others[epoch.number]) or "no command"}'
        yield (
            f'<text class="head" x="{x + COLUMN_WIDTH / 2}" y="14">{epoch.number}</text>'
            f'<rect x="{x}" y="0" width="{COLUMN_WIDTH}" height="{height}" fill="transparent">'
            f'<title>{escape(title)}</title></rect>'
        )


Cell = tuple[str, str]
"""Text and class of a cell of the timeline; an empty class is not coloured."""


def _rows(epochs: Sequence[HeardEpoch], space: StateSpace) -> Iterator[list[Cell]]:
    """Yield the cells of each row; empty where nothing was decided."""
    states = [each.state if len(each.state) == len(space.names) else () for each in epochs]
    views = [space.split(np.array(state)) if state else None for state in states]
    told = [each.decision.in_range or (1,) * space.k for each in epochs]
    known = [(s.g.tolist(), flags) if s else None for s, flags in zip(views, told)]
    for j in range(min(space.k, MOST_GOAL_ROWS)):
        yield [_goal_cell((here[0][j], here[1][j]) if here else None) for here in known]
    if space.levels > 1:
        yield [(str(s.b[0]), '') if s else ('', '') for s in views]
    yield [
        ('silent', 'none-1') if not epoch.command else _commitment(state)
        for epoch, state in zip(epochs, states)
    ]
    yield [(str(state[-4]), '') if state else ('', '') for state in states]
    yield [
        (THREAT_LEVELS[state[-2]], f't-{state[-2]}') if state and state[-2] else ('', '')
        for state in states
    ]
    yield [('yes', 'm-1') if state and state[-1] else ('', '') for state in states]
    yield [_fault_cell(state) for state in states]


def _goal_cell(known: tuple[int, int] | None) -> Cell:
    """Priority of a goal, of g and r; grey where it is out of range."""
    g, r = known or (0, 0)
    if not g:
        return '', ''
    word = ('', 'low', 'high')[g]
    return (word, f'g-{g}') if r else ('out', 'r-1')


def _commitment(state: tuple[int, ...]) -> Cell:
    return (str(state[-3]), 'c-1') if state and state[-3] else ('', '')


def _fault_cell(state: tuple[int, ...]) -> Cell:
    if not state or not 1 < state[0] <= len(FAULT_MODES):
        return '', ''
    return SHORT_FAULTS[state[0] - 1], 'f-1'


def _other_cell(command: str | None, mission: Mission | None) -> Cell:
    """What another policy would have done, in short, where that is something else."""
    if command is None:
        return '', ''
    if command in SHORT_COMMANDS or mission is None:
        return SHORT_COMMANDS.get(command, 'goal'), 'd-1'
    action = parse_command(mission, command)
    assert action.goal is not None
    return f'{action.goal + 1}{"!" if action.agile else ""}', 'd-1'


LIGHT = ('g-1', 't-1', 'd-1')
"""Classes whose colour is so light that text on it is dark."""


def _runs(cells: Sequence[Cell], row: int) -> Iterator[str]:
    """Draw equal neighbours as one bar."""
    start = 0
    for column in range(1, len(cells) + 1):
        if column < len(cells) and cells[column] == cells[start]:
            continue
        (text, kind), y, width = cells[start], ROW_HEIGHT * row, COLUMN_WIDTH * (column - start)
        x, height = COLUMN_WIDTH * start, ROW_HEIGHT - 4
        if kind:
            yield f'<rect class="{kind}" x="{x}" y="{y + 2}" width="{width}" height="{height}"/>'
        if text:
            on = (' class="on-light"' if kind in LIGHT else ' class="on"') if kind else ''
            yield f'<text{on} x="{x + width / 2}" y="{y + 14}">{escape(text)}</text>'
        start = column
