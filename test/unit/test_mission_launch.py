"""The launch file's own logic, with stand-ins for the launch packages that pip has not got."""

from __future__ import annotations

import runpy
import shutil
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from uav_mission_manager.paths import share_directory

SHARE = share_directory()
PACKAGES = (
    'launch',
    'launch.actions',
    'launch.conditions',
    'launch.substitutions',
    'launch_ros',
    'launch_ros.actions',
    'launch_ros.parameter_descriptions',
    'launch_ros.substitutions',
)


@pytest.fixture
def launch_file(monkeypatch):
    for name in PACKAGES:
        monkeypatch.setitem(sys.modules, name, MagicMock())
    sys.modules['launch_ros.actions'].Node = lambda **arguments: arguments
    sys.modules['launch.actions'].ExecuteProcess = lambda **arguments: arguments
    sys.modules['launch_ros.parameter_descriptions'].ParameterValue = lambda value, **_: value
    sys.modules['launch.substitutions'].LaunchConfiguration = lambda name: SimpleNamespace(
        perform=lambda arguments: arguments[name]
    )
    return runpy.run_path(str(SHARE / 'launch' / 'mission.launch.py'))


def defaults(launch_file) -> dict[str, str]:
    return {name: default for name, (default, _) in launch_file['ARGUMENTS'].items()}


def test_the_defaults_are_one_mission(launch_file):
    launch_file['one_mission'](defaults(launch_file))


def test_a_mission_without_its_policy_is_refused(launch_file, tmp_path):
    other = tmp_path / 'other.yaml'
    shutil.copy(SHARE / 'config' / 'case_study.yaml', other)
    arguments = {**defaults(launch_file), 'mission': str(other)}
    launch_file['one_mission'](arguments)
    other.write_text(other.read_text().replace('discount: ', 'discount: 0.5 # '))
    with pytest.raises(RuntimeError, match='was not built from mission'):
        launch_file['one_mission'](arguments)


def test_paths_may_have_a_home_and_variables(launch_file, monkeypatch):
    monkeypatch.setenv('HOME', str(SHARE / 'config'))
    monkeypatch.setenv('SHARE', str(SHARE))
    given = {'mission': '~/case_study.yaml', 'policy': '$SHARE/policies/case_study'}
    launch_file['one_mission']({**defaults(launch_file), **given})
    assert simulator(launch_file, **given) == simulator(launch_file)


def launched(launch_file, **given: str) -> dict[str, dict]:
    """Return what is started with the given arguments, by name."""
    arguments = {**defaults(launch_file), **given}
    return {node['executable']: node for node in launch_file['nodes'](arguments)}


def simulator(launch_file, **given: str) -> list[str]:
    [process] = launch_file['simulated_autopilot']({**defaults(launch_file), **given})
    return process['cmd']


@pytest.mark.parametrize(
    ('given', 'namespace', 'connection', 'system'),
    [
        ({}, 'uav1', 'udpin:127.0.0.1:14550', 1),
        ({'system': '2'}, 'uav2', 'udpin:127.0.0.1:14560', 2),
        ({'system': '255'}, 'uav255', 'udpin:127.0.0.1:17090', 255),
        ({'system': '2', 'namespace': 'a'}, 'a', 'udpin:127.0.0.1:14560', 2),
        ({'system': '2', 'connection': 'tcp:10.0.0.1:5760'}, 'uav2', 'tcp:10.0.0.1:5760', 2),
    ],
)
def test_every_system_has_a_namespace_and_a_port_of_its_own(
    launch_file, given, namespace, connection, system
):
    nodes = launched(launch_file, **given)
    assert set(nodes) == {'base_station', 'manager', 'mavlink_bridge'}
    assert {node['namespace'] for node in nodes.values()} == {namespace}
    own = nodes['mavlink_bridge']['parameters'][-1]
    assert (own['connection'], own['target_system']) == (connection, system)
    command = simulator(launch_file, **given)
    assert command[command.index('--connection') + 1] == connection.replace('udpin', 'udpout')
    assert f'--system-id={system}' in command


@pytest.mark.parametrize('system', ['0', '256', '-1', 'two', '1.0', ''])
def test_what_is_no_system_id_is_refused(launch_file, system):
    with pytest.raises(RuntimeError, match='is not a MAVLink system id, 1 to 255'):
        launched(launch_file, system=system)


def test_the_nodes_and_the_simulator_are_part_of_the_launch(launch_file):
    launch_file['generate_launch_description']()
    calls = sys.modules['launch.actions'].OpaqueFunction.mock_calls
    functions = [call.kwargs['function'] for call in calls]
    names = ('one_mission', 'nodes', 'simulated_autopilot')
    assert functions == [launch_file[name] for name in names]
