"""Three vehicles, nine goals, real nodes, simulated autopilots: one is killed, one recharged."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from pymavlink import mavutil
from rcl_interfaces.srv import GetParameters
from ros_helpers import ROOT, NodeProcess, Ros, free_port
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager.console.messages import shares_of
from uav_mission_manager.mdp import load_mission
from uav_mission_manager.nodes import qos

MISSION, POLICY = ROOT / 'config' / 'fleet.yaml', ROOT / 'policies' / 'fleet'
SPEEDUP = 8.0
LOST_AFTER = 10.0
BRIDGE = {
    'mission': MISSION,
    'allow_arming': True,
    'goal_dwell': 1.0,
    'service_time': 1.0,
    'manager_timeout': 30.0,
    'link_timeout': 30.0,
}
MANAGER = {'command_dwell': 0.5, 'settling_time': 0.5, 'input_timeout': 30.0}
"""With time-outs that a busy machine does not run into."""


def parameters(**values: object) -> list[str]:
    words = [w for name, value in values.items() for w in ('-p', f'{name}:={value}')]
    return ['--ros-args', *words]


class Vehicle:
    """The processes of one vehicle, and the ground crew's link to it."""

    def __init__(self, ros: Ros, number: int, done: list[str]) -> None:
        self.ros, self.number, self.name = ros, number, f'/uav{number}'
        port, crew = free_port(), free_port()
        self.link = mavutil.mavlink_connection(f'udpin:127.0.0.1:{crew}', source_system=255)
        namespace = ['-r', f'__ns:={self.name}']
        bridge = {'connection': f'udpin:127.0.0.1:{port}', 'target_system': number}
        self.processes: list[NodeProcess] = [
            ros.start(
                'autopilot.sim_autopilot',
                *('--connection', f'udpout:127.0.0.1:{port}'),
                *('--connection', f'udpout:127.0.0.1:{crew}'),
                *('--system-id', str(number), f'--speedup={SPEEDUP}'),
            ),
            ros.start(
                'nodes.mavlink_bridge',
                *parameters(**BRIDGE, **bridge, flight_altitude=10.0 + 10.0 * number),
                *namespace,
            ),
            ros.start('nodes.manager', *parameters(**MANAGER, policy=POLICY), *namespace),
        ]
        ros.node.create_subscription(
            String, f'{self.name}/goal_completed', lambda m: done.append(m.data), qos.EVENT
        )
        self.commands = ros.listen(f'{self.name}/mission_command', String, qos.LATCHED)
        self.asked = ros.listen(f'{self.name}/goal_priorities', UInt8MultiArray, qos.LATCHED)

    @property
    def goals(self) -> set[int]:
        """What it is asked for now."""
        return {j for j, g in enumerate(self.asked[-1].data) if g} if self.asked else set()

    @property
    def command(self) -> str:
        return self.commands[-1].data if self.commands else ''

    def set(self, parameter: str, value: float) -> None:
        """Set a parameter of the simulated autopilot."""
        asked = [0.0]

        def done() -> bool:
            if time.monotonic() > asked[0] + 0.5:
                asked[0] = time.monotonic()
                self.link.mav.param_set_send(self.number, 1, parameter.encode(), value, 9)
            message = self.link.recv_match(type='PARAM_VALUE')
            return message is not None and message.param_id == parameter

        self.ros.until(done, f'{parameter} of {self.name}')

    def landed(self, diagnostics: list[DiagnosticArray]) -> bool:
        """Whether its bridge last said that the motors stand."""
        name = f'{self.name}/mavlink_bridge: autopilot'
        found = [s for m in diagnostics for s in m.status if s.name == name]
        return any(v.key == 'armed' and v.value == 'False' for v in found[-1].values)

    def kill(self) -> None:
        for process in self.processes:
            process.kill()


@pytest.fixture
def done() -> list[str]:
    """Goals completed by whichever vehicle, in their order."""
    return []


@pytest.fixture
def vehicles(ros: Ros, done: list[str]) -> Iterator[list[Vehicle]]:
    found = [Vehicle(ros, n, done) for n in (1, 2, 3)]
    yield found
    for vehicle in found:
        vehicle.link.close()


def test_there_is_one_base_station_a_vehicle(ros: Ros) -> None:
    station = ros.start('nodes.base_station', '--ros-args', '-r', '__ns:=/uav2')
    heard = ros.listen('/uav2/presence/base_station', String, qos.EVENT)
    ros.until(lambda: len(heard) > 1, 'the base station')
    fleet = ros.start('nodes.fleet', '--ros-args', '-p', 'listening_time:=60.0')
    assert fleet.wait() == 1
    [line] = fleet.lines('FATAL')
    assert 'another base_station is in /uav2' in line
    assert station.process.poll() is None


def test_it_goes_on_after_it_was_killed(ros: Ros) -> None:
    heard = ros.listen('/uav1/goal_priorities', UInt8MultiArray, qos.LATCHED)
    first = ros.start('nodes.fleet', '--ros-args', '-p', 'vehicles:=[uav1]')
    ros.until(lambda: heard, 'the first request, for nothing')
    assert ros.set_parameter('fleet', 'priorities', [1, 2, *[0] * 7]).successful
    state = [1, *[1] * 9, *[0] * 9, 0, 0, 0, 0]
    decision = DiagnosticStatus(
        name='/uav1/manager: decision',
        message='no goal is wanted',
        values=[
            KeyValue(key='state', value=' '.join(map(str, state))),
            KeyValue(key='values', value=''),
        ],
    )
    facts = {'link': 'up', 'phase': 'en route', 'armed': 'True', 'flight_altitude': '20.0'}
    bridge = DiagnosticStatus(
        name='/uav1/mavlink_bridge: autopilot',
        values=[KeyValue(key=key, value=value) for key, value in facts.items()],
    )
    array = DiagnosticArray(status=[decision])
    ros.repeat('/uav1/manager/decision', lambda: array, qos.LATCHED)
    ros.repeat('/diagnostics', lambda: DiagnosticArray(status=[bridge]), qos.RELIABLE)
    ros.until(lambda: any(heard[-1].data), 'a goal')
    [goal] = [j for j, g in enumerate(heard[-1].data) if g]
    before = heard[-1].layout.dim[0].label
    done = ('gate', 'roof')[goal]
    ros.publish('/uav1/goal_completed', String(data=done), qos.EVENT)
    ros.until(lambda: heard[-1].layout.dim[0].label != before, 'the next goal')
    last = heard[-1]
    assert [j for j, g in enumerate(last.data) if g] == [1 - goal]
    first.kill()
    heard.clear()
    again = ros.start('nodes.fleet', '--ros-args', '-p', 'vehicles:=[uav1]')
    ros.until(lambda: len(heard) > 2, 'the one after it')
    assert {m.layout.dim[0].label for m in heard} == {last.layout.dim[0].label}
    assert {tuple(m.data) for m in heard} == {tuple(last.data)}
    assert f'achieved: {done}' in again.output
    assert again.stop() == 0


def test_an_inactive_one_asks_for_nothing_and_goes_on_when_it_is_active_again(ros: Ros) -> None:
    heard = ros.listen('/uav1/goal_priorities', UInt8MultiArray, qos.LATCHED)
    ros.start('nodes.fleet', '--ros-args', '-p', 'vehicles:=[uav1]')
    ros.until(lambda: heard, 'a request')
    assert ros.set_parameter('fleet', 'priorities', [0, 2, *[0] * 7]).successful

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(ros.call('fleet/change_state', request, ChangeState).success)

    for _ in range(2):
        assert change(Transition.TRANSITION_DEACTIVATE)
        heard.clear()
        assert not ros.set_parameter('fleet', 'priorities', [0] * 9).successful
        ros.spin(1.5)
        assert not heard
        assert change(Transition.TRANSITION_ACTIVATE)
        ros.until(lambda: heard, 'a request again')
    [value] = ros.call(
        'fleet/get_parameters', GetParameters.Request(names=['priorities']), GetParameters
    ).values
    assert list(value.integer_array_value) == [0, 2, *[0] * 7]


@pytest.mark.parametrize(
    ('parameter', 'words'),
    [
        ('assignment:=best', "parameter assignment: 'best' is none of queue, optimal"),
        ('vehicles:=[uav1, /uav1/]', 'parameter vehicles: /uav1 is there twice'),
        ('vehicles:=[1st]', "parameter vehicles: '/1st' is no namespace"),
        ('lost_after:=1.0', 'parameter lost_after'),
        (f'policy:={ROOT}/policies/case_study', 'mission'),
    ],
)
def test_a_bad_parameter_ends_the_start_in_one_line(ros: Ros, parameter: str, words: str) -> None:
    node = ros.start('nodes.fleet', '--ros-args', '-p', parameter)
    assert node.wait() == 1
    [line] = node.output.splitlines()
    assert 'FATAL' in line
    assert words in line


def level_of(messages: list[DiagnosticArray], name: str) -> tuple[bytes, str]:
    """How a part of the fleet node was last, in level and words."""
    found = [s for m in messages for s in m.status if s.name == name]
    return (found[-1].level, found[-1].message) if found else (DiagnosticStatus.STALE, '')


def test_all_goals_are_done_once(ros: Ros, vehicles: list[Vehicle], done: list[str]) -> None:
    names = [goal.name for goal in load_mission(MISSION).goals]
    diagnostics = ros.listen('/diagnostics', DiagnosticArray, qos.RELIABLE)
    decisions = ros.listen('/fleet/decision', DiagnosticArray, qos.LATCHED)
    station = ros.start(
        'nodes.fleet', *parameters(mission=MISSION, policy=POLICY, lost_after=LOST_AFTER)
    )
    one, two, three = vehicles

    def ready(vehicle: Vehicle) -> bool:
        level, _ = level_of(diagnostics, f'/fleet: {vehicle.name}')
        return level == DiagnosticStatus.OK

    ros.until(lambda: all(map(ready, vehicles)), 'three vehicles that are ready')
    assert not any(vehicle.goals for vehicle in vehicles)
    assert ros.set_parameter('fleet', 'priorities', [2] * 9).successful

    def shared() -> bool:
        taken = [j for vehicle in vehicles for j in vehicle.goals]
        assert len(taken) == len(set(taken))
        return len(taken) == 3

    ros.until(shared, 'a goal for each vehicle')

    def told() -> bool:
        given = {words.partition(':')[0] for _, words in shares_of(decisions[-1])}
        return given == {f'to {names[j]}' for vehicle in vehicles for j in vehicle.goals}

    ros.until(told, 'the decision in words')
    first = two.goals
    ros.until(lambda: two.goals and two.goals != first, 'another goal for the second one')
    [lost] = two.goals
    two.kill()
    three.set('BATT_LOW_VOLT', 9.0)  # Its failsafe would end the flight before the landing does.
    three.set('SIM_BATT_PCT', 20.0)
    ros.until(lambda: three.command == 'recharge', 'recharge')
    ros.until(lambda: lost in one.goals | three.goals, 'the lost goal, given to another one')
    ros.until(
        lambda: level_of(diagnostics, '/fleet: /uav2')[0] == DiagnosticStatus.ERROR,
        'word of the lost one',
    )
    assert 'has no goal: manager not heard any more' in level_of(diagnostics, '/fleet: /uav2')[1]
    ros.until(lambda: three.landed(diagnostics), 'the landing')
    three.set('SIM_BATT_PCT', 100.0)
    ros.until(lambda: three.command != 'recharge', 'the end of recharging')
    ros.until(lambda: set(done) == set(names), 'all goals')
    assert done.index('gate') < done.index('quarry')
    ros.until(lambda: not (one.goals or three.goals), 'nothing more asked for')
    assert Counter(done) == dict.fromkeys(names, 1)
    assert station.stop() == 0
