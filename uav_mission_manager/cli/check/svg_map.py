"""The map of `mission_check` as SVG: what all maps show, and ways, reach and worth of goals.

Everything that comes from the file is escaped. South is down, so y is -north.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from uav_mission_manager.cli.check.facts import goal_facts
from uav_mission_manager.drawing.base_map import (
    MAP_STYLE,
    Scale,
    drawn_name,
    frame,
    ground,
    opening,
    points_of,
    stations,
    text_at,
    waypoints,
)
from uav_mission_manager.drawing.places import reaches
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission


def svg_map(mission: Mission) -> str:
    """Return the map as one `svg` element, which is a whole file too."""
    scale = Scale(mission)
    parts = [
        opening(mission, scale),
        f'<style>{MAP_STYLE}</style>',
        *ground(mission, scale),
        *_reach(mission, scale),
        *_ways(mission),
        *waypoints(mission, scale),
        *stations(mission, scale),
        *_goals(mission, scale),
        *frame(scale),
        '</svg>',
    ]
    return '\n'.join(parts)


def _reach(mission: Mission, scale: Scale) -> Iterator[str]:
    """Draw the rings that are on the map, each with its charge where it is first seen."""
    edges = scale.west, scale.north, scale.east - scale.west, scale.south - scale.north
    x, y, width, height = (f'{value:.6g}' for value in edges)
    yield (
        f'<clipPath id="frame"><rect x="{x}" y="{y}" width="{width}" height="{height}"/>'
        '</clipPath>'
    )
    for reach in reaches(mission):
        seen = [point for point in reach.ring if mission.grid.contains(*point)]
        if seen:
            ring = points_of(reach.ring)
            yield f'<polygon class="reach" clip-path="url(#frame)" points="{ring}"/>'
            east, north = seen[0]
            x_text = min(max(east, scale.west + 3 * scale.text), scale.east - 3 * scale.text)
            y_text = min(max(-north, scale.north + 1.2 * scale.text), scale.south - scale.text)
            yield text_at('reach-label', x_text, y_text, f'{reach.charge:.0%}', 0.8 * scale.text)


def _ways(mission: Mission) -> Iterator[str]:
    grid = mission.grid
    base, service = grid.position(grid.base), grid.position(grid.service)
    for goal in mission.goals:
        place = grid.position(goal.cell)
        for kind, start, end in (('there', base, place), ('onward', place, service)):
            yield (
                f'<line class="{kind}" x1="{start[0]:.6g}" y1="{-start[1]:.6g}" '
                f'x2="{end[0]:.6g}" y2="{-end[1]:.6g}"/>'
            )


def _goals(mission: Mission, scale: Scale) -> Iterator[str]:
    size, drawn = scale.text, dict[int, int]()
    for number, goal in enumerate(goal_facts(mission), 1):
        east, north = mission.grid.position(goal.cell)
        drawn[goal.cell] = (
            drawn.get(goal.cell, -1) + 1
        )  # Goals of one cell stand below each other.
        x, y = east, -north + drawn[goal.cell] * 3.4 * size
        title = escape(f'{shown(goal.name)}: cell {goal.cell}, needs {goal.needed:,.0f} m')
        yield f'<g><title>{title}</title>'
        yield f'<circle class="goal" cx="{x:.6g}" cy="{y:.6g}" r="{0.95 * size:.6g}"/>'
        yield text_at('sign', x, y + 0.36 * size, str(number), size)
        yield text_at('name', x, y + 2.0 * size, drawn_name(goal.name), 0.85 * size)
        worth = f'eta {goal.eta:g}, delta {goal.delta:g}'
        yield text_at('small', x, y + 2.9 * size, worth, 0.68 * size) + '</g>'
