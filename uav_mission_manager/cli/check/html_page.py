"""One HTML page of a mission: map, legend and goals; it loads nothing from anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from uav_mission_manager.cli.check.facts import (
    done_text,
    epoch_seconds,
    full_range,
    goal_facts,
    grid_text,
    task_text,
    worth_a_minute,
)
from uav_mission_manager.cli.check.finding import Finding
from uav_mission_manager.cli.check.svg_map import svg_map
from uav_mission_manager.cli.html_document import html_document
from uav_mission_manager.drawing.places import area_shapes, reaches, rounds
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission

STYLE = """
body{font:16px/1.45 system-ui,sans-serif;color:#2b2a26;background:#fff;
margin:1.5rem auto;max-width:62rem;padding:0 1rem}
h1{font-size:1.4rem;margin:0 0 .2rem;overflow-wrap:anywhere}p{margin:.2rem 0 1rem}
svg{width:100%;max-height:80vh}
table{border-collapse:collapse;width:100%;margin:1rem 0}
th,td{padding:.3rem .6rem;border-bottom:1px solid #e4e0d6;text-align:right;white-space:nowrap}
th:nth-child(-n+2),td:nth-child(-n+2){text-align:left;overflow-wrap:anywhere;white-space:normal}
td:nth-child(2){min-width:7rem}
th:last-child,td:last-child{text-align:left;white-space:normal}
.legend{display:flex;flex-wrap:wrap;gap:.4rem 1.4rem;list-style:none;padding:0;font-size:.9rem}
.legend svg{width:1.6rem;height:1.1rem;vertical-align:-.2rem;margin-right:.4rem;font-size:8px}
"""

GOAL_TABLE = """<table>
<thead><tr><th>#</th><th>goal</th><th>cell</th><th>from base</th><th>to service</th><th>needs</th>
<th>charge</th><th>done in</th><th>eta, delta</th><th>worth a minute</th><th>task</th></tr>
</thead>
<tbody>
{}
</tbody>
</table>"""

BOX = '<rect class="{kind}" width="24" height="16"/>'
GROUND_LEGEND = (
    ('base, where it starts', BOX.format(kind='base-sign')),
    ('service, where it is recharged and repaired', BOX.format(kind='service-sign')),
    ('threats likelier than elsewhere', BOX.format(kind='zone')),
    ('threats less likely', BOX.format(kind='calm')),
)
WAY_LEGEND = (
    ('goal, by its number below', '<circle class="goal" cx="12" cy="8" r="7.5"/>'),
    ('way from base', '<line class="there" x1="0" y1="8" x2="24" y2="8"/>'),
    ('on to service', '<line class="onward" x1="0" y1="8" x2="24" y2="8"/>'),
)


def html_page(mission: Mission, findings: Sequence[Finding]) -> str:
    """Return the page."""
    body = (
        f'<p>{escape(summary(mission))}</p>',
        svg_map(mission),
        f'<ul class="legend">\n{map_legend(mission)}\n</ul>',
        goal_table(mission),
        finding_list(findings),
    )
    return html_document(f'Mission {shown(mission.name)}', STYLE, '\n'.join(body))


def map_legend(mission: Mission) -> str:
    """Return what the signs of the map mean, as items of a list."""
    return ground_legend(mission) + _items([*WAY_LEGEND, *_reach_legend(mission)])


def ground_legend(mission: Mission) -> str:
    """Return what the signs mean that all maps of a mission have."""
    return _items([*GROUND_LEGEND, *_area_legend(mission)])


def _items(legend: Sequence[tuple[str, str]]) -> str:
    return '\n'.join(
        f'<li><svg viewBox="0 0 24 16">{sign}</svg>{escape(text)}</li>' for text, sign in legend
    )


def goal_table(mission: Mission) -> str:
    """Return a table of the goals."""
    return GOAL_TABLE.format('\n'.join(_rows(mission)))


def summary(mission: Mission) -> str:
    """Say in a line how large the mission is, and where."""
    grid, seconds, had = mission.grid, epoch_seconds(mission), full_range(mission)
    text = grid_text(grid)
    if seconds is not None and had is not None:
        text += f'; an epoch takes {seconds:.4g} s; range on a full battery {had:,.0f} m'
    if grid.origin is not None:
        text += f'; cell 0 at {grid.origin.latitude:.6f}, {grid.origin.longitude:.6f} deg'
    return text


def _area_legend(mission: Mission) -> list[tuple[str, str]]:
    """Legend of what only some missions have."""
    kinds = {area.stay_inside for area in area_shapes(mission)}
    signs = [
        ('fence, to stay inside', BOX.format(kind='fence'), True in kinds),
        ('area not to fly over', BOX.format(kind='no-fly'), False in kinds),
        ('waypoints', '<path class="round" d="M0 8H24"/>', bool(rounds(mission))),
    ]
    return [(text, sign) for text, sign, there in signs if there]


def _reach_legend(mission: Mission) -> list[tuple[str, str]]:
    rings = [f'{ring.charge:.0%}: {ring.distance:,.0f} m' for ring in reaches(mission)]
    if not rings:
        return []
    sign = '<ellipse class="reach" cx="12" cy="8" rx="11" ry="7"/>'
    text = 'in range from base, there and on to service, by charge (where it ends on the map): '
    return [(text + ', '.join(rings), sign)]


def _rows(mission: Mission) -> list[str]:
    rows = []
    for number, goal in enumerate(goal_facts(mission), 1):
        worth = worth_a_minute(goal, epoch_seconds(mission))
        cells = (
            str(number),
            shown(goal.name),
            str(goal.cell),
            f'{goal.from_base:,.0f} m',
            f'{goal.to_service:,.0f} m',
            f'{goal.needed:,.0f} m',
            '' if goal.charge is None else f'{goal.charge:.0%}',
            '' if goal.done_seconds is None else done_text(goal),
            f'{goal.eta:.4g}, {goal.delta:.4g}',
            '' if worth is None else f'{worth[0]:.4g}, {worth[1]:.4g}',
            task_text(goal),
        )
        rows.append(f'<tr>{"".join(f"<td>{escape(cell)}</td>" for cell in cells)}</tr>')
    return rows


def finding_list(findings: Sequence[Finding]) -> str:
    """Return warnings and notes as a list."""
    if not findings:
        return '<p>Nothing implausible was found.</p>'
    items = ''.join(
        f'<li>{"note: " if finding.note else ""}{escape(str(finding))}</li>'
        for finding in findings
    )
    return f'<ul>{items}</ul>'
