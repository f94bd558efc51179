"""The base station of several vehicles that share the goals of one mission."""

from __future__ import annotations

import re
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header, UInt8MultiArray

from uav_mission_manager.echo import quoted
from uav_mission_manager.fleet import FleetDispatcher, FleetRole, FleetSettings, VehicleShare
from uav_mission_manager.mdp import StateSpace, load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.clocks import WorkingTime, safety_clock, seconds
from uav_mission_manager.nodes.command_outputs import NO_PUBLISHER_EVENTS
from uav_mission_manager.nodes.fleet_inputs import FleetInputs
from uav_mission_manager.nodes.lifecycle import AUTOSTART, ManagedNode
from uav_mission_manager.nodes.memory import STATE_DIR, open_journal, state_before
from uav_mission_manager.nodes.parameters import NodeParameter, declare
from uav_mission_manager.nodes.presence import LISTENING, Presence
from uav_mission_manager.nodes.priority_parameter import (
    REQUESTED_PRIORITIES,
    PriorityParameter,
    new_request_id,
    priorities_message,
)
from uav_mission_manager.nodes.reporting import status
from uav_mission_manager.nodes.runtime import run_node
from uav_mission_manager.onboard.journal import Journal
from uav_mission_manager.policy import load_policy
from uav_mission_manager.solver.recombination import FleetPlanner
from uav_mission_manager.solver.recombination.fleet import ASSIGNMENTS

FLEET_DEFAULTS = FleetSettings()
"""Defaults of the parameters."""

PARAMETERS = (
    NodeParameter('mission', '', 'Mission file', path=True, example='config/fleet.yaml'),
    NodeParameter(
        'vehicles',
        ['uav1', 'uav2', 'uav3'],
        "Namespaces of the vehicles' nodes; they may come later",
    ),
    NodeParameter(
        'policy',
        '',
        'Directory of the policy set that all managers are to use; empty: whichever they have',
        path=True,
    ),
    NodeParameter(
        'assignment',
        FLEET_DEFAULTS.assignment,
        f'How goals are shared out: {", ".join(ASSIGNMENTS)}',
    ),
    NodeParameter(
        'lost_after',
        FLEET_DEFAULTS.lost_after,
        'Time for which a vehicle that is not heard, or does not obey its manager, keeps its goal '
        '[s]',
        3.0,
        3600.0,
        read_only=False,
    ),
    NodeParameter(
        'separation',
        FLEET_DEFAULTS.separation,
        "Least difference of two vehicles' flight_altitude [m]; who flies nearer to one before it "
        'is given no goal',
        0.0,
        100.0,
    ),
    NodeParameter('rate', 1.0, 'Repetition rate [Hz]', 0.1, 20.0),
    STATE_DIR,
    LISTENING,
    AUTOSTART,
)

LEVELS = {
    FleetRole.READY: DiagnosticStatus.OK,
    FleetRole.AWAITED: DiagnosticStatus.WARN,
    FleetRole.OUT: DiagnosticStatus.ERROR,
}
"""How bad it is for a vehicle to have a role."""


class FleetStation(ManagedNode):
    """Shares out the goals asked for by its parameter `priorities` among several vehicles.

    It is the base station of each of them: one goal a vehicle, anew when a goal is achieved, a
    vehicle comes, is lost, fails or falls out of range. What was asked for before it was started
    again goes on.
    """

    _journal: Journal | None = None
    _parameter: PriorityParameter | None = None

    def __init__(self) -> None:
        super().__init__('fleet')
        self._settings = declare(
            self, PARAMETERS, later=(REQUESTED_PRIORITIES,), changed=self._adjust
        )
        self._vehicles = _namespaces(self._settings.vehicles)
        if self._settings.assignment not in ASSIGNMENTS:
            given, known = quoted(self._settings.assignment), ', '.join(ASSIGNMENTS)
            raise ValueError(f'parameter assignment: {given} is none of {known}')
        self._steady = safety_clock()

    def configure(self) -> None:
        """Read the mission and solve its sub-MDPs."""
        p = self._settings
        mission = load_mission(p.mission)
        self._digest = load_policy(p.policy, mission).digest if p.policy else ''
        try:
            self._planner = FleetPlanner(mission)
        except ValueError as error:
            raise ValueError(f'{p.mission}: fleet: {error}') from error

    def activate(self) -> None:
        """Go on where the one before ended, and begin to listen."""
        p, mission = self._settings, self._planner.mission
        self._journal = open_journal(self, p.state_dir, 'fleet', mission)
        memory, trouble = state_before(self._journal)
        if memory is not None and not self._fits(memory):
            memory, trouble = None, f'{self._journal.path}: of a mission with other variables'
        if trouble:
            self.get_logger().warning(f'{trouble}; not used: nothing was asked for')
        self._time = WorkingTime(lambda: seconds(self._steady))
        self._dispatcher = FleetDispatcher(
            *(self._planner, self._vehicles, self._fleet_settings),
            *(self._time(), memory),
        )
        self._told: tuple[VehicleShare, ...] = ()
        self._requests = {
            vehicle: self.create_publisher(
                UInt8MultiArray,
                f'{vehicle}/goal_priorities',
                qos.LATCHED,
                event_callbacks=NO_PUBLISHER_EVENTS,
                qos_overriding_options=qos.OVERRIDABLE,
            )
            for vehicle in self._vehicles
        }
        self._decisions, self._diagnostics = (
            self.create_publisher(
                DiagnosticArray, topic, profile, qos_overriding_options=qos.OVERRIDABLE
            )
            for topic, profile in (('~/decision', qos.LATCHED), ('/diagnostics', qos.RELIABLE))
        )
        self._inputs = FleetInputs(self, self._dispatcher, self._digest, self._time, self._step)
        self._presences = [
            Presence(self, 'base_station', p.listening_time, vehicle) for vehicle in self._vehicles
        ]
        self._parameter = PriorityParameter(self, self._dispatcher.wish, mission.k, self._on_asked)
        self.create_timer(1.0 / p.rate, self._repeat, clock=self._steady)
        self.create_timer(1.0, self._diagnose, clock=self._steady)

    def deactivate(self) -> None:
        """Leave the journal to the next one."""
        if self._parameter is not None:
            self._parameter.close()
        if self._journal is not None:
            self._journal.close()
        self._parameter = self._journal = None

    def _fits(self, memory: dict[str, Any]) -> bool:
        """Whether the states in it are the mission's: a charge takes the place of range flags."""
        lengths = {len(state) for state in memory['states'].values()}
        return lengths <= {len(StateSpace.of(self._planner.mission).shape)}

    @property
    def _fleet_settings(self) -> FleetSettings:
        p = self._settings
        return FleetSettings(p.lost_after, p.separation, p.assignment)

    def _adjust(self) -> None:
        if self.active:
            self._dispatcher.settings = self._fleet_settings

    def _on_asked(self) -> None:
        self._dispatcher.forget_refusals()
        self._record()  # Whoever asks may see this process die before it decides.
        self._step()

    def _step(self) -> None:
        """Decide, and tell the vehicles that are asked for something new, once that is safe."""
        if any(presence.silent for presence in self._presences):
            return
        asked = self._dispatcher.step(self._time(), new_request_id)
        if asked:
            self._publish(asked)
        if self._dispatcher.decision.shares != self._told:
            self._explain()

    def _repeat(self) -> None:
        self._step()
        if not any(presence.silent for presence in self._presences):
            self._publish(self._vehicles)

    def _publish(self, vehicles: tuple[str, ...] | list[str]) -> None:
        """Record the requests, then say them: what has been heard is not forgotten."""
        self._record()
        for vehicle in vehicles:
            request = self._dispatcher.requests[vehicle]
            self._requests[vehicle].publish(priorities_message(request))

    def _record(self) -> None:
        if self._journal is not None:
            self._journal.write(self._dispatcher.memory)

    def _explain(self) -> None:
        """Say who is given which goal, why, and what else there was."""
        decision, before = self._dispatcher.decision, {s.vehicle: s.goal for s in self._told}
        for share in decision.shares:
            if before.get(share.vehicle, -1) != share.goal:
                self.get_logger().info(f'{share.vehicle} {self._words(share)}')
        self._told = decision.shares
        given = [f'{s.vehicle} to {self._goal(s)}' for s in decision.shares if s.goal >= 0]
        report = status(
            DiagnosticStatus.OK,
            f'{self.get_fully_qualified_name()}: decision',
            ', '.join(given) or 'no vehicle has a goal',
            **{share.vehicle: self._words(share) for share in decision.shares},
            **decision.left,
        )
        self._decisions.publish(self._array([report]))

    def _goal(self, share: VehicleShare) -> str:
        return self._dispatcher.goals[share.goal]

    def _words(self, share: VehicleShare) -> str:
        to = f'to {self._goal(share)}' if share.goal >= 0 else 'has no goal'
        return f'{to}: {share.reason}'

    def _array(self, statuses: list[DiagnosticStatus]) -> DiagnosticArray:
        header = Header(stamp=self.get_clock().now().to_msg())
        return DiagnosticArray(header=header, status=statuses)

    def _diagnose(self) -> None:
        self._time()
        name, wish = self.get_fully_qualified_name(), self._dispatcher.wish
        complaints, decision = self._inputs.complaints, self._dispatcher.decision
        memory = self._journal.error if self._journal else ''
        statuses = [
            status(
                LEVELS[share.role],
                f'{name}: {share.vehicle}',
                complaints.get(share.vehicle) or self._words(share),
            )
            for share in decision.shares
        ]
        left = '; '.join(f'{goal} {why}' for goal, why in decision.left.items())
        wanted = {goal: g for goal, g in zip(self._dispatcher.goals, wish.priorities) if g}
        stuck = wanted and not any(share.goal >= 0 for share in decision.shares)
        level = DiagnosticStatus.WARN if stuck else DiagnosticStatus.OK
        achieved = ', '.join(wish.achieved)
        statuses += [
            status(level, f'{name}: goals', left or 'all good', achieved=achieved, **wanted),
            status(
                DiagnosticStatus.WARN if memory else DiagnosticStatus.OK,
                f'{name}: memory',
                memory or 'all good',
            ),
        ]
        self._diagnostics.publish(self._array(statuses))


def _namespaces(given: list[str]) -> tuple[str, ...]:
    """Return the namespaces of vehicles as ROS writes them."""
    names = tuple(f'/{name.strip("/")}' for name in given)
    for name in names:
        if not re.fullmatch(r'(/[A-Za-z_]\w*)+', name, re.ASCII):
            raise ValueError(f'parameter vehicles: {quoted(name)} is no namespace')
        if names.count(name) > 1:
            raise ValueError(f'parameter vehicles: {name} is there twice')
    return names


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(FleetStation, (*PARAMETERS, REQUESTED_PRIORITIES), args)


if __name__ == '__main__':
    sys.exit(main())
