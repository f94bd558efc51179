"""The three processes: the cores that the nodes are made of.

What the nodes add to their cores is here as thin as there: topics, stamps, what is repeated.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from parts.soak.processes import LISTENING_TIME, Killed, Process
from parts.soak.vehicle import Vehicle
from uav_mission_manager.autopilot.bridge import BridgeStep, VehicleBridge
from uav_mission_manager.autopilot.faults import FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.task import Settings
from uav_mission_manager.mdp import FAULT_MODES
from uav_mission_manager.nodes.flight_plan import FlightPlan
from uav_mission_manager.onboard import (
    InputError,
    ManagerSettings,
    MissionManager,
    Refusal,
    format_command,
    parse_command,
)
from uav_mission_manager.onboard.heard_input import HeardInput
from uav_mission_manager.onboard.priority_request import REQUEST_TIME, PriorityRequest
from uav_mission_manager.onboard.stamps import stamp_age
from uav_mission_manager.onboard.trace import TraceWriter
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

MANAGER_SETTINGS = ManagerSettings()
"""Of the manager: the nodes' defaults."""

REPEAT_PERIOD, FAULT_REPEAT_PERIOD, DECISION_PERIOD = 1.0, 0.5, 0.25
"""Time [s] between two messages that say the same: the nodes'; and between two decisions where
nothing but position and charge is new, which the nodes take with each message: less work."""

Record = Callable[[str, str, float], None]
"""Takes what is said on a topic for a recording, at a time [s]."""

SOCKET_BUFFER = 400
"""Datagrams that wait for a process that stands still, at most: a choice, near Linux' default."""


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
    reads = 'command', 'goals', 'to_bridge', 'failed'
    writes = ()

    def __init__(self, vehicle: Vehicle, *process: Any) -> None:
        super().__init__(*process)
        self.vehicle = vehicle
        self._plan = FlightPlan(self.mission, SETTINGS.flight_altitude)

    def begin(self) -> None:
        """Open a link, and go on from the journal."""
        self.port = _Port(self)
        link = AutopilotLink(self.port, source_system=245)
        self.core = VehicleBridge(link, Pilot(SETTINGS, self._plan.ground), FaultEstimator())
        memory = self.recall()
        if self.doubt:
            self.core.distrust(self.doubt)
        elif memory:
            self.core.restore(memory)
        self.core.remember = self.remember
        self._goals_at = self._fault_at = -math.inf
        self._fault: Any = None

    def step(self, now: float) -> None:
        """Take in what has arrived, even while it stands still, and go on."""
        for datagram in self.vehicle.down.arrived(now):
            if self.up and len(self.port.waiting) < SOCKET_BUFFER:
                self.port.waiting.append(datagram)
        super().step(now)

    def hold(self) -> tuple[bool, str]:
        """Call ~/hold; without an answer it has died."""
        return self._answer(self.core.hold)

    def resume(self) -> tuple[bool, str]:
        """Call ~/resume; without an answer it has died."""
        return self._answer(self.core.resume)

    def _answer(self, service: Callable[[float], tuple[bool, str]]) -> tuple[bool, str]:
        try:
            return service(self.clock)
        except Killed:
            self.kill()
            return False, ''

    def work(self) -> None:
        """Hear, decide, ask, tell."""
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
        for goal in self.bus.to_bridge.take(self.now):
            self.core.pilot.work.completed(goal, self.clock)
        for goal in self.bus.failed.take(self.now):
            if goal == self.core.output.active:
                self.core.pilot.work.fail('the program says so')
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
            bus.complete(step.pilot.completed, now)
        if step.pilot.refused:
            goals = [goal.name for goal in self.mission.goals]
            for goal in goals if step.pilot.losing_ground else [step.pilot.refused]:
                self.watch.refused(goal)
                bus.refused.publish(goal, now)
        for number, battery in step.batteries.items():
            bus.battery.publish((self.wall, f'id{number}', battery), now)
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
        self.record: Record | None = None
        self._trace: TraceWriter | None = None

    def begin(self) -> None:
        """Go on from the journal, with the policy that was in use."""
        memory = self.recall() or {'policy': 0, 'core': None}
        self._policy = memory['policy']
        self.core = MissionManager(self._policies[self._policy], MANAGER_SETTINGS, memory['core'])
        self._decide_at = self._repeat_at = -math.inf
        self._command, self._goals = '', ()
        self.problem = self._complaint = ''
        if self.record:
            self._trace = TraceWriter(self.core, self.clock)

    def work(self) -> None:
        """Hear, decide, command; tell what was decided on."""
        self._decide(self._hear())
        if self.record and self._trace and (entry := self._trace.entry()):
            self.record('manager/trace', entry, self.now)

    def _decide(self, news: bool) -> None:
        if not self.works or self._waits or not (news or self.clock >= self._decide_at):
            return
        self._decide_at = self.clock + DECISION_PERIOD
        outcome = self.core.step(self.clock)
        if self._trace:
            self._trace.step(self.clock, outcome)
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

    @property
    def _waits(self) -> bool:
        """Whether it has just started, and has not heard what is wanted by now."""
        young = self.now - self.started_at < LISTENING_TIME + REQUEST_TIME
        return young and 'goal_priorities' not in self.core.situation.seen

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
            if self.record:
                self.record('mission_command', command, self.now)

    def _hear(self) -> bool:
        """Take what has arrived; return whether anything but charge and position has."""
        bus, now, clock = self.bus, self.now, self.clock
        for stamp, name, b in bus.battery.take(now):
            values = {
                **{'percentage': b.charge, 'healthy': b.healthy, 'voltage': b.voltage},
                **{'current': -b.current, 'battery': name},
            }
            self._take(HeardInput('battery_state', clock, values), stamp)
        for stamp, east, north in bus.odom.take(now):
            self._take(HeardInput('odom', clock, {'east': east, 'north': north}), stamp)
        requests = bus.priorities.take(now)
        news = [
            *(HeardInput('fault_mode', clock, {'name': name}) for name in bus.fault.take(now)),
            *(HeardInput('threat_level', clock, {'name': name}) for name in bus.threat.take(now)),
            *(
                HeardInput('goal_priorities', clock, {'values': values, 'request': request})
                for values, request in requests
            ),
            *(
                HeardInput('goal_completed', clock, {'name': name})
                for name in bus.completed.take(now)
            ),
            *(HeardInput('goal_refused', clock, {'name': name}) for name in bus.refused.take(now)),
        ]
        for heard in news:
            self._take(heard)
        for number in bus.policy.take(now):
            self.core.adopt(self._policies[number])
            self._policy = number
            if self._trace:
                self._trace.adopt()
        return bool(news)

    def _take(self, heard: HeardInput, stamp: float | None = None) -> None:
        topic = heard.topic
        try:
            stamp_age(topic, stamp, self.wall, MANAGER_SETTINGS.input_timeout)
            self.core.take(heard)
            if self._trace:
                self._trace.hear(heard)
            for warning in self.core.news():
                self.watch.note('manager', warning)
        except InputError as error:
            self.watch.counts[f'refused: {topic}'] += 1
            if topic != self._complaint:
                self.watch.note('manager', str(error))
            self._complaint = topic


class StationProcess(Process):
    """The base station."""

    name = 'station'
    reads = ('to_station',)

    def begin(self) -> None:
        """Go on with the request of the journal."""
        goals = [goal.name for goal in self.mission.goals]
        self.core = PriorityRequest(goals, self.recall())
        self._repeat_at = -math.inf

    def ask(self, priorities: Sequence[int]) -> None:
        """Set the parameter `priorities`."""
        self.core.ask(priorities, f'{self.rng.randrange(1 << 32):08x}')
        self.journal.write(self.core.memory)
        self._repeat_at = -math.inf

    def work(self) -> None:
        """Hear of goals that are completed; repeat the request."""
        for goal in self.bus.to_station.take(self.now):
            self.core.complete(goal)
        self.remember(self.core.memory)
        self.die('sending')
        if self.core.request and self.works and self.clock >= self._repeat_at:
            self._repeat_at = self.clock + REPEAT_PERIOD
            self.bus.priorities.publish((self.core.priorities, self.core.request), self.now)
