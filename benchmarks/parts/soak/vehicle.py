"""The simulated autopilot at its end of the wire, and what really happens to the vehicle."""

from __future__ import annotations

import math
import random
from dataclasses import astuple
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from parts.soak.wires import Wire
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.link import SimulatedLink
from uav_mission_manager.autopilot.simulator.modes import SimulatedMode
from uav_mission_manager.autopilot.simulator.physics import SimulatedOrigin
from uav_mission_manager.autopilot.simulator.protocol import SimulatedAutopilot
from uav_mission_manager.mdp import Grid

BOOT_TIME = 10.0
"""Simulated time [s] from boot to a position: a choice, a quarter of ArduCopter's."""

GAUGE_NOISE = 1
"""Largest error of the battery gauge [%], besides its rounding down: a choice."""

VOLTAGE_NOISE = 0.05
"""Largest error of the battery's voltage [V]: a choice."""

PARAMETERS = {'FENCE_ENABLE': 1.0, 'BATT_CRT_VOLT': 10.25, 'BATT_FS_CRT_ACT': 1.0}
"""Of the autopilot, beside the defaults: it has a fence, and lands where it is at some 8 %."""

SUBSTEPS = 2
"""Steps of the autopilot in one of the chain."""


class _NoisyLink(SimulatedLink):
    """A link whose battery gauge trembles, and that says which message it sends."""

    def __init__(self, vehicle: Vehicle, rng: random.Random) -> None:
        self._vehicle, self._rng = vehicle, rng
        super().__init__(vehicle)

    def send(self, message: Any) -> None:
        if message is None:
            return
        if message.get_type() in ('SYS_STATUS', 'BATTERY_STATUS'):
            self._tremble(message)
        if message.get_type() == 'STATUSTEXT':
            self._vehicle.texts.append(message.text)
        self._vehicle.message = message
        super().send(message)

    def send_as_camera(self, message: Any) -> None:
        self._vehicle.message = None  # Not the autopilot's.
        super().send_as_camera(message)

    def _tremble(self, message: Any) -> None:
        noisy = message.battery_remaining + self._rng.randint(-GAUGE_NOISE, GAUGE_NOISE)
        message.battery_remaining = min(max(noisy, 0), 100)
        if message.get_type() == 'SYS_STATUS':
            error = self._rng.uniform(-VOLTAGE_NOISE, VOLTAGE_NOISE)
            message.voltage_battery += round(1000.0 * error)


class _Nowhere:
    def write(self, data: bytes) -> None:
        pass


class Vehicle:
    """Flies; says it on a wire; hears the bridge from another wire, and the crew by its own.

    Attributes
    ----------
    flight : SimulatedFlight
        The truth.
    down, up : Wire
        To the bridge, and from it.
    foreign : SimulatedMode or None
        The mode that the vehicle was put into in flight by anyone but the bridge, if it is still
        in that mode.
    piloted : bool
        Whether a person has changed the mode, or held it, since the last take-off.
    """

    def __init__(self, grid: Grid, rng: random.Random) -> None:
        assert grid.origin is not None
        origin = SimulatedOrigin(*astuple(grid.origin))
        self.flight = SimulatedFlight(origin, BOOT_TIME, rng.randrange(1 << 30))
        self.flight.parameters.update(PARAMETERS)
        self.message: Any = None
        self.texts: list[str] = []
        self.down, self.up = Wire(rng), Wire(rng)
        self._now = 0.0
        self._bridge, self._crew = _NoisyLink(self, rng), SimulatedLink(_Nowhere())
        self._autopilot = SimulatedAutopilot(self.flight, [self._bridge, self._crew], camera=True)
        self._encoder = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.foreign: SimulatedMode | None = None
        self.piloted = False
        self._mode = self.flight.mode

    def write(self, data: bytes) -> None:
        """Send the bytes of the message at hand."""
        self.down.send(self.message, bytes(data), self._now)

    def step(self, dt: float, now: float) -> None:
        """Hear what has arrived, and fly on."""
        self._now, stood = now, not self.airborne
        for _, data in self.up.arrived(now):
            self._autopilot.receive(self._bridge, data)
            self._watch_mode(by_bridge=True)
        for _ in range(SUBSTEPS):
            self._autopilot.step(dt / SUBSTEPS)
        self._watch_mode(by_bridge=False)
        if stood and self.airborne:
            self.piloted = False

    def tell(self, number: int, *params: float) -> None:
        """Give the autopilot a command from the ground, by a radio of the crew's own."""
        params += (0.0,) * (7 - len(params))
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, *params)
        self._autopilot.receive(self._crew, message.pack(self._encoder))
        self._watch_mode(by_bridge=False)
        self.piloted = self.piloted or number == mavlink.MAV_CMD_DO_SET_MODE

    def _watch_mode(self, *, by_bridge: bool) -> None:
        flight = self.flight
        if flight.mode != self._mode:
            self._mode = flight.mode
            self.foreign = None if by_bridge or not flight.armed else flight.mode

    # The truth

    @property
    def place(self) -> tuple[float, float]:
        """East and north of the centre of cell 0 [m]."""
        position = self.flight.body.position
        return position.imag, position.real

    @property
    def airborne(self) -> bool:
        """Whether it is off the ground."""
        return not self.flight.body.on_ground

    def distance(self, grid: Grid, cell: int) -> float:
        """Distance [m] from a cell's centre."""
        return math.dist(self.place, grid.position(cell))

    def off_grid(self, grid: Grid) -> float:
        """Distance from the grid [m]."""
        east, north = self.place
        half = grid.cell_size / 2.0
        right, bottom = (grid.cols - 0.5) * grid.cell_size, (grid.rows - 0.5) * grid.cell_size
        x = max(-half - east, east - right, 0.0)
        y = max(north - half, -north - bottom, 0.0)
        return math.hypot(x, y)
