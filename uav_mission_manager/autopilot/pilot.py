"""The pilot on board: flies one mission command at a time, as long as nobody else is in command.

In command are, in this order, the human pilot, the autopilot's failsafes, and the manager; see
`authority`. The pilot is pure: `update` takes the telemetry and the time, and returns what to ask
of the vehicle. A request is repeated, with growing pauses, until telemetry shows that it was done.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from uav_mission_manager.autopilot.authority import Authority
from uav_mission_manager.autopilot.flying import TaskFlight
from uav_mission_manager.autopilot.goal_work import GoalWork
from uav_mission_manager.autopilot.requests import Requests
from uav_mission_manager.autopilot.service import ServiceStop
from uav_mission_manager.autopilot.site import Site
from uav_mission_manager.autopilot.task import (
    NO_HEARTBEAT,
    NO_POSITION_TO_HOLD,
    NOT_ACTIVE,
    UNTIL_RESUME,
    FlightTask,
    Phase,
    PilotOutput,
    Settings,
)
from uav_mission_manager.autopilot.telemetry import Position, Telemetry
from uav_mission_manager.autopilot.vehicle import (
    Arm,
    FlightMode,
    Fly,
    Request,
    SetMode,
    TakeOff,
    mode_name,
)

MIN_HOLD_HEIGHT = 3.0
"""Height above ground [m] below which no position is held: a choice."""


class Pilot:
    """State machine that flies mission commands; see the module's docstring.

    Parameters
    ----------
    settings : Settings
        Kept as `site.settings`, which may be replaced in flight.
    ground : callable
        Altitude of the ground above mean sea level [m] at a latitude and longitude [deg].

    Attributes
    ----------
    goals_wanted : bool or None
        Whether any goal has a priority above 0; without, a vehicle on the ground stays there.
        None where nobody says: then a commitment says that its goal is wanted.
    active : bool
        Whether it obeys the manager; in flight it holds otherwise.
    work : GoalWork
        What is done at goals.
    """

    def __init__(self, settings: Settings, ground: Callable[[float, float], float]) -> None:
        self.site = Site(settings, ground)
        self.goals_wanted: bool | None = None
        self.active = True
        self._authority = Authority()
        self._requests = Requests()
        self._task: FlightTask | None = None
        self._heard = self._awaited = -math.inf  # the manager's last command; awaited anew since
        self._updated = self._take_off_at = -math.inf
        self._held = self._returning = self._distrusted = ''  # why
        self._landing = False  # in LAND, by an order from here
        self.work = GoalWork(ground)
        self._flight = TaskFlight(self.site, self._requests, self.work)
        self._hold_point: Position | None = None
        self._service = ServiceStop(self.site)

    def command(self, task: FlightTask, now: float) -> None:
        """Take a mission command; every repetition is a sign of life of the manager."""
        if self._task is None or self._task.goal != task.goal:
            self._flight.retarget()
        if self._task is None or self._task.service != task.service:
            self._service.interrupt()
        if self._task is None or self._task.text != task.text:
            self._requests.forget_refusals()
        self._task, self._heard = task, now

    def hold(self) -> None:
        """Hold position, or stay on the ground, until `resume`."""
        self._held, self._returning, self._hold_point = UNTIL_RESUME, '', None

    def set_active(self, active: bool, now: float) -> None:
        """Obey the manager, who is awaited anew, or nobody."""
        self.active = active
        self._await_manager(now)

    def resume(self, now: float) -> None:
        """Take command again, whatever the mode is; a silent manager is awaited anew."""
        self._held = self._returning = self._distrusted = ''
        self._landing = False
        self._authority.resume()
        self._await_manager(now)

    @property
    def armed(self) -> bool:
        """Whether the motors ran when the vehicle was last seen."""
        return self._authority.armed

    @property
    def memory(self) -> dict[str, Any]:
        """What `restore` takes: JSON values."""
        return {
            'held': self._held,
            'returning': self._returning,
            'distrusted': self._distrusted,
            'landing': self._landing,
            'authority': self._authority.memory,
            'work': self.work.memory,
        }

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Go on from a `memory`, before the first `update`."""
        self._held, self._returning = memory['held'], memory['returning']
        self._distrusted, self._landing = memory['distrusted'], memory['landing']
        self._authority.restore(memory['authority'])
        self.work.restore(memory.get('work', {}))

    def rebooted(self) -> None:
        """Take note of a reboot of the autopilot that nobody saw, since the `memory`."""
        self._authority.rebooted()

    def distrust(self, why: str) -> None:
        """Obey nobody until `resume`: stay on the ground; in flight hold, then return."""
        self._distrusted = why

    def answered(self, kind: type[Request], accepted: bool, why: str, since: float) -> None:
        """Take the autopilot's answer to a request; a mode heard after `since` was told later."""
        self._requests.answered(kind, accepted, why)
        if kind is SetMode and accepted:
            self._authority.accepted(since)

    def update(self, telemetry: Telemetry | None, now: float) -> PilotOutput:
        """Return what to do now; `telemetry` is None while the link is lost."""
        output = self._decide(telemetry, now)
        self.work.watch(output.phase)
        return output

    def _decide(self, telemetry: Telemetry | None, now: float) -> PilotOutput:
        last, self._updated = self._updated, now
        if telemetry is None:  # Nothing seen, nothing to take over.
            self._flight.interrupt()
            self._service.interrupt()
            self._authority.link_lost()
            self._excuse_manager(last, now)
            return NO_HEARTBEAT
        if telemetry.unheard:
            self._excuse_manager(last, now)
            return PilotOutput(Phase.WAITING, f'not heard yet: {telemetry.unheard}')
        changed, given = self._authority.watch(telemetry, now)
        if given:
            self._await_manager(now)
        if changed:
            self._requests.clear()
            self._flight.restart()
        if taken := self._authority.taken:
            return PilotOutput(Phase.PILOT, f'{taken}; ~/resume gives command back')
        return self._stand(telemetry, now) if not telemetry.armed else self._lead(telemetry, now)

    def _await_manager(self, now: float) -> None:
        """Count the manager's silence from now on, and hold here until it is heard."""
        self._awaited, self._hold_point = now, None

    def _excuse_manager(self, last: float, now: float) -> None:
        """Do not count its silence since `last`: while nothing is heard it has no inputs."""
        since = max(self._heard, self._awaited)
        silence = max(last - since, 0.0) if since > -math.inf else 0.0
        self._awaited, self._hold_point = now - silence, None

    @property
    def _why_held(self) -> str:
        return UNTIL_RESUME if self._held == UNTIL_RESUME else f'{UNTIL_RESUME}; {self._held}'

    # On the ground, disarmed

    def _stand(self, telemetry: Telemetry, now: float) -> PilotOutput:
        task, position = self._task, telemetry.fix(now)
        if self._returning:
            self._held, self._returning = f'returned to launch: {self._returning}', ''
        self._held, self._distrusted = self._held or self._distrusted, ''
        if self._held:
            return PilotOutput(Phase.HOLDING, f'on the ground {self._why_held}')
        if not self.active:
            return PilotOutput(Phase.HOLDING, f'on the ground; {NOT_ACTIVE}')
        if task is None:
            return PilotOutput(Phase.GROUND, 'no mission command yet')
        if position is None:  # It silences the manager too.
            return PilotOutput(Phase.GROUND, f'{task.text}: no position yet')
        if now - self._heard > self.site.settings.manager_timeout:
            return PilotOutput(Phase.GROUND, 'the manager is silent')
        if far := self.site.too_far(task, position):
            return PilotOutput(Phase.HOLDING, far)
        if stays := self.site.may_stay(task, position, self.goals_wanted):
            serviced = self._service.done(task, position, now)
            return PilotOutput(Phase.GROUND, stays, serviced=serviced)
        self._service.interrupt()
        return self._arm(task, telemetry, position, now)

    def _arm(
        self, task: FlightTask, telemetry: Telemetry, position: Position, now: float
    ) -> PilotOutput:
        if not self.site.settings.allow_arming:
            return self._needs_a_pilot(task)
        if telemetry.failsafe:
            return PilotOutput(Phase.BLOCKED, f'{task.text}: the autopilot is in a failsafe')
        if wrong := self.site.wrong_datum(position, position.altitude, 'the vehicle'):
            return PilotOutput(Phase.HOLDING, f'{task.text}: {wrong}')
        if telemetry.mode != FlightMode.GUIDED:
            return self._order(FlightMode.GUIDED, Phase.ARMING, task.text, telemetry, now)
        if telemetry.ready is False:
            return PilotOutput(Phase.BLOCKED, f'{task.text}: the autopilot is not ready to arm')
        self._authority.arm(now)
        return self._requests.ask(Arm(), Phase.ARMING, task.text, now)

    def _needs_a_pilot(self, task: FlightTask) -> PilotOutput:
        return PilotOutput(Phase.BLOCKED, f'{task.text}: allow_arming is false: a pilot takes off')

    # Armed

    def _lead(self, telemetry: Telemetry, now: float) -> PilotOutput:
        """Return what to do with a vehicle whose motors run."""
        if not self._authority.here:
            why = f'{mode_name(telemetry.mode)}; GUIDED gives command here'
            return PilotOutput(Phase.PILOT, why)
        if telemetry.fix(now) is None:  # Where a hold began may have been wrong.
            self._hold_point = None
        if self._returning:
            return self._return(telemetry, now)
        if self._held:
            return self._hold(telemetry, self._why_held, now)
        if not self.active:
            return self._wait(NOT_ACTIVE, math.inf, telemetry, now)
        if self._distrusted:
            patience = self._awaited + self.site.settings.rtl_delay - now
            return self._wait(self._distrusted, patience, telemetry, now)
        if self._task is None or now - self._heard > self.site.settings.manager_timeout:
            timeout = self.site.settings.manager_timeout + self.site.settings.rtl_delay
            patience = max(self._heard, self._awaited) + timeout - now
            return self._wait('the manager is silent', patience, telemetry, now)
        return self._fly(self._task, telemetry, now)

    def _fly(self, task: FlightTask, telemetry: Telemetry, now: float) -> PilotOutput:
        position = telemetry.fix(now)
        if position is None:
            return PilotOutput(Phase.WAITING, f'{task.text}: no position')
        if far := self.site.too_far(task, position):
            return self._hold(telemetry, far, now)
        self._hold_point = None
        landing = task.land and telemetry.mode == FlightMode.LAND
        if landing and self.site.there(task, position):
            return PilotOutput(Phase.LANDING, task.text)
        if self._landing and telemetry.failsafe and telemetry.mode == FlightMode.LAND:
            # It may have turned critical since, which the mode would not show.
            return PilotOutput(Phase.LANDING, 'it goes on, for the autopilot is in a failsafe')
        if telemetry.on_ground and (
            stays := self.site.may_stay(task, position, self.goals_wanted)
        ):
            return self._stop_motors(Phase.GROUND, stays, telemetry, now)
        if telemetry.mode != FlightMode.GUIDED:
            return self._order(FlightMode.GUIDED, Phase.EN_ROUTE, task.text, telemetry, now)
        if telemetry.on_ground:
            return self._take_off(task, telemetry, position, now)
        if task.land and self._flight.over(task, position):
            return self._order(FlightMode.LAND, Phase.LANDING, task.text, telemetry, now)
        step = self._flight.fly(task, position, now)
        if step.phase is Phase.RETURNING:
            self._returning = step.status
            return self._return(telemetry, now)
        return step

    def _take_off(
        self, task: FlightTask, telemetry: Telemetry, position: Position, now: float
    ) -> PilotOutput:
        """Armed on the ground in GUIDED: take off, or stop the motors that this pilot started."""
        if not self.site.settings.allow_arming:
            return self._needs_a_pilot(task)
        if wrong := self.site.wrong_datum(position, position.home_altitude, 'home'):
            return self._stay_down(f'{task.text}: {wrong}', telemetry, now)
        if not self._flight.taking_off:
            self._flight.taking_off, self._take_off_at = True, now
        patience = self.site.settings.progress_timeout
        if now - self._take_off_at > patience:
            _, why = self._requests.refusals(TakeOff)
            why = f'no take-off in {patience:.0f} s' + (f': {why}' if why else '')
            return self._stay_down(f'{task.text}: {why}', telemetry, now)
        take_off = TakeOff(task.cruise_altitude - position.home_altitude)
        return self._requests.ask(take_off, Phase.TAKE_OFF, task.text, now)

    def _stay_down(self, why: str, telemetry: Telemetry, now: float) -> PilotOutput:
        """Stop the motors, and start them for nothing but `resume`."""
        self._held = why
        return self._stop_motors(Phase.HOLDING, self._why_held, telemetry, now)

    def _stop_motors(
        self, phase: Phase, why: str, telemetry: Telemetry, now: float
    ) -> PilotOutput:
        """On the ground: LAND disarms. Motors that a human started stay as they are."""
        if self._authority.motors_started_here and telemetry.mode != FlightMode.LAND:
            return self._order(FlightMode.LAND, phase, why, telemetry, now)
        return PilotOutput(phase, why)

    def _wait(self, why: str, patience: float, telemetry: Telemetry, now: float) -> PilotOutput:
        """Hold for `patience` [s], then return; a landing under way is safe and goes on."""
        if telemetry.mode == FlightMode.LAND:
            return PilotOutput(Phase.LANDING, why)
        if patience < 0.0 and not telemetry.on_ground:
            self._returning = why
            return self._return(telemetry, now)
        return self._hold(telemetry, why, now)

    def _return(self, telemetry: Telemetry, now: float) -> PilotOutput:
        if telemetry.mode == FlightMode.RTL:
            return PilotOutput(Phase.RETURNING, self._returning)
        return self._order(FlightMode.RTL, Phase.RETURNING, self._returning, telemetry, now)

    def _hold(self, telemetry: Telemetry, why: str, now: float) -> PilotOutput:
        """Stay where the hold began, in GUIDED, which needs a position."""
        self._flight.interrupt()
        if telemetry.on_ground:
            return self._stop_motors(Phase.HOLDING, why, telemetry, now)
        position, task = telemetry.fix(now), self._task
        if position is None or (task is not None and self.site.too_far(task, position)):
            return PilotOutput(Phase.HOLDING, f'{why}; {NO_POSITION_TO_HOLD}')
        self._hold_point = point = self._hold_point or position
        if telemetry.mode != FlightMode.GUIDED:
            return self._order(FlightMode.GUIDED, Phase.HOLDING, why, telemetry, now)
        ground = self.site.ground(point.latitude, point.longitude)
        altitude = max(point.altitude, ground + MIN_HOLD_HEIGHT)
        fly = Fly(point.latitude, point.longitude, altitude, self.site.settings.cruise_speed)
        return self._requests.ask(fly, Phase.HOLDING, why, now, position.speed)

    def _order(
        self, mode: FlightMode, phase: Phase, why: str, telemetry: Telemetry, now: float
    ) -> PilotOutput:
        self._landing = mode == FlightMode.LAND
        self._authority.order(mode, telemetry.mode, now)
        return self._requests.ask(SetMode(mode), phase, why, now)
