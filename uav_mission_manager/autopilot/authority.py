"""Who is in command of the vehicle: the flight mode says it.

Someone else has taken command when the mode changes to one that was not ordered from here, or when
the motors stop in GUIDED or in the air. Those that stop as a landing ends, just when GUIDED is
ordered, were stopped by nobody else. A failsafe that leaves the vehicle in GUIDED takes nothing
over; one that begins in a landing may be why it goes on. A vehicle that is flown by hand from the
start is taken over when it is put into GUIDED. What happened unseen while this program was not
running counts as if it had been seen: it was nobody here who did it. A mode that was about to be
left then may have been given anew meanwhile: it is somebody else's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from uav_mission_manager.autopilot.telemetry import Telemetry
from uav_mission_manager.autopilot.vehicle import FlightMode, mode_name

REQUEST_EFFECT_TIME = 5.0
"""Time [s] after a request within which a change of mode or arming is its effect: a choice."""

AIRBORNE_HEIGHT = 5.0
"""Height above home [m] from which stopped motors may mean a fall, not a landing: a choice."""

MAX_LANDING_SINK_RATE = 0.5
"""Descent [m/s] above which a vehicle whose motors stop is falling: that of ArduCopter just before
touch-down (LAND_SPEED, 50 cm/s by default); a landing ends at rest."""

FALL_RATE = 3.0
"""Descent [m/s] that, near the time when the motors stop, is a fall: a choice, twice that of
ArduCopter's landing at its fastest (WPNAV_SPEED_DN, 150 cm/s by default)."""

FALL_TIME = 2.0
"""Time [s] between a fall and the news that the motors have stopped, at most, whichever comes
first: a choice. ArduCopter may tell of it as late as with its next heartbeat, a second later."""


class Authority:
    """Follows mode and arming; see the module's docstring.

    Attributes
    ----------
    taken : str
        Who else has taken command, and so how; '' for nobody. It stays until `resume`.
    motors_started_here : bool
        Whether the motors run because this program asked for it.
    """

    def __init__(self) -> None:
        self.taken = ''
        self.motors_started_here = False
        self._mode: int | None = None  # the mode in which this program is in command
        self._ordered: int | None = None  # the mode that it waits for
        self._ordered_at = -math.inf
        self._accepted_at = math.inf  # when the order for that mode was, if it was
        self._alone = True  # nor was another mode waited for when it was given
        self._arm_asked: float | None = None  # until the motors run, or it has had its time
        self._adopt = False
        self._restored = False  # and nothing seen since
        self._in_doubt = False  # whose mode it is, for an order was under way then
        self._fell_at, self._stopped_at = math.inf, -math.inf
        self._seen: tuple[int | None, bool] = (None, False)
        self._failsafe_seen = False

    @property
    def here(self) -> bool:
        """Whether this program is in command of the vehicle in flight."""
        return self._mode is not None and not self.taken

    def order(self, mode: FlightMode, present: int | None, now: float) -> None:
        """Count a change from the present mode to `mode` as ordered from here."""
        if mode != self._ordered:
            self._alone, self._accepted_at = self._ordered is None, math.inf
        self._mode, self._ordered, self._ordered_at = present, mode, now

    def accepted(self, since: float) -> None:
        """Take note of it that the order was accepted: what is heard since is its effect, or not.

        An answer does not say to which mode it belongs, if two were ordered.
        """
        if self._alone:
            self._accepted_at = min(self._accepted_at, since)

    def arm(self, now: float) -> None:
        """Count motors that start now as started from here."""
        self._arm_asked = now

    def resume(self) -> None:
        """Take command again, whatever the mode is."""
        self.taken, self._adopt, self._fell_at = '', True, math.inf

    @property
    def armed(self) -> bool:
        """Whether the motors ran when the vehicle was last seen."""
        return self._seen[1]

    @property
    def memory(self) -> dict[str, Any]:
        """What `restore` takes: JSON values."""
        return {
            'taken': self.taken,
            'mode': self._mode,
            'ordered': self._ordered,
            'arming': self._arm_asked is not None,
            'armed': self.armed,
            'motors_started_here': self.motors_started_here,
            'failsafe': self._failsafe_seen,
        }

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Go on from a `memory`; the time of requests under way counts from what is seen next."""
        self.taken, self._mode = memory['taken'], memory['mode']
        self._ordered, self._ordered_at = memory['ordered'], math.inf
        self._arm_asked = math.inf if memory['arming'] else None
        self._seen = None, memory['armed']
        self.motors_started_here = memory['motors_started_here']
        self._failsafe_seen, self._restored = memory['failsafe'], True
        under_way = self._ordered is not None and memory['armed']
        self._in_doubt = under_way and self._mode != FlightMode.GUIDED

    def rebooted(self) -> None:
        """Take nothing over that a reboot of the autopilot did, on the ground."""
        self._restored = self._in_doubt = False
        self.link_lost()

    def link_lost(self) -> None:
        """Take nothing over unseen; on the ground the autopilot may reboot meanwhile."""
        self._adopt = False
        if not self.armed and not self._restored:
            self._mode = self._ordered = None

    def watch(self, telemetry: Telemetry, now: float) -> tuple[bool, bool]:
        """Take note of mode and arming; yield to whoever else changed them.

        Returns
        -------
        tuple of bool
            Whether mode or arming have changed, and whether command was found given here.
        """
        self._restored = False
        self._ordered_at = min(self._ordered_at, now)
        if self._arm_asked is not None:
            self._arm_asked = min(self._arm_asked, now)
            if now - self._arm_asked >= REQUEST_EFFECT_TIME:
                self._arm_asked = None
        if telemetry.armed and not self.armed:
            self.motors_started_here, self._arm_asked = self._arm_asked is not None, None
            if not self.motors_started_here:  # by hand: not ours until it is put into GUIDED
                self._mode = self._ordered = None
        given = self._mode is None and telemetry.armed and telemetry.mode == FlightMode.GUIDED
        if self._adopt or given or telemetry.mode == self._ordered:
            self._mode, self._ordered, self._adopt = telemetry.mode, None, False
        if now - self._ordered_at > REQUEST_EFFECT_TIME:
            self._ordered = None
        if self._ordered is not None and telemetry.received['HEARTBEAT'] > self._accepted_at:
            self._mode, self._ordered = self._ordered, None
        if not self.taken:
            self._watch_falls(telemetry, now)
            self.taken = self._someone_else(telemetry)
            self._in_doubt = False
        self.motors_started_here = self.motors_started_here and telemetry.armed
        changed = self._seen != (telemetry.mode, telemetry.armed)
        self._seen, self._failsafe_seen = (telemetry.mode, telemetry.armed), telemetry.failsafe
        return changed, given

    def _someone_else(self, telemetry: Telemetry) -> str:
        """Say who else is in command, '' for nobody."""
        if self._in_doubt and telemetry.mode == self._mode:
            return f'{mode_name(telemetry.mode)} may have been ordered anew, by somebody else'
        if self._mode is not None and telemetry.mode not in (self._mode, self._ordered):
            failsafe = ', the autopilot is in a failsafe' if telemetry.failsafe else ''
            return f'{mode_name(telemetry.mode)} was not ordered from here{failsafe}'
        began = telemetry.armed and telemetry.failsafe and not self._failsafe_seen
        if began and self.armed and telemetry.mode in (FlightMode.LAND, FlightMode.RTL):
            return f'the autopilot is in a failsafe ({mode_name(telemetry.mode)})'
        stopped = self.armed and not telemetry.armed
        landing = self._seen[0] in (FlightMode.LAND, FlightMode.RTL)  # until just now
        if stopped and telemetry.mode == FlightMode.GUIDED and not landing:
            return 'disarmed, but not from here'
        if not telemetry.armed and abs(self._fell_at - self._stopped_at) <= FALL_TIME:
            return 'the motors were stopped in the air'
        return _fallen(telemetry) if stopped else ''

    def _watch_falls(self, telemetry: Telemetry, now: float) -> None:
        if self.armed and not telemetry.armed:
            self._stopped_at = now
        position = telemetry.position
        if position is not None and position.velocity[2] < -FALL_RATE:
            self._fell_at = now


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
