"""What a vehicle flew of a round of waypoints, by its own positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from scenarios import Sample

from uav_mission_manager.goal_task import Waypoints
from uav_mission_manager.mdp import Mission

RADIUS, TOLERANCE = 3.0, 2.0
"""How near [m] a waypoint is passed, beside and below or above: the bridge's defaults."""

BESIDE = RADIUS + 2.0
"""How far [m] beside a leg it may be flown: it begins and ends anywhere near its ends, and at
3 m/s the vehicle takes 2 m to turn."""

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Visit:
    """A waypoint, from 1, and the first and the last sample of the track that is near it."""

    waypoint: int
    first: int
    last: int


def waypoints_of(mission: Mission, goal: str, flight_altitude: float) -> list[Place]:
    """East, north and height above the ground at cell 0 [m] of a goal's waypoints."""
    [task] = [each.task for each in mission.goals if each.name == goal]
    assert isinstance(task, Waypoints)
    assert mission.grid.origin is not None
    return [
        (
            *mission.grid.origin.to_local(point.latitude, point.longitude),
            flight_altitude if point.height is None else point.height,
        )
        for point in task.points
    ]


def visits(track: Sequence[Sample], points: Sequence[Place]) -> list[Visit]:
    """Return when the vehicle was near which waypoint, in the order in which it came there."""
    found = []
    for number, (east, north, height) in enumerate(points, 1):
        near = [
            math.hypot(at.east - east, at.north - north) <= RADIUS
            and abs(at.height - height) <= TOLERANCE
            for at in track
        ]
        edges = [n for n in range(len(near)) if near[n] != (n > 0 and near[n - 1])]
        edges += [len(near)] * (len(edges) % 2)
        found += [Visit(number, *ends) for ends in zip(edges[::2], edges[1::2], strict=True)]
    return sorted(found, key=lambda visit: visit.first)


def farthest_beside(track: Sequence[Sample], start: Place, end: Place) -> float:
    """Return how far [m] beside the straight leg between two places the track leads at most."""
    (x, y, _), (to_x, to_y, _) = start, end
    length = math.hypot(to_x - x, to_y - y)
    return max(
        abs((at.east - x) * (to_y - y) - (at.north - y) * (to_x - x)) / length for at in track
    )


def require_flown_once(
    track: Sequence[Sample], points: Sequence[Place], left_after: int = 0
) -> None:
    """Require that each waypoint was passed once, in order, and each leg was flown straight.

    `left_after` is the waypoint after which the round was left, to be taken up at the next one;
    0 where it was not.
    """
    seen = visits(track, points)
    assert [visit.waypoint for visit in seen] == [*range(1, len(points) + 1)]
    for one, other in pairwise(seen):
        if one.waypoint != left_after:
            ends = points[one.waypoint - 1], points[other.waypoint - 1]
            beside = farthest_beside(track[one.last : other.first], *ends)
            assert beside < BESIDE, f'the leg after waypoint {one.waypoint}'
