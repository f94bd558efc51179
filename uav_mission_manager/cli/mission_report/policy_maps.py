"""What a policy does in each cell, as small maps beside each other: by fault, threat, priority."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from uav_mission_manager.cli.check.facts import marks
from uav_mission_manager.drawing.base_map import points_of
from uav_mission_manager.drawing.places import corners, outline
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import (
    FAULT_MODES,
    Action,
    ActionKind,
    Grid,
    Mission,
    action_name,
    global_actions,
)
from uav_mission_manager.policy import Policy
from uav_mission_manager.policy.plotting import (
    MOST_LETTERED,
    action_colour,
    map_states,
    range_columns,
)

MOST_GOALS = 6
"""Goals that have a row of maps of their own: a choice, a page."""

MAPS_STYLE = """
.maps td,.maps th{border:0;padding:.15rem .4rem;vertical-align:middle}
.maps th:first-child{width:7rem}
.maps svg{max-height:9rem;display:block}.maps text{text-anchor:middle;font-weight:600;fill:#11100e}
.maps text.sign-of-cell{font-size:6px;font-weight:400;text-anchor:start}
.agile{fill:url(#agile)}
.edge{stroke:#8f8a7d;fill:none}
"""


@dataclass(frozen=True)
class MapRow:
    """A row of maps: what it is called, and its fault mode, range flags and priorities."""

    name: str
    fault: str
    ranges: tuple[int, ...]
    priorities: tuple[int, ...]


def fault_rows(mission: Mission) -> list[MapRow]:
    """Return a row for each fault mode, with all goals in range and wanted."""
    k = mission.k
    return [MapRow(name.replace('_', ', '), name, (1,) * k, (2,) * k) for name in FAULT_MODES]


def priority_rows(mission: Mission) -> list[MapRow]:
    """Return rows without faults: priorities, each goal alone, and none in range."""
    k, well = mission.k, FAULT_MODES[0]
    rows = [
        MapRow('all goals high', well, (1,) * k, (2,) * k),
        MapRow('all goals low', well, (1,) * k, (1,) * k),
        MapRow('no goal wanted', well, (1,) * k, (0,) * k),
    ]
    for j in range(min(k, MOST_GOALS) if k > 1 else 0):
        only = tuple(2 * (i == j) for i in range(k))
        rows.append(MapRow(f'{shown(mission.goals[j].name, 40)} high alone', well, (1,) * k, only))
    return [*rows, MapRow('all high, none in range', well, (0,) * k, (2,) * k)]


def maps_table(policy: Policy, rows: Sequence[MapRow]) -> str:
    """Return the maps of some rows, a column for each threat level."""
    levels = policy.mission.threat.levels
    heads = ''.join(f'<th>threat {escape(level)}</th>' for level in levels)
    parts = [f'<table class="maps"><thead><tr><th></th>{heads}</tr></thead><tbody>']
    for row in rows:
        maps = ''.join(f'<td>{_map(policy, row, level)}</td>' for level in levels)
        parts.append(f'<tr><th>{escape(row.name)}</th>{maps}</tr>')
    return '\n'.join((*parts, '</tbody></table>'))


def hatch(grid: Grid) -> str:
    """Return the hatch of agile flight, for all maps of a page: as coarse as their cells."""
    return (
        '<svg style="position:absolute;width:0;height:0" aria-hidden="true"><defs>'
        '<pattern id="agile" width="6" height="6" patternUnits="userSpaceOnUse" '
        f'patternTransform="scale({grid.cell_size / 24:.6g}) rotate(45)">'
        '<path d="M0 0V6" stroke="#555" stroke-width="1.6"/>'
        '</pattern></defs></svg>'
    )


def legend(mission: Mission) -> str:
    """Return what colours and letters mean, as items of a list."""
    box = '<svg viewBox="0 0 24 16"><rect width="24" height="16" {}/></svg>'
    items = []
    for action in global_actions(mission):
        if action.agile:
            continue
        text = 'to base, or stay there'
        if action.goal is not None:
            text = f'commit to {shown(mission.goals[action.goal].name, 40)}'
        elif action.kind is not ActionKind.NONE:
            text = action.kind.value
        fill = f'fill="{action_colour(action)}"'
        items.append(f'<li>{box.format(fill)}{_letter(action)}: {escape(text)}</li>')
    width, height = mission.grid.cell_size, mission.grid.cell_size * 2 / 3
    items.append(
        f'<li><svg viewBox="0 0 {width:g} {height:g}"><rect class="agile" width="{width:g}" '
        f'height="{height:g}"/></svg>in agile mode</li>'
    )
    items.append('<li>small letters: base B, service cell S, goals by number</li>')
    return ''.join(items)


def _map(policy: Policy, row: MapRow, threat: str) -> str:
    """Draw one map in cells: a cell is 24 units wide, and letters fit."""
    mission = policy.mission
    grid = mission.grid
    if mission.range.charge is None:
        columns = range_columns(policy, row.ranges, None)
    else:  # Full, or empty: then no goal is in range.
        columns = range_columns(policy, None, mission.range.levels - 1 if all(row.ranges) else 0)
    states = map_states(policy, row.fault, threat, columns, row.priorities)
    actions = [global_actions(mission)[number - 1] for number in policy.act(states)]
    unit = 24 / grid.cell_size
    easts, norths = zip(*outline(grid), strict=True)
    left, top = unit * min(easts), -unit * max(norths)
    width, height = unit * (max(easts) - min(easts)), unit * (max(norths) - min(norths))
    label, signs = escape(f'{row.name}, threat {threat}'), marks(mission)
    parts = [
        f'<svg viewBox="{left - 1:.6g} {top - 1:.6g} {width + 2:.6g} {height + 2:.6g}" role="img" '
        f'aria-label="{label}" font-size="13"><g transform="scale({unit:.6g})">',
        *_cells(grid, actions),
        '</g>',
    ]
    if max(grid.rows, grid.cols) <= MOST_LETTERED:
        for cell, action in enumerate(actions):
            east, north = grid.position(cell)
            name = escape(f'cell {cell}: {shown(action_name(mission, action))}')
            x, y = unit * east, -unit * north
            parts.append(
                f'<text x="{x:.6g}" y="{y + 4.5:.6g}">{_letter(action)}'
                f'<title>{name}</title></text>'
            )
            if cell in signs:
                place = f'x="{x - 11:.6g}" y="{y - 5.5:.6g}"'
                parts.append(f'<text class="sign-of-cell" {place}>{signs[cell]}</text>')
    return ''.join((*parts, '</svg>'))


def _cells(grid: Grid, actions: Sequence[Action]) -> Iterator[str]:
    """Colour the cells, hatch the agile ones; equal neighbours of a row are one piece."""
    stroke = grid.cell_size / 24
    for kind in ('colour', 'agile'):
        for first, last in _runs(grid, actions):
            action = actions[first]
            ring = points_of(corners(grid, first, last))
            if kind == 'colour':
                fill = action_colour(action)
                yield f'<polygon points="{ring}" fill="{fill}" stroke="{fill}" stroke-width="0"/>'
            elif action.agile:
                yield f'<polygon class="agile" points="{ring}"/>'
    ring = points_of(outline(grid))
    yield f'<polygon class="edge" points="{ring}" stroke-width="{stroke:.4g}"/>'


def _runs(grid: Grid, actions: Sequence[Action]) -> Iterator[tuple[int, int]]:
    first = 0
    for cell in range(1, grid.q + 1):
        if cell == grid.q or cell % grid.cols == 0 or actions[cell] != actions[first]:
            yield first, cell - 1
            first = cell


def _letter(action: Action) -> str:
    """What stands in a cell: a goal's number, or the first letter of what else is done."""
    if action.goal is not None:
        return str(action.goal + 1)
    return {ActionKind.RECHARGE: 'C', ActionKind.REPAIR: 'R'}.get(action.kind, 'B')
