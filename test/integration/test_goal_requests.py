"""Goals requested in flight: the chain as processes, from the request to the goal done."""

from __future__ import annotations

import json
import math
import signal
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml
from nav_msgs.msg import Odometry
from ros_helpers import ROOT, NodeProcess, Ros, free_port
from std_msgs.msg import String, UInt8MultiArray

from uav_mission_manager import build_policy, load_mission, load_policy
from uav_mission_manager.autopilot.task import Settings
from uav_mission_manager.nodes import qos

SPEEDUP = 4
NO_FLY_CELL, PLACE, NEXT_PLACE = 7, 6, 2
REFUSED = 'goal request refused: '
REPEAT_PERIOD = 3.0
FLIGHT = {'allow_arming': True, 'goal_dwell': 1.0, 'service_time': 1.0}


def parameters(**given: object) -> list[str]:
    return [
        '--ros-args',
        *(w for name, value in given.items() for w in ('-p', f'{name}:={value}')),
    ]


class Chain:
    """All nodes of a vehicle, the solver and a simulated autopilot."""

    def __init__(self, ros: Ros, folder: Path, slot: bool = True) -> None:
        self.ros, self.file = ros, folder / 'mission.yaml'
        data = yaml.safe_load((ROOT / 'config' / 'case_study.yaml').read_text())
        data['goals'][2] |= {'name': 'spare', 'cell': 0, 'slot': slot}
        data['threat']['zones'] = {}
        data['threat']['onset'] = 0.0
        origin = load_mission(ROOT / 'config' / 'case_study.yaml').grid
        corners = ((-20, -20), (20, -20), (20, 20), (-20, 20))
        east, north = origin.position(NO_FLY_CELL)
        polygon = [list(origin.origin.to_geodetic(east + x, north + y)) for x, y in corners]
        data['areas'] = {'no_fly': [{'name': 'nest', 'polygon': polygon}]}
        self.file.write_text(yaml.safe_dump(data))
        self.mission = load_mission(self.file)
        self.policy, self.out = folder / 'policy', folder / 'sets' / 'built'
        build_policy(self.mission).save(self.policy)
        self.port = free_port()
        self.track: list[tuple[float, float, float]] = []
        self.commanded: list[tuple[float, str]] = []
        ros.node.create_subscription(Odometry, 'odom', self._on_odom, qos.SENSOR)
        ros.node.create_subscription(String, 'mission_command', self._on_command, qos.LATCHED)
        self.completed = ros.listen('goal_completed', String, qos.EVENT)
        self.goals = ros.listen('goal_states', UInt8MultiArray, qos.LATCHED)
        self.asked = ros.listen('goal_priorities', UInt8MultiArray, qos.STATE_IN)
        ros.advertise('goal_requests', String, qos.EVENT)
        home = self.mission.grid.origin
        ros.start(
            'autopilot.sim_autopilot',
            *('--connection', f'udpout:127.0.0.1:{self.port}', f'--speedup={SPEEDUP}'),
            f'--origin={home.latitude},{home.longitude},{home.altitude}',
        )
        self.start_base()
        self.start_bridge()
        self.start_manager()
        self.start_solver()

    def start_base(self) -> None:
        self.base = self.ros.start('nodes.base_station', *parameters(mission=self.file))

    def start_bridge(self) -> None:
        connection = f'udpin:127.0.0.1:{self.port}'
        given = parameters(mission=self.file, connection=connection, **FLIGHT)
        self.bridge = self.ros.start('nodes.mavlink_bridge', *given)

    def start_manager(self) -> None:
        given = parameters(policy=self.policy, command_dwell=0.5)
        self.manager = self.ros.start('nodes.manager', *given)

    def start_solver(self) -> None:
        self.solver = self.ros.start('nodes.solver', *parameters(mission=self.file, out=self.out))

    def _on_odom(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self.track.append((place.x, place.y, place.z))

    def _on_command(self, message: String, info: dict[str, int]) -> None:
        self.commanded.append((info['source_timestamp'] * 1e-9, message.data))

    @property
    def command(self) -> str:
        return self.commanded[-1][1] if self.commanded else ''

    def say(self, text: str) -> None:
        self.ros.publish('goal_requests', String(data=text), qos.EVENT)

    def until_refused(self, words: str, *texts: str) -> None:
        """Ask until it is refused in a line with these words: the manager may not be heard yet."""

        def refused() -> bool:
            return any(words in line for line in self.solver.lines(REFUSED))

        self.repeat(texts, refused, f'refusal: {words}')

    def until_placed(self, **fields: Any) -> None:
        """Ask until the manager has taken a goal over."""
        over = f'; goals {fields["name"]}'
        self.repeat([json.dumps(fields)], lambda: self.manager.lines(over), f'take-over{over}')

    def repeat(self, texts: Iterable[str], condition: Callable[[], Any], what: str) -> None:
        asked = -math.inf

        def done() -> Any:
            nonlocal asked
            if time.monotonic() > asked + REPEAT_PERIOD:
                asked = time.monotonic()
                for text in texts:
                    self.say(text)
            return condition()

        self.ros.until(done, what)

    def until_in_the_air(self) -> None:
        """Armed on the ground without a bridge, the autopilot disarms by itself: a pilot's act."""
        self.ros.until(lambda: self.track and self.track[-1][2] > 2.0, 'in the air')

    def until_done(self, goal: str) -> None:
        def done() -> bool:
            return goal in [message.data for message in self.completed]

        self.ros.until(done, f'{goal}; {self.command}, {self.track[-1:]}')

    def until_wanted(self, goals: list[int]) -> None:
        self.ros.until(
            lambda: self.goals and list(self.goals[-1].data) == goals, f'goal_states {goals}'
        )

    def position(self, cell: int) -> tuple[float, float]:
        return self.mission.grid.position(cell)

    def nearest(self, cell: int) -> float:
        """How near [m] the track comes to the centre of a cell, at the height of flight."""
        east, north = self.position(cell)
        flown = [(x, y) for x, y, z in self.track if z > 0.9 * Settings().flight_altitude]
        return min((math.hypot(x - east, y - north) for x, y in flown), default=math.inf)

    def silence_at(self, line: str) -> float:
        """Time [s] between the commands before and after a line of the manager's log."""
        then = float(line.split('[')[2].split(']')[0])
        times = [time for time, _ in self.commanded]
        return min(t for t in times if t > then) - max(t for t in times if t < then)


@pytest.fixture
def chain(ros: Ros, tmp_path: Path) -> Chain:
    return Chain(ros, tmp_path)


def ask(chain: Chain, priorities: list[int]) -> None:
    """Ask for goals, by a base station, and wait until the vehicle flies to one."""
    chain.ros.until(lambda: chain.track, 'the vehicle')
    assert chain.ros.set_parameter('base_station', 'priorities', priorities).successful
    chain.ros.until(lambda: chain.command.startswith('commit'), 'a commitment')


def test_a_goal_requested_in_flight_is_flown_and_its_slot_taken_again(chain: Chain) -> None:
    ask(chain, [1, 2, 0])
    for text, words in (
        ('{"cell": 6', '\'{"cell": 6\' is not valid JSON'),
        ('{"cell": 99}', '99 is no cell of the 2x4 grid'),
        ('{"east": 400, "north": 0}', '400 m east, 0 m north of cell 0 is off the 2x4 grid'),
        (json.dumps({'cell': NO_FLY_CELL}), 'cell 7 is in the no-fly area nest'),
        ('{"cell": 6, "prio": 2}', "prio: is unknown; the nearest known key is 'priority'"),
    ):
        chain.until_refused(words, text)
    assert not chain.out.parent.exists()

    both = tuple(json.dumps({'cell': cell}) for cell in (PLACE, NEXT_PLACE))
    chain.until_refused('is being built; ask again when it is done', *both)
    taken = f'policy taken over: {chain.out}.goals1'
    chain.ros.until(lambda: chain.manager.lines(taken), 'take-over')
    assert '; goals placed1' in chain.manager.lines(taken)[0]
    chain.track.clear()
    for goal in 'goal1', 'goal2', 'placed1':
        chain.until_done(goal)
    chain.until_wanted([0, 0, 0])
    assert chain.nearest(PLACE) < Settings().acceptance_radius
    assert chain.silence_at(chain.manager.lines(taken)[0]) < Settings().manager_timeout

    latitude, longitude = chain.mission.grid.origin.to_geodetic(*chain.position(NEXT_PLACE))
    chain.track.clear()
    fields = {'name': 'tree', 'worth': 60.0, 'priority': 1}  # Worth a flight from anywhere.
    chain.until_placed(latitude=latitude, longitude=longitude, **fields)
    assert chain.ros.set_parameter('solver', 'max_goals', 3).successful
    words = 'no slot is free of tree, and for a further goal it has too many, 3 of 3 at most'
    chain.until_refused(words, json.dumps({'cell': PLACE}))
    chain.ros.until(lambda: 'commit tree' in chain.command, 'the next commitment')
    again = chain.ros.call('solver/build')
    assert again.success, again.message
    assert again.message.startswith(f'{chain.out}.goals1: ')
    names = [goal.name for goal in load_policy(f'{chain.out}.goals1').mission.goals]
    assert names == ['goal1', 'goal2', 'tree']
    chain.until_done('tree')
    assert chain.nearest(NEXT_PLACE) < Settings().acceptance_radius
    assert load_mission(chain.file) == chain.mission


def killed(process: NodeProcess) -> None:
    assert process.stop(signal.SIGKILL) == -signal.SIGKILL


def test_a_requested_goal_outlives_all_nodes(chain: Chain, tmp_path: Path) -> None:
    ask(chain, [0, 2, 0])
    chain.until_placed(cell=PLACE, name='tree', worth=10.0)
    journal = tmp_path / 'uav_mission_manager' / 'state' / 'mavlink_bridge.journal'
    chain.ros.until(lambda: 'built.goals1' in journal.read_text(), "the bridge's journal")
    chain.until_in_the_air()
    for process in chain.solver, chain.bridge, chain.manager:
        killed(process)
    chain.start_bridge()
    chain.start_manager()
    chain.ros.until(lambda: chain.manager.lines('.goals1'), 'the next manager')
    for goal in 'goal2', 'tree':
        chain.until_done(goal)
    assert chain.nearest(PLACE) < Settings().acceptance_radius


def test_a_manager_that_forgot_wants_no_old_request(chain: Chain, tmp_path: Path) -> None:
    ask(chain, [0, 1, 0])
    chain.until_placed(cell=PLACE, name='tree')
    killed(chain.manager)
    (tmp_path / 'uav_mission_manager' / 'state' / 'manager.journal').unlink()
    chain.goals.clear()
    chain.start_manager()
    chain.ros.until(lambda: chain.manager.lines('goals tree, not wanted'), 'take-over')
    chain.ros.until(lambda: chain.goals, 'goal_states')
    assert all(message.data[2] == 0 for message in chain.goals)


def test_where_no_slot_is_free_a_goal_is_added_and_the_base_station_learns_of_it(
    ros: Ros, tmp_path: Path
) -> None:
    chain = Chain(ros, tmp_path, slot=False)
    ask(chain, [0, 2, 0])
    chain.until_placed(cell=PLACE, name='tree', priority=1)
    assert f'goal tree in cell {PLACE}, added: ' in chain.solver.lines('goal tree')[0]

    def wished(priorities: list[int]) -> bool:
        return chain.ros.set_parameter('base_station', 'priorities', priorities).successful

    def held(priorities: list[int]) -> bool:
        return any(list(message.data) == priorities for message in chain.goals)

    ros.until(lambda: held([0, 2, 0, 1]) or held([0, 0, 0, 1]), 'the goal as requested')
    ros.until(lambda: wished([0, 0, 0, 2]), 'a base station that knows')
    ros.until(lambda: held([0, 0, 0, 2]), 'what was asked for')
    assert not wished([0, 1])
    assert not wished([0, 1, 0, 2, 1])
    chain.until_in_the_air()
    for process in chain.bridge, chain.base:
        killed(process)
    chain.start_bridge()
    chain.start_base()
    chain.asked.clear()
    ros.until(lambda: chain.asked and len(chain.asked[-1].data) == 4, 'the next base station')
    chain.until_wanted([0, 0, 0, 0])
    assert chain.nearest(PLACE) < Settings().acceptance_radius
