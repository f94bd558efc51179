"""Flying a task in GUIDED: climb, travel, stay over the destination, do what is done there."""

from __future__ import annotations

from dataclasses import replace

from uav_mission_manager.autopilot.goal_work import GoalWork
from uav_mission_manager.autopilot.leg import Leg
from uav_mission_manager.autopilot.requests import Requests
from uav_mission_manager.autopilot.site import Site
from uav_mission_manager.autopilot.task import FlightTask, Phase, PilotOutput
from uav_mission_manager.autopilot.telemetry import Position
from uav_mission_manager.autopilot.vehicle import Fly
from uav_mission_manager.goal_task import Dwell, External

REFUSALS_TO_BLOCK = 2
"""How often in a row the autopilot must refuse a flight to a point until it is out of reach: a
choice; the first time it may only be too early."""


class TaskFlight:
    """The part of a task that is flown: over it ends, at the destination and its height.

    Attributes
    ----------
    taking_off : bool
        Whether a take-off was asked for, whose end is waited for: `progress_timeout` at most.
    """

    def __init__(self, site: Site, requests: Requests, work: GoalWork) -> None:
        self._site = site
        self._requests = requests
        self._work = work
        self.taking_off = False
        self._leg: Leg | None = None
        self._climb_point: Position | None = None
        self._rising_since: float | None = None

    def retarget(self) -> None:
        """Begin anew for another goal."""
        self._work.retarget()

    def interrupt(self) -> None:
        """Stop where it is: the leg, and the take-off, begin anew."""
        self._leg = self._rising_since = None
        self.taking_off = False

    def restart(self) -> None:
        """Begin anew after a change of mode or arming."""
        self._leg = self._climb_point = self._rising_since = None
        self.taking_off = False

    def over(self, task: FlightTask, position: Position) -> bool:
        """Whether the vehicle is over the destination, and not in a take-off."""
        radius = self._site.settings.acceptance_radius
        distance = position.distance_to(task.latitude, task.longitude)
        return distance <= radius and not self._rising(task, position)

    def fly(self, task: FlightTask, position: Position, now: float) -> PilotOutput:
        """Return what to do now; the phase RETURNING says that there is no getting there."""
        if self._rising(task, position):
            if self._rising_since is None:
                self._rising_since = now
            if now - self._rising_since <= self._site.settings.progress_timeout:
                return PilotOutput(Phase.TAKE_OFF, task.text)
        self.taking_off, self._rising_since = False, None
        goal, task = task, self._work.target(task)
        if not self.over(task, position):
            return self._travel(task, position, now)
        return self._stay(task, goal, position, now)

    def _rising(self, task: FlightTask, position: Position) -> bool:
        return self.taking_off and self._low(task, position)

    def _low(self, task: FlightTask, position: Position) -> bool:
        """Whether the vehicle has to climb before it moves; a climb ends a little higher."""
        margin = self._site.settings.height_tolerance / (2.0 if self._climb_point else 1.0)
        return position.altitude < task.cruise_altitude - margin

    def _travel(self, task: FlightTask, position: Position, now: float) -> PilotOutput:
        """Climb where it is, then fly to the destination."""
        end = self._to(task, task.cruise_altitude)
        if self._low(task, position):
            self._climb_point = point = self._climb_point or position
            climb = replace(end, latitude=point.latitude, longitude=point.longitude)
            return self._advance(climb, end, Phase.CLIMBING, task, position, now)
        self._climb_point = None
        return self._advance(end, end, Phase.EN_ROUTE, task, position, now)

    def _stay(
        self, task: FlightTask, goal: FlightTask, position: Position, now: float
    ) -> PilotOutput:
        """Over the destination: go to its height, and do there what the goal asks for."""
        self._climb_point = None
        fly = self._to(task, task.altitude)
        if abs(position.altitude - task.altitude) > self._site.settings.height_tolerance:
            return self._advance(fly, fly, Phase.EN_ROUTE, task, position, now)
        self._leg = None
        step = self._requests.ask(fly, Phase.ON_SITE, task.text, now)
        return self._attend(goal, step, now) if goal.goal else step

    def _to(self, task: FlightTask, altitude: float) -> Fly:
        speed = self._site.settings.agile_speed if task.agile else self._site.settings.cruise_speed
        return Fly(task.latitude, task.longitude, altitude, speed)

    def _advance(
        self,
        fly: Fly,
        end: Fly,
        phase: Phase,
        task: FlightTask,
        position: Position,
        now: float,
    ) -> PilotOutput:
        """Fly on towards the end of a leg; where it cannot be reached, say so, then return."""
        if self._leg is None or not self._leg.same(end):
            self._leg = Leg(end, now)
        leg = self._leg
        leg.watch(position, now)
        refusals, why = self._requests.refusals(Fly)
        patience = self._site.settings.progress_timeout
        if refusals < REFUSALS_TO_BLOCK:
            why = leg.stuck(patience, now)
        if not why:
            leg.blocked_at = None
            return self._requests.ask(fly, phase, task.text, now, position.speed)
        if leg.blocked_at is None:
            leg.blocked_at = now
        if now - leg.blocked_at > patience:
            return PilotOutput(Phase.RETURNING, f'{task.text}: {why}')
        step = self._requests.ask(fly, Phase.BLOCKED, f'{task.text}: {why}', now, position.speed)
        if not task.goal or not self._work.report(now):
            return step
        return replace(step, refused=task.goal, losing_ground=leg.losing_ground)

    def _attend(self, task: FlightTask, step: PilotOutput, now: float) -> PilotOutput:
        """Do what is done at the goal, and report the end of it.

        If the command is still the same 10 s later, the manager has missed that, and it is
        reported again.
        """
        task = task if task.work else replace(task, work=Dwell(self._site.settings.goal_dwell))
        work = self._work
        status = '; '.join(filter(None, (task.text, work.step(task, now))))
        if work.failed:
            why = f'{task.text}: {work.failed}'
            refused = task.goal if work.report(now) else ''
            return replace(step, phase=Phase.BLOCKED, status=why, refused=refused)
        if work.done:
            return replace(step, completed=task.goal if work.report(now) else '')
        photo = work.photo(task, now)
        requests = (*step.requests, photo) if photo else step.requests
        active = task.goal if isinstance(task.work, External) else ''
        return replace(step, status=status, requests=requests, active=active)
