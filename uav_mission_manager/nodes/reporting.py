"""What the manager knows and decides, as diagnostic and marker messages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from uav_mission_manager.echo import shown
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.mdp import Grid
from uav_mission_manager.onboard import Refusal, Situation, format_command
from uav_mission_manager.policy import Decision, Policy

LONGEST_TEXT = 2000
"""Characters of a message or value in the diagnostics: a choice, ten that are cut where they come
from, and the values of all actions of a mission of a hundred goals."""

KEPT_INPUTS = ('threat_level', 'goal_priorities')
"""Inputs whose last value stays in force however old it is; the diagnostics warn of its age."""

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

WHITE, GREY, BLUE = (1.0, 1.0, 1.0, 1.0), (0.6, 0.6, 0.6, 1.0), (0.1, 0.4, 1.0, 1.0)
"""Colours of names, of the grid, and of the UAV and its target."""

PRIORITY_COLOURS = (GREY, (1.0, 0.8, 0.1, 1.0), (1.0, 0.4, 0.0, 1.0))
"""Colour of a goal, by its priority."""

THREAT_COLOURS = ((0.0, 0.8, 0.2, 0.2), (1.0, 0.8, 0.0, 0.4), (1.0, 0.0, 0.0, 0.5))
"""Colour of the UAV's cell, by the threat level t."""


def status(level: bytes, name: str, message: str, **values: object) -> DiagnosticStatus:
    """Return a diagnostic status with its values as text, in one line each."""
    pairs = [
        KeyValue(key=shown(key), value=shown(value, LONGEST_TEXT)) for key, value in values.items()
    ]
    text = shown(message, LONGEST_TEXT)
    return DiagnosticStatus(level=level, name=name, message=text, values=pairs)


def decision_status(
    name: str,
    outcome: Decision | Refusal,
    situation: Situation,
    now: float,
    digest: str,
) -> DiagnosticStatus:
    """Return why the manager decided as it did, or why it did not decide."""
    ages = {f'age {topic} [s]': f'{age:.2f}' for topic, age in situation.ages(now).items()}
    refused = ', '.join(situation.refused_goals) or 'none'
    if isinstance(outcome, Refusal):
        return status(
            DiagnosticStatus.ERROR,
            name,
            outcome.reason,
            refused_goals=refused,
            policy=digest,
            **ages,
        )
    mission = situation.mission
    runner_up = outcome.runner_up
    return status(
        DiagnosticStatus.OK,
        name,
        outcome.reason,
        state=' '.join(map(str, outcome.state)),
        command=format_command(mission, outcome.action),
        action=outcome.action.number,
        refused_goals=refused,
        runner_up='none' if runner_up is None else format_command(mission, runner_up),
        values=' '.join(f'{value:.6g}' for value in outcome.values),
        margin=f'{outcome.margin:.6g}',
        lower_bound=f'{outcome.lower_bound:.6g}',
        upper_bound=f'{outcome.upper_bound:.6g}',
        policy=digest,
        **ages,
    )


def manager_health(
    name: str,
    used: tuple[str, Policy],
    outcome: Decision | Refusal,
    situation: Situation,
    complaints: Mapping[str, str],
    troubles: Mapping[str, str],
    now: float,
    timeout: float,
) -> list[DiagnosticStatus]:
    """Return how the manager is: its policy and inputs, and what else there is to say.

    Parameters
    ----------
    name : str
        Of the node.
    used : tuple of str and Policy
        Where the policy is from, and the policy.
    outcome : Decision or Refusal
    situation : Situation
    complaints : mapping
        What is wrong with messages, by topic.
    troubles : mapping
        What is wrong with other parts, by part; empty if nothing.
    now, timeout : float
        Time, and the age above which an input is old [s].
    """
    ok, warn, error = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
    path, policy = used
    bad_policy = complaints.get('policy_set', '')
    ages = situation.ages(now)
    notes = [text for topic, text in complaints.items() if topic != 'policy_set']
    notes += situation.warnings
    notes += [
        f'{topic} {ages[topic]:.1f} s old, its last value kept'
        for topic in KEPT_INPUTS
        if ages.get(topic, 0.0) > timeout
    ]
    level, link = ok, 'all inputs fresh'
    if missing := situation.missing(now, timeout):
        level, link = error, 'link lost: ' + ', '.join(missing)
    elif isinstance(outcome, Refusal):  # Before anything is asked for, this is as it should be.
        level, link = error if 'goal_priorities' in situation.known else warn, outcome.reason
    details = {topic: f'{age:.2f} s' for topic, age in ages.items()}
    return [
        status(
            warn if bad_policy else ok,
            f'{name}: policy',
            bad_policy or path,
            digest=policy.digest,
            method=policy.method,
        ),
        status(
            warn if notes else ok, f'{name}: inputs', '; '.join(notes) or 'all good', **details
        ),
        status(level, f'{name}: link', link),
        *(
            status(warn if trouble else ok, f'{name}: {part}', trouble or 'all good')
            for part, trouble in troubles.items()
        ),
    ]


def cell_pose(grid: Grid, cell: int, stamp: Time) -> PoseStamped:
    """Return the centre of a cell in `map`."""
    message = PoseStamped(header=Header(stamp=stamp, frame_id=MAP_FRAME))
    message.pose.position.x, message.pose.position.y = grid.position(cell)
    message.pose.orientation.w = 1.0
    return message


def markers(situation: Situation, target: int | None, stamp: Time) -> MarkerArray:
    """Return grid, goals, threat, UAV and the line to its target cell, for RViz and Foxglove."""
    grid, array = situation.mission.grid, MarkerArray()

    def add(space: str, kind: int, colour: Colour, size: float, number: int = 0) -> Marker:
        marker = Marker(
            header=Header(stamp=stamp, frame_id=MAP_FRAME), ns=space, id=number, type=kind
        )
        marker.pose.orientation.w = 1.0
        marker.color = ColorRGBA(**dict(zip('rgba', colour, strict=True)))
        marker.scale.x = marker.scale.y = marker.scale.z = size
        array.markers.append(marker)
        return marker

    def at(marker: Marker, position: tuple[float, float]) -> Marker:
        marker.pose.position.x, marker.pose.position.y = position
        return marker

    size = grid.cell_size
    add('grid', Marker.LINE_LIST, GREY, size / 50).points = list(_grid_lines(grid))
    for j, goal in enumerate(situation.mission.goals):
        colour = PRIORITY_COLOURS[situation.priorities[j]]
        at(add('goal', Marker.SPHERE, colour, size / 4, j), grid.position(goal.cell))
        label = add('name', Marker.TEXT_VIEW_FACING, WHITE, size / 6, j)
        at(label, grid.position(goal.cell)).text = f'{goal.name}: {situation.priorities[j]}'
    cube = add('threat', Marker.CUBE, THREAT_COLOURS[situation.threat], size)
    at(cube, grid.position(situation.cell)).scale.z = size / 50
    half_turn = -math.radians(grid.bearing) / 2.0
    cube.pose.orientation.z, cube.pose.orientation.w = math.sin(half_turn), math.cos(half_turn)
    line = add('target', Marker.LINE_STRIP, BLUE, size / 25)
    if situation.position is None or target is None:
        line.action = Marker.DELETE
    else:
        line.points = [_point(situation.position), _point(grid.position(target))]
    if situation.position is not None:
        at(add('uav', Marker.SPHERE, BLUE, size / 5), situation.position)
    return array


def _point(position: tuple[float, float]) -> Point:
    return Point(x=position[0], y=position[1])


def _grid_lines(grid: Grid) -> Iterator[Point]:
    right, bottom = grid.cols - 0.5, grid.rows - 0.5
    for col in range(grid.cols + 1):
        yield from (_point(grid.at(col - 0.5, -0.5)), _point(grid.at(col - 0.5, bottom)))
    for row in range(grid.rows + 1):
        yield from (_point(grid.at(-0.5, row - 0.5)), _point(grid.at(right, row - 0.5)))
