"""The life cycle of a node, through the services that Nav2's manager and `ros2 lifecycle` call."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from flights import SHIPPED, Flight
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from ros_helpers import Ros
from std_msgs.msg import String

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.ending import ENDING_SIGNALS
from uav_mission_manager.nodes.lifecycle import AUTOSTART, ManagedNode
from uav_mission_manager.nodes.parameters import declare

UP = [Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE]
DOWN = [Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP]


class Probe(ManagedNode):
    """Latches a word when active, notes its transitions, and fails in those it is told to."""

    def __init__(self) -> None:
        super().__init__('probe')
        declare(self, (AUTOSTART,))
        self.done: list[str] = []
        self.failing: dict[str, Exception] = {}

    def _do(self, what: str) -> None:
        self.done.append(what)
        if what in self.failing:
            raise self.failing[what]

    def configure(self) -> None:
        self.create_subscription(String, 'heard', lambda _: None, qos.EVENT)
        self._do('configure')

    def activate(self) -> None:
        self.create_publisher(
            String, 'word', qos.LATCHED, qos_overriding_options=qos.OVERRIDABLE
        ).publish(String(data='latched'))
        self.create_timer(1.0, lambda: None)
        self._do('activate')

    def deactivate(self) -> None:
        self._do('deactivate')

    def cleanup(self) -> None:
        self._do('cleanup')


@pytest.fixture
def probe(ros: Ros) -> Iterator[Callable[..., Probe]]:
    executors, nodes = [], []

    def made(autostart: bool = False) -> Probe:
        words = ['--ros-args', '-p', f'{AUTOSTART.name}:={autostart}'.lower()]
        rclpy.init(args=words, domain_id=ros.domain)
        executors.append(executor := SingleThreadedExecutor())
        nodes.append(node := Probe())
        executor.add_node(node)
        ros.node.create_timer(0.005, lambda: executor.spin_once(timeout_sec=0.0))
        node.start()
        return node

    yield made
    for executor in executors:
        executor.shutdown()
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def change(ros: Ros, *transitions: int, node: str = 'probe') -> list[bool]:
    return [
        ros.call(
            f'{node}/change_state',
            ChangeState.Request(transition=Transition(id=transition)),
            ChangeState,
        ).success
        for transition in transitions
    ]


def state(ros: Ros) -> int:
    return int(ros.call('probe/get_state', GetState.Request(), GetState).current_state.id)


def created(node: Probe) -> tuple[int, int, int]:
    return tuple(len(list(n)) for n in (node.subscriptions, node.publishers, node.timers))


def test_every_transition_there_and_back_twice(ros: Ros, probe: Callable[..., Probe]) -> None:
    node = probe()
    assert state(ros) == State.PRIMARY_STATE_UNCONFIGURED
    before = created(node)
    for _ in range(2):
        assert change(ros, Transition.TRANSITION_CONFIGURE) == [True]
        assert state(ros) == State.PRIMARY_STATE_INACTIVE
        configured = created(node)
        assert configured == (before[0] + 1, *before[1:])
        for _ in range(2):
            assert not node.active
            assert change(ros, Transition.TRANSITION_ACTIVATE) == [True]
            assert state(ros) == State.PRIMARY_STATE_ACTIVE
            assert node.active
            assert created(node) == (before[0] + 1, before[1] + 1, before[2] + 1)
            assert change(ros, Transition.TRANSITION_DEACTIVATE) == [True]
            assert created(node) == configured
        assert change(ros, Transition.TRANSITION_CLEANUP) == [True]
        assert state(ros) == State.PRIMARY_STATE_UNCONFIGURED
        assert created(node) == before
    cycle = ['configure', *['activate', 'deactivate'] * 2, 'cleanup']
    assert node.done == cycle * 2


def test_an_inactive_node_has_nothing_latched(ros: Ros, probe: Callable[..., Probe]) -> None:
    probe()
    assert all(change(ros, *UP))
    early = ros.listen('word', String, qos.LATCHED)
    ros.until(lambda: early, 'the latched word')
    assert all(change(ros, Transition.TRANSITION_DEACTIVATE))
    late = ros.listen('word', String, qos.LATCHED)
    ros.spin(1.0)
    assert late == []


def test_autostart_configures_and_activates(ros: Ros, probe: Callable[..., Probe]) -> None:
    assert probe(autostart=True).active
    assert state(ros) == State.PRIMARY_STATE_ACTIVE


@pytest.mark.parametrize('error', [ValueError('no such file'), KeyError('a fault')])
@pytest.mark.parametrize('failing', ['configure', 'activate'])
def test_a_step_up_that_fails_is_undone(
    ros: Ros, probe: Callable[..., Probe], failing: str, error: Exception
) -> None:
    node = probe()
    before = created(node)
    node.failing[failing] = error
    results = change(ros, *UP[: 1 + (failing == 'activate')])
    assert results == [True] * (failing == 'activate') + [False]
    if failing == 'configure':
        assert state(ros) == State.PRIMARY_STATE_UNCONFIGURED
        assert (created(node), node.done) == (before, ['configure', 'cleanup'])
    else:
        assert state(ros) == State.PRIMARY_STATE_INACTIVE
        assert created(node) == (before[0] + 1, *before[1:])
        assert node.done[-2:] == ['activate', 'deactivate']
    node.failing.clear()
    assert all(change(ros, *UP[failing == 'activate' :]))
    assert node.active


def test_autostart_says_what_failed(probe: Callable[..., Probe], monkeypatch) -> None:
    def activate(_: Probe) -> None:
        raise ValueError('no such port')

    monkeypatch.setattr(Probe, 'activate', activate)
    with pytest.raises(ValueError, match='no such port'):
        probe(autostart=True)


@pytest.mark.parametrize('failing', ['deactivate', 'cleanup'])
def test_a_step_down_that_fails_leaves_nothing_behind(
    ros: Ros, probe: Callable[..., Probe], failing: str
) -> None:
    node = probe()
    before = created(node)
    assert all(change(ros, *UP))
    node.failing[failing] = OSError('it will not close')
    results = change(ros, *DOWN[: 1 + (failing == 'cleanup')])
    assert not results[-1]
    assert not node.active
    assert state(ros) == State.PRIMARY_STATE_UNCONFIGURED
    assert created(node) == before
    node.failing.clear()
    assert all(change(ros, *UP))


@pytest.mark.parametrize('transitions', [[], UP[:1], UP])
def test_shutdown_from_every_state(
    ros: Ros, probe: Callable[..., Probe], transitions: list[int]
) -> None:
    node = probe()
    before = created(node)
    assert all(change(ros, *transitions))
    shutdown = (
        Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
        Transition.TRANSITION_INACTIVE_SHUTDOWN,
        Transition.TRANSITION_ACTIVE_SHUTDOWN,
    )[len(transitions)]
    assert change(ros, shutdown) == [True]
    assert state(ros) == State.PRIMARY_STATE_FINALIZED
    assert created(node) == before
    assert not node.active


@pytest.mark.parametrize('transition', [Transition.TRANSITION_CONFIGURE, 99, 255])
def test_a_transition_that_there_is_not_changes_nothing(
    ros: Ros, probe: Callable[..., Probe], transition: int
) -> None:
    node = probe(autostart=True)
    assert change(ros, transition) == [False]
    assert state(ros) == State.PRIMARY_STATE_ACTIVE
    assert node.active


def test_the_end_of_a_node_undoes_what_it_has_begun(ros: Ros, probe: Callable[..., Probe]) -> None:
    node = probe(autostart=True)
    node.destroy_node()
    assert node.done == ['configure', 'activate', 'deactivate', 'cleanup']


def test_a_manager_commands_while_it_is_active(ros: Ros) -> None:
    flight = Flight(ros)
    manager = flight.start('-p', 'autostart:=false')
    ros.spin(1.0)
    assert flight.diagnostics == []
    assert change(ros, *UP, node='manager') == [True, True]
    flight.until_asked([2, 0, 0], 'a')
    flight.until_command('commit goal1 normal')
    assert change(ros, DOWN[0], node='manager') == [True]
    ros.spin(1.0)  # What was under way.
    said = len(flight.commands)
    late = ros.listen('mission_command', String, qos.LATCHED)
    ros.spin(2.0)
    assert (len(flight.commands), late) == (said, [])
    flight.commands.clear()
    assert change(ros, *DOWN[1:], *UP, node='manager') == [True, True, True]
    ros.until(lambda: flight.commands, 'a command')
    assert flight.commands[0].data == 'commit goal1 normal'
    assert manager.lines('WARN') == manager.lines('threat_level: never heard')


def test_a_manager_that_cannot_be_configured_says_why_and_may_be_later(
    ros: Ros, tmp_path: Path
) -> None:
    manager = ros.start(
        'nodes.manager', '--ros-args', '-p', f'policy:={tmp_path}/p', '-p', 'autostart:=false'
    )
    assert change(ros, UP[0], node='manager') == [False]
    [line] = manager.lines('ERROR')
    assert f'{tmp_path}/p' in line
    shutil.copytree(SHIPPED, tmp_path / 'p')
    assert change(ros, *UP, node='manager') == [True, True]


@pytest.mark.parametrize('number', ENDING_SIGNALS)
@pytest.mark.parametrize('transitions', [[], UP[:1], [*UP, DOWN[0]], [*UP, *DOWN]])
def test_a_signal_ends_a_manager_in_every_state(
    ros: Ros, transitions: list[int], number: int
) -> None:
    manager = Flight(ros).start('-p', 'autostart:=false')
    assert all(change(ros, *transitions, node='manager'))
    ros.until(lambda: 'manager' in ros.node.get_node_names(), 'the node')
    assert manager.stop(number) == 0
    assert 'Traceback' not in manager.output
