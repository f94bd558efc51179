"""An input as data: what was heard can be written down, and heard again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from uav_mission_manager.onboard.situation import Situation

CHANGES: dict[str, Callable[..., Situation]] = {
    'battery_state': Situation.with_battery,
    'odom': Situation.with_position,
    'fault_mode': Situation.with_fault,
    'threat_level': Situation.with_threat,
    'goal_priorities': Situation.with_priorities,
}
"""What a message of each topic that tells how things are does to the situation."""

EVENT_CHANGES: dict[str, Callable[..., Situation]] = {
    'goal_completed': Situation.with_completed,
    'goal_refused': Situation.with_refused,
}
"""The same of topics that tell what has happened, whenever that was."""


@dataclass(frozen=True)
class HeardInput:
    """A message of a topic, as the arguments of the method of `Situation` that takes it.

    Attributes
    ----------
    topic : str
        A key of `CHANGES` or `EVENT_CHANGES`.
    time : float
        From when it is [s].
    values : mapping
        The method's other arguments by name: JSON values, or sequences of them.
    """

    topic: str
    time: float
    values: Mapping[str, Any]

    def __call__(self, situation: Situation) -> Situation:
        """Return the next situation. Raises `InputError`."""
        if self.topic in EVENT_CHANGES:
            return EVENT_CHANGES[self.topic](situation, **self.values)
        return CHANGES[self.topic](situation, **self.values, now=self.time)
