"""What nodes make of names and paths that they are given."""

from __future__ import annotations

import itertools
from importlib import import_module

import pytest
import yaml

from uav_mission_manager.likeness import likeness, nearest
from uav_mission_manager.nodes.ending import NODES, node_run
from uav_mission_manager.nodes.overrides import MISSPELT, given_to_all
from uav_mission_manager.paths import expanded, share_directory

NAMES = {
    node: {row.name for row in import_module(f'uav_mission_manager.nodes.{node}').PARAMETERS}
    for node in NODES
}


@pytest.mark.parametrize(('one', 'other'), list(itertools.permutations(NODES, 2)))
def test_no_parameter_of_a_node_passes_for_a_misspelt_one_of_another(one, other):
    foreign = NAMES[one] - NAMES[other]
    pairs = itertools.product(foreign, NAMES[other] | {'priorities', 'use_sim_time'})
    assert [pair for pair in pairs if likeness(*pair) > MISSPELT] == []


@pytest.mark.parametrize(
    ('name', 'meant'),
    [
        ('polcy', 'policy'),
        ('misson', 'mission'),
        ('cruise_sped', 'cruise_speed'),
        ('allowarming', 'allow_arming'),
    ],
)
def test_misspelt_names_are_like_those_that_are_meant(name, meant):
    assert likeness(name, meant) > MISSPELT
    assert nearest(name, set().union(*NAMES.values())) == meant


def test_the_shipped_params_file_has_parameters_of_its_nodes_only():
    text = (share_directory() / 'config' / 'nodes.yaml').read_text()
    for key, value in yaml.safe_load(text).items():
        assert set(value['ros__parameters']) <= NAMES[key.removeprefix('/**/')]


@pytest.mark.parametrize(
    ('text', 'names'),
    [
        ('/**: {ros__parameters: {a: 1, b: {c: 2}}}', {'a', 'b.c'}),
        ('/uav1/*: {ros__parameters: {a: 1}}', {'a'}),
        ('uav1: {"*": {ros__parameters: {a: 1}}}', {'a'}),
        ('/**/manager: {ros__parameters: {a: 1}}', set()),
        ('"/**": {manager: {ros__parameters: {a: 1}}}', set()),
        ('/**: {ros__parameters: {given: 1}}', set()),
        ('[1, 2', set()),
        ('', set()),
    ],
)
def test_what_a_file_gives_to_all_nodes(tmp_path, text, names):
    file = tmp_path / 'params.yaml'
    file.write_text(text)
    arguments = ['--ros-args', '--params-file', str(file), '-p', 'given:=2']
    assert given_to_all(arguments) == names
    assert given_to_all(['--params-file', str(tmp_path / 'none.yaml')]) == set()


def test_a_path_is_what_a_shell_makes_of_it(monkeypatch):
    monkeypatch.setenv('HOME', '/home/pilot')
    monkeypatch.setenv('FIELD', 'north')
    paths = ('~/a', '$HOME/a', '/x/${FIELD}.yaml', 'a b/~c', '/x/$')
    wanted = ['/home/pilot/a', '/home/pilot/a', '/x/north.yaml', 'a b/~c', '/x/$']
    assert [str(expanded(path)) for path in paths] == wanted


@pytest.mark.parametrize('path', ['$NO_SUCH/a', '/x/${NO_SUCH}', '~no_such_user/a'])
def test_a_path_that_no_shell_knows_is_refused(path):
    with pytest.raises(ValueError, match=r'no_such|NO_SUCH'):
        expanded(path)


@pytest.mark.parametrize(
    ('program', 'started_as', 'node'),
    [
        ('/usr/lib/uav_mission_manager/manager', [], 'manager'),
        ('-m', ['python3', '-X', 'dev', '-m', 'uav_mission_manager.nodes.solver', '-m'], 'solver'),
        ('-m', ['python3', '-m', 'pytest', 'manager'], ''),
        ('-m', ['python3', '-m', 'uav_mission_manager.cli.demo'], ''),
        ('/usr/bin/pytest', [], ''),
        ('', [], ''),
    ],
)
def test_a_node_knows_that_it_is_the_program(monkeypatch, program, started_as, node):
    monkeypatch.setattr('sys.argv', [program])
    monkeypatch.setattr('sys.orig_argv', started_as)
    assert node_run() == node
