"""Imports run one way: mdp <- solver <- policy <- onboard <- nodes, cli; autopilot is beside."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = 'uav_mission_manager'
# Layer -> what it may import of this package, and of the ROS and MAVLink worlds.
ALLOWED = {
    'mdp': set(),
    'solver': {'mdp'},
    'policy': {'mdp', 'solver'},
    'onboard': {'mdp', 'solver', 'policy'},
    'autopilot': {'pymavlink'},
    'nodes': {'mdp', 'solver', 'policy', 'onboard', 'autopilot', 'ros'},
    'cli': {'mdp', 'solver', 'policy', 'onboard', 'autopilot', 'nodes', 'ros', 'pymavlink'},
}
ROS = {'rclpy', 'ament_index_python', 'builtin_interfaces', 'rcl_interfaces', 'std_srvs'}
MODULES = sorted((ROOT / PACKAGE).glob('*/**/*.py'))


def imports(path: Path) -> set[str]:
    """Return the full names of all that the module at `path` imports, also inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = path.relative_to(ROOT).with_suffix('').parts[:-node.level or None]
            base = '.'.join(base) if node.level else ''
            module = '.'.join(filter(None, (base, node.module)))
            names |= {f'{module}.{alias.name}' for alias in node.names}
    return names


def layer(name: str) -> str | None:
    """Return the layer or outer world an imported name belongs to; None if it is neither."""
    head, _, rest = name.partition('.')
    if head == PACKAGE:
        part = rest.partition('.')[0]
        if part == 'paths':
            return None
        return part if part in ALLOWED else 'policy'  # What __init__ exports is policy's.
    if head in ROS or head.endswith('_msgs'):
        return 'ros'
    return 'pymavlink' if head == 'pymavlink' else None


@pytest.mark.parametrize('path', MODULES, ids=lambda p: str(p.relative_to(ROOT / PACKAGE)))
def test_imports_run_one_way(path):
    own = path.relative_to(ROOT / PACKAGE).parts[0]
    used = {layer(name) for name in imports(path)} - {None, own}
    assert used <= ALLOWED[own]


def test_every_layer_is_checked():
    assert {path.relative_to(ROOT / PACKAGE).parts[0] for path in MODULES} == set(ALLOWED)


@pytest.mark.parametrize(('line', 'expected'), [
    ('import rclpy.node', 'ros'),
    ('from sensor_msgs.msg import BatteryState', 'ros'),
    ('from pymavlink import mavutil', 'pymavlink'),
    ('from uav_mission_manager import nodes', 'nodes'),
    ('from uav_mission_manager.policy import Policy', 'policy'),
    ('from uav_mission_manager import build_policy', 'policy'),
    ('from uav_mission_manager.paths import share_directory', None),
    ('from ..solver import bellman', 'solver'),
    ('from .states import StateSpace', 'mdp'),
    ('def f():\n    import rclpy', 'ros'),
    ('import numpy', None),
])
def test_layer_of_an_import(line, expected, tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), 'ROOT', tmp_path)
    path = tmp_path / PACKAGE / 'mdp' / 'probe.py'
    path.parent.mkdir(parents=True)
    path.write_text(line)
    assert {layer(name) for name in imports(path)} == {expected}
