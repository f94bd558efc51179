"""The chain in one process and in simulated time: no ROS, no sockets, the same core as the nodes.

The vehicle is the simulated autopilot; every byte between it and the bridge goes over a wire in
memory.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scenarios import Chain

from uav_mission_manager.autopilot.bridge import WARNING_PHASES, BridgeStep, VehicleBridge
from uav_mission_manager.autopilot.faults import FaultEstimator
from uav_mission_manager.autopilot.link import AutopilotLink
from uav_mission_manager.autopilot.pilot import Pilot
from uav_mission_manager.autopilot.simulator.flight import SimulatedFlight
from uav_mission_manager.autopilot.simulator.frames import QUAD_X, MotorFrame
from uav_mission_manager.autopilot.simulator.link import SimulatedLink
from uav_mission_manager.autopilot.simulator.physics import SimulatedOrigin
from uav_mission_manager.autopilot.simulator.protocol import SimulatedAutopilot
from uav_mission_manager.autopilot.task import Settings
from uav_mission_manager.mdp import FAULT_MODES, Mission
from uav_mission_manager.nodes.flight_plan import FlightPlan
from uav_mission_manager.onboard import (
    MissionManager,
    Refusal,
    Situation,
    format_command,
)
from uav_mission_manager.policy import Policy

STEP = 0.05
SETTINGS = Settings(
    goal_dwell=1.0, service_time=3.0, manager_timeout=3.0, rtl_delay=10.0, allow_arming=True
)


class MemoryPort:
    """The bridge's end of the wire."""

    def __init__(self) -> None:
        self.arrived: deque[bytes] = deque()
        self.sent: deque[bytes] = deque()

    def recv(self, size: int) -> bytes:
        return self.arrived.popleft() if self.arrived else b''

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def close(self) -> None:
        pass


class VehicleEnd:
    """The autopilot's end: what is written to it goes to the test, and over the wire."""

    def __init__(self, chain: SimulatedChain) -> None:
        self._chain = chain
        self._parser = mavlink.MAVLink(None)

    def write(self, data: bytes) -> None:
        chain = self._chain
        if chain.connected:
            chain.port.arrived.append(bytes(data))
        for message in self._parser.parse_buffer(data) or []:
            chain.watch_vehicle(message, chain.connected and not chain.stalled)


class SimulatedChain(Chain):
    """The chain with a simulated autopilot, some hundred times faster than life.

    The vehicle stands `depth` [m] below the mission file's ground. The bridge may have another
    `mission` of the same geography.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        seed: int = 0,
        frame: MotorFrame = QUAD_X,
        settings: Settings = SETTINGS,
        depth: float = 0.0,
        mission: Mission | None = None,
    ) -> None:
        super().__init__(mission or policy.mission)
        self._policy = policy
        self.port, self.connected, self.stalled = MemoryPort(), True, False
        ground = replace(self.origin, altitude=self.origin.altitude - depth)
        self.flight = SimulatedFlight(SimulatedOrigin(*astuple(ground)), 30.0, seed, frame)
        self._vehicle_link = SimulatedLink(VehicleEnd(self))
        self.autopilot = SimulatedAutopilot(self.flight, [self._vehicle_link])
        self._time = 1000.0
        self._crew = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._forger = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._bridge_parser = mavlink.MAVLink(None)
        plan = FlightPlan(self.mission, settings.flight_altitude)
        self._plan = plan
        link = AutopilotLink(self.port, source_system=245)
        self.bridge = VehicleBridge(link, Pilot(settings, plan.ground), FaultEstimator())
        self._fault = ''
        self._request: tuple[tuple[int, ...], str] = ((0,) * policy.mission.k, 'request 0')
        self._beat_at = self._decide_at = 0.0
        self._news: tuple[object, ...] = ()
        self.start_manager()

    def _step(self) -> None:
        """Let `STEP` pass for everybody."""
        self._time += STEP
        for _ in range(2):
            self.autopilot.step(STEP / 2.0)
        if self._time - self._beat_at >= 1.0:
            self._beat_at = self._time
            self.say(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self.stalled:
            return
        self._step_bridge()
        while self.port.sent:
            data = self.port.sent.popleft()
            for message in self._bridge_parser.parse_buffer(data) or []:
                self.watch_bridge(message)
            if self.connected:
                self.autopilot.receive(self._vehicle_link, data)

    def _step_bridge(self) -> None:
        step = self.bridge.step(self._time)
        self.active = step.pilot.active
        if step.pilot.completed:
            self.completed.append(step.pilot.completed)
        refused = [step.pilot.refused] * bool(step.pilot.refused)
        if refused and step.pilot.losing_ground:
            refused = [goal.name for goal in self.mission.goals]
        self.refused += refused
        self.reasons += [step.pilot.status] * bool(step.pilot.refused)
        if step.fault is not None:
            self._fault = FAULT_MODES[step.fault]
        if self.manager is not None:
            self._inform(self.manager, step, refused)
            news = (self._fault, self._request, *self.completed, *refused)
            if news != self._news or self._time >= self._decide_at:
                self._news, self._decide_at = news, self._time + 0.25
                self._decide(self.manager)

    def _inform(self, manager: MissionManager, step: BridgeStep, refused: list[str]) -> None:
        """Tell the manager what the bridge publishes."""
        now = self._time
        for number, battery in step.batteries.items():
            manager.take(
                lambda s, number=number, battery=battery: s.with_battery(
                    battery.charge,
                    now,
                    battery.healthy,
                    voltage=battery.voltage,
                    current=-battery.current,
                    battery=f'id{number}',
                )
            )
        if step.position:
            place = self.origin.to_local(step.position.latitude, step.position.longitude)
            manager.take(lambda s: s.with_position(*place, now))
        if step.fault is not None:
            manager.take(lambda s: s.with_fault(self._fault, now))
        if step.pilot.completed:
            manager.take(lambda s: s.with_completed(step.pilot.completed))
        for goal in refused:
            manager.take(lambda s, goal=goal: s.with_refused(goal))

    def _decide(self, manager: MissionManager) -> None:
        """Let the manager decide, and the bridge hear of it."""
        manager.take(lambda s: s.with_priorities(*self._request, self._time))
        outcome = manager.step(self._time)
        if isinstance(outcome, Refusal):
            return
        text = format_command(self.mission, outcome.action)
        if text != self.command:
            self.commands.append((self._time, text))
        self.bridge.pilot.goals_wanted = any(manager.situation.priorities)
        self.bridge.pilot.command(self._plan.task(outcome.action, text), self._time)

    # The crew

    def want(self, *priorities: int) -> None:
        self._request = priorities, f'request at {self._time}'
        if self.manager is not None:
            self.manager.take(lambda s: s.with_priorities(*self._request, self._time))

    def spend(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self._step()

    def set(self, name: str, value: float) -> None:
        if name in self.flight.parameters:
            self.say(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9))

    def say(self, message: Any) -> None:
        self.autopilot.receive(self._vehicle_link, message.pack(self._crew))

    def forge(self, message: Any, v1: bool = False) -> None:
        self.port.arrived.append(message.pack(self._forger, force_mavlink1=v1))

    def cut(self) -> None:
        self.connected = False

    def mend(self) -> None:
        self.connected = True

    def stall(self, seconds: float) -> None:
        self.stalled = True
        self.spend(seconds)
        self.stalled = False

    def kill_manager(self) -> None:
        self.manager: MissionManager | None = None

    def start_manager(self) -> None:
        self.manager = MissionManager(self._policy)

    @property
    def _situation(self) -> Situation | None:
        return self.manager and self.manager.situation

    def answer(self, goal: str, why: str = '') -> None:
        if why:
            self.bridge.pilot.work.fail(why)
            return
        self.completed.append(goal)
        self.bridge.pilot.work.completed(goal, self._time)
        if self.manager is not None:
            self.manager.take(lambda s: s.with_completed(goal))

    def hold(self) -> tuple[bool, str]:
        return self.bridge.hold(self._time)

    def resume(self) -> tuple[bool, str]:
        return self.bridge.resume(self._time)

    @property
    def now(self) -> float:
        return self._time

    @property
    def phase(self) -> str:
        return self.bridge.output.phase.value

    @property
    def report(self) -> tuple[bool, str]:
        output, warnings = self.bridge.output, self.bridge.warnings
        text: Sequence[str] = (f'{output.phase.value}: {output.status}', *warnings)
        return bool(warnings) or output.phase in WARNING_PHASES, '; '.join(text)

    @property
    def fault(self) -> str:
        return self._fault
