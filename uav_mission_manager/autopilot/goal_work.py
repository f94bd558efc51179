"""What is done at a goal, once the vehicle is there: its state, and what is to be done next.

An interruption, whatever it is, keeps what has been done; see `GoalWork.memory`. Done or failed, a
task is over, and if its goal is commanded again after another one it begins anew.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from uav_mission_manager.autopilot.task import FlightTask, Phase
from uav_mission_manager.autopilot.vehicle import TakePhoto
from uav_mission_manager.echo import shown
from uav_mission_manager.goal_task import Dwell, External, Photo, Waypoints

MAX_STEP = 1.0
"""Time [s] between two steps at most that counts as time on site: a choice, twenty steps."""

LEG_SAMPLES = 20
"""Places on a leg where the ground is looked up: a choice; a leg is two cells long at most."""

EVENT_REPEAT_PERIOD = 10.0
"""Time [s] after which a goal that is still commanded is reported as completed, or refused, again:
a choice."""

ON_THE_ROUND = (Phase.ON_SITE, Phase.EN_ROUTE, Phase.CLIMBING, Phase.BLOCKED)
"""Phases between waypoints; after another one the round is taken up from the goal."""

WHAT_DIGITS = 16
"""Digits of a task's hash: a choice, enough to tell a few tasks apart."""

_Point = tuple[float, float, float]
"""Latitude, longitude [deg], altitude above mean sea level [m]."""


@dataclass
class _Task:
    """A task that was begun, known by a hash; `done` counts seconds, pictures or waypoints."""

    what: str
    done: float = 0.0


class GoalWork:
    """The tasks at goals; see the module's docstring.

    Parameters
    ----------
    ground : callable
        Altitude of the ground above mean sea level [m] at a latitude and longitude [deg].

    Attributes
    ----------
    goal : str
        The present goal, once the vehicle was there; '' for none.
    done : bool
        Whether the task of the present goal is done.
    failed : str
        Why it cannot be done, '' if it can.
    """

    def __init__(self, ground: Callable[[float, float], float]) -> None:
        self._ground = ground
        self._begun: dict[str, _Task] = {}
        self.goal = ''
        self.done, self.failed = False, ''
        self._reported_at = -math.inf
        self._leg_altitude: float | None = None  # [m]; None while not on the way to a waypoint
        self._stepped_at = self._photo_at = -math.inf
        self._photo_asked = False

    @property
    def memory(self) -> dict[str, list[Any]]:
        """What `restore` takes: JSON values, in whole seconds."""
        return {goal: [task.what, int(task.done)] for goal, task in self._begun.items()}

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Go on from a `memory`; ValueError if it is none."""
        try:
            begun = {goal: _Task(what, float(done)) for goal, (what, done) in dict(memory).items()}
        except (TypeError, ValueError):
            begun = None
        if begun is None or not all(0.0 <= task.done < math.inf for task in begun.values()):
            raise ValueError(f'no tasks at goals: {shown(memory)}')
        self._begun = begun

    def retarget(self) -> None:
        """Take up another goal."""
        self.goal, self.done, self.failed = '', False, ''
        self._pause()
        self._leg_altitude = None
        self._photo_at = self._reported_at = -math.inf

    def watch(self, phase: Phase) -> None:
        """Take note of what the pilot is doing; only on site something is done."""
        if phase is not Phase.ON_SITE:
            self._pause()
        if phase not in ON_THE_ROUND:
            self._leg_altitude = None

    def target(self, task: FlightTask) -> FlightTask:
        """Return where to fly now: to the goal, and from there from waypoint to waypoint."""
        points = task.points
        if self._leg_altitude is None or self._over or task.goal != self.goal or not points:
            return task
        passed = int(self._begun_at(task).done)
        latitude, longitude, altitude = points[passed]
        return replace(
            task,
            text=f'{task.text}; waypoint {passed + 1} of {len(points)}',
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            cruise_altitude=self._leg_altitude,
        )

    def step(self, task: FlightTask, now: float) -> str:
        """Do what is to be done on site, at the `target`; say what that is, '' for a stay."""
        self.goal = task.goal
        passed = now - self._stepped_at
        self._stepped_at = now
        if self._over:
            return ''
        begun, work = self._begun_at(task), task.work
        if isinstance(work, Photo):
            return self._photograph(begun, work, now)
        if isinstance(work, Waypoints):
            return self._fly_round(begun, task)
        begun.done += passed if passed <= MAX_STEP else 0.0
        if isinstance(work, External):
            if begun.done >= work.timeout:
                self.fail(f'nothing heard of it for {work.timeout:g} s')
            return 'waits for goal_completed or goal_failed'
        if isinstance(work, Dwell) and begun.done >= work.seconds:
            self._finish()
        return ''

    def photo(self, task: FlightTask, now: float) -> TakePhoto | None:
        """Return the picture to ask for now, if there is one."""
        work = task.work
        if not isinstance(work, Photo) or self._over or self._photo_asked:
            return None
        if now - self._photo_at < work.interval:
            return None
        self._photo_asked, self._photo_at = True, now
        return TakePhoto(int(self._begun_at(task).done) + 1)

    def photo_answered(self, accepted: bool, why: str) -> None:
        """Take the camera's answer."""
        asked, self._photo_asked = self._photo_asked, False
        if not asked or self._over:
            return
        if accepted:
            self._begun[self.goal].done += 1
        else:
            self.fail(f'no picture: {why}')

    def completed(self, goal: str, now: float) -> None:
        """Take note that a goal was reported as completed, by another program or this one."""
        self._begun.pop(goal, None)
        if goal and goal == self.goal and not self.failed:
            self.done, self._reported_at = True, now

    def fail(self, why: str) -> None:
        """Give up the task of the present goal."""
        self._begun.pop(self.goal, None)
        self.failed = why

    def report(self, now: float) -> bool:
        """Whether it is time to report what became of the goal, for the first time or again."""
        due = now - self._reported_at >= EVENT_REPEAT_PERIOD
        if due:
            self._reported_at = now
        return due

    def _finish(self) -> None:
        self._begun.pop(self.goal, None)
        self.done = True

    @property
    def _over(self) -> bool:
        return self.done or bool(self.failed)

    def _pause(self) -> None:
        self._stepped_at, self._photo_asked = -math.inf, False

    def _begun_at(self, task: FlightTask) -> _Task:
        """Return the task as far as it was done, or anew if it was another one."""
        said = repr((task.work, task.points, task.latitude, task.longitude))
        what = hashlib.sha256(said.encode()).hexdigest()[:WHAT_DIGITS]
        begun = self._begun.get(task.goal)
        if begun is None or begun.what != what:
            begun = self._begun[task.goal] = _Task(what)
        return begun

    def _photograph(self, begun: _Task, work: Photo, now: float) -> str:
        if begun.done >= work.count:
            self._finish()
        return f'{begun.done:.0f} of {work.count} pictures'

    def _fly_round(self, begun: _Task, task: FlightTask) -> str:
        """At the goal, or at a waypoint: go on to the next."""
        here: _Point = (task.latitude, task.longitude, task.altitude)
        if self._leg_altitude is not None:
            here = task.points[int(begun.done)]
            begun.done += 1
        if begun.done >= len(task.points):
            self._finish()
            self._leg_altitude = None
        else:
            self._leg_altitude = self._clear_altitude(here, task.points[int(begun.done)])
        return f'{begun.done:.0f} of {len(task.points)} waypoints'

    def _clear_altitude(self, start: _Point, end: _Point) -> float:
        """Altitude of a leg [m]: not below either end, nor nearer to the ground than the lower."""
        grounds = [
            self._ground(*(a + (b - a) * n / LEG_SAMPLES for a, b in zip(start[:2], end[:2])))
            for n in range(LEG_SAMPLES + 1)
        ]
        above = min(start[2] - grounds[0], end[2] - grounds[-1])
        return max(start[2], end[2], max(grounds) + above)
