"""Items of a plan of QGroundControl: places to fly to, and what is done there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from uav_mission_manager.cli.mission_new.found import Found, Place, point_of
from uav_mission_manager.cli.mission_new.json_value import JsonValue
from uav_mission_manager.cli.mission_new.qgc_transects import POSITION, read_complex_item
from uav_mission_manager.echo import shown
from uav_mission_manager.goal_task import Dwell, Photo
from uav_mission_manager.mdp.fields import number, within
from uav_mission_manager.mdp.goal_tasks import MAX_PICTURES, MAX_TIME

PLACE_COMMANDS = {
    16: 'waypoint',
    17: 'loiter',
    18: 'loiter',
    19: 'loiter',
    31: 'loiter',
    82: 'spline',
}
"""MAV_CMD of the items that are places to fly to, and what their goals are called."""

HOLD_COMMANDS = (16, 19, 82)
"""Those whose first parameter is how long to stay [s]."""

LOITER_TIME = 19
"""MAV_CMD of a stay at a place, or where the vehicle is then."""

DELAY, PICTURE, PICTURES = 93, 203, 2000
"""MAV_CMD of a stay, a picture, and of pictures, where the vehicle is then."""

LAST_OF_NAVIGATION = 95
"""MAV_CMD up to which items move the vehicle: MAV_CMD_NAV_LAST."""

OTHER_COMMANDS = {
    20: 'return to launch',
    21: 'landing: the mission says where, by its base and service cells',
    22: 'take-off: the bridge takes off by itself',
    178: 'change of speed: give --speed',
    195: 'region of interest: no place to fly to',
    201: 'region of interest: no place to fly to',
    206: 'pictures by distance: let the camera, or the autopilot, take them by itself',
    530: 'camera mode: set it on the camera',
    2001: 'end of pictures: a photo task ends by itself',
}
"""Why other items are left out."""

RELATIVE_FRAMES = (3, 6)
"""MAV_FRAME of altitudes above home."""

_TIME, _COUNT = within(0.0, MAX_TIME), within(0.0, MAX_PICTURES)


class ItemReader:
    """Takes the items of a plan one by one; what is done at a place follows it.

    Attributes
    ----------
    heights : list of (height, item)
        Heights above home [m] that places and surveys have.
    """

    def __init__(self, found: Found) -> None:
        self._found = found
        self._there = False  # at the last place of `found`
        self.heights: list[tuple[float, str]] = []

    def read(self, item: JsonValue, position: int) -> None:
        """Take one item."""
        what = f'item {position}'
        if item['type'].value == 'ComplexItem':
            self._there = False
            height = read_complex_item(self._found, item, position)
            self._add_height(height, what)
            return
        command = item['command'].value
        if not isinstance(command, int):
            command = 0
        if command in PLACE_COMMANDS:
            self._read_place(item, command, position)
        elif self._there and command in (DELAY, PICTURE, PICTURES):
            self._read_deed(item, command, what)
        else:
            self._there &= command > LAST_OF_NAVIGATION
            nowhere = 'it is not done at a waypoint'
            deeds = dict.fromkeys((DELAY, PICTURE, PICTURES), nowhere)
            why = {**OTHER_COMMANDS, **deeds}.get(command)
            self._found.leave_out(
                what, why or f'command {shown(item["command"].value)} is no place to fly to'
            )

    def _add_height(self, height: float | None, what: str) -> None:
        if height:
            self.heights.append((height, what))

    def _read_place(self, item: JsonValue, command: int, position: int) -> None:
        what, name = f'item {position}', PLACE_COMMANDS[command]
        params = [entry.value for entry in item['params'].entries()]
        point = params[POSITION]
        if len(point) < 2 or None in point or point == [0, 0]:
            if self._there and command == LOITER_TIME:
                self._read_deed(item, DELAY, what)
                return
            self._found.leave_out(
                what, f'{name} without a position: it means where the vehicle is'
            )
            return
        place = item['params'].read(lambda _: point_of(point))
        hold = _param(item, 0, _TIME) if command in HOLD_COMMANDS else None
        task = Dwell(hold) if hold else None
        self._found.add_place(f'{name}_{position}', place, what, task)
        self._there = True
        height = item['Altitude'].value if item['Altitude'] else (params + [None] * 7)[6]
        if item['frame'].value in RELATIVE_FRAMES and height is not None:
            self._add_height(item['Altitude'].read(lambda _: number(height)), what)

    def _read_deed(self, item: JsonValue, command: int, what: str) -> None:
        """Take a stay, or pictures, at the last place."""
        place = self._found.places[-1]
        read = self._stay if command == DELAY else self._pictures
        if task := read(item, command, place, what):
            self._found.places[-1] = replace(place, task=task)

    def _stay(self, item: JsonValue, _: int, place: Place, what: str) -> Dwell | None:
        """Return how long to stay in all, None for no longer."""
        stay = _param(item, 0, number) or 0.0
        if stay <= 0.0 or isinstance(place.task, Photo):
            self._found.leave_out(what, 'a stay beside pictures, or until a time of day')
            return None
        return Dwell(stay + (place.task.seconds if isinstance(place.task, Dwell) else 0.0))

    def _pictures(self, item: JsonValue, command: int, place: Place, what: str) -> Photo | None:
        """Return which pictures to take in all, None for no more."""
        count, interval = 1, 0.0
        if command == PICTURES:
            interval = _param(item, 1, _TIME) or 0.0
            count = int(_param(item, 2, _COUNT) or 0)
        if count < 1:
            self._found.leave_out(what, 'pictures without end: give them a number')
            return None
        before = place.task
        if isinstance(before, Photo):
            return Photo(count + before.count, max(interval, before.interval))
        if isinstance(before, Dwell):
            instead = 'pictures are taken instead'
            self._found.leave_out(place.source, f'its stay of {before.seconds:g} s: {instead}')
        return Photo(count, interval)


def _param(item: JsonValue, index: int, check: Callable[[Any], float]) -> float | None:
    """Return a parameter of an item, None where it has none."""
    params = item['params'].entries()
    return params[index].read(check) if index < len(params) and params[index] else None
