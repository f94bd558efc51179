"""What the thread of ROS writes and the page reads: whole values, each exchanged in one step."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from queue import SimpleQueue

from uav_mission_manager.console.forecasting import Forecaster, GoalChances
from uav_mission_manager.console.heard import Heard
from uav_mission_manager.console.map_overlay import Craft
from uav_mission_manager.console.orders import OperatorOrder
from uav_mission_manager.console.policies import PolicyShelf
from uav_mission_manager.console.view import VehicleView, view_of
from uav_mission_manager.console.words import staleness
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import Mission
from uav_mission_manager.policy import Policy

MOST_ANSWERS_KEPT = 20
"""Answers that pages may still have to tell: a choice."""


@dataclass(frozen=True)
class OrderAnswer:
    """What became of an order; numbered from 1."""

    number: int
    order: OperatorOrder
    good: bool
    text: str


class Fleet:
    """The vehicles, by namespace.

    Parameters
    ----------
    shelf : PolicyShelf
    clock : callable
        Returns the time [s] that things are noted by.
    timeout : float
        Age [s] above which a thing is old.

    Attributes
    ----------
    heard : dict of str to Heard
    attended : set of str
        The vehicles that a page has shown at large: who may be ordered something.
    orders : queue of OperatorOrder
        What the page orders.
    answers : tuple of OrderAnswer
        What became of the last ones, in their order.
    obstacle : str
        Why no vehicle can be ordered anything, '' where one can.
    missions : tuple of Mission
        Of vehicles whose policy set is not at hand: one of the same goals is shown.
    """

    answers: tuple[OrderAnswer, ...] = ()
    obstacle = ''
    missions: tuple[Mission, ...] = ()

    def __init__(self, shelf: PolicyShelf, clock: Callable[[], float], timeout: float) -> None:
        self.heard: dict[str, Heard] = {}
        self.attended: set[str] = set()
        self.orders: SimpleQueue[OperatorOrder] = SimpleQueue()
        self._shelf, self.clock, self.timeout = shelf, clock, timeout
        self._forecaster = Forecaster()

    def answer(self, order: OperatorOrder, good: bool, text: str) -> None:
        """Say what became of an order; for the thread that writes `heard`."""
        number = self.answers[-1].number + 1 if self.answers else 1
        answer = OrderAnswer(number, order, good, text)
        self.answers = (*self.answers, answer)[-MOST_ANSWERS_KEPT:]

    @property
    def names(self) -> list[str]:
        """The vehicles, `/uav2` before `/uav10`."""
        return sorted(self.heard, key=_natural)

    def policy(self, vehicle: str) -> Policy | None:
        """Return the policy set that a vehicle's manager uses; None while it is not at hand."""
        heard = self.heard.get(vehicle)
        if heard is None or heard.decision is None:
            return None
        return self._shelf.find(heard.decision.value.digest, self.clock(), heard.policy_set)

    def mission_of(self, vehicle: str) -> Mission | None:
        """Return the mission that a vehicle flies; None while it is not known."""
        policy, heard = self.policy(vehicle), self.heard.get(vehicle, Heard())
        if policy:
            return policy.mission
        goals = heard.decision.value.goals if heard.decision else ()
        same = (m for m in self.missions if goals in ((), tuple(shown(g.name) for g in m.goals)))
        return next(same, None)

    def view(self, vehicle: str) -> VehicleView:
        """Return what to show of a vehicle now."""
        heard, policy = self.heard.get(vehicle, Heard()), self.policy(vehicle)
        state = heard.decision.value.state if heard.decision else ()
        parts = self._shelf.parts(policy, state) if policy and state else ()
        mission = self.mission_of(vehicle)
        view = view_of(vehicle or '/', heard, mission, parts, self.clock(), self.timeout)
        return replace(view, obstacle=self.obstacle or view.obstacle)

    def crafts(self, mission: Mission) -> dict[str, Craft]:
        """Return the vehicles that are on the grid of a mission, by namespace."""
        found = {}
        for vehicle, heard in list(self.heard.items()):
            flown = self.mission_of(vehicle)
            if heard.pose is not None and flown and flown.grid == mission.grid:
                old = bool(staleness(heard.pose, self.clock(), self.timeout))
                found[vehicle] = Craft(heard.pose.value, old)
        return found

    def forecast(self, vehicle: str) -> GoalChances | None:
        """Return the last forecast of a vehicle, and ask for one of its present state."""
        heard, policy = self.heard.get(vehicle, Heard()), self.policy(vehicle)
        state = heard.decision.value.state if heard.decision else ()
        if policy is not None and state:
            self._forecaster.want(vehicle, policy, state)
        return self._forecaster.found.get(vehicle)


def _natural(name: str) -> list[tuple[bool, int, str]]:
    """Sort key by which numbers in names count as numbers."""
    parts = re.findall(r'\d+|\D+', name)
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]
