"""The fleet's base station without ROS: one request for all becomes one for each vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from uav_mission_manager.fleet.reports import FleetSettings, VehicleReport, roles
from uav_mission_manager.fleet.sharing import FleetDecision, share_goals
from uav_mission_manager.mdp import StateSpace
from uav_mission_manager.mdp.charge import RangeFlags
from uav_mission_manager.onboard.priority_request import PriorityRequest
from uav_mission_manager.solver.recombination import FleetPlanner


class FleetDispatcher:
    """Shares out goals, anew when something has changed that matters.

    That is what is wanted, who takes part, a fault mode, a goal's range or a refusal: not where
    the vehicles are, so that they fly to the end what they have begun.

    Parameters
    ----------
    planner : FleetPlanner
    vehicles : sequence of str
    settings : FleetSettings
    now : float
        Time [s], on the clock of the reports.
    memory : mapping, optional
        What `memory` said of one for the same goals and grid: this one goes on from there, and
        awaits the vehicles that were heard before.

    Attributes
    ----------
    mission : Mission
    goals : tuple of str
        Their names.
    settings : FleetSettings
    wish : PriorityRequest
        What is asked of the fleet.
    requests : dict of str to PriorityRequest
        What is asked of each vehicle.
    reports : dict of str to VehicleReport
    decision : FleetDecision
        The last one.

    Raises
    ------
    ValueError
        If the memory is of something else.
    """

    def __init__(
        self,
        planner: FleetPlanner,
        vehicles: Sequence[str],
        settings: FleetSettings,
        now: float,
        memory: Mapping[str, Any] | None = None,
    ) -> None:
        mission = planner.mission
        self.mission, self.settings, self._planner = mission, settings, planner
        self.goals = tuple(goal.name for goal in mission.goals)
        self._flags, self._space = RangeFlags(mission), StateSpace.of(mission)
        self.decision = FleetDecision((), {})
        self._decided_on: object = None
        memory = memory or {'fleet': None, 'vehicles': {}, 'states': {}}
        kept, states = memory['vehicles'], memory['states']
        self.wish = PriorityRequest(self.goals, memory['fleet'])
        self.requests = {v: PriorityRequest(self.goals, kept.get(v)) for v in vehicles}
        self.reports = {
            v: VehicleReport.awaited(tuple(states[v]), now) if v in states else VehicleReport()
            for v in vehicles
        }

    @property
    def memory(self) -> dict[str, Any]:
        """What the next one needs to go on, as JSON values."""
        return {
            'fleet': self.wish.memory,
            'vehicles': {vehicle: each.memory for vehicle, each in self.requests.items()},
            'states': {v: list(each.state) for v, each in self.reports.items() if each.state},
        }

    def forget_refusals(self) -> None:
        """After a new request, let vehicles try again what they could not fly to."""
        for vehicle, report in self.reports.items():
            self.reports[vehicle] = replace(report, refused=frozenset())

    def complete(self, goal: str) -> bool:
        """Take a goal as achieved, by whichever vehicle; return whether that is new."""
        for request in self.requests.values():
            request.complete(goal)
        return self.wish.complete(goal)

    def refuse(self, vehicle: str, goal: str) -> bool:
        """Take note that a vehicle could not fly to a goal; return whether that is new."""
        report = self.reports[vehicle]
        if goal not in self.goals or self.goals.index(goal) in report.refused:
            return False
        self.reports[vehicle] = report.with_refused(self.goals.index(goal))
        return True

    def step(self, now: float, new_id: Callable[[], str]) -> list[str]:
        """Decide, if anything has changed; return the vehicles that are asked for something new.

        Parameters
        ----------
        now : float
            Time [s], on the clock of the reports.
        new_id : callable
            Returns an id that no request has.
        """
        parts = roles(self.reports, self.settings, now)
        had = {vehicle: _goal(request) for vehicle, request in self.requests.items()}
        wanted = self.wish.priorities
        decided_on = wanted, parts, had, self._conditions()
        if decided_on != self._decided_on:
            self.decision = share_goals(
                self._planner, wanted, self.reports, parts, had, self.settings
            )
        asked = [v for v, goal in self.decision.given.items() if self._ask(v, goal, new_id)]
        had = {vehicle: _goal(request) for vehicle, request in self.requests.items()}
        self._decided_on = wanted, parts, had, self._conditions()
        return asked

    def _ask(self, vehicle: str, goal: int, new_id: Callable[[], str]) -> bool:
        """Ask a vehicle for its goal alone, unless that is asked for; return if it is new.

        At first it is asked for no goal: before that its manager decides nothing.
        """
        request, wanted = self.requests[vehicle], self.wish.priorities
        values = [g if j == goal else 0 for j, g in enumerate(wanted)]
        if request.request and list(request.priorities) == values:
            return False
        request.ask(values, new_id())
        return True

    def _conditions(self) -> dict[str, object]:
        """What of the vehicles' states a decision rests on, but for their places."""
        found: dict[str, object] = {}
        for vehicle, report in self.reports.items():
            if report.state:
                s = self._space.split(np.array([report.state]))
                found[vehicle] = int(s.f[0]), self._flags(s)[0].tolist(), report.refused
        return found


def _goal(request: PriorityRequest) -> int:
    """The goal that a vehicle is asked for, -1 for none."""
    return next((j for j, g in enumerate(request.priorities) if g), -1)
