"""Everything that may happen to the chain, and for how long."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from parts.soak.agenda import Agenda
from parts.soak.crew import Crew
from parts.soak.day import STEP, Day
from parts.soak.processes import Process
from parts.soak.wires import Quality

BAD_WIRE = Quality(loss=0.3, twice=0.1, noise=0.02, delay=0.4)
FAIR_WIRE = Quality(loss=0.02, twice=0.02, noise=0.002, delay=0.05)
"""The wire in bad times, and in all others."""

BREEZE = 8.0
"""Strongest wind [m/s] that is no gale."""

FENCE_RADIUS = 300.0
"""Radius [m] of the fence: ArduCopter's default, with the whole grid inside."""

DYING_PLACES = ('', 'before memory', 'after memory', 'sending')
"""Where a process dies: between its steps, or within one."""

DAMAGE_SHARE = 0.03
"""Share of the starts before which the journal is damaged; not the base station's, for it knows
nothing then until a person asks."""


@dataclass(frozen=True)
class Happening:
    """Something that happens every so many seconds [s] of storm, on average."""

    name: str
    period: float
    begin: Callable[[], None]


class Mischief:
    """Lets things happen."""

    def __init__(self, day: Day, agenda: Agenda, crew: Crew) -> None:
        self.day, self._agenda, self._crew, self.rng = day, agenda, crew, day.rng
        self.flickers: Callable[[], None] | None = None
        self._flickers_until = 0.0
        for wire in day.wires:
            wire.quality = FAIR_WIRE

    def happenings(self) -> tuple[Happening, ...]:
        """Return all that may happen."""
        day, crew = self.day, self._crew
        kills = [
            Happening(f'kill of the {process.name}', period, lambda p=process: self.kill(p))
            for process, period in (
                (day.bridge, 100.0),
                (day.manager, 100.0),
                (day.station, 150.0),
            )
        ]
        return (
            Happening('request', 60.0, self.ask),
            Happening('threat', 70.0, self.threaten),
            Happening('flicker', 400.0, self.flicker),
            Happening('GPS outage', 200.0, lambda: self.outage('SIM_GPS1_ENABLE', 0, 1)),
            Happening('compass outage', 250.0, lambda: self.outage('SIM_MAG1_FAIL', 1, 0)),
            Happening('barometer outage', 300.0, lambda: self.outage('SIM_BARO_DISABLE', 1, 0)),
            Happening('camera failure', 600.0, lambda: self.set('SIM_CAM_FAIL', 1)),
            Happening('motor failure', 500.0, self.weaken),
            Happening('radio outage', 500.0, lambda: self.outage('SIM_RC_FAIL', 1, 0)),
            Happening('other wind', 120.0, self.blow),
            Happening('gale', 900.0, self.gale),
            Happening('cut link', 150.0, self.cut),
            Happening('bad wire', 150.0, self.spoil),
            Happening('standstill', 200.0, self.stall),
            Happening('pilot takes over', 200.0, crew.take_over),
            Happening('hold', 250.0, crew.hold),
            Happening('reboot of the autopilot', 150.0, crew.reboot),
            Happening('battery warning', 500.0, self.warn),
            Happening('weak battery', 200.0, self.drain),
            Happening('small fence', 600.0, self.fence),
            Happening('other policy', 200.0, self.replace_policy),
            Happening('clock step', 200.0, self.step_clocks),
            Happening('wrong clock', 500.0, self.err_clock),
            Happening('computer off and on', 600.0, self.switch_off),
            *kills,
        )

    def set(self, name: str, value: float) -> None:
        """Set a parameter of the simulated world."""
        self.day.vehicle.flight.parameters[name] = value

    def ask(self) -> None:
        """Ask for some goals; for none now and then."""
        k = self.day.mission.k
        if self.rng.random() < 0.2:
            self.day.ask(*[0] * k)
            return
        priorities = [self.rng.choice((0, 1, 2)) for _ in range(k)]
        self.day.ask(*(priorities if any(priorities) else [1] * k))

    def threaten(self) -> None:
        """Let a threat appear, grow, go."""
        self.day.threat = self.rng.choice(('none', 'none', 'low', 'high'))

    def flicker(self) -> None:
        """Let an input change ten times a second."""
        day, rng = self.day, self.rng
        self._flickers_until = day.now + rng.uniform(10.0, 30.0)

        def threat() -> None:
            day.threat = rng.choice(('none', 'low', 'high'))
            day.bus.threat.publish(day.threat, day.now)

        def priorities() -> None:
            if round(day.now / STEP) % 2:
                self.ask()

        self.flickers = rng.choice((threat, priorities))

    def outage(self, name: str, bad: float, good: float) -> None:
        """Let something fail for some seconds."""
        self.set(name, bad)
        self._agenda.after(1.0, 20.0, lambda: self.set(name, good))

    def weaken(self) -> None:
        """Let a motor give less, but not in a gale: nobody could hold the vehicle up."""
        if self._gale:
            return
        self.set('SIM_ENGINE_MUL', self.rng.uniform(0.72, 0.8))
        self.set('SIM_ENGINE_FAIL', 1 << self.rng.randrange(4))

    def blow(self) -> None:
        """Let another wind blow."""
        self.set('SIM_WIND_SPD', self.rng.uniform(0.0, BREEZE))
        self.set('SIM_WIND_DIR', self.rng.uniform(0.0, 360.0))
        self.set('SIM_WIND_TURB', self.rng.uniform(0.0, 3.0))

    def gale(self) -> None:
        """Let a wind blow that the vehicle cannot fly against, if all motors are well."""
        if self.day.vehicle.flight.parameters['SIM_ENGINE_FAIL']:
            return
        self.set('SIM_WIND_SPD', self.rng.uniform(14.0, 20.0))
        self.set('SIM_WIND_TURB', 5.0)
        self._agenda.after(10.0, 60.0, self.blow)

    @property
    def _gale(self) -> bool:
        return self.day.vehicle.flight.parameters['SIM_WIND_SPD'] > BREEZE

    def cut(self) -> None:
        """Cut the link, one way or both."""
        wires = self.day.wires
        chosen = self.rng.choice((wires, wires, wires[:1], wires[1:]))

        def mend() -> None:
            for wire in wires:
                wire.cut = False

        for wire in chosen:
            wire.cut = True
        self._agenda.after(0.5, 30.0, mend)

    def spoil(self) -> None:
        """Make the link bad."""
        wires = self.day.wires

        def mend() -> None:
            for wire in wires:
                wire.quality = FAIR_WIRE

        for wire in wires:
            wire.quality = BAD_WIRE
        self._agenda.after(5.0, 40.0, mend)

    def stall(self) -> None:
        """Let a process stand still."""
        process = self.rng.choice(self.day.processes)
        process.stalled_until = self.day.now + self.rng.uniform(0.2, 20.0)

    def warn(self) -> None:
        """Let the battery's voltage sag until someone changes the battery."""
        self.set('SIM_BATT_VOLTAGE', 10.3)

    def drain(self) -> None:
        """Let the battery have less than it seemed."""
        battery = self.day.vehicle.flight.body.battery
        battery.charge = max(
            battery.charge - self.rng.uniform(0.05, 0.4), min(battery.charge, 0.2)
        )

    def fence(self) -> None:
        """Draw the fence so narrow that not all goals are inside."""
        self.set('FENCE_RADIUS', self.rng.uniform(70.0, 150.0))
        self._agenda.after(20.0, 90.0, lambda: self.set('FENCE_RADIUS', FENCE_RADIUS))

    def replace_policy(self) -> None:
        """Announce the other policy set, or the first again."""
        self.day.bus.policy.publish(self.rng.randrange(2), self.day.now)

    def step_clocks(self) -> None:
        """Step the computer's clock, by hours."""
        step = self.rng.uniform(-4.0, 4.0) * 3600.0
        for process in self.day.processes:
            process.wall_error += step

    def err_clock(self) -> None:
        """Let one computer's clock be wrong for a while."""
        process = self.rng.choice((self.day.bridge, self.day.manager))
        error = self.rng.choice((-1.0, 1.0)) * self.rng.uniform(1.0, 3600.0)
        process.wall_error += error

        def mend() -> None:
            process.wall_error -= error

        self._agenda.after(2.0, 40.0, mend)

    def kill(self, process: Process) -> None:
        """Kill a process, between its steps or within one; it is started again."""
        if not process.up:
            return
        self.day.kill(process, self.rng.choice(DYING_PLACES))

        self._agenda.after(0.5, self.rng.choice((3.0, 3.0, 20.0)), lambda: self._start(process))

    def _start(self, process: Process) -> None:
        """Start it; once in a while its journal has been damaged meanwhile."""
        died = not process.up
        if died and process is not self.day.station and self.rng.random() < DAMAGE_SHARE:
            process.damage()
        self.day.start(process)

    def switch_off(self) -> None:
        """Switch the computer off and on."""
        for process in self.day.processes:
            self.day.kill(process)
            start = partial(self.day.start, process, computer_too=True)
            self._agenda.after(5.0, 20.0, start)

    def flicker_on(self) -> None:
        """Go on with what flickers."""
        if self.flickers is not None:
            self.flickers()
            if self.day.now > self._flickers_until:
                self.still()

    def still(self) -> None:
        """End it."""
        self.flickers, self.day.threat = None, 'none'
