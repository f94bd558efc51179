"""The launch files' own logic, with stand-ins for the launch packages that pip has not got."""

from __future__ import annotations

import itertools
import runpy
import shutil
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
import yaml

from uav_mission_manager.fleet import FleetSettings
from uav_mission_manager.nodes import fleet as fleet_node
from uav_mission_manager.paths import share_directory

SHARE = share_directory()
LAUNCH_FILES = sorted((SHARE / 'launch').glob('*.launch.py'))
PACKAGES = (
    'launch',
    'launch.actions',
    'launch.conditions',
    'launch.launch_description_sources',
    'launch.substitutions',
    'launch_ros',
    'launch_ros.actions',
    'launch_ros.parameter_descriptions',
    'launch_ros.substitutions',
)


@pytest.fixture
def stand_ins(monkeypatch):
    for name in PACKAGES:
        monkeypatch.setitem(sys.modules, name, MagicMock())
    actions = sys.modules['launch.actions']
    sys.modules['launch_ros.actions'].Node = lambda **arguments: arguments
    actions.ExecuteProcess = lambda **arguments: arguments
    actions.IncludeLaunchDescription = lambda source, launch_arguments: (source, launch_arguments)
    sources = sys.modules['launch.launch_description_sources']
    sources.PythonLaunchDescriptionSource = lambda path: path
    parameters = sys.modules['launch_ros.parameter_descriptions']
    parameters.ParameterValue = lambda value, value_type: value_type(value)
    sys.modules['launch.conditions'].IfCondition = lambda value: SimpleNamespace(
        evaluate=lambda arguments: value.perform(arguments) == 'true'
    )
    used = set()

    def configuration(name: str) -> SimpleNamespace:
        used.add(name)
        return SimpleNamespace(perform=lambda arguments: arguments[name])

    sys.modules['launch.substitutions'].LaunchConfiguration = configuration
    return used


@pytest.fixture
def launch_file(stand_ins):
    return runpy.run_path(str(SHARE / 'launch' / 'mission.launch.py'))


@pytest.fixture
def bringup(stand_ins):
    return runpy.run_path(str(SHARE / 'launch' / 'bringup.launch.py'))


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
    """Return what is started with the given arguments, by name, also by a file it includes."""
    arguments = {**defaults(launch_file), **given}
    if 'nodes' in launch_file:
        return {node['executable']: node for node in launch_file['nodes'](arguments)}
    [(path, passed)] = launch_file['bringup'](arguments)
    included = runpy.run_path(path)
    assert dict(passed).keys() <= included['ARGUMENTS'].keys()
    return launched(included, **dict(passed))


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


def test_a_simulation_remembers_nothing_of_the_one_before(launch_file, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))

    def places(**given: str) -> set[str]:
        nodes = launched(launch_file, **given)
        return {node['parameters'][-1].get('state_dir', '') for node in nodes.values()}

    assert places() == {''}
    first, second = (places(simulate='true') for _ in range(2))
    assert len(first) == len(second) == 1
    assert '' not in first
    assert first != second


@pytest.fixture
def fleet(stand_ins):
    return runpy.run_path(str(SHARE / 'launch' / 'fleet.launch.py'))


def crafts(fleet, **given: str) -> list[dict[str, dict]]:
    """Return what is started of each vehicle, by name."""
    found = []
    for path, passed in fleet['crafts']({**defaults(fleet), **given}):
        included = runpy.run_path(path)
        assert dict(passed).keys() <= included['ARGUMENTS'].keys()
        found.append(launched(included, **dict(passed)))
    return found


def test_the_vehicles_of_a_fleet_share_nothing_but_their_station(fleet):
    vehicles = crafts(fleet, vehicles='4')
    assert [set(nodes) for nodes in vehicles] == [{'manager', 'mavlink_bridge'}] * 4
    bridges = [nodes['mavlink_bridge'] for nodes in vehicles]
    assert [bridge['namespace'] for bridge in bridges] == ['uav1', 'uav2', 'uav3', 'uav4']
    own = [bridge['parameters'][-1] for bridge in bridges]
    assert len({values['connection'] for values in own}) == 4
    assert [values['target_system'] for values in own] == [1, 2, 3, 4]
    heights = [values['flight_altitude'] for values in own]
    assert min(b - a for a, b in itertools.pairwise(heights)) >= FleetSettings().separation
    [station] = fleet['station']({**defaults(fleet), 'vehicles': '4'})
    assert station['executable'] == 'fleet'
    known = {row.name for row in fleet_node.PARAMETERS}
    assert station['parameters'][-1].keys() <= known
    assert station['parameters'][-1]['vehicles'] == ['uav1', 'uav2', 'uav3', 'uav4']


def test_a_simulated_fleet_remembers_nothing_and_can_fly(fleet, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    [station] = fleet['station']({**defaults(fleet), 'simulate': 'true'})
    places = {station['parameters'][-1]['state_dir']}
    for nodes in crafts(fleet, simulate='true'):
        places |= {nodes['manager']['parameters'][-1]['state_dir']}
    assert len(places) == 4
    mission = runpy.run_path(str(SHARE / 'launch' / 'mission.launch.py'))
    given = {name: defaults(fleet)[name] for name in ('mission', 'policy')}
    mission['one_mission']({**defaults(mission), **given})


@pytest.mark.parametrize('vehicles', ['0', '256', 'two', ''])
def test_what_is_no_number_of_vehicles_is_refused(fleet, vehicles):
    with pytest.raises(RuntimeError, match='is not a number from 1 to 255'):
        crafts(fleet, vehicles=vehicles)


@pytest.mark.parametrize('system', ['0', '256', '-1', 'two', '1.0', ''])
def test_what_is_no_system_id_is_refused(launch_file, system):
    with pytest.raises(RuntimeError, match='is not a MAVLink system id, 1 to 255'):
        launched(launch_file, system=system)


def test_the_nodes_and_the_simulator_are_part_of_the_launch(launch_file):
    launch_file['generate_launch_description']()
    calls = sys.modules['launch.actions'].OpaqueFunction.mock_calls
    functions = [call.kwargs['function'] for call in calls]
    names = ('one_mission', 'bringup', 'simulated_autopilot')
    assert functions == [launch_file[name] for name in names]


def test_bringup_leaves_to_the_params_file_what_is_not_given(bringup):
    nodes = launched(bringup)
    assert list(nodes) == ['base_station', 'manager', 'mavlink_bridge']
    for node in nodes.values():
        assert node['parameters'] == [str(SHARE / 'config' / 'nodes.yaml'), {}]
        assert node['namespace'] == ''
        assert node['respawn']
        assert node['respawn_delay'] > 0.0


def test_bringup_gives_each_node_its_own_parameters_in_their_types(bringup):
    given = {
        'namespace': 'a/b',
        'params_file': '/my.yaml',
        'use_respawn': 'False',
        'autostart': 'false',
        'use_sim_time': 'true',
        'mission': '/m.yaml',
        'policy': '/p',
        'connection': 'tcp:10.0.0.1:5760',
        'system': '3',
        'allow_arming': 'true',
        'flight_altitude': '35',
        'state_dir': '/s',
        'bag': '/b',
    }
    nodes = launched(bringup, **given)
    assert {node['namespace'] for node in nodes.values()} == {'a/b'}
    assert {node['respawn'] for node in nodes.values()} == {False}
    files, own = zip(*(node['parameters'] for node in nodes.values()))
    assert set(files) == {'/my.yaml'}
    assert dict(zip(nodes, own)) == {
        'base_station': {'mission': '/m.yaml', 'state_dir': '/s', 'use_sim_time': True},
        'manager': {'policy': '/p', 'state_dir': '/s', 'autostart': False, 'use_sim_time': True},
        'mavlink_bridge': {
            'mission': '/m.yaml',
            'connection': 'tcp:10.0.0.1:5760',
            'target_system': 3,
            'allow_arming': True,
            'flight_altitude': 35.0,
            'state_dir': '/s',
            'autostart': False,
            'use_sim_time': True,
        },
        'mission_record': {'bag': '/b'},
    }


@pytest.mark.parametrize(
    'given',
    [
        *({'system': 'two'}, {'allow_arming': 'yes'}, {'use_respawn': '1'}, {'rviz': 'yes'}),
        *({'flight_altitude': 'high'}, {'base_station': 'no'}),
    ],
)
def test_bringup_refuses_what_is_no_value(bringup, given):
    with pytest.raises(RuntimeError, match=next(iter(given))):
        [*launched(bringup, **given), *watched(bringup, **given)]


def test_what_the_launch_files_give_to_nodes_are_parameters_of_theirs(bringup):
    for executable, names in bringup['NODES'].items():
        module = import_module(f'uav_mission_manager.nodes.{executable}')
        known = {row.name for row in module.PARAMETERS} | {'use_sim_time'}
        assert {bringup['PARAMETER_NAMES'].get(name, name) for name in names} <= known


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda path: path.name)
def test_a_launch_file_declares_the_arguments_it_uses_and_starts_commands(stand_ins, path):
    parameters = sys.modules['launch_ros.parameter_descriptions']
    parameters.ParameterValue = lambda value, value_type: value
    actions = sys.modules['launch.actions']
    started = []
    for place in (actions, sys.modules['launch_ros.actions']):
        name = 'ExecuteProcess' if place is actions else 'Node'
        setattr(place, name, lambda **arguments: started.append(arguments))
    launch_file = runpy.run_path(str(path))
    launch_file['generate_launch_description']()
    for call in actions.OpaqueFunction.mock_calls:
        call.kwargs['function'](defaults(launch_file))
    assert stand_ins == set(launch_file['ARGUMENTS'])
    commands = {path.name for path in (SHARE / 'resource' / 'bin').iterdir()}
    own = [node for node in started if node.get('package') == 'uav_mission_manager']
    assert {node['executable'] for node in own} <= commands
    assert len(own) == len(started) - sum('cmd' in process for process in started)


def watched(launch_file, **given: str) -> dict[str, dict]:
    nodes = launch_file['viewers']({**defaults(launch_file), **given})
    return {node['package']: node for node in nodes}


def test_nobody_watches_unless_asked(bringup):
    assert watched(bringup) == {}


def test_rviz_shows_the_vehicle_of_the_namespace(bringup):
    [rviz] = watched(bringup, rviz='true', namespace='uav2').values()
    assert (rviz['package'], rviz['executable']) == ('rviz2', 'rviz2')
    assert rviz['namespace'] == 'uav2'
    option, path = rviz['arguments']
    assert option == '-d'
    shown = yaml.safe_load(Path(path).read_text())['Visualization Manager']['Displays']
    absolute = {display['Topic']['Value'] for display in shown if 'Topic' in display}
    # Relative names are in the namespace.
    assert dict(rviz['remappings']) == {topic: topic.removeprefix('/') for topic in absolute}


def test_foxglove_is_heard_on_this_machine_alone(bringup):
    [bridge] = watched(bringup, foxglove='true', namespace='uav2').values()
    assert (bridge['package'], bridge['executable']) == ('foxglove_bridge',) * 2
    assert bridge['parameters'] == [{'address': '127.0.0.1', 'port': 8765}]


def test_the_simulation_can_be_watched_too(launch_file):
    [(path, passed)] = launch_file['bringup']({**defaults(launch_file), 'rviz': 'true'})
    included = runpy.run_path(path)
    [rviz] = watched(included, **dict(passed)).values()
    assert (rviz['package'], rviz['namespace']) == ('rviz2', 'uav1')
