"""Clocks that are wrong, stand or jump: it is told, nothing old is obeyed, time-outs go on."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from bridge_crew import CASE_STUDY, GOAL1, GOAL2, Dummy, crews
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from ros_helpers import Ros
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.complaints import Complaints
from uav_mission_manager.nodes.flight_plan import FlightPlan, Plans
from uav_mission_manager.nodes.manager_inputs import ManagerInputs

COMMAND = 'commit goal1 normal'


@pytest.fixture
def dummy(ros: Ros):
    yield from crews(Dummy, ros)


class Hearing:
    """What the bridge hears of a manager, with stamps as a test has them."""

    def __init__(self, ros: Ros) -> None:
        mission = load_mission(CASE_STUDY)
        self.tasks: list[str] = []
        self.pilot = SimpleNamespace(
            goals_wanted=None, command=lambda task, now: self.tasks.append(task.text)
        )
        self.node = ros.node
        self.inputs = ManagerInputs(ros.node, Plans(FlightPlan(mission, 20.0)), self.pilot, 3.0)

    def hear(self, *, sent: float = 0.0, posed: float | None = None) -> None:
        """A pose and a command, so many seconds ahead of the clock here; twice, as repeated."""
        info = {'received_timestamp': 10**18, 'source_timestamp': 10**18 + round(sent * 1e9)}
        pose = PoseStamped()
        pose.header.frame_id = 'map'
        pose.pose.position.x, pose.pose.position.y = GOAL1
        if posed is not None:
            now = self.node.get_clock().now().nanoseconds + round(posed * 1e9)
            pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(now, 10**9)
        for _ in range(2):
            self.inputs._on_goals(UInt8MultiArray(data=[1, 0, 0]), info)
            self.inputs._on_pose(pose)
            self.inputs._on_command(String(data=COMMAND), info)


@pytest.fixture
def hearing(ros: Ros) -> Hearing:
    return Hearing(ros)


@pytest.mark.parametrize(
    'stamps', [{}, {'sent': -2.0, 'posed': -2.0}, {'sent': 2.0, 'posed': 2.0}]
)
def test_what_is_of_the_present_is_obeyed(hearing, stamps):
    hearing.hear(**stamps)
    assert hearing.tasks == [COMMAND] * 2
    assert (hearing.pilot.goals_wanted, hearing.inputs.complaints) == (True, ())


@pytest.mark.parametrize(
    ('sent', 'why'),
    [(-60.0, 'stamped 60.0 s ago'), (60.0, 'stamped 60.0 s ahead of the clock here')],
)
def test_a_clock_ahead_is_as_suspect_as_one_behind(hearing, sent, why):
    hearing.hear(sent=sent)
    assert (hearing.tasks, hearing.pilot.goals_wanted) == ([], None)
    complaints = '; '.join(hearing.inputs.complaints)
    assert f'goal_states: {why}' in complaints
    assert f'mission_command: {why}' in complaints
    assert f"'{COMMAND}' ignored" in complaints
    hearing.hear()
    assert hearing.tasks == [COMMAND] * 2
    assert hearing.inputs.complaints == ()


@pytest.mark.parametrize('posed', [-60.0, 65.0])  # Seconds may pass until it is looked at.
def test_the_stamp_of_the_pose_counts(hearing, posed):
    hearing.hear(posed=posed)
    assert hearing.tasks == []
    assert all('command_pose: stamped 6' in text for text in hearing.inputs.complaints)
    assert len(hearing.inputs.complaints) == 2
    hearing.hear(posed=0.0)
    assert hearing.tasks == [COMMAND] * 2


def test_a_complaint_that_goes_on_is_said_once(hearing):
    lines: list[str] = []
    clock = itertools.count(0.0, 10.0)
    hearing.inputs._complaints = Complaints(lines.append, lambda: next(clock))
    info = {'received_timestamp': 10**18, 'source_timestamp': 10**18}
    for _ in range(3):
        hearing.inputs._on_command(String(data='commit nothing normal'), info)
        hearing.inputs._complaints.flush()
    assert len(lines) == 1
    assert len(hearing.inputs.complaints) == 1
    hearing.hear()
    assert hearing.inputs.complaints == ()


def ticking(ros: Ros) -> Callable[[float], None]:
    """Publish /clock; return what sets it forward or back."""
    time = [5000.0]

    def tick() -> Clock:
        time[0] += 0.1
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(round(time[0] * 1e9), 10**9)
        return clock

    def jump(seconds: float) -> None:
        time[0] += seconds

    ros.repeat('/clock', tick, qos.RELIABLE, period=0.1)
    return jump


def airborne(make: Callable[..., Dummy]) -> Dummy:
    """A vehicle in the air, that is commanded."""
    flight = make(use_sim_time=True)
    flight.mode, flight.armed, flight.landed = 4, True, 2
    flight.command = 'commit goal2 normal'
    flight.until(lambda: flight.value('phase') in ('climbing', 'en route'), 'flight')
    return flight


def test_simulated_time_goes_back_and_it_holds_when_the_manager_dies(dummy, ros):
    jump = ticking(ros)
    flight = airborne(dummy)
    jump(-1000.0)
    flight.until(lambda: 'the clock jumped by -' in flight.status.message, 'a word about it')
    assert flight.status.level == DiagnosticStatus.WARN
    flight.command = None
    flight.until(lambda: flight.value('phase') == 'holding', 'holding')
    flight.until(lambda: flight.value('phase') == 'returning to launch', 'RTL')
    assert mavlink.MAV_CMD_DO_SET_MODE in flight.heard()


def test_without_simulated_time_it_flies_tells_and_holds_when_the_manager_dies(dummy, ros):
    flight = airborne(dummy)
    flight.until(lambda: 'the clock stands' in flight.status.message, 'a word about it')
    assert flight.status.level == DiagnosticStatus.WARN
    flight.command = None
    flight.until(lambda: flight.value('phase') == 'holding', 'holding')


def test_a_pose_of_another_clock_is_told_and_not_flown_by(dummy, ros):
    flight = dummy()
    flight.until(lambda: flight.odom, 'telemetry')
    flight.pose_stamp = 1000.0
    flight.command, flight.pose = 'commit goal2 normal', GOAL2
    flight.until(lambda: 'command_pose: stamped' in flight.status.message, 'a word about it')
    assert flight.status.level == DiagnosticStatus.WARN
    assert flight.heard() == set()
