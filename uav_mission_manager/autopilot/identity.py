"""Who is heard on a MAVLink connection, and which of them is the autopilot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.exchange import enum_name, short_name

MULTIROTOR_TYPES = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DECAROTOR,
    mavlink.MAV_TYPE_DODECAROTOR,
)
"""Types of vehicle that ArduCopter gives multirotors; all others have other flight modes."""

EQUIPMENT_TYPES = (
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_ADSB,
    mavlink.MAV_TYPE_CAMERA,
    mavlink.MAV_TYPE_FLARM,
    mavlink.MAV_TYPE_SERVO,
    mavlink.MAV_TYPE_ODID,
)
"""Types that are no vehicle: with an autopilot's ids they are somebody's mistake, and ignored."""

MAX_OTHERS = 16
"""How many others are remembered: a choice, so that forged ids fill no memory."""

OTHERS_TIMEOUT = 10.0
"""Time [s] after which a silent other is forgotten: a choice, ten heartbeats."""

WRONG_VEHICLE_TIMEOUT = 3.0
"""Time [s] for which one who was heard as a wrong vehicle is not commanded: a choice, three
heartbeats."""


@dataclass(frozen=True)
class _Caller:
    """Whose frame it was."""

    system: int
    component: int
    address: Any
    version: int


class Identity:
    """The autopilot among all that is heard: component 1 of the wanted system, from one address.

    Parameters
    ----------
    target_system : int
        System id of the vehicle; 0 takes the first that qualifies and stays with it.
    timeout : float
        Seconds of silence after which the autopilot may be at another address.

    Attributes
    ----------
    address : object
        Where the chosen autopilot is, None where the transport does not say.
    vehicle : str
        The chosen autopilot in words, '' until there is one.
    rejected : str
        Why the wanted vehicle is not commanded, '' if nothing is wrong.
    beat_at : float
        When the autopilot's last HEARTBEAT came [s].
    """

    def __init__(self, target_system: int, timeout: float) -> None:
        self._timeout = timeout
        self.target_system = target_system
        self.address: Any = None
        self.vehicle = self.rejected = ''
        self.beat_at = self._kept_at = -math.inf
        self._free = True  # To choose, as nobody is chosen or who was chosen is silent.
        self._heard: dict[int, float] = {}
        self._wrong: dict[_Caller, float] = {}
        self._others: dict[_Caller, tuple[float, int | None]] = {}

    def hear(self, message: Any, address: Any, now: float) -> bool:
        """Take note of a message; return whether it is the chosen autopilot's."""
        caller = _Caller(
            message.get_srcSystem(),
            message.get_srcComponent(),
            address,
            1 if message.get_msgbuf()[0] == mavlink.PROTOCOL_MARKER_V1 else 2,
        )
        beat = message if message.get_type() == 'HEARTBEAT' else None
        if beat and caller.version == 2 and caller.system == self.target_system:
            self._heard[caller.component] = now
        if self._is_autopilot(caller, beat, now):
            return True
        self._note(caller, beat, now)
        return False

    @property
    def others(self) -> tuple[str, ...]:
        """Whoever else is heard."""
        return tuple(sorted(_in_words(c, kind) for c, (_, kind) in self._others.items()))

    def component_heard(self, component: int) -> float | None:
        """When a component of the vehicle was last heard, None if it never was."""
        return self._heard.get(component)

    def expect(self, component: int) -> None:
        """Count a component of the vehicle as heard, whenever that was."""
        self._heard.setdefault(component, -math.inf)

    def watch(self, now: float) -> None:
        """Forget who is silent; only then may the autopilot be another one."""
        if now - max(self.beat_at, self._kept_at) > self._timeout:
            self._free = True
        self._wrong = {
            c: t for c, t in self._wrong.items() if 0 <= now - t <= WRONG_VEHICLE_TIMEOUT
        }
        if not self._wrong:
            self.rejected = ''
        self._others = {
            c: other for c, other in self._others.items() if 0 <= now - other[0] <= OTHERS_TIMEOUT
        }

    def lose(self, now: float) -> None:
        """Count the autopilot as lost until its next HEARTBEAT, but wait for it as if just heard.

        Times from before are cut to `now`: the clock may have been set back.
        """
        self.beat_at, self._kept_at = -math.inf, now
        self._heard = {component: min(time, now) for component, time in self._heard.items()}

    def _is_autopilot(self, caller: _Caller, beat: Any | None, now: float) -> bool:
        wanted = (
            caller.version == 2
            and caller.component == mavlink.MAV_COMP_ID_AUTOPILOT1
            and 0 < caller.system == (self.target_system or caller.system)
        )
        if not wanted:
            return False
        if beat is None:
            return not self._free and caller.address == self.address
        if beat.type in EQUIPMENT_TYPES or beat.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return False
        if not self._free and caller.address != self.address:
            return False
        objection = _objection(beat)
        if objection:
            self._reject(caller, objection, now)
            return False
        # One who was heard as two vehicles may be two: not before the other one is silent.
        if not self._free or now - self._wrong.get(caller, -math.inf) > WRONG_VEHICLE_TIMEOUT:
            self._choose(caller, beat, now)
            return True
        return False

    def _reject(self, caller: _Caller, objection: str, now: float) -> None:
        self._wrong[caller] = now
        if len(self._wrong) > MAX_OTHERS:
            del self._wrong[min(self._wrong, key=self._wrong.__getitem__)]
        self.rejected = objection
        if caller.address == self.address:
            self.vehicle, self._free = '', True
            self.beat_at = self._kept_at = -math.inf

    def _choose(self, caller: _Caller, beat: Any, now: float) -> None:
        self.target_system, self.address = caller.system, caller.address
        kind = short_name('MAV_TYPE', beat.type).lower()
        self.vehicle = f'system {caller.system}, component {caller.component}, {kind}'
        self.rejected, self.beat_at, self._free = '', now, False
        self._heard[caller.component] = now
        self._others.pop(caller, None)

    def _note(self, caller: _Caller, beat: Any | None, now: float) -> None:
        autopilots = self.target_system, mavlink.MAV_COMP_ID_AUTOPILOT1
        if (caller.system, caller.component) != autopilots:  # Its address matters little.
            caller = replace(caller, address=None)
        _, kind = self._others.get(caller, (now, None))
        self._others[caller] = now, beat.type if beat else kind
        if len(self._others) > MAX_OTHERS:
            del self._others[min(self._others, key=lambda c: self._others[c][0])]


def _objection(beat: Any) -> str:
    """Return why a vehicle is not to be commanded, '' for an ArduCopter."""
    system = beat.get_srcSystem()
    if beat.type not in MULTIROTOR_TYPES:
        kind = enum_name('MAV_TYPE', beat.type)
        return f'system {system} is a {kind}, not a multirotor: never commanded'
    if beat.autopilot != mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
        firmware = enum_name('MAV_AUTOPILOT', beat.autopilot)
        return f'system {system} runs {firmware}, not ArduCopter: never commanded'
    return ''


def _in_words(caller: _Caller, kind: int | None) -> str:
    words = f'system {caller.system} component {caller.component}'
    if kind is not None:
        words += f' {short_name("MAV_TYPE", kind)}'
    if caller.address is not None:
        at = caller.address
        words += f' at {":".join(map(str, at)) if isinstance(at, tuple) else at}'
    return words if caller.version == 2 else f'{words}, MAVLink 1: ignored'
