"""Where nodes keep their journals."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from strategies import case_study

from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.nodes.memory import POWER_ON_TIME, moment, open_journal, time_here

MISSION = mission_from_dict(case_study(1), 'test')


def node(namespace='/'):
    return SimpleNamespace(get_namespace=lambda: namespace)


def places(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob('*.journal'))


def test_every_vehicle_and_node_has_a_journal_of_its_own(tmp_path):
    for namespace in ('/', '/uav1', '/field/uav2'):
        for kind in ('manager', 'base_station'):
            journal = open_journal(node(namespace), str(tmp_path), kind, MISSION)
            journal.write({'where': namespace, 'who': kind})
            assert journal.error == ''
            journal.close()
    names = ('base_station.journal', 'manager.journal')
    assert places(tmp_path) == sorted(
        f'{folder}{name}' for folder in ('', 'uav1/', 'field/uav2/') for name in names
    )
    read = open_journal(node('/uav1'), str(tmp_path), 'manager', MISSION).read()
    assert read.state == {'where': '/uav1', 'who': 'manager'}


@pytest.mark.parametrize(('variable', 'below'), [('ROS_HOME', ''), ('HOME', '.ros')])
def test_it_is_in_the_home_of_ros(tmp_path, monkeypatch, variable, below):
    monkeypatch.delenv('ROS_HOME', raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    journal = open_journal(node('/uav1'), '', 'manager', MISSION)
    journal.write({})
    journal.close()
    assert places(tmp_path / below) == ['uav_mission_manager/state/uav1/manager.journal']


def test_a_place_that_cannot_be_is_told_by_the_parameters_name(tmp_path, monkeypatch):
    (tmp_path / 'file').touch()
    with pytest.raises(ValueError, match=r'parameter state_dir: .*file'):
        open_journal(node(), str(tmp_path / 'file'), 'manager', MISSION)
    monkeypatch.setenv('ROS_HOME', '$NO_SUCH_VARIABLE/x')
    with pytest.raises(ValueError, match=r'parameter state_dir: .*\$NO_SUCH_VARIABLE is not set'):
        open_journal(node(), '', 'manager', MISSION)
    monkeypatch.setenv('ROS_HOME', '')
    monkeypatch.setenv('HOME', '')
    with pytest.raises(ValueError, match='parameter state_dir: not given, and neither ROS_HOME'):
        open_journal(node(), '', 'manager', MISSION)


def test_times_of_this_boot_are_known_others_end_when_the_vehicle_was_switched_on():
    assert time_here(moment(123.0)) == 123.0
    assert time_here({**moment(123.0), 'boot': 'another'}) == -POWER_ON_TIME < 0.0
