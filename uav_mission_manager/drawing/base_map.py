"""What all maps of a mission show, as SVG in metres: cells, zones, areas, stations, scale, north.

Everything that comes from the file is escaped. South is down, so y is -north.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape

from uav_mission_manager.drawing.places import (
    Point,
    area_shapes,
    corners,
    inner_lines,
    onsets,
    outline,
    rounds,
)
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission

MOST_NUMBERED = 400
"""Cells of a grid whose numbers can be read on a screen: a choice."""

MOST_LINES = 200
"""Lines of a grid one way that can be told apart on a screen: a choice."""

LONGEST_NAME_DRAWN = 18
"""Characters of a name on the map: a choice; all of it is in the tooltip."""

TEXT_SHARE = 42.0
"""Width of the map over the height of its text: a choice, 20 pixels on a map of 850."""

MAP_STYLE = """
.ground{fill:#fbfaf6}.zone{fill:#f6c8b6}.calm{fill:#e9f3e4}.base{fill:#d5e4f7}.service{fill:#e4dcf3}
.line{stroke:#d9d4c7;fill:none}.edge{stroke:#8f8a7d;fill:none}
.there,.onward{stroke:#3d6b99;stroke-opacity:.75;stroke-width:.16em;stroke-linecap:round}
.onward{stroke:#7a5aa6;stroke-dasharray:.1em .45em}
.reach{fill:none;stroke:#2f8f5b;stroke-dasharray:.7em .4em;stroke-width:.14em}
.goal{fill:#b3471d;stroke:#fff}.base-sign{fill:#2a5d9c;stroke:#fff}
.service-sign{fill:#6a489b;stroke:#fff}.north{fill:#44413a}.scale{stroke:#44413a;fill:none;stroke-width:.12em}
text{font-family:system-ui,sans-serif;text-anchor:middle;fill:#2b2a26}
text.sign{fill:#fff;font-weight:700}text.name,text.halo{font-weight:600}text.reach-label{fill:#23734a}
text.halo{fill:#fff;stroke:#fff;stroke-width:.3em;stroke-opacity:.85;stroke-linejoin:round}
.fence{fill:none;stroke:#1d1c1a;stroke-width:.22em;stroke-dasharray:1.1em .35em}
.no-fly{fill:#5b2a6e;fill-opacity:.28;stroke:#5b2a6e;stroke-width:.16em}text.area-name{fill:#5b2a6e}
.round{fill:none;stroke:#b3471d;stroke-width:.12em;stroke-linejoin:round}.waypoint{fill:#b3471d}
text.number{text-anchor:start;fill:#9a9484}
"""
"""Styles of the map; on a page they are those of its legend too."""


class Scale:
    """Sizes on the map [m], by its extent: text is as large to read on every map.

    Attributes
    ----------
    box : tuple
        Left, top, width and height of the picture.
    text : float
        Height of text.
    """

    def __init__(self, mission: Mission) -> None:
        easts, norths = zip(*outline(mission.grid), strict=True)
        west, east, south, north = min(easts), max(easts), min(norths), max(norths)
        width, height = east - west, north - south
        self.text = max(width, height) / TEXT_SHARE
        side, foot = 2.2 * self.text, 4.6 * self.text
        self.box = west - side, -north - side, width + 2 * side, height + side + foot
        self.west, self.east, self.south, self.north = west, east, -south, -north


def ground(mission: Mission, scale: Scale) -> Iterator[str]:
    """Cells with their numbers and chances of threats, and the areas of the mission file."""
    yield from _cells(mission)
    yield from _lines(mission)
    yield from _numbers(mission, scale)
    yield from _areas(mission, scale)


def waypoints(mission: Mission, scale: Scale) -> Iterator[str]:
    """Waypoints of goals, with the legs between them."""
    for number, points in rounds(mission).items():
        goal = mission.goals[number]
        here = mission.grid.position(goal.cell)
        steps = 'L'.join(f'{east:.6g} {-north:.6g}' for east, north in (here, *points))
        title = escape(f'{shown(goal.name)}: {len(points)} waypoints')
        size = 0.28 * scale.text
        dots = ''.join(
            f'M{east - size / 2:.6g} {-north - size / 2:.6g}h{size:.4g}v{size:.4g}h{-size:.4g}z'
            for east, north in points
        )
        yield f'<path class="round" d="M{steps}"><title>{title}</title></path>'
        yield f'<path class="waypoint" d="{dots}"/>'


def frame(scale: Scale) -> Iterator[str]:
    """A scale bar, and where north is."""
    yield from _scale_bar(scale)
    yield from _north_arrow(scale)


def opening(mission: Mission, scale: Scale) -> str:
    """Start of an `svg` element, whole but for its end."""
    box = ' '.join(f'{value:.6g}' for value in scale.box)
    label = escape(f'map of mission {shown(mission.name)}')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" role="img" '
        f'aria-label="{label}" font-size="{scale.text:.6g}" stroke-width="{scale.text / 14:.4g}">'
    )


def stations(mission: Mission, scale: Scale) -> Iterator[str]:
    """Signs of base and service, beside each other where they are one cell."""
    grid, size = mission.grid, scale.text
    for name, cell, sign, shift in (
        ('base', grid.base, 'B', -0.75 * (grid.base == grid.service)),
        ('service', grid.service, 'S', 0.75 * (grid.base == grid.service)),
    ):
        east, north = grid.position(cell)
        x, y = east + 2 * shift * size, -north
        yield (
            f'<rect class="{name}-sign" x="{x - 0.8 * size:.6g}" y="{y - 0.8 * size:.6g}" '
            f'width="{1.6 * size:.6g}" height="{1.6 * size:.6g}" rx="{0.25 * size:.4g}"/>'
        )
        yield text_at('sign', x, y + 0.36 * size, sign, size)
        yield text_at('name', x, y + 2.0 * size, name, 0.85 * size)


def drawn_name(name: str) -> str:
    """A name as long as there is room for."""
    name = shown(name)
    return (
        name
        if len(name) <= LONGEST_NAME_DRAWN
        else f'{name[: LONGEST_NAME_DRAWN - 1]}\N{HORIZONTAL ELLIPSIS}'
    )


def text_at(kind: str, x: float, y: float, text: str, size: float) -> str:
    """Text with a halo, for it to be read on lines too."""
    place = f'x="{x:.6g}" y="{y:.6g}" font-size="{size:.4g}"'
    halo = '' if kind == 'sign' else f'<text class="halo" {place}>{escape(text)}</text>'
    return f'{halo}<text class="{kind}" {place}>{escape(text)}</text>'


def points_of(ring: Sequence[Point]) -> str:
    """Corners of a ring for `points`; the last one of a closed ring is left out."""
    return ' '.join(map(_pair, ring[:-1]))


def _pair(point: Point) -> str:
    return f'{point[0]:.6g},{-point[1]:.6g}'


def _cells(mission: Mission) -> Iterator[str]:
    grid, ordinary = mission.grid, mission.threat.onset
    yield f'<polygon class="ground" points="{points_of(outline(grid))}"/>'
    special = {cell: ('zone' if p > ordinary else 'calm') for cell, p in onsets(mission).items()}
    for cell, kind in special.items():
        onset = f'cell {cell}: threat comes with {dict(mission.threat.zones)[cell]:.3g} an epoch'
        points = points_of(corners(grid, cell, cell))
        yield f'<polygon class="{kind}" points="{points}"><title>{onset}</title></polygon>'
    for name, cell in (('service', grid.service), ('base', grid.base)):
        yield f'<polygon class="{name}" points="{points_of(corners(grid, cell, cell))}"/>'


def _lines(mission: Mission) -> Iterator[str]:
    grid = mission.grid
    if max(grid.rows, grid.cols) > MOST_LINES:
        return
    lines = ''.join(f'M{_pair(start)}L{_pair(end)}' for start, end in inner_lines(grid))
    yield f'<path class="line" d="{lines}"/>'
    yield f'<polygon class="edge" points="{points_of(outline(grid))}"/>'


def _numbers(mission: Mission, scale: Scale) -> Iterator[str]:
    grid = mission.grid
    if grid.q > MOST_NUMBERED:
        return
    size = min(0.62 * scale.text, grid.cell_size / 4)
    right, down = 0.5 * size / grid.cell_size - 0.5, 1.3 * size / grid.cell_size - 0.5
    for cell in range(grid.q):
        row, col = divmod(cell, grid.cols)
        east, north = grid.at(col + right, row + down)
        place = f'translate({east:.6g} {-north:.6g}) rotate({grid.bearing:g})'
        yield f'<text class="number" transform="{place}" font-size="{size:.4g}">{cell}</text>'


def _areas(mission: Mission, scale: Scale) -> Iterator[str]:
    """Draw the fence and the areas not to fly over, named where they are named on the map."""
    for area in area_shapes(mission):
        kind, title = 'fence' if area.stay_inside else 'no-fly', escape(shown(area.name))
        ring = points_of(area.ring)
        yield f'<polygon class="{kind}" points="{ring}"><title>{title}</title></polygon>'
        east, north = (sum(values) / len(values) for values in zip(*area.ring[:-1], strict=True))
        if not area.stay_inside and mission.grid.contains(east, north):
            yield text_at('area-name', east, -north, drawn_name(area.name), 0.75 * scale.text)


def _scale_bar(scale: Scale) -> Iterator[str]:
    """A bar of a round length, about a quarter of the map."""
    length = _round_length((scale.east - scale.west) / 4)
    x, y, tick = scale.west, scale.south + 1.8 * scale.text, 0.35 * scale.text
    end = f'v{2 * tick:.4g}m0 {-tick:.4g}'
    bar = f'M{x:.6g} {y - tick:.6g}{end}h{length:.6g}m0 {-tick:.4g}{end}'
    yield f'<path class="scale" d="{bar}"/>'
    text = f'{length:g} m' if length < 10_000 else f'{length / 1000:g} km'
    yield text_at('small', x + length / 2, y + 1.4 * scale.text, text, 0.85 * scale.text)


def _round_length(most: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not above this."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1, 2, 5) if step * power <= most)


def _north_arrow(scale: Scale) -> Iterator[str]:
    size, x, y = scale.text, scale.east - scale.text, scale.south + 0.9 * scale.text
    arrow = (
        f'M{x:.6g} {y:.6g}l{0.6 * size:.4g} {1.9 * size:.4g}l{-0.6 * size:.4g} {-0.45 * size:.4g}'
    )
    yield f'<path class="north" d="{arrow}l{-0.6 * size:.4g} {0.45 * size:.4g}z"/>'
    yield text_at('small', x, y + 3.0 * size, 'N', 0.85 * size)
