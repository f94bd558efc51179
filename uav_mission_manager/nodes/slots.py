"""The slots of the mission that the manager flies by: which are free, and what takes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import PRIORITY_LEVELS, Mission
from uav_mission_manager.mdp.placing import place_goal, with_places_of
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import safety_clock, seconds
from uav_mission_manager.policy import PolicyError
from uav_mission_manager.policy.store import read_digest, read_mission

DECISION_TIME = 5.0
"""Time [s] after which a manager's last decision says nothing of now: a choice, five repetitions
of it."""

TAKE_OVER_TIME = 30.0
"""Time [s] that a manager is given to take over a policy set, before a goal is placed in another
one: a choice, enough to load a large one."""

SUFFIXES = '.goals1', '.goals2'
"""What the names of policy sets with requested goals end with: there is one to fly by and one to
be built."""


@dataclass(frozen=True)
class Placement:
    """A mission with goals in its slots, the file that it was written to, where its set goes."""

    mission: Mission
    file: str
    out: Path


class SlotsInFlight:
    """Hears from the manager what it flies by, and how much each goal is wanted.

    What it flies by is the mission file, or one of two policy sets beside the solver's own: the
    other one may be built anew. So nothing is to be remembered here.

    Parameters
    ----------
    node : Node
    """

    def __init__(self, node: Node) -> None:
        self._clock = safety_clock()
        self._decision: Mapping[str, str] = {}
        self._decided_at = self._announced_at = -math.inf
        self._announced = ''
        node.create_subscription(
            DiagnosticArray,
            'manager/decision',
            self._on_decision,
            qos.LATCHED,
            qos_overriding_options=qos.OVERRIDABLE,
        )

    def place(self, mission: Mission, out: Path, most: int, text: str) -> tuple[Placement, str]:
        """Write the mission with a requested goal in a free slot, or added; say which.

        Parameters
        ----------
        mission : Mission
            Of the mission file.
        out : Path
            Of its policy set.
        most : int
            See `place_goal`.
        text : str
            The request.

        Raises
        ------
        ValueError
            One line: the request is refused, or the manager is not ready for it.
        OSError
            If it cannot be written.
        """
        waits = seconds(self._clock) - self._announced_at < TAKE_OVER_TIME
        if self._announced and waits and self._decision.get('policy') != self._announced:
            raise ValueError('the manager has not taken over the last policy set yet; ask again')
        flown = self._flown(mission, out)
        slots = [j for j, goal in enumerate(flown.goals) if goal.slot]
        free = [j for j in slots if not self._is_open(flown.goals[j].name)]
        placed, slot = place_goal(flown, text, free, most)
        goal = placed.goals[slot]
        of = f'in place of {flown.goals[slot].name}' if slot < flown.k else 'added'
        said = f'goal {goal.name} in cell {goal.cell}, {of}'
        return self._written(placed, out), said

    def kept(self, mission: Mission, out: Path) -> Placement | None:
        """Write a mission file's mission with the goals that are in its slots; None without any.

        Raises as `place` does, but for what is wrong with a request.
        """
        if not self._is_heard or self._set_in_use(out) is None:
            return None
        return self._written(self._flown(mission, out), out)

    def announced(self, digest: str) -> None:
        """Take note that the manager is told of a policy set."""
        self._announced, self._announced_at = digest, seconds(self._clock)

    def _on_decision(self, message: DiagnosticArray) -> None:
        self._decision = {pair.key: pair.value for s in message.status for pair in s.values}
        self._decided_at = seconds(self._clock)

    @property
    def _is_heard(self) -> bool:
        return seconds(self._clock) - self._decided_at < DECISION_TIME

    def _is_open(self, name: str) -> bool:
        """Whether a goal is wanted, or was refused and is wanted still."""
        refused = self._decision.get('refused_goals', '').split(', ')
        return self._priority(name) != PRIORITY_LEVELS[0] or name in refused

    def _priority(self, name: str) -> str | None:
        return self._decision.get(f'{name} priority')

    def _flown(self, mission: Mission, out: Path) -> Mission:
        """Return a mission with its slots where the manager has them."""
        if not self._is_heard:
            raise ValueError('no manager is heard, so nobody knows which slots are free')
        used = self._set_in_use(out)
        if used is not None:
            placed = read_mission(used)
            names = [goal.name for goal in placed.goals]
            wanted = [j for j, name in enumerate(names) if self._is_open(name)]
            mission = with_places_of(mission, placed, wanted)
        names = [goal.name for goal in mission.goals]
        if 'state' not in self._decision:
            raise ValueError(
                'the manager decides nothing now, so nobody knows which slots are free'
            )
        if not all(map(self._priority, names)):
            raise ValueError(f'the manager has other goals than {shown(", ".join(names))}')
        return mission

    def _set_in_use(self, out: Path) -> Path | None:
        """Return which of the two sets beside another one the manager flies by."""
        for place in _places(out):
            try:
                if read_digest(place) == self._decision.get('policy'):
                    return place
            except PolicyError:  # There is none yet.
                continue
        return None

    def _written(self, mission: Mission, out: Path) -> Placement:
        """Write a mission file beside the set that is not in use."""
        used = self._set_in_use(out)
        place = next(place for place in _places(out) if place != used)
        file = place.with_name(f'{place.name}.yaml')
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(yaml.safe_dump(mission.to_dict(), sort_keys=False))
        return Placement(mission, str(file), place)


def _places(out: Path) -> list[Path]:
    return [out.with_name(out.name + suffix) for suffix in SUFFIXES]
