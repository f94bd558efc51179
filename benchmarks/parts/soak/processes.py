"""The processes: the cores that the nodes are made of, their journals, and how they die.

What the nodes add to their cores is here as thin as there: topics, stamps, the time in which a
node only listens. A process has a clock of its own for time-outs, which begins anywhere, and one
for stamps, which may be wrong.
"""

from __future__ import annotations

import math
import random
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from parts.soak.vehicle import Vehicle
from parts.soak.wires import Topic
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from uav_mission_manager.autopilot.bridge import BridgeStep, VehicleBridge
from uav_mission_manager.autopilot.faults import FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import Settings
from uav_mission_manager.mdp import FAULT_MODES, Mission
from uav_mission_manager.nodes.flight_plan import FlightPlan
from uav_mission_manager.onboard import (
    InputError,
    ManagerSettings,
    MissionManager,
    Refusal,
    format_command,
    parse_command,
)
from uav_mission_manager.onboard.journal import Journal, goals_hash
from uav_mission_manager.onboard.priority_request import PriorityRequest
from uav_mission_manager.onboard.stamps import stamp_age
from uav_mission_manager.policy import Policy

SETTINGS = Settings(
    goal_dwell=1.0,
    service_time=3.0,
    manager_timeout=3.0,
    rtl_delay=10.0,
    reach=450.0,
    allow_arming=True,
)
"""Of the bridge: shorter times than the nodes' defaults, that more happens in an hour."""

LISTENING_TIME = 3.0
"""Time [s] in which a process that has started only listens: the nodes' default."""

REPEAT_PERIOD, FAULT_REPEAT_PERIOD, DECISION_PERIOD = 1.0, 0.5, 0.25
"""Time [s] between two messages that say the same: the nodes'; and between two decisions where
nothing but position and charge is new, which the nodes take with each message: less work."""

SOCKET_BUFFER = 400
"""Datagrams that wait for a process that stands still, at most: a choice, near Linux' default."""

REBOOT_SHARE = 0.1
"""Share of the starts with which the computer starts too, and the clock for time-outs anew."""

INPUT_TIMEOUT = ManagerSettings().input_timeout
"""Age [s] of a stamp above which a message is refused."""

MAX_CLOCK = 1e6
"""Latest beginning [s] of a process' clock for time-outs."""


class Killed(BaseException):  # noqa: N818 - as KeyboardInterrupt: nobody in between shall catch it
    """The process has died in the middle of what it did."""


class Watch(Protocol):
    """What is told to those who watch the chain from outside."""

    counts: Counter[str]

    def heard(self, message: Any) -> None:
        """The bridge has read a message of the autopilot."""

    def sent(self, message: Any) -> None:
        """The bridge has sent a message."""

    def commanded(self, text: str) -> None:
        """The manager has published a command."""

    def completed(self, goal: str) -> None:
        """The bridge has published that a goal is completed."""

    def refused(self, goal: str) -> None:
        """The bridge has published that a goal is out of reach."""

    def note(self, who: str, text: str) -> None:
        """Someone has something to tell."""


class Bus:
    """All topics."""

    def __init__(self, rng: random.Random) -> None:
        def lossy() -> Topic:
            return Topic(rng, 0.02)

        def event() -> Topic:
            return Topic(rng, 0.02, depth=10)

        def latched() -> Topic:
            return Topic(rng, depth=1, latched=True)

        self.battery, self.odom, self.fault, self.threat = lossy(), lossy(), lossy(), lossy()
        self.priorities = Topic(rng, 0.02, depth=1)
        self.completed, self.refused, self.to_station = event(), event(), event()
        self.command, self.goals, self.policy = latched(), latched(), latched()


class Process:
    """One process; it is `up` from `start` until `kill`.

    Attributes
    ----------
    stalled_until, worked_at : float
        Time [s] until which it stands still, and of its last step.
    wall_error : float
        How far [s] its clock for stamps is ahead.
    dies_at : str
        Where in its next step it dies: 'before memory', 'after memory', 'sending' or ''.
    forgetful : bool
        Whether it does not believe its journal: a fault to show that it would be noticed.
    """

    name = ''
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()

    def __init__(
        self, mission: Mission, bus: Bus, watch: Watch, folder: Path, rng: random.Random
    ) -> None:
        self.mission, self._mission_hash = mission, goals_hash(mission)
        self.bus, self.watch, self.folder, self.rng = bus, watch, folder, rng
        self.up, self.forgetful, self.dies_at = False, False, ''
        self.stalled_until = self.wall_error = 0.0
        self.started_at = self.worked_at = 0.0
        self.starts = 0
        self._epoch = 0.0
        self.now = 0.0

    def start(self, now: float) -> None:
        """Begin as a new process does: with the journal, and nothing else."""
        self.now = self.started_at = self.worked_at = now
        if self.starts == 0 or self.rng.random() < REBOOT_SHARE:
            self._epoch = self.rng.uniform(0.0, MAX_CLOCK) - now
        for topic in self.reads:
            getattr(self.bus, topic).reader_starts(now)
        self.begin()
        self.up, self.dies_at, self.stalled_until = True, '', 0.0
        self.starts += 1

    def kill(self) -> None:
        """Die without a word."""
        self.up, self.dies_at = False, ''
        for topic in self.writes:
            getattr(self.bus, topic).writer_dies()
        self.end()

    def step(self, now: float) -> None:
        """Go on to `now`, or die on the way."""
        self.now = now
        if not self.up or now < self.stalled_until:
            return
        try:
            self.work()
            self.worked_at = now
            if self.dies_at:
                raise Killed
        except Killed:
            self.kill()

    @property
    def clock(self) -> float:
        """The time [s] for time-outs."""
        return self.now + self._epoch

    @property
    def wall(self) -> float:
        """The time [s] for stamps."""
        return self.now + 1e9 + self.wall_error

    @property
    def works(self) -> bool:
        """Whether it does its work, and not only listens."""
        settled = self.now - self.started_at >= LISTENING_TIME
        return self.up and settled and self.now >= self.stalled_until

    def begin(self) -> None:
        """Make the core anew."""

    def end(self) -> None:
        """Let the files go, as the end of a process does."""
        self.journal.close()

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Record the core's state, before anything follows from it."""
        self.die('before memory')
        self.journal.write(memory)
        self.die('after memory')
        if self.journal.error:
            raise OSError(self.journal.error)

    def recall(self) -> Mapping[str, Any] | None:
        """Open the journal, and return what it says; None on the first start."""
        path = self.folder / f'{self.name}.journal'
        self.journal = Journal(path, self.name, self._mission_hash)
        record = self.journal.read()
        return None if record is None or self.forgetful else record.state

    def work(self) -> None:
        """Do what is due."""

    def die(self, where: str) -> None:
        """Die here, if this is where."""
        if self.dies_at == where:
            raise Killed


class _Port:
    """The bridge's end of the wire."""

    def __init__(self, bridge: BridgeProcess) -> None:
        self._bridge = bridge
        self.waiting: deque[tuple[Any, bytes]] = deque()
        self._parser = mavlink.MAVLink(None)

    def recv(self, size: int) -> bytes:
        if not self.waiting:
            return b''
        message, data = self.waiting.popleft()
        if message is not None:
            self._bridge.watch.heard(message)
        return data

    def write(self, data: bytes) -> None:
        self._bridge.die('sending')
        for message in self._parser.parse_buffer(data) or []:
            self._bridge.watch.sent(message)
        self._bridge.vehicle.up.send(None, data, self._bridge.now)

    def close(self) -> None:
        pass


class BridgeProcess(Process):
    """The MAVLink bridge."""

    name = 'bridge'
    reads = 'command', 'goals'
    writes = ()

    def __init__(self, vehicle: Vehicle, *process: Any) -> None:
        super().__init__(*process)
        self.vehicle = vehicle
        self._plan = FlightPlan(self.mission, SETTINGS.flight_altitude)

    def begin(self) -> None:
        self.port = _Port(self)
        link = AutopilotLink(self.port, source_system=245)
        self.core = VehicleBridge(link, Pilot(SETTINGS, self._plan.ground), FaultEstimator())
        if memory := self.recall():
            self.core.restore(memory)
        self.core.remember = self.remember
        self._goals_at = self._fault_at = -math.inf
        self._fault: Any = None

    def step(self, now: float) -> None:
        for datagram in self.vehicle.down.arrived(now):
            if self.up and len(self.port.waiting) < SOCKET_BUFFER:
                self.port.waiting.append(datagram)
        super().step(now)

    def hold(self) -> tuple[bool, str]:
        """Call ~/hold."""
        return self.core.hold(self.clock)

    def resume(self) -> tuple[bool, str]:
        """Call ~/resume."""
        return self.core.resume(self.clock)

    def work(self) -> None:
        if not self.works:
            self.core.link.poll(self.clock)  # and drop it: it will be out of date
            return
        self._obey()
        step = self.core.step(self.clock)
        for warning, text in step.log:
            if warning:
                self.watch.note('bridge', text)
        self._publish(step)

    def _obey(self) -> None:
        for values in self.bus.goals.take(self.now):
            self.core.pilot.goals_wanted, self._goals_at = any(values), self.clock
        if self.clock - self._goals_at > SETTINGS.manager_timeout:
            self.core.pilot.goals_wanted = None
        for stamp, text in self.bus.command.take(self.now):
            try:
                stamp_age('mission_command', stamp, self.wall, SETTINGS.manager_timeout)
            except InputError:
                self.watch.counts['refused: mission_command'] += 1
                continue
            task = self._plan.task(parse_command(self.mission, text), text)
            self.core.pilot.command(task, self.clock)

    def _publish(self, step: BridgeStep) -> None:
        bus, now = self.bus, self.now
        if step.pilot.completed:
            self.watch.completed(step.pilot.completed)
            bus.completed.publish(step.pilot.completed, now)
            bus.to_station.publish(step.pilot.completed, now)
        if step.pilot.refused:
            goals = [goal.name for goal in self.mission.goals]
            for goal in goals if step.pilot.losing_ground else [step.pilot.refused]:
                self.watch.refused(goal)
                bus.refused.publish(goal, now)
        if step.battery:
            bus.battery.publish((self.wall, step.battery), now)
        if step.position:
            position = step.position
            place = self._plan.origin.to_local(position.latitude, position.longitude)
            bus.odom.publish((self.wall, *place), now)
        if step.fault is not None and (
            step.fault != self._fault or self.clock - self._fault_at >= FAULT_REPEAT_PERIOD
        ):
            self._fault, self._fault_at = step.fault, self.clock
            bus.fault.publish(FAULT_MODES[step.fault], now)


class ManagerProcess(Process):
    """The mission manager."""

    name = 'manager'
    reads = 'battery', 'odom', 'fault', 'threat', 'priorities', 'completed', 'refused', 'policy'
    writes = 'command', 'goals'

    def __init__(self, policies: Sequence[Policy], *process: Any) -> None:
        super().__init__(*process)
        self._policies = policies

    def begin(self) -> None:
        memory = self.recall() or {'policy': 0, 'core': None}
        self._policy = memory['policy']
        self.core = MissionManager(
            self._policies[self._policy], ManagerSettings(), memory['core']
        )
        self._decide_at = self._repeat_at = -math.inf
        self._command, self._goals = '', ()
        self.problem = ''

    def work(self) -> None:
        news = self._hear()
        if not self.works or not (news or self.clock >= self._decide_at):
            return
        self._decide_at = self.clock + DECISION_PERIOD
        outcome = self.core.step(self.clock)
        self.remember({'policy': self._policy, 'core': self.core.memory})
        repeat = self.clock >= self._repeat_at
        if repeat:
            self._repeat_at = self.clock + REPEAT_PERIOD
        goals = self.core.situation.priorities
        if repeat or goals != self._goals:
            self._goals = goals
            self.bus.goals.publish(goals, self.now)
        self.die('sending')
        self._command_as(outcome, repeat)

    def _command_as(self, outcome: Any, repeat: bool) -> None:
        refused = outcome.reason if isinstance(outcome, Refusal) else ''
        if refused and refused.partition(':')[0] != self.problem.partition(':')[0]:
            self.watch.note('manager', refused)
        self.problem = refused
        if refused:
            self._command = ''
            return
        command = format_command(self.mission, outcome.action)
        if command != self._command or repeat:
            if command != self._command:
                self.watch.note('manager', f'{command}: {outcome.reason}')
            self._command = command
            self.watch.commanded(command)
            self.bus.command.publish((self.wall, command), self.now)

    def _hear(self) -> bool:
        """Take what has arrived; return whether anything but charge and position has."""
        bus, now, clock = self.bus, self.now, self.clock
        for stamp, b in bus.battery.take(now):
            flow = {'voltage': b.voltage, 'current': -b.current}
            self._take(
                lambda s, b=b, flow=flow: s.with_battery(b.charge, clock, b.healthy, **flow),
                'battery_state',
                stamp,
            )
        for stamp, east, north in bus.odom.take(now):
            self._take(lambda s, e=east, n=north: s.with_position(e, n, clock), 'odom', stamp)
        news = [
            *((lambda s, m=m: s.with_fault(m, clock)) for m in bus.fault.take(now)),
            *((lambda s, m=m: s.with_threat(m, clock)) for m in bus.threat.take(now)),
            *((lambda s, m=m: s.with_priorities(*m, clock)) for m in bus.priorities.take(now)),
            *((lambda s, m=m: s.with_completed(m)) for m in bus.completed.take(now)),
            *((lambda s, m=m: s.with_refused(m)) for m in bus.refused.take(now)),
        ]
        for change in news:
            self._take(change)
        for number in bus.policy.take(now):
            self.core.adopt(self._policies[number])
            self._policy = number
        return bool(news)

    def _take(self, change: Any, topic: str = '', stamp: float | None = None) -> None:
        try:
            stamp_age(topic, stamp, self.wall, INPUT_TIMEOUT)
            for warning in self.core.take(change):
                self.watch.note('manager', warning)
        except InputError as error:
            self.watch.counts[f'refused: {topic}'] += 1
            self.watch.note('manager', str(error))


class StationProcess(Process):
    """The base station."""

    name = 'station'
    reads = ('to_station',)

    def begin(self) -> None:
        goals = [goal.name for goal in self.mission.goals]
        self.core = PriorityRequest(goals, self.recall())
        self._repeat_at = -math.inf

    def ask(self, priorities: Sequence[int]) -> None:
        """Set the parameter `priorities`."""
        self.core.ask(priorities, f'{self.rng.randrange(1 << 32):08x}')
        self.journal.write(self.core.memory)
        self._repeat_at = -math.inf

    def work(self) -> None:
        for goal in self.bus.to_station.take(self.now):
            self.core.complete(goal)
        self.remember(self.core.memory)
        self.die('sending')
        if self.core.request and self.works and self.clock >= self._repeat_at:
            self._repeat_at = self.clock + REPEAT_PERIOD
            self.bus.priorities.publish((self.core.priorities, self.core.request), self.now)
