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


def test_the_check_is_part_of_the_launch(launch_file):
    launch_file['generate_launch_description']()
    action = sys.modules['launch.actions'].OpaqueFunction
    assert launch_file['one_mission'] in [call.kwargs['function'] for call in action.mock_calls]
