"""What is to be done at the goals, and the program that does it at one of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from uav_mission_manager.goal_task import External, GoalTask, Photo, Waypoint, Waypoints
from uav_mission_manager.mdp import Mission

if TYPE_CHECKING:
    from parts.soak.day import Day

ROUND = ((15.0, 0.0), (0.0, 15.0), (-15.0, 0.0), (0.0, 0.0))
"""Waypoints east and north of their goal [m]: nearer than where a vehicle has left it."""

WORK_TIME = 4.0
"""Time [s] on site that the program needs."""

FAILURE_SHARE = 0.1
"""Share of its works that fail."""


def with_work(mission: Mission) -> Mission:
    """Return a mission with pictures at the first goal, a round at the second, then a program."""
    tasks: list[GoalTask] = [Photo(4, 1.0), _round(mission), External(30.0)]
    goals = [
        replace(goal, task=task)
        for goal, task in zip(mission.goals, tasks[: mission.k], strict=True)
    ]
    return replace(mission, goals=tuple(goals))


def _round(mission: Mission) -> Waypoints:
    grid = mission.grid
    assert grid.origin is not None
    east, north = grid.position(mission.goals[1].cell)
    places = [grid.origin.to_geodetic(east + x, north + y) for x, y in ROUND]
    return Waypoints(tuple(Waypoint(*place) for place in places))


class Program:
    """Works at the goal that is active, as long as there is a bridge to say so."""

    def __init__(self, day: Day) -> None:
        self._day = day
        self._goal = ''
        self._begun_at = 0.0

    def step(self) -> None:
        """Go on with the work; say what became of it, once."""
        day = self._day
        active = day.bridge.core.output.active if day.bridge.works else ''
        if active:
            day.invariants.check_work('the work of a program', active)
        if active != self._goal:
            self._goal, self._begun_at = active, day.now
        if active and day.now - self._begun_at >= WORK_TIME:
            self._begun_at = float('inf')
            self._answer(active)

    def _answer(self, goal: str) -> None:
        bus, day = self._day.bus, self._day
        if day.rng.random() < FAILURE_SHARE:
            day.counts['work of a program failed'] += 1
            bus.failed.publish(goal, day.now)
        else:
            day.completed(goal)
            bus.complete(goal, day.now)
