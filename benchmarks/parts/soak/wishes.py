"""What people want, and what of it is done, to hold commands and flights against."""

from __future__ import annotations

import math

from uav_mission_manager.mdp import Mission

GRACE = 12.0
"""Time [s] of work of all processes after which what a person asked for is known: twice the time
in which requests settle, and lost messages repeated."""


class Wishes:
    """What people want, by goal: asked for, done, or asked for again just when it was done."""

    def __init__(self, mission: Mission) -> None:
        self.names = [goal.name for goal in mission.goals]
        self.wanted = dict.fromkeys(self.names, False)
        self.doubtful = dict.fromkeys(self.names, False)
        self.unwanted_for = dict.fromkeys(self.names, math.inf)
        self.asked_for = 0.0
        self.done: dict[str, float] = {}

    def ask(self, priorities: tuple[int, ...]) -> None:
        """Someone has set the parameter."""
        for name, value in zip(self.names, priorities, strict=True):
            self.wanted[name] = value > 0
            if value:
                self.done.pop(name, None)
            self.doubtful[name] = False
        self.asked_for = 0.0

    def complete(self, name: str, now: float) -> None:
        """It was done, and said so."""
        self.doubtful[name] = self.wanted[name] and self.asked_for < GRACE
        self.wanted[name] = False
        self.done.setdefault(name, now)

    def pass_time(self, dt: float, *, all_work: bool) -> None:
        """Count the time in which all could hear of it."""
        if all_work:
            self.asked_for += dt
        for name in self.names:
            if self.wanted[name] or self.doubtful[name]:
                self.unwanted_for[name] = 0.0
            elif all_work:
                self.unwanted_for[name] += dt

    @property
    def none_for(self) -> float:
        """For how long [s] no goal has been wanted."""
        return min(self.unwanted_for.values())
