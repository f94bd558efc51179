"""The bridge to one vehicle without ROS: link, telemetry, faults and pilot, stepped together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.faults import Fault, FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import (
    NO_HEARTBEAT,
    NO_POSITION_TO_HOLD,
    NOT_ACTIVE,
    Phase,
    PilotOutput,
)
from uav_mission_manager.autopilot.telemetry import (
    BatteryReading,
    Position,
    Telemetry,
    forget,
    update,
)
from uav_mission_manager.autopilot.vehicle import REQUESTED_BY, TakePhoto, commands
from uav_mission_manager.echo import shown

CAMERA_COMPONENT = 100
"""MAV_COMP_ID_CAMERA, the component whose heartbeat says that the camera works."""

WARNING_SEVERITY = 4
"""MAV_SEVERITY_WARNING: texts of this severity or worse (lower numbers) are logged as warnings."""

PREARM_TIME = 35.0
"""Time [s] for which a reason not to arm holds that is not said again: ArduCopter says it every
30 s."""

MAX_REASONS = 3
"""Reasons not to arm that are told at a time, at most: a choice."""

BATTERY_DISAGREEMENT = 0.2
"""Difference of the charges of two batteries from which it is told: a choice."""

WARNING_PHASES = (
    Phase.NO_LINK,
    Phase.PILOT,
    Phase.HOLDING,
    Phase.RETURNING,
    Phase.BLOCKED,
    Phase.WAITING,
)
"""Phases in which the manager's command is not flown."""


@dataclass(frozen=True)
class BridgeStep:
    """What a step brought.

    Attributes
    ----------
    pilot : PilotOutput
    batteries : mapping of int to BatteryReading
        By id, if heard anew.
    position : Position or None
        If heard anew, and to be flown by.
    fault : Fault or None
        None while too little is known.
    log : tuple of (bool, str)
        What there is to tell; whether it is a warning.
    """

    pilot: PilotOutput
    batteries: Mapping[int, BatteryReading]
    position: Position | None
    fault: Fault | None
    log: tuple[tuple[bool, str], ...]


class VehicleBridge:
    """Hears the vehicle and flies it; `step` is to be called some 20 times a second.

    Attributes
    ----------
    remember : callable
        Called with the `memory` before anything is done that follows from it.
    """

    def __init__(self, link: AutopilotLink, pilot: Pilot, faults: FaultEstimator) -> None:
        self.link, self.pilot, self.faults = link, pilot, faults
        self.remember: Callable[[dict[str, Any]], object] = lambda memory: None
        self.telemetry = Telemetry()
        self.output: PilotOutput = NO_HEARTBEAT
        self._said: dict[str, str] = {}
        self._reasons: dict[str, float] = {}  # not to arm, with the time [s] they were said
        self._log: list[tuple[bool, str]] = []
        self._remembered_at: float | None = None  # until it is known what has rebooted since

    def step(self, now: float) -> BridgeStep:
        """Hear what has arrived, decide, and ask of the vehicle what is to be asked."""
        last = self.telemetry
        self._hear(now)
        output = self._fly(now)
        self.link.repeat(now)
        self._tell(now)
        position = self.telemetry.fix(now)
        fault = self._judge(now)
        self.remember(self.memory)
        log, self._log = tuple(self._log), []
        return BridgeStep(
            output,
            self.telemetry.all_batteries if self.telemetry.battery is not last.battery else {},
            position if position is not last.position else None,
            fault,
            log,
        )

    @property
    def memory(self) -> dict[str, Any]:
        """What another one needs to go on from here: JSON values."""
        return {
            'pilot': self.pilot.memory,
            'faults': self.faults.memory,
            'camera': self._camera == CAMERA_COMPONENT,
        }

    def restore(self, memory: Mapping[str, Any], written_at: float | None = None) -> None:
        """Go on from the `memory` of another one, before the first `step`.

        Parameters
        ----------
        memory : mapping
        written_at : float, optional
            When it was [s], to know of an autopilot that has been switched on since.

        Raises
        ------
        ValueError
            It is none.
        """
        try:
            self.pilot.restore(memory['pilot'])
            self.faults.restore(memory['faults'])
            if memory['camera']:
                self.link.expect(CAMERA_COMPONENT)
            self._remembered_at = written_at
        except (KeyError, TypeError) as error:
            raise ValueError(f'no memory of a bridge: {error!r}') from error

    def distrust(self, why: str) -> None:
        """Obey nobody until `resume`, for what was before is not known: see `Pilot.distrust`."""
        self.pilot.distrust(why)

    def hold(self, now: float) -> tuple[bool, str]:
        """Hold until `resume`; return whether it does, and a word about it."""
        if self.output.phase is Phase.PILOT:
            return False, self.output.status
        self.pilot.hold()
        self.remember(self.memory)
        if not self.link.up:
            return False, f'{self.output.status}; holds when it is back'
        if self.telemetry.on_ground is not True and self.telemetry.fix(now) is None:
            return False, f'{NO_POSITION_TO_HOLD}; holds when there is one'
        return True, 'holds until ~/resume'

    def resume(self, now: float) -> tuple[bool, str]:
        """Give command back to the manager; return whether it has it, and what is done now."""
        if self.output.phase is Phase.NO_LINK or self.telemetry.unheard:
            return False, self.output.status  # What is heard next, somebody may have done since.
        if not self.pilot.active:
            return False, NOT_ACTIVE
        self.pilot.resume(now)
        output = self._fly(now)
        resumed = output.phase not in (Phase.PILOT, Phase.NO_LINK)
        return resumed, f'{output.phase.value}: {output.status}'

    @property
    def warnings(self) -> tuple[str, ...]:
        """What keeps the vehicle from flying as commanded, or may do so soon."""
        refused = (f'{name} refused: {why}' for name, why in self.link.refused.items())
        telemetry = self.telemetry
        failsafe = 'the autopilot reports a failsafe' if telemetry.failsafe else ''
        waits = self.output.phase is Phase.BLOCKED and not telemetry.armed
        reasons = self._reasons if waits else ()
        told = (self.link.rejected, failsafe, _battery_warning(telemetry), *refused, *reasons)
        return tuple(filter(None, told))

    def _hear(self, now: float) -> None:
        messages = self.link.poll(now)
        if self.link.rebooted:
            self._log.append((True, 'the autopilot has rebooted'))
            self.faults.rebooted()
        if self.link.rebooted or not self.link.up:
            self.telemetry = Telemetry()
            self.pilot.update(None, now)
        if not self.link.up:
            self.faults.link_lost()
        if not self.link.up or self.link.rebooted:  # What came before it holds no longer.
            return
        for message in messages:
            self.telemetry = update(self.telemetry, message, now)
            if message.get_type() == 'STATUSTEXT':
                text = shown(message.text)
                self._log.append((message.severity <= WARNING_SEVERITY, f'autopilot: {text}'))
                if text.startswith('PreArm: '):
                    self._reasons[text] = now
        self.telemetry = forget(self.telemetry, now)
        said = sorted(self._reasons.items(), key=lambda item: -item[1])[:MAX_REASONS]
        self._reasons = {text: at for text, at in said if now - at <= PREARM_TIME}

    def _fly(self, now: float) -> PilotOutput:
        for answer in self.link.take_answers():
            kind = REQUESTED_BY.get(answer.command.number)
            if kind is TakePhoto:
                self.pilot.work.photo_answered(answer.accepted, answer.why)
            elif kind is not None:
                since = -math.inf if self.link.mode_told else now
                self.pilot.answered(kind, answer.accepted, answer.why, since)
        self._look_for_reboot(now)
        output = self.pilot.update(self.telemetry if self.link.up else None, now)
        last, self.output = self.output, output
        if output.phase is not last.phase:  # What was asked for is no longer wanted.
            self.link.cancel()
        self.remember(self.memory)
        for request in output.requests:
            self.link.send(commands(request, self._camera), now)
        if output.serviced:
            self.faults.serviced()
            self._log.append((False, 'service done'))
        if (output.phase, output.status) != (last.phase, last.status):
            warning = output.phase in WARNING_PHASES
            self._log.append((warning, f'{output.phase.value}: {output.status}'))
        return output

    @property
    def _camera(self) -> int:
        """Component that takes pictures: a camera, if one was ever heard, else the autopilot."""
        heard = self.link.component_age(CAMERA_COMPONENT, 0.0) is not None
        return CAMERA_COMPONENT if heard else mavlink.MAV_COMP_ID_AUTOPILOT1

    def _look_for_reboot(self, now: float) -> None:
        """Tell of a reboot between the memory and the first that is heard of the autopilot."""
        since = self._remembered_at
        if since is None or not self.link.up or self.telemetry.unheard:
            return
        self._remembered_at = None
        if self.link.boot_time < now - since:
            self._log.append((False, 'the autopilot was switched on since'))
            self.faults.rebooted()
            self.pilot.rebooted()

    def _tell(self, now: float) -> None:
        """Log what is new about the link: who is flown, who is not, what was refused."""
        facts = {
            'vehicle': self.link.vehicle,
            'link error': self.link.error,
            **{f'warning {text}': text for text in self.warnings},
        }
        for key, text in facts.items():
            if text and self._said.get(key) != text:
                self._log.append((key != 'vehicle', text))
        self._said = facts

    def _judge(self, now: float) -> Fault | None:
        if not self.link.up:
            return None
        camera_age = self.link.component_age(CAMERA_COMPONENT, now)
        return self.faults.update(self.telemetry, camera_age, now)


def _battery_warning(telemetry: Telemetry) -> str:
    """Say so where a battery is not what its charge says, '' where all is well."""
    batteries = telemetry.all_batteries.values()
    if not all(battery.healthy for battery in batteries):
        return 'the autopilot calls a battery unhealthy: it counts as empty'
    known = [battery.charge for battery in batteries if not math.isnan(battery.charge)]
    if known and max(known) - min(known) > BATTERY_DISAGREEMENT:
        return f'batteries at {min(known):.0%} and {max(known):.0%}: the least counts'
    return ''
