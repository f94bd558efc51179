"""What messages say, as changes of what was heard of a vehicle.

They are of ROS's classes or of those of a bag's reader, which have the same fields.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from uav_mission_manager.console.heard import Heard, LogLine, Pose, bridge_from, decision_from
from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.frames import MAP_FRAME
from uav_mission_manager.mdp import FAULT_MODES, THREAT_LEVELS

DECISION_TOPIC = 'manager/decision'
"""The topic by which a vehicle is found; what is before it is its namespace."""

DIAGNOSTICS_TOPIC = '/diagnostics'
"""The topic of all vehicles, see `bridge_reports`."""

FLEET_TOPIC = 'fleet/decision'
"""The topic of the base station of several vehicles, below its namespace, see `shares_of`."""

BRIDGE_STATUS = '/mavlink_bridge: autopilot'
"""What the name of a bridge's status ends in, after its namespace."""


class Moment(NamedTuple):
    """When something was so [s], and the time of day at which it was heard, for people."""

    at: float
    time_of_day: str


HeardChange = Callable[[Heard, Any, Moment], Heard]
"""How a message changes what is known; raises `ValueError` where it cannot be believed."""


def heard_after(heard: Heard, topic: str, message: Any, moment: Moment) -> Heard:
    """Return what is known after a message of one of `HEARD_CHANGES`; one not believed is told."""
    try:
        return HEARD_CHANGES[topic](heard, message, moment)
    except ValueError as error:
        text = f'{topic}: {shown(error)}'
        return heard.with_line(LogLine(moment.time_of_day, text, 'warning'))


def bridge_reports(message: Any) -> Iterator[tuple[str, Any]]:
    """Yield vehicle and status of the bridges in a message of `DIAGNOSTICS_TOPIC`."""
    for status in message.status:
        vehicle, found, _ = status.name.partition(BRIDGE_STATUS)
        if found:
            yield vehicle, status


def shares_of(message: Any) -> Iterator[tuple[str, str]]:
    """Yield vehicle, and which goal it is given and why, of a message of `FLEET_TOPIC`."""
    for status in message.status:
        for pair in status.values:
            if pair.key.startswith('/'):  # Else it is about a goal that nobody is given.
                yield pair.key, pair.value


def _odometry(heard: Heard, message: Any, moment: Moment) -> Heard:
    if message.header.frame_id not in ('', MAP_FRAME):
        raise ValueError(f'frame_id {quoted(message.header.frame_id)} is not {MAP_FRAME!r}')
    return heard.with_pose(pose_of(message), moment.at)


def pose_of(odometry: Any) -> Pose:
    """Return where a vehicle is, and where it heads, by its odometry."""
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    yaw = math.atan2(
        2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2)
    )
    return Pose(place.x, place.y, place.z, math.pi / 2.0 - yaw)


def _battery(heard: Heard, message: Any, moment: Moment) -> Heard:
    return heard.with_battery(message.location, message.percentage, moment.at)


def _fault(heard: Heard, message: Any, moment: Moment) -> Heard:
    if message.data not in FAULT_MODES:
        raise ValueError(f'{quoted(message.data)} is no fault mode')
    return heard.with_fault(message.data, *moment)


def _threat(heard: Heard, message: Any, moment: Moment) -> Heard:
    if message.data not in THREAT_LEVELS:
        raise ValueError(f'{quoted(message.data)} is no threat level')
    return heard.with_threat(message.data, *moment)


def _asked(heard: Heard, message: Any, moment: Moment) -> Heard:
    return heard.with_asked(tuple(map(int, message.data)), *moment)


def _told(what: str, level: str = '') -> HeardChange:
    """Return the change by a word of which only the log tells; an empty one is none."""

    def change(heard: Heard, message: Any, moment: Moment) -> Heard:
        if not message.data:
            return heard
        return heard.with_line(LogLine(moment.time_of_day, f'{what}: {message.data}', level))

    return change


def _policy_set(heard: Heard, message: Any, moment: Moment) -> Heard:
    return heard.with_policy_set(message.data, moment.time_of_day)


def _decision(heard: Heard, message: Any, moment: Moment) -> Heard:
    for status in message.status:
        heard = heard.with_decision(decision_from(status.message, _values(status)), *moment)
    return heard


def _bridge(heard: Heard, status: Any, moment: Moment) -> Heard:
    return heard.with_bridge(bridge_from(status.message, _values(status)), *moment)


def _values(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


HEARD_CHANGES: dict[str, HeardChange] = {
    'odom': _odometry,
    'battery_state': _battery,
    'fault_mode': _fault,
    'threat_level': _threat,
    'goal_priorities': _asked,
    'goal_active': _told('another program works at'),
    'goal_completed': _told('completed'),
    'goal_failed': _told('task failed', 'warning'),
    'goal_refused': _told('out of reach', 'warning'),
    'policy_set': _policy_set,
    DECISION_TOPIC: _decision,
    DIAGNOSTICS_TOPIC: _bridge,
}
"""What is heard; of `DIAGNOSTICS_TOPIC` one status alone."""
