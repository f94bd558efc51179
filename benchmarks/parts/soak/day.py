"""A day of the chain: all processes and the vehicle, stepped together."""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from parts.soak.chain import BridgeProcess, ManagerProcess, Record, StationProcess
from parts.soak.invariants import Invariants
from parts.soak.processes import Bus, Process
from parts.soak.vehicle import Vehicle
from parts.soak.wires import Wire
from parts.soak.work import Program
from uav_mission_manager.autopilot.bridge import WARNING_PHASES
from uav_mission_manager.policy import Policy

STEP = 0.05
"""Time [s] of a step: the bridge's."""

KEPT_LINES = 60
"""Lines of the log that are kept, to be shown with a failure."""

SAID_STEPS = 40
"""Steps for which it is remembered what the bridge has said: two seconds."""

NOT_TAKEN = 'no heartbeat', 'not heard yet'
"""Answers of ~/resume that change nothing; of all others something is told that is true now."""

WINDY = 6.0
"""Wind [m/s] from which the way home may be long: a choice."""


class Day:
    """Base station, manager, bridge and vehicle, with what is noted of them.

    Parameters
    ----------
    policies : sequence of Policy
        Of one mission's goals and grid; the first is flown, until another one is announced.
    folder : Path
        Where the journals go.
    seed : int
    record : callable, optional
        Takes what the manager says and decides on.
    """

    def __init__(
        self, policies: Sequence[Policy], folder: Path, seed: int, record: Record | None = None
    ) -> None:
        self.rng = random.Random(seed)
        self.mission = mission = policies[0].mission
        self.now = 0.0
        self.counts: Counter[str] = Counter()
        self.log: deque[str] = deque(maxlen=KEPT_LINES)
        self.vehicle = Vehicle(mission.grid, self.rng)
        self.bus = Bus(self.rng)
        common = mission, self.bus, self, folder, self.rng
        self.bridge = BridgeProcess(self.vehicle, *common)
        self.manager = ManagerProcess(policies, *common)
        self.manager.record = record
        self.station = StationProcess(*common)
        self.processes: tuple[Process, ...] = (self.bridge, self.manager, self.station)
        self.threat = 'none'
        self.refused_goals: set[str] = set()
        self.vehicle_texts: list[str] = []
        self.said: deque[str] = deque(maxlen=SAID_STEPS)
        self.invariants = Invariants(self)
        self.program = Program(self)
        self.every_step: Callable[[], None] = lambda: None
        self._threat_at = 0.0
        self._dead: set[Process] = set()
        for process in self.processes:
            process.start(0.0)

    def step(self) -> None:
        """Let a step pass for everybody."""
        self.now = round(self.now + STEP, 9)
        self.vehicle.step(STEP, self.now)
        self.vehicle_texts, self.vehicle.texts = self.vehicle.texts, []
        for text in self.vehicle_texts:
            self.note('vehicle', text)
        if self.now >= self._threat_at:
            self._threat_at = self.now + 0.5
            self.bus.threat.publish(self.threat, self.now)
        for process in self.processes:
            process.step(self.now)
            self._notice_death(process)
        if self.bridge.works:
            self.said.append(self.diagnosis)
        self.program.step()
        self.every_step()
        self.invariants.check(STEP)

    def spend(self, seconds: float) -> None:
        """Let time pass."""
        end = self.now + seconds
        while self.now < end:
            self.step()

    def until(self, condition: Callable[[], Any], limit: float) -> bool:
        """Let time pass until something is true; return whether it is."""
        end = self.now + limit
        while not condition():
            if self.now >= end:
                return False
            self.step()
        return True

    # What people do

    def ask(self, *priorities: int) -> None:
        """Set the base station's priorities, if there is one."""
        if self.station.up:
            self.note('people', f'ask for {priorities}')
            self.counts['requests'] += 1
            self.refused_goals.clear()
            self.station.ask(priorities)
            self.invariants.asked(priorities)

    def hold(self) -> None:
        """Call ~/hold, if there is a bridge to answer."""
        if self.bridge.works:
            done, text = self.bridge.hold()
            self.note('people', f'~/hold: {text}')
            self.invariants.held(done or 'holds when' in text)
            self._notice_death(self.bridge)

    def resume(self) -> bool:
        """Call ~/resume; return whether it was taken."""
        if not self.bridge.works:
            return False
        before = self.invariants.resumed()
        done, text = self.bridge.resume()
        self.note('people', f'~/resume: {text}')
        if self._notice_death(self.bridge):  # Nobody knows whether it was taken.
            return False
        taken = done or not any(why in text for why in NOT_TAKEN)
        if not taken:
            self.invariants.not_resumed(before)
        return taken

    def kill(self, process: Process, where: str = '') -> None:
        """Let a process die now, or somewhere in its next step."""
        if where:
            process.dies_at = where
            return
        if process.up:
            process.kill()
        self._notice_death(process)

    def start(self, process: Process, *, computer_too: bool = False) -> None:
        """Start a process that is dead, or about to die."""
        if process.dies_at:
            self.kill(process)
        if process.up:
            return
        self._dead.discard(process)
        self.note(process.name, 'started')
        process.start(self.now, computer_too=computer_too)
        self.counts['journals not believed'] += bool(process.doubt)
        if process is self.bridge:
            self.invariants.bridge_started(process.doubt)

    def _notice_death(self, process: Process) -> bool:
        """Take note of it if a process has died just now."""
        if process.up or process in self._dead:
            return False
        self._dead.add(process)
        self.counts[f'kills of the {process.name}'] += 1
        self.note(process.name, 'killed')
        if process is self.bridge:
            self.invariants.bridge_died()
        if process is self.manager:
            self.invariants.manager_died()
        return True

    # What is noted

    def note(self, who: str, text: str) -> None:
        """Add a line to the log."""
        self.log.append(f'{self.now:10.2f} {who:8} {text}')
        if who == 'bridge':
            self.said.append(text)

    def heard(self, message: Any) -> None:
        """See `Watch`."""
        self.invariants.heard(message)

    def sent(self, message: Any) -> None:
        """See `Watch`."""
        self.invariants.sent(message)

    def commanded(self, text: str) -> None:
        """See `Watch`."""
        self.counts['changed commands'] += text != self.invariants.command
        self.invariants.commanded(text)

    def completed(self, goal: str) -> None:
        """See `Watch`."""
        self.note('bridge', f'{goal} completed')
        self.counts['goals completed'] += 1
        reads = self.manager, self.station
        heard = any(process.up for process in reads)
        self.counts['completions that nobody heard'] += not heard
        self.invariants.completed(goal, heard)

    def refused(self, goal: str) -> None:
        """See `Watch`."""
        self.note('bridge', f'{goal} refused')
        self.counts['goals refused'] += 1
        self.refused_goals.add(goal)

    # What can be seen

    @property
    def phase(self) -> str:
        """What the bridge says it is doing."""
        return self.bridge.core.output.phase.value if self.bridge.up else ''

    @property
    def diagnosis(self) -> str:
        """What the bridge's diagnostics say."""
        output, warnings = self.bridge.core.output, self.bridge.core.warnings
        return '; '.join((f'{output.phase.value}: {output.status}', *warnings))

    @property
    def wires(self) -> tuple[Wire, Wire]:
        """The wires between bridge and vehicle."""
        return self.vehicle.up, self.vehicle.down

    @property
    def all_work(self) -> bool:
        """Whether all processes do their work."""
        return all(process.works for process in self.processes)

    @property
    def told(self) -> bool:
        """Whether the manager hears from the vehicle."""
        return not (any(wire.cut for wire in self.wires) or self.manager.problem)

    @property
    def troubled(self) -> bool:
        """Whether something keeps the vehicle from flying as commanded."""
        waits = self.bridge.up and self.bridge.core.output.phase in WARNING_PHASES
        windy = abs(self.vehicle.flight.wind) > WINDY
        return waits or windy or not (self.told and self.all_work) or self.threat != 'none'
