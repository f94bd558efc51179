"""A plan of QGroundControl, flown by the processes of the demo, with a battery that runs low."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from ros_helpers import ROOT, Ros
from rounds_flown import RADIUS, require_flown_once, visits, waypoints_of
from scenarios import Sample
from std_msgs.msg import String

from uav_mission_manager.cli import mission_new, policy_build
from uav_mission_manager.cli.demo.stack import NAMESPACE, Stack
from uav_mission_manager.mdp import Mission, load_mission
from uav_mission_manager.nodes import qos

PLAN = ROOT / 'config' / 'plans' / 'field.plan'
SPEEDUP, SLOW = 16.0, 1.0
POSITION_INTERVAL = 100_000.0
"""Simulated time [us] between two positions of the vehicle."""


class Crew:
    """The base station's operator and the ground crew; they see the vehicle by its own link."""

    def __init__(self, ros: Ros, stack: Stack, mission: Mission) -> None:
        self.ros, self.stack, self.mission = ros, stack, mission
        self.link = mavutil.mavlink_connection(stack.crew_connection, source_system=255)
        self.commands = ros.listen(f'{NAMESPACE}/mission_command', String, qos.LATCHED)
        self.completed = ros.listen(f'{NAMESPACE}/goal_completed', String, qos.EVENT)
        self.track: list[Sample] = []
        self.armed = False
        self.confirmed: dict[str, float] = {}

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Look at every position of the vehicle, one by one, until something is true."""

        def seen() -> bool:
            while not condition():
                message = self.link.recv_match()
                if message is None:
                    assert not self.stack.ended(), self.stack.ended()
                    return False
                self._take(message)
            return True

        self.ros.until(seen, f'{what}; {self.commands[-1:]}, {self.track[-1:]}')

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if kind == 'HEARTBEAT':
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if not self.track:
                self.link.mav.command_long_send(
                    1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, 33, POSITION_INTERVAL, *[0] * 5
                )
        elif kind == 'PARAM_VALUE':
            self.confirmed[message.param_id] = message.param_value
        elif kind == 'GLOBAL_POSITION_INT' and (message.lat or message.lon):
            origin = self.mission.grid.origin
            assert origin is not None
            place = origin.to_local(message.lat / 1e7, message.lon / 1e7)
            height = message.alt / 1000.0 - origin.altitude
            self.track.append(Sample(message.time_boot_ms / 1000.0, *place, height, 0.0))

    def set(self, name: str, value: float) -> None:
        """Set a parameter of the simulated vehicle."""
        self.confirmed.pop(name, None)
        asked = [-1.0]

        def done() -> bool:
            if time.monotonic() > asked[0] + 0.5:
                asked[0] = time.monotonic()
                self.link.mav.param_set_send(1, 1, name.encode(), value, 9)
            return name in self.confirmed

        self.until(done, name)
        assert self.confirmed[name] == value

    @property
    def command(self) -> str:
        return self.commands[-1].data if self.commands else ''


@pytest.fixture
def crew(ros: Ros, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Crew]:
    path, policy = tmp_path / 'field.yaml', tmp_path / 'policy'
    assert mission_new.main([str(PLAN), '--out', str(path)]) == 0
    assert policy_build.main([str(path), '--out', str(policy)]) == 0
    mission = load_mission(path)
    grid = mission.grid
    assert grid.origin is not None
    assert mission.energy is not None
    monkeypatch.setenv('ROS_DOMAIN_ID', str(ros.domain))
    stack = Stack(path, policy, tmp_path / 'logs', SPEEDUP)
    crew = Crew(ros, stack, mission)
    latitude, longitude = grid.origin.to_geodetic(*grid.position(grid.base))
    try:
        stack.start(f'{latitude},{longitude},{grid.origin.altitude}', mission.energy)
        yield crew
    finally:
        crew.link.close()
        stack.stop()


def test_a_survey_left_for_a_low_battery_is_taken_up_where_it_was_left(crew):
    """It is left on the leg after waypoint 10, or later: the ways home and back cross none."""
    points = waypoints_of(crew.mission, 'survey_2', flight_altitude=20.0)
    assert len(points) == 16
    crew.until(lambda: crew.track, 'the vehicle')
    crew.set('BATT_LOW_TIMER', 1.0)  # Else the vehicle has flown half a leg before it says so.
    ask = crew.ros.set_parameter(f'{NAMESPACE}/base_station', 'priorities', [0, 0, 2])
    assert ask.successful

    def from_ten() -> tuple[float, float]:
        """How far [m] along the rows, and across them, it is from waypoint 10."""
        here, (east, north, _) = crew.track[-1], points[9]
        return abs(here.east - east), abs(here.north - north)

    crew.until(lambda: max(from_ten()) < RADIUS, 'waypoint 10')
    crew.set('SIM_SPEEDUP', SLOW)  # There is time for the chain to decide, however busy it is.
    crew.until(lambda: from_ten()[0] > 25.0, 'the leg after it')
    crew.set('SIM_BATT_PCT', 10.0)
    crew.until(lambda: not crew.command.startswith('commit'), 'the end of the commitment')
    crew.until(lambda: from_ten()[1] > 20.0, 'the way home')
    crew.set('SIM_SPEEDUP', SPEEDUP)
    crew.until(lambda: crew.command == 'recharge' and not crew.armed, 'the landing')
    flown = [visit.waypoint for visit in visits(crew.track, points)]
    assert flown == [*range(1, len(flown) + 1)]
    assert 10 <= len(flown) < len(points)
    assert not crew.completed
    assert crew.track[-1].height < RADIUS
    crew.set('SIM_BATT_PCT', 100.0)
    crew.until(lambda: crew.armed, 'the next take-off')
    crew.until(lambda: crew.completed, 'the survey')
    crew.until(lambda: visits(crew.track[-100:], points[-1:]), 'its last waypoint, on the track')
    require_flown_once(crew.track, points, left_after=len(flown))
