"""Failsafes of the simulated autopilot: battery, radio, ground station, estimator, as ArduCopter.

What a failsafe does when the vehicle stands on the ground, lands already or has no position is
ArduCopter's; its texts too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from uav_mission_manager.autopilot.simulator.battery import BatteryMonitor
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode

if TYPE_CHECKING:
    from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight

CRITICAL, WARNING, NOTICE, INFO = 2, 4, 5, 6
"""Severities of a text to the pilot: MAVLink's numbers (MAV_SEVERITY)."""

RADIO_TIMEOUT = 1.0
"""Time [s] without the remote control after which it is lost: ArduCopter's default."""

THRUST_LOSS_TIME = 1.0
"""Time [s] of too little thrust after which it is reported, as in ArduCopter's own check."""

CONTINUE_IN_GUIDED, CONTINUE_LANDING = 4, 8
"""Bits of FS_OPTIONS: GUIDED goes on without the remote control; a landing goes on anyway."""

BATTERY_ACTIONS = {1: SimulatedMode.LAND, 2: SimulatedMode.RTL}
"""Mode that a battery failsafe flies, by its BATT_FS_*_ACT; none for 0."""

BATTERY_LEVELS = (('low', 'BATT_FS_LOW_ACT'), ('critical', 'BATT_FS_CRT_ACT'))
"""What the battery is called at failsafe level 1 and 2, and the parameter of what it does then."""

LANDING_VALUES = {'FS_THR_ENABLE': 3, 'FS_GCS_ENABLE': 5}
"""Value of each parameter that lands; any other but 0 returns."""


class Failsafes:
    """Watches over one flight.

    Attributes
    ----------
    battery : BatteryMonitor
    radio, ground, estimator : bool
        Whether the remote control, the ground station, the position is lost and acted upon.
    fence, thrust_loss : bool
        Whether the vehicle is outside the fence, and the motors were found too weak: failsafes
        that the vehicle's state does not tell.
    """

    def __init__(self) -> None:
        self.battery = BatteryMonitor()
        self.radio = self.ground = self.estimator = False
        self.fence = self.thrust_loss = False
        self._radio_silent = self._short = 0.0
        self._ground_silent: float | None = None

    @property
    def active(self) -> bool:
        """Whether a failsafe is on that the vehicle's state tells, also disarmed."""
        return self.battery.level > 0 or self.radio or self.ground or self.estimator

    def hear_ground_station(self) -> None:
        """Take note of a HEARTBEAT of the ground station."""
        self._ground_silent = 0.0

    def update(self, dt: float, flight: SimulatedFlight) -> None:
        """Watch for another `dt` seconds."""
        self._watch_battery(dt, flight)
        self._watch_radio(dt, flight)
        self._watch_ground_station(dt, flight)
        self._watch_position(flight)
        self._watch_fence(flight)
        self._short = self._short + dt if flight.body.thrust_short else 0.0
        if self._short > THRUST_LOSS_TIME and flight.armed and not self.thrust_loss:
            self.thrust_loss = True
            flight.say(CRITICAL, 'Potential Thrust Loss (1)')

    def _watch_battery(self, dt: float, flight: SimulatedFlight) -> None:
        voltage = flight.body.battery.voltage
        if flight.armed and self.battery.update(dt, voltage, flight.parameters):
            name, parameter = BATTERY_LEVELS[self.battery.level - 1]
            used = flight.body.battery.consumed * 1000.0
            flight.say(WARNING, f'Battery 1 is {name} {voltage:.2f}V used {used:.0f} mAh')
            action = BATTERY_ACTIONS.get(int(flight.parameters[parameter]))
            _act(flight, 'Battery', action, self._landing_goes_on(flight))

    def _watch_radio(self, dt: float, flight: SimulatedFlight) -> None:
        """Without signal, or with the throttle below FS_THR_VALUE, which receivers do then."""
        parameters = flight.parameters
        silent = parameters['SIM_RC_FAIL'] or parameters['SIM_RC3'] < parameters['FS_THR_VALUE']
        self._radio_silent = self._radio_silent + dt if silent else 0.0
        lost = self._radio_silent >= RADIO_TIMEOUT and parameters['FS_THR_ENABLE'] > 0.0
        if lost and not self.radio:
            goes_on = self._landing_goes_on(flight)
            options = int(parameters['FS_OPTIONS'])
            if flight.mode == SimulatedMode.GUIDED and options & CONTINUE_IN_GUIDED:
                goes_on = 'Continuing Guided Mode'
            _act(flight, 'Radio', _lost_link_action(flight, 'FS_THR_ENABLE'), goes_on)
        elif self.radio and not lost:
            flight.say(WARNING, 'Radio Failsafe Cleared')
        self.radio = lost

    def _watch_ground_station(self, dt: float, flight: SimulatedFlight) -> None:
        """It counts as lost only after it has been heard since boot."""
        if self._ground_silent is None:
            return
        self._ground_silent += dt
        late = self._ground_silent > flight.parameters['FS_GCS_TIMEOUT']
        lost = late and flight.parameters['FS_GCS_ENABLE'] > 0.0
        if lost and not self.ground:
            goes_on = self._landing_goes_on(flight)
            if flight.armed:
                _act(flight, 'GCS', _lost_link_action(flight, 'FS_GCS_ENABLE'), goes_on)
            else:
                flight.say(WARNING, 'GCS Failsafe')
        elif self.ground and not lost:
            flight.say(WARNING, 'GCS Failsafe Cleared')
        self.ground = lost

    def _watch_position(self, flight: SimulatedFlight) -> None:
        if flight.position_ok:
            if self.estimator:
                flight.say(CRITICAL, 'EKF Failsafe Cleared')
            self.estimator = False
        elif flight.armed and not self.estimator and flight.mode != SimulatedMode.STABILIZE:
            self.estimator = True
            flight.say(CRITICAL, 'EKF Failsafe: changed to LAND Mode')
            flight.change_mode(SimulatedMode.LAND)

    def _watch_fence(self, flight: SimulatedFlight) -> None:
        body = flight.body
        outside = flight.armed and not flight.inside_fence(body.position, body.altitude)
        if outside and not self.fence:
            circle = flight.inside_fence(flight.home.position, body.altitude)
            flight.say(NOTICE, f'{"Circle" if circle else "Max Alt"} fence breached')
            if not flight.landed:
                flight.change_mode(_possible(flight, SimulatedMode.RTL))
        self.fence = outside

    def _landing_goes_on(self, flight: SimulatedFlight) -> str:
        """Words for it that a landing goes on whatever is lost; empty if it does not."""
        wanted = int(flight.parameters['FS_OPTIONS']) & CONTINUE_LANDING
        name = BATTERY_LEVELS[self.battery.level - 1][1] if self.battery.level else ''
        needed = name and BATTERY_ACTIONS.get(int(flight.parameters[name])) == SimulatedMode.LAND
        return 'Continuing Landing' if flight.landing and (wanted or needed) else ''


def _lost_link_action(flight: SimulatedFlight, parameter: str) -> SimulatedMode:
    lands = flight.parameters[parameter] == LANDING_VALUES[parameter]
    return SimulatedMode.LAND if lands else SimulatedMode.RTL


def _possible(flight: SimulatedFlight, mode: SimulatedMode) -> SimulatedMode:
    """Without a position it can only land."""
    return mode if flight.position_ok else SimulatedMode.LAND


def _act(flight: SimulatedFlight, name: str, action: SimulatedMode | None, goes_on: str) -> None:
    """Tell of a failsafe and do it; on the ground it disarms."""
    if flight.landed:
        flight.say(WARNING, f'{name} Failsafe - Disarming')
        flight.disarm()
    elif goes_on:
        flight.say(WARNING, f'{name} Failsafe - {goes_on}')
    else:
        flight.say(WARNING, f'{name} Failsafe')
        if action is not None and action != flight.mode:
            flight.change_mode(_possible(flight, action))
