"""The map of a flight: its track, coloured by time, and where each command was given."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

from uav_mission_manager.cli.mission_report.flight_record import FlightRecord, TrackPoint
from uav_mission_manager.cli.mission_report.story import StoryRow
from uav_mission_manager.drawing.base_map import (
    Scale,
    drawn_name,
    frame,
    ground,
    opening,
    stations,
    text_at,
    waypoints,
)
from uav_mission_manager.drawing.trail import TRAIL_BREAK
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission

TIME_COLOURS = ('#440154', '#3b528b', '#21918c', '#35a13f', '#b0a000', '#d95f0e')
"""From the beginning to the end of a flight: dark to light, told apart by the colour-blind."""

TRACK_STEP = 0.12
"""Distance of two points of the track, in heights of text: a choice, below a pixel on paper."""

MOST_NUMBERS = 6
"""Numbers of commands that one mark shows: a choice; more are counted."""

TRACK_STYLE = """
.track{fill:none;stroke-width:.3em;stroke-linejoin:round;stroke-linecap:round}
.command-mark{fill:#fff;stroke:var(--craft);stroke-width:.1em}
text.command-number{fill:var(--craft);font-weight:700}
"""


@dataclass
class Mark:
    """A place on the map with the numbers of the commands given there."""

    east: float
    north: float
    numbers: list[int]

    @property
    def text(self) -> str:
        """The numbers as a label."""
        shown_here = ', '.join(map(str, self.numbers[:MOST_NUMBERS]))
        more = len(self.numbers) - MOST_NUMBERS
        return f'{shown_here} +{more}' if more > 0 else shown_here


def track_map(mission: Mission, record: FlightRecord, commands: Sequence[StoryRow]) -> str:
    """Return the map as one `svg` element."""
    scale = Scale(mission)
    parts = (
        opening(mission, scale).replace('<svg ', '<svg class="map" ', 1),
        *ground(mission, scale),
        *waypoints(mission, scale),
        *_track(record, scale),
        *stations(mission, scale),
        *_goals(mission, scale),
        *_marks(record, commands, scale),
        *frame(scale),
        '</svg>',
    )
    return '\n'.join(parts)


def time_legend(end: float, text: str) -> str:
    """Return the colours of the time with their beginning and end."""
    width = 100 / len(TIME_COLOURS)
    boxes = ''.join(
        f'<rect x="{width * place:.2f}" width="{width:.2f}" height="8" fill="{colour}"/>'
        for place, colour in enumerate(TIME_COLOURS)
    )
    return (
        f'<svg viewBox="0 0 100 8" style="width:9rem" role="img" aria-label="colours of the time">'
        f'{boxes}</svg>{escape(text)}'
    )


def _hue(at: float, end: float) -> int:
    share = at / end if end > 0 else 0.0
    return min(int(share * len(TIME_COLOURS)), len(TIME_COLOURS) - 1)


def _track(record: FlightRecord, scale: Scale) -> Iterator[str]:
    for piece in _pieces(_thinned(record.track, TRACK_STEP * scale.text)):
        last: TrackPoint | None = None
        for hue, group in groupby(piece, key=lambda place: _hue(place.at, record.end)):
            places = list(group)
            line = places if last is None else [last, *places]
            points = ' '.join(f'{p.east:.1f},{-p.north:.1f}' for p in line)
            yield f'<polyline class="track" stroke="{TIME_COLOURS[hue]}" points="{points}"/>'
            last = places[-1]


def _thinned(track: Sequence[TrackPoint], step: float) -> list[TrackPoint]:
    """Leave out places that are nearer than a step to the one before."""
    kept: list[TrackPoint] = []
    for place in track:
        if not kept or math.dist(kept[-1][1:3], place[1:3]) >= step:
            kept.append(place)
    return kept


def _pieces(track: Sequence[TrackPoint]) -> Iterator[list[TrackPoint]]:
    """Cut the track where the position jumps."""
    piece: list[TrackPoint] = []
    for place in track:
        if piece and math.dist(piece[-1][1:3], place[1:3]) > TRAIL_BREAK:
            yield piece
            piece = []
        piece.append(place)
    yield piece


def command_marks(record: FlightRecord, commands: Sequence[StoryRow], apart: float) -> list[Mark]:
    """Return where commands were given; those nearer than `apart` [m] share a mark."""
    found: list[Mark] = []
    for row in commands:
        place = record.place_at(row.at)
        if place is None:
            continue
        near = next((m for m in found if math.dist((m.east, m.north), place[1:3]) < apart), None)
        if near is None:
            found.append(Mark(place.east, place.north, [row.number]))
        else:
            near.numbers.append(row.number)
    return found


def _marks(record: FlightRecord, commands: Sequence[StoryRow], scale: Scale) -> Iterator[str]:
    size = 0.9 * scale.text
    for mark in command_marks(record, commands, 2.0 * scale.text):
        x, y, width = mark.east, -mark.north - 2.3 * size, (0.9 + 0.55 * len(mark.text)) * size
        yield (
            f'<path class="command-mark" d="M{x:.6g} {-mark.north:.6g}V{y:.6g}"/>'
            f'<rect class="command-mark" x="{x - width / 2:.6g}" y="{y - 0.75 * size:.6g}" '
            f'width="{width:.4g}" height="{1.5 * size:.4g}" rx="{0.7 * size:.4g}"/>'
            f'<text class="command-number" x="{x:.6g}" y="{y + 0.36 * size:.6g}" '
            f'font-size="{size:.4g}">{mark.text}</text>'
        )


def _goals(mission: Mission, scale: Scale) -> Iterator[str]:
    size, drawn = scale.text, dict[int, int]()
    for number, goal in enumerate(mission.goals, 1):
        drawn[goal.cell] = drawn.get(goal.cell, -1) + 1  # Of one cell below each other.
        east, north = mission.grid.position(goal.cell)
        x, y = east, -north + drawn[goal.cell] * 3.4 * size
        yield f'<g><title>{escape(f"{shown(goal.name)}: cell {goal.cell}")}</title>'
        yield f'<circle class="goal" cx="{x:.6g}" cy="{y:.6g}" r="{0.95 * size:.6g}"/>'
        yield text_at('sign', x, y + 0.36 * size, str(number), size)
        yield text_at('name', x, y + 2.1 * size, drawn_name(goal.name), 0.85 * size) + '</g>'
