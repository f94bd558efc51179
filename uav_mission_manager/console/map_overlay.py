"""What moves on the map, as SVG over the mission's own map: goals, range, way, trail, vehicles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape

import numpy as np

from uav_mission_manager.console.heard import Heard, Pose, last_state
from uav_mission_manager.drawing.base_map import (
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
from uav_mission_manager.drawing.places import Point, corners, ellipse
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission, StateSpace
from uav_mission_manager.mdp.charge import state_flags
from uav_mission_manager.mdp.range_model import flight_range
from uav_mission_manager.onboard import parse_command

PRIORITY_WORDS = ('not wanted', 'low priority', 'high priority')
"""What the priorities 0, 1 and 2 mean."""

OVERLAY_STYLE = """
.goal-0{fill:var(--ground);stroke:var(--dim)}.goal-1{fill:var(--low);stroke:var(--ink)}
.goal-2{fill:var(--high);stroke:var(--ink)}
.pale{opacity:.45}
.lost{stroke-dasharray:.35em .25em}.committed{fill:none;stroke:var(--craft);stroke-width:.28em}
.sign-0{fill:var(--dim)!important;font-weight:700}.sign-1{fill:#1d1c1a!important;font-weight:700}
.sign-2{fill:#fff!important;font-weight:700}
.range{fill:none;stroke:var(--good);stroke-dasharray:.7em .4em;stroke-width:.2em}
.way{stroke:var(--craft);stroke-width:.22em;stroke-dasharray:.2em .5em;stroke-linecap:round}
.target{fill:none;stroke:var(--craft);stroke-width:.2em}
.trail{fill:none;stroke:var(--craft);stroke-opacity:.45;stroke-width:.16em}
.craft{fill:var(--craft);stroke:#fff;stroke-width:.14em;stroke-linejoin:round}
.craft.old{fill:var(--stale)}.other .craft{fill:var(--dim)}
.threat-1{fill:var(--warning);stroke:var(--warning)}.threat-2{fill:var(--danger);
stroke:var(--danger)}.threat-1,.threat-2{fill-opacity:.3;stroke-width:.3em}
"""
"""Styles of what moves; colours are variables of the page, for light and dark."""


def base_layer(mission: Mission) -> str:
    """Return what does not move: cells, zones, areas, waypoints, base, service, scale, north."""
    scale = Scale(mission)
    parts = (
        *ground(mission, scale),
        *waypoints(mission, scale),
        *stations(mission, scale),
        *frame(scale),
    )
    return '\n'.join((opening(mission, scale), *parts, '</svg>'))


@dataclass(frozen=True)
class Craft:
    """A vehicle on the map; an old position is grey."""

    pose: Pose
    old: bool


def goal_layer(mission: Mission, heard: Heard, old: bool) -> str:
    """Return the goals as they are wanted, or were when that was last decided, pale if it is old.

    They change with a decision only.
    """
    scale = Scale(mission)
    parts = (
        *_threat(mission, heard),
        f'<g class="{"pale" if old else "now"}">',
        *_goals(mission, heard, scale),
        '</g>',
    )
    return '\n'.join((_layer(mission, scale), *parts, '</svg>'))


def _layer(mission: Mission, scale: Scale) -> str:
    return opening(mission, scale).replace('role="img"', 'role="presentation"')


def moving_layer(mission: Mission, heard: Heard, vehicle: str, crafts: Mapping[str, Craft]) -> str:
    """Return range, way and trail of a vehicle, and all vehicles.

    Parameters
    ----------
    mission : Mission
    heard : Heard
        Of the vehicle.
    vehicle : str
    crafts : mapping of str to Craft
        By vehicle; this one is drawn last, with its height, the others with their names.
    """
    scale = Scale(mission)
    parts = [
        _layer(mission, scale),
        '<clipPath id="map-edge"><rect '
        f'x="{scale.west:.6g}" y="{scale.north:.6g}" width="{scale.east - scale.west:.6g}" '
        f'height="{scale.south - scale.north:.6g}"/></clipPath>',
        *_range(mission, heard),
        *_trail(heard),
        *_way(mission, heard, scale),
    ]
    for name, craft in crafts.items():
        if name != vehicle:
            parts += ['<g class="other">', *_craft(craft, scale, name), '</g>']
    if vehicle in crafts:
        parts += _craft(crafts[vehicle], scale, f'{crafts[vehicle].pose.height:.0f} m')
    return '\n'.join((*parts, '</svg>'))


def _threat(mission: Mission, heard: Heard) -> Iterator[str]:
    """Mark the cell of a vehicle that is threatened."""
    decision = heard.decision.value if heard.decision else None
    if decision and decision.state and decision.state[-2] and heard.pose:
        pose = heard.pose.value
        cell = mission.grid.cell_at(pose.east, pose.north)
        ring = points_of(corners(mission.grid, cell, cell))
        yield f'<polygon class="threat-{decision.state[-2]}" points="{ring}"/>'


def _range(mission: Mission, heard: Heard) -> Iterator[str]:
    """Draw where it may go and still reach the service cell, with the charge left."""
    if mission.energy is None or heard.pose is None or not heard.batteries:
        return
    charge = min(noted.value for noted in heard.batteries.values())
    here = heard.pose.value.east, heard.pose.value.north
    service = mission.grid.position(mission.grid.service)
    had = flight_range(mission.energy, charge)
    if had > math.dist(here, service):
        ring = points_of(ellipse(here, service, had))
        yield f'<polygon class="range" clip-path="url(#map-edge)" points="{ring}"/>'


def _trail(heard: Heard) -> Iterator[str]:
    if len(heard.trail) > 1:
        path = ' '.join(f'{east:.1f},{-north:.1f}' for east, north in heard.trail)
        yield f'<polyline class="trail" points="{path}"/>'


def _way(mission: Mission, heard: Heard, scale: Scale) -> Iterator[str]:
    target = target_of(mission, heard)
    if target is None:
        return
    x, y, size = target[0], -target[1], 1.7 * scale.text
    if heard.pose:
        pose = heard.pose.value
        yield (
            f'<line class="way" x1="{pose.east:.1f}" y1="{-pose.north:.1f}" '
            f'x2="{x:.6g}" y2="{y:.6g}"/>'
        )
    arm = f'{0.5 * size:.4g}'
    yield (
        f'<path class="target" d="M{x - size:.6g} {y:.6g}h{arm}M{x + size:.6g} {y:.6g}h-{arm}'
        f'M{x:.6g} {y - size:.6g}v{arm}M{x:.6g} {y + size:.6g}v-{arm}"/>'
    )


def target_of(mission: Mission, heard: Heard) -> Point | None:
    """Where the command leads [m]; None where nothing is commanded."""
    if heard.decision is None or not heard.decision.value.command:
        return None
    try:
        action = parse_command(mission, heard.decision.value.command)
    except ValueError:
        return None
    return mission.grid.position(action.destination)


def _goals(mission: Mission, heard: Heard, scale: Scale) -> Iterator[str]:
    """Draw goals by priority and state: the larger, the more is wanted."""
    size, drawn = scale.text, dict[int, int]()
    space = StateSpace.of(mission)
    state = last_state(heard.epochs)
    known = len(state) == len(space.names)
    s = space.split(np.array(state if known else (0,) * len(space.names)))
    flags = state_flags(mission, s)
    for j, goal in enumerate(mission.goals):
        priority = int(s.g[j])
        in_range = not known or bool(flags[j])
        committed = known and state[-3] == j + 1
        drawn[goal.cell] = (
            drawn.get(goal.cell, -1) + 1
        )  # Goals of one cell stand below each other.
        east, north = mission.grid.position(goal.cell)
        x, y = east, -north + drawn[goal.cell] * 3.4 * size
        words = PRIORITY_WORDS[priority] + ('' if in_range else ', out of range')
        words = words if known else 'not known'
        place = f'cx="{x:.6g}" cy="{y:.6g}"'
        lost = '' if in_range else ' lost'
        yield f'<g><title>{escape(f"{shown(goal.name)}: cell {goal.cell}, {words}")}</title>'
        if committed:
            yield f'<circle class="committed" {place} r="{1.5 * size:.6g}"/>'
        radius = (0.85 + 0.15 * priority) * size
        yield f'<circle class="goal-{priority}{lost}" {place} r="{radius:.6g}"/>'
        at = f'x="{x:.6g}" y="{y + 0.36 * size:.6g}" font-size="{size:.4g}"'
        yield f'<text class="sign-{priority}" {at}>{j + 1}</text>'
        yield text_at('name', x, y + 2.3 * size, drawn_name(goal.name), 0.85 * size)
        yield text_at('small', x, y + 3.2 * size, words, 0.7 * size) + '</g>'


def _craft(craft: Craft, scale: Scale, label: str) -> Iterator[str]:
    """Draw a vehicle as an arrow along its heading; as a disc where that is not known."""
    pose = craft.pose
    x, y, size = pose.east, -pose.north, 1.1 * scale.text
    kind = 'craft old' if craft.old else 'craft'
    if math.isfinite(pose.heading):
        shape = (
            f'M0 {-1.3 * size:.4g}L{0.8 * size:.4g} {0.9 * size:.4g}L0 {0.45 * size:.4g}'
            f'L{-0.8 * size:.4g} {0.9 * size:.4g}z'
        )
        turn = f'translate({x:.1f} {y:.1f}) rotate({math.degrees(pose.heading):.0f})'
        yield f'<path class="{kind}" transform="{turn}" d="{shape}"/>'
    else:
        yield f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{0.7 * size:.4g}"/>'
    yield text_at('name', x, y - 1.7 * size, drawn_name(label), 0.85 * scale.text)
