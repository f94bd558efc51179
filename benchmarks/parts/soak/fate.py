"""What happens to the chain: everything, at random times, and over some time later.

A day is storms and calms by turns. In a storm things happen; in the calm after it all is put
right, and what is wanted must get done.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from parts.soak.day import Day
from parts.soak.invariants import Violated
from parts.soak.processes import Process
from parts.soak.wires import Quality
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.simulator.modes import SimulatedMode

STORM = (300.0, 900.0)
"""Shortest and longest storm [s]."""

CALM_LIMIT = 900.0
"""Time [s] of calm within which all that is wanted is done, and the vehicle is down: a choice,
three goals with a stop for a battery and one for a repair."""

BAD_WIRE = Quality(loss=0.3, twice=0.1, noise=0.02, delay=0.4)
FAIR_WIRE = Quality(loss=0.02, twice=0.02, noise=0.002, delay=0.05)
"""The wire in bad times, and in all others."""

CARE_PERIOD = 1.0
"""Time [s] between two looks of the crew at the vehicle."""

LOW_CHARGE = 0.2
"""Charge below which the crew changes the battery wherever the vehicle stands."""

NEAR = 25.0
"""How far [m] from a cell's centre the vehicle stands in it."""


@dataclass(frozen=True)
class Happening:
    """Something that happens every so many seconds [s] of storm, on average."""

    name: str
    period: float
    begin: Callable[[], None]


class Fate:
    """Lets things happen to a day, and a crew look after the vehicle.

    Parameters
    ----------
    day : Day
    without : sequence of str
        What does not happen: beginnings of names.
    """

    def __init__(self, day: Day, without: Sequence[str] = ()) -> None:
        self.day, self.rng = day, day.rng
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._care_at = 0.0
        self._down_since: float | None = None
        self._meddling = False  # someone is flying, or has called ~/hold, and means it
        self._gives_back = False  # and calls ~/resume until it is taken
        self._patience = 10.0
        self._flicker: Callable[[], None] | None = None
        self._flicker_until = 0.0
        self.storming = False
        left_out = tuple(without) or ("-",)
        self.happenings = [h for h in self._happenings() if not h.name.startswith(left_out)]
        day.every_step = self._step
        for wire in (day.vehicle.up, day.vehicle.down):
            wire.quality = FAIR_WIRE

    def run(self, seconds: float) -> None:
        """Let a day of this length pass: storms, and the calm after each."""
        end = self.day.now + seconds
        while self.day.now < end:
            self.storm(min(self.rng.uniform(*STORM), end - self.day.now))
            self.calm()

    def storm(self, seconds: float) -> None:
        """Let things happen."""
        self.day.note('fate', 'a storm')
        self.day.counts['storms'] += 1
        self.storming = True
        strength = self.rng.uniform(0.5, 2.0)
        for happening in self.happenings:
            self._next(happening, strength, self.day.now + seconds)
        self.day.spend(seconds)
        self.storming = False

    def calm(self) -> None:
        """Put everything right; see that all that is wanted gets done, and nothing else."""
        day = self.day
        day.note('fate', 'calm')
        while self._due:
            heapq.heappop(self._due)[2]()
        self._flicker, day.threat = None, 'none'
        day.vehicle.flight.parameters['SIM_WIND_SPD'] = self.rng.uniform(0.0, 4.0)
        day.vehicle.flight.parameters['SIM_WIND_TURB'] = self.rng.uniform(0.0, 1.0)
        day.until(lambda: day.all_work, 60.0)
        wishes = day.invariants.wishes
        if not any(wishes.wanted.values()):
            self.ask()
        if not day.until(self._all_done, CALM_LIMIT):
            wanted = [name for name, wanted in wishes.wanted.items() if wanted]
            place = 'up' if day.vehicle.airborne else 'down'
            raise Violated(
                f'no goal is lost: {", ".join(wanted) or "none"} wanted, the vehicle {place} '
                f'after {CALM_LIMIT:.0f} s of calm; {day.invariants.command!r}; {day.diagnosis}'
            )
        day.spend(self.rng.uniform(5.0, 30.0))

    def _all_done(self) -> bool:
        day, grid = self.day, self.day.mission.grid
        near = min(day.vehicle.distance(grid, cell) for cell in (grid.base, grid.service))
        wanted = any(day.invariants.wishes.wanted.values())
        return not wanted and not day.vehicle.flight.armed and near < NEAR

    # Time

    def _step(self) -> None:
        now = self.day.now
        while self._due and self._due[0][0] <= now:
            heapq.heappop(self._due)[2]()
        if self._flicker is not None:
            self._flicker()
            if now > self._flicker_until:
                self._flicker, self.day.threat = None, 'none'
        if now >= self._care_at:
            self._care_at = now + CARE_PERIOD
            self._care()

    def _at(self, time: float, action: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (time, self._count, action))

    def _after(self, shortest: float, longest: float, action: Callable[[], None]) -> None:
        self._at(self.day.now + self.rng.uniform(shortest, longest), action)

    def _next(self, happening: Happening, strength: float, end: float) -> None:
        def happen() -> None:
            if not self.storming or self.day.now >= end:
                return
            self.day.note('fate', happening.name)
            self.day.counts[happening.name] += 1
            happening.begin()
            self._next(happening, strength, end)

        due = self.day.now + self.rng.expovariate(strength / happening.period)
        if due < end:
            self._at(due, happen)

    # What happens

    def _happenings(self) -> tuple[Happening, ...]:
        day = self.day
        kills = [
            Happening(f'kill of the {process.name}', period, lambda p=process: self.kill(p))
            for process, period in ((day.bridge, 100.0), (day.manager, 100.0), (day.station, 150.0))
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
            Happening('pilot takes over', 200.0, self.take_over),
            Happening('hold', 250.0, self.hold),
            Happening('reboot of the autopilot', 150.0, self.reboot),
            Happening('battery warning', 500.0, self.warn),
            Happening('weak battery', 200.0, self.drain),
            Happening('small fence', 600.0, self.fence),
            Happening('other policy', 200.0, self.replace_policy),
            Happening('clock step', 200.0, self.step_clocks),
            Happening('wrong clock', 500.0, self.err_clock),
            *kills,
        )

    def set(self, name: str, value: float) -> None:
        """Set a parameter of the simulated world."""
        self.day.vehicle.flight.parameters[name] = value

    def ask(self) -> None:
        """Ask for some goals; for none now and then."""
        k = self.day.mission.k
        if self.storming and self.rng.random() < 0.2:
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
        self._flicker_until = day.now + rng.uniform(10.0, 30.0)

        def threat() -> None:
            day.threat = rng.choice(('none', 'low', 'high'))
            day.bus.threat.publish(day.threat, day.now)

        def priorities() -> None:
            if round(day.now / 0.05) % 2:
                self.ask()

        self._flicker = rng.choice((threat, priorities))

    def outage(self, name: str, bad: float, good: float) -> None:
        """Let something fail for some seconds."""
        self.set(name, bad)
        self._after(1.0, 20.0, lambda: self.set(name, good))

    def weaken(self) -> None:
        """Let a motor give less."""
        self.set('SIM_ENGINE_MUL', self.rng.uniform(0.72, 0.8))
        self.set('SIM_ENGINE_FAIL', 1 << self.rng.randrange(4))

    def blow(self) -> None:
        """Let another wind blow."""
        self.set('SIM_WIND_SPD', self.rng.uniform(0.0, 8.0))
        self.set('SIM_WIND_DIR', self.rng.uniform(0.0, 360.0))
        self.set('SIM_WIND_TURB', self.rng.uniform(0.0, 3.0))

    def gale(self) -> None:
        """Let a wind blow that the vehicle cannot fly against."""
        self.set('SIM_WIND_SPD', self.rng.uniform(14.0, 20.0))
        self.set('SIM_WIND_TURB', 5.0)
        self._after(10.0, 60.0, self.blow)

    def cut(self) -> None:
        """Cut the link, one way or both."""
        wires = self.day.vehicle.up, self.day.vehicle.down
        chosen = self.rng.choice((wires, wires, wires[:1], wires[1:]))

        def mend() -> None:
            for wire in wires:
                wire.cut = False

        for wire in chosen:
            wire.cut = True
        self._after(0.5, 30.0, mend)

    def spoil(self) -> None:
        """Make the link bad."""
        wires = self.day.vehicle.up, self.day.vehicle.down

        def mend() -> None:
            for wire in wires:
                wire.quality = FAIR_WIRE

        for wire in wires:
            wire.quality = BAD_WIRE
        self._after(5.0, 40.0, mend)

    def stall(self) -> None:
        """Let a process stand still."""
        process = self.rng.choice(self.day.processes)
        process.stalled_until = self.day.now + self.rng.uniform(0.2, 20.0)

    def take_over(self) -> None:
        """Let a pilot change the mode in flight, and give command back later."""
        if not self.day.vehicle.airborne or self._meddling:
            return
        modes = (SimulatedMode.LOITER, SimulatedMode.BRAKE, SimulatedMode.RTL, SimulatedMode.LAND)
        self._put_into(self.rng.choice(modes))
        self._meddling = True

        def give_back() -> None:
            if self.rng.random() < 0.3 and self.day.vehicle.flight.armed:
                self._put_into(SimulatedMode.GUIDED)
            self._gives_back = True

        self._after(0.5, 60.0, give_back)

    def _put_into(self, mode: SimulatedMode) -> None:
        self.day.note('people', f'{mode.name}')
        self.day.vehicle.tell(mavlink.MAV_CMD_DO_SET_MODE, 1, mode)

    def hold(self) -> None:
        """Let someone call ~/hold, and ~/resume later."""
        if self._meddling:
            return
        self._meddling = True

        self.day.hold()
        self._after(1.0, 60.0, self._give_back)

    def reboot(self) -> None:
        """Reboot the autopilot, if it stands on the ground."""
        if not self.day.vehicle.flight.armed:
            self.day.vehicle.tell(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
            self.day.invariants.rebooted()

    def warn(self) -> None:
        """Let the battery's voltage sag until someone changes the battery."""
        self.set('SIM_BATT_VOLTAGE', 10.3)

    def drain(self) -> None:
        """Let the battery have less than it seemed."""
        battery = self.day.vehicle.flight.body.battery
        battery.charge = max(battery.charge - self.rng.uniform(0.05, 0.4), min(battery.charge, 0.2))

    def fence(self) -> None:
        """Draw the fence so narrow that not all goals are inside."""
        self.set('FENCE_RADIUS', self.rng.uniform(70.0, 150.0))
        self._after(20.0, 90.0, lambda: self.set('FENCE_RADIUS', 300.0))

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

        self._after(2.0, 40.0, mend)

    def kill(self, process: Process) -> None:
        """Kill a process, between its steps or within one; it is started again."""
        if not process.up:
            return
        self.day.kill(process, self.rng.choice(('', 'before memory', 'after memory', 'sending')))

        def start() -> None:
            if process.dies_at:  # It has not come so far.
                self.day.kill(process)
            if not process.up:
                self.day.note(process.name, 'started')
                process.start(self.day.now)

        self._after(0.5, 20.0 if self.rng.random() < 0.3 else 3.0, start)

    # The crew

    def _care(self) -> None:
        """Look after the vehicle, as people do."""
        day, flight = self.day, self.day.vehicle.flight
        if self._gives_back and day.resume():  # Until someone answers.
            self._meddling = self._gives_back = False
        if flight.armed or day.vehicle.airborne:
            self._down_since = None
            if not self._meddling and day.phase == 'pilot in command':
                self._resume_later()
            return
        if self._down_since is None:
            self._down_since = day.now
            self._patience = self.rng.uniform(3.0, 15.0)
        self._mend()
        if day.now - self._down_since < self._patience:
            return
        if not self._meddling and day.phase in ('pilot in command', 'holding'):
            day.resume()
            self._down_since = None

    def _resume_later(self) -> None:
        """In the air: give command back some seconds after an own failsafe of the autopilot."""
        self._meddling = True

        self._after(1.0, 20.0, self._give_back)

    def _give_back(self) -> None:
        self._gives_back = True

    def _mend(self) -> None:
        """Change the battery, mend motors and camera, ask again for what was out of reach."""
        day, flight, grid = self.day, self.day.vehicle.flight, self.day.mission.grid
        at_service = day.vehicle.distance(grid, grid.service) < NEAR
        low = flight.body.battery.charge < LOW_CHARGE or flight.parameters['SIM_BATT_VOLTAGE']
        if low or (at_service and flight.body.battery.charge < 0.9):
            self.set('SIM_BATT_VOLTAGE', 0.0)
            flight.set_charge(self.rng.uniform(85.0, 100.0))
            day.counts['batteries changed'] += 1
        if at_service and day.invariants.command == 'repair':
            day.counts['repairs'] += flight.parameters['SIM_ENGINE_FAIL'] > 0
            self.set('SIM_ENGINE_FAIL', 0)
            self.set('SIM_CAM_FAIL', 0)
        wishes = day.invariants.wishes
        if any(wishes.wanted[name] for name in day.refused_goals) and not self.storming:
            day.ask(*(int(wishes.wanted[name]) for name in wishes.names))
