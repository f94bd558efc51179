"""The pilot on board: flies one mission command at a time, as long as nobody else is in command.

In command are, in this order, the human pilot, the autopilot's failsafes, and the manager.
Someone else has taken command when the mode changes to one that was not ordered here, or when the
motors stop in GUIDED or in the air; then nothing is asked of the vehicle until `resume`. A vehicle
that is flown by hand from the start is taken over when it is put into GUIDED.

The pilot is pure: `update` takes the telemetry and the time, and returns what to ask of the
vehicle. A request is repeated until telemetry shows that it was done.
"""

from __future__ import annotations

import math
from dataclasses import replace

from uav_mission_manager.autopilot.task import (
    NO_HEARTBEAT,
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

REQUEST_REPEAT_PERIOD = 2.0
"""Time [s] after which a request that telemetry does not show as done is repeated: a choice."""

FLY_REPEAT_PERIOD = 5.0
"""The same [s] for a flight to a point, which telemetry cannot confirm: a choice."""

REQUEST_EFFECT_TIME = 5.0
"""Time [s] after a request within which a change of mode or arming is its effect: a choice."""

COMPLETION_REPEAT_PERIOD = 10.0
"""Time [s] after which a goal that is still commanded is reported as completed again: a choice."""

MIN_HOLD_HEIGHT = 3.0
"""Height above home [m] below which no position is held: a choice."""

AIRBORNE_HEIGHT = 5.0
"""Height above home [m] from which stopped motors may mean a fall, not a landing: a choice."""

MAX_LANDING_SINK_RATE = 0.5
"""Descent [m/s] above which a vehicle whose motors stop is falling: that of ArduCopter just before
touch-down (LAND_SPEED, 50 cm/s by default); a landing ends at rest."""

CLIMBED_ALTITUDE_SHARE = 0.9
"""Share of the flight altitude from which the vehicle counts as up: a choice."""

NO_POSITION_TO_HOLD = 'no position to hold; what happens is up to the autopilot and its failsafes'
"""What the pilot says where it should hold and cannot."""


class Pilot:
    """State machine that flies mission commands; see the module's docstring."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._task: FlightTask | None = None
        self._heard = self._awaited = -math.inf  # the manager's last command; awaited anew since
        self._held = False
        self._returning = False
        self._taken = ''
        self._adopt = False
        self._mode: int | None = None  # the mode this pilot is in command in
        self._ordered: int | None = None  # the mode it waits for
        self._ordered_at = -math.inf
        self._seen: tuple[int | None, bool] = (None, False)
        self._arm_asked = -math.inf
        self._armed_here = False
        self._sent: dict[type, tuple[Request, float]] = {}
        self._climbing = False
        self._hold_point: Position | None = None
        self._arrived: float | None = None
        self._completed_at = -math.inf

    def command(self, task: FlightTask, now: float) -> None:
        """Take a mission command; every repetition is a sign of life of the manager."""
        old = self._task
        if old is None or (old.goal, old.service) != (task.goal, task.service):
            self._arrived, self._completed_at = None, -math.inf
        self._task, self._heard = task, now

    def hold(self) -> None:
        """Hold position, or stay on the ground, until `resume`."""
        self._held, self._returning, self._hold_point = True, False, None

    def resume(self, now: float) -> None:
        """Take command again, whatever the mode is; a silent manager is awaited anew."""
        self._held, self._returning, self._taken, self._adopt = False, False, '', True
        self._await_manager(now)

    def update(self, telemetry: Telemetry | None, now: float) -> PilotOutput:
        """Return what to do now; `telemetry` is None while the link is lost."""
        if telemetry is None:
            # Nothing seen, nothing to take over; and the manager, without inputs, is silent.
            self._arrived, self._adopt = None, False
            self._await_manager(now)
            if not self._seen[1]:  # on the ground it may reboot, at a change of battery say
                self._mode = self._ordered = None
            return NO_HEARTBEAT
        self._watch(telemetry, now)
        if self._taken:
            return PilotOutput(Phase.PILOT, f'{self._taken}; ~/resume gives command back')
        if not telemetry.armed:
            return self._stand(telemetry, now)
        if self._mode is None:
            return PilotOutput(
                Phase.PILOT, f'{mode_name(telemetry.mode)}; GUIDED gives command here'
            )
        if self._returning:
            return self._return(telemetry, now)
        if self._held:
            return self._hold(telemetry, 'until ~/resume', now)
        if self._task is None or now - self._heard > self._settings.manager_timeout:
            return self._without_manager(telemetry, now)
        return self._fly(self._task, telemetry, now)

    # Who is in command

    def _watch(self, telemetry: Telemetry, now: float) -> None:
        """Follow mode and arming, and yield to whoever else changed them."""
        if telemetry.armed and not self._seen[1]:
            self._armed_here = now - self._arm_asked < REQUEST_EFFECT_TIME
            if not self._armed_here:  # by hand: not ours until it is put into GUIDED
                self._mode = self._ordered = None
        found_guided = (
            self._mode is None and telemetry.armed and telemetry.mode == FlightMode.GUIDED
        )
        if self._adopt or found_guided or telemetry.mode == self._ordered:
            self._mode, self._ordered, self._adopt = telemetry.mode, None, False
        if found_guided:
            self._await_manager(now)
        if now - self._ordered_at > REQUEST_EFFECT_TIME:
            self._ordered = None
        if not self._taken:
            self._taken = self._someone_else(telemetry)
        self._armed_here = self._armed_here and telemetry.armed
        if self._seen != (telemetry.mode, telemetry.armed):
            self._seen = (telemetry.mode, telemetry.armed)
            self._sent.clear()
            self._climbing = False

    def _someone_else(self, telemetry: Telemetry) -> str:
        """Say who else is in command, '' for nobody."""
        mode = mode_name(telemetry.mode)
        if telemetry.armed and telemetry.failsafe:
            return f'the autopilot is in a failsafe ({mode})'
        if self._mode is not None and telemetry.mode not in (self._mode, self._ordered):
            return f'{mode} was not ordered from here'
        if self._seen[1] and not telemetry.armed:
            if telemetry.mode == FlightMode.GUIDED:
                return 'disarmed, but not from here'
            return _fallen(telemetry)
        return ''

    def _await_manager(self, now: float) -> None:
        """Count the manager's silence from now on, and hold here until it is heard."""
        self._awaited, self._hold_point = now, None

    # On the ground, disarmed

    def _stand(self, telemetry: Telemetry, now: float) -> PilotOutput:
        self._returning = False
        task, position = self._task, telemetry.fix(now)
        if self._held:
            return PilotOutput(Phase.HOLDING, 'on the ground until ~/resume')
        if task is None:
            return PilotOutput(Phase.GROUND, 'no mission command yet')
        if now - self._heard > self._settings.manager_timeout:
            return PilotOutput(Phase.GROUND, 'the manager is silent')
        if position is None:
            return PilotOutput(Phase.GROUND, f'{task.text}: no position yet')
        if far := self._too_far(task, position):
            return PilotOutput(Phase.HOLDING, far)
        if self._may_stay(task, position):
            return PilotOutput(Phase.GROUND, task.text, serviced=self._service(task, now))
        self._arrived = None
        return self._arm(task, telemetry, now)

    def _too_far(self, task: FlightTask, position: Position) -> str:
        """Say so where the destination cannot be part of a mission flown here, '' where it can."""
        distance = position.distance_to(task.latitude, task.longitude)
        if distance <= self._settings.reach:
            return ''
        return f'{task.text}: {distance / 1000.0:.1f} km away; is it the right mission file?'

    def _may_stay(self, task: FlightTask, position: Position) -> bool:
        """Whether a vehicle on the ground fulfils the task by staying there."""
        if not task.land:
            return not task.goal
        distance = position.distance_to(task.latitude, task.longitude)
        return distance <= self._settings.landed_radius

    def _service(self, task: FlightTask, now: float) -> bool:
        """Whether a repair has just been done; while it is commanded, another one follows."""
        if not task.service:
            return False
        if self._arrived is None:
            self._arrived = now
        done = now - self._arrived >= self._settings.service_time
        if done:
            self._arrived = now
        return done

    def _arm(self, task: FlightTask, telemetry: Telemetry, now: float) -> PilotOutput:
        if not self._settings.allow_arming:
            return PilotOutput(
                Phase.GROUND, f'{task.text}: allow_arming is false, a pilot must take off'
            )
        if telemetry.failsafe:
            return PilotOutput(Phase.GROUND, f'{task.text}: the autopilot is in a failsafe')
        if telemetry.mode != FlightMode.GUIDED:
            return self._order(FlightMode.GUIDED, Phase.ARMING, task.text, telemetry, now)
        if telemetry.ready is False:
            return PilotOutput(Phase.ARMING, f'{task.text}: the autopilot is not ready to arm')
        self._arm_asked = now
        return self._ask(Arm(), Phase.ARMING, task.text, now)

    # In the air

    def _fly(self, task: FlightTask, telemetry: Telemetry, now: float) -> PilotOutput:
        settings, position = self._settings, telemetry.fix(now)
        if position is None:
            return PilotOutput(Phase.WAITING, f'{task.text}: no position')
        if far := self._too_far(task, position):
            return self._hold(telemetry, far, now)
        self._hold_point = None
        distance = position.distance_to(task.latitude, task.longitude)
        if task.land and telemetry.mode == FlightMode.LAND and distance <= settings.landed_radius:
            return PilotOutput(Phase.LANDING, task.text)
        if telemetry.mode != FlightMode.GUIDED:
            return self._order(FlightMode.GUIDED, Phase.EN_ROUTE, task.text, telemetry, now)
        if telemetry.on_ground:
            return self._take_off(task, telemetry, position, now)
        high = position.height >= CLIMBED_ALTITUDE_SHARE * settings.flight_altitude
        if self._climbing and not high:
            return PilotOutput(Phase.TAKE_OFF, task.text)
        self._climbing = False
        speed = settings.agile_speed if task.agile else settings.cruise_speed
        fly = Fly(task.latitude, task.longitude, settings.flight_altitude, speed)
        if distance > settings.acceptance_radius or (task.goal and not high):
            self._arrived = None
            return self._ask(fly, Phase.EN_ROUTE, task.text, now)
        if task.land:
            return self._order(FlightMode.LAND, Phase.LANDING, task.text, telemetry, now)
        step = self._ask(fly, Phase.ON_SITE, task.text, now)
        return replace(step, completed=self._complete(task, now))

    def _take_off(
        self, task: FlightTask, telemetry: Telemetry, position: Position, now: float
    ) -> PilotOutput:
        """Armed on the ground in GUIDED: take off, or stop the motors that this pilot started."""
        if self._may_stay(task, position):
            return self._stop_motors(Phase.GROUND, task.text, telemetry, now)
        if not self._settings.allow_arming:
            return PilotOutput(
                Phase.GROUND, f'{task.text}: allow_arming is false, a pilot must take off'
            )
        self._climbing = True
        take_off = TakeOff(self._settings.flight_altitude)
        return self._ask(take_off, Phase.TAKE_OFF, task.text, now)

    def _stop_motors(
        self, phase: Phase, why: str, telemetry: Telemetry, now: float
    ) -> PilotOutput:
        """On the ground: LAND disarms. Motors that a human started stay as they are."""
        if self._armed_here and telemetry.mode != FlightMode.LAND:
            return self._order(FlightMode.LAND, phase, why, telemetry, now)
        return PilotOutput(phase, why)

    def _complete(self, task: FlightTask, now: float) -> str:
        """Return the goal when the dwell is over, else ''.

        If the command is still the same 10 s later, the manager missed the completion or wants
        the goal anew, and it is returned again.
        """
        if self._arrived is None:
            self._arrived = now
        dwelt = now - self._arrived >= self._settings.goal_dwell
        if not task.goal or not dwelt or now - self._completed_at < COMPLETION_REPEAT_PERIOD:
            return ''
        self._completed_at = now
        return task.goal

    def _without_manager(self, telemetry: Telemetry, now: float) -> PilotOutput:
        """Hold, then return to launch; a landing under way is safe and goes on."""
        if telemetry.mode == FlightMode.LAND:
            return PilotOutput(Phase.LANDING, 'the manager is silent')
        silence = now - max(self._heard, self._awaited)
        patience = self._settings.manager_timeout + self._settings.rtl_delay
        if silence > patience and not telemetry.on_ground:
            self._returning = True
            return self._return(telemetry, now)
        return self._hold(telemetry, 'the manager is silent', now)

    def _return(self, telemetry: Telemetry, now: float) -> PilotOutput:
        why = 'the manager is silent'
        if telemetry.mode == FlightMode.RTL:
            return PilotOutput(Phase.RETURNING, why)
        return self._order(FlightMode.RTL, Phase.RETURNING, why, telemetry, now)

    def _hold(self, telemetry: Telemetry, why: str, now: float) -> PilotOutput:
        """Stay where the hold began, in GUIDED, which needs a position."""
        self._arrived, self._climbing = None, False
        if telemetry.on_ground:
            return self._stop_motors(Phase.HOLDING, why, telemetry, now)
        position = telemetry.fix(now)
        if position is None:
            return PilotOutput(Phase.HOLDING, f'{why}; {NO_POSITION_TO_HOLD}')
        self._hold_point = point = self._hold_point or position
        if telemetry.mode != FlightMode.GUIDED:
            return self._order(FlightMode.GUIDED, Phase.HOLDING, why, telemetry, now)
        height = max(point.height, MIN_HOLD_HEIGHT)
        fly = Fly(point.latitude, point.longitude, height, self._settings.cruise_speed)
        return self._ask(fly, Phase.HOLDING, why, now)

    def _order(
        self, mode: FlightMode, phase: Phase, why: str, telemetry: Telemetry, now: float
    ) -> PilotOutput:
        self._mode, self._ordered, self._ordered_at = telemetry.mode, mode, now
        return self._ask(SetMode(mode), phase, why, now)

    def _ask(self, request: Request, phase: Phase, why: str, now: float) -> PilotOutput:
        """Return a step with the request, if it is new or was made long enough ago."""
        last, at = self._sent.get(type(request), (None, -math.inf))
        repeat = FLY_REPEAT_PERIOD if isinstance(request, Fly) else REQUEST_REPEAT_PERIOD
        if request == last and now - at < repeat:
            return PilotOutput(phase, why)
        self._sent[type(request)] = (request, now)
        return PilotOutput(phase, why, (request,))


def _fallen(telemetry: Telemetry) -> str:
    """Say so if the motors were stopped in the air, '' if the vehicle landed, be it on a hill."""
    position = telemetry.position
    if position is None or position.height < AIRBORNE_HEIGHT:
        return ''
    landing = (
        telemetry.mode in (FlightMode.LAND, FlightMode.RTL)
        and position.velocity[2] > -MAX_LANDING_SINK_RATE
    )
    return '' if landing else f'disarmed {position.height:.0f} m above home'
