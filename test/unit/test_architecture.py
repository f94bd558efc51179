"""Imports run one way: mdp <- solver <- policy <- onboard <- nodes, cli; autopilot is beside.

Pictures of missions (drawing) are before the console's page, which a node and a command serve.

So they do between the rooms of the solver, which all stand on its ground floor. And no two modules
have one name for two things.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = 'uav_mission_manager'
# Layer -> what it may import of this package, and of the ROS and MAVLink worlds.
ALLOWED = {
    'mdp': set(),
    'solver': {'mdp'},
    'policy': {'mdp', 'solver'},
    'learning': {'mdp', 'solver', 'policy'},
    'onboard': {'mdp', 'solver', 'policy'},
    'fleet': {'mdp', 'solver', 'policy', 'onboard'},
    'autopilot': {'pymavlink'},
    'drawing': {'mdp', 'onboard'},
    'console': {'mdp', 'solver', 'policy', 'onboard', 'autopilot', 'drawing'},
    'nodes': {
        *('mdp', 'solver', 'policy', 'onboard', 'fleet', 'autopilot', 'drawing', 'console'),
        'ros',
    },
    'cli': {
        *('mdp', 'solver', 'policy', 'learning', 'onboard', 'autopilot', 'drawing', 'console'),
        *('nodes', 'ros', 'pymavlink'),
    },
}
# Room of the solver -> what it may import of the others, all of them before it.
ROOMS = {
    'ground floor': set(),
    'exact': {'ground floor'},
    'decomposition': {'ground floor'},
    'bounds': {'ground floor', 'decomposition'},
    'expansion': {'ground floor', 'decomposition'},
    'recombination': {'ground floor', 'exact'},
    'evaluation': {'ground floor', 'exact', 'recombination'},
}
ROS = {'rclpy', 'ament_index_python', 'builtin_interfaces', 'rcl_interfaces', 'std_srvs'}
COMMON_GROUND = {'paths', 'geodesy', 'goal_task', 'echo', 'likeness', 'arguments', 'output'}
"""Modules that import none of the layers and serve all; the earth, and what is done at a
goal, is the autopilot's too."""
MODULES = sorted((ROOT / PACKAGE).glob('*/**/*.py'))
PLAYS_ONE_PART = {'main', 'PARAMETERS'}
"""Names that say a part which many modules play: a command's, and a node's parameters."""


def imports(path: Path) -> set[str]:
    """Return the full names of all that the module at `path` imports, also inside functions."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = path.relative_to(ROOT).with_suffix('').parts[: -node.level or None]
            base = '.'.join(base) if node.level else ''
            module = '.'.join(filter(None, (base, node.module)))
            names |= {f'{module}.{alias.name}' for alias in node.names}
    return names


def layer(name: str) -> str | None:
    """Return the layer or outer world an imported name belongs to; None if it is neither."""
    head, _, rest = name.partition('.')
    if head == PACKAGE:
        part = rest.partition('.')[0]
        if part in COMMON_GROUND:
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


SOLVER = [path for path in MODULES if 'solver' in path.parts]


def room(name: str) -> str | None:
    """Return the solver's room that an imported name belongs to; None if it is none of them."""
    head = f'{PACKAGE}.solver.'
    if not name.startswith(head):
        return None
    part = name.removeprefix(head).partition('.')[0]
    return part if part in ROOMS else 'ground floor'


@pytest.mark.parametrize('path', SOLVER, ids=lambda p: str(p.relative_to(ROOT / PACKAGE)))
def test_rooms_build_on_those_before_them(path):
    *_, own = 'ground floor', *path.relative_to(ROOT / PACKAGE / 'solver').parts[:-1]
    assert {room(name) for name in imports(path)} - {None, own} <= ROOMS[own]


def test_every_room_is_checked_and_comes_after_what_it_needs():
    folders = {path.parent.name for path in SOLVER} - {'solver'}
    assert folders == set(ROOMS) - {'ground floor'}
    for position, needed in enumerate(ROOMS.values()):
        assert needed <= set(list(ROOMS)[:position])


@pytest.mark.parametrize('name', sorted(COMMON_GROUND))
def test_common_ground_stands_on_no_layer(name):
    used = imports(ROOT / PACKAGE / f'{name}.py')
    assert {layer(module) for module in used} == {None}


def test_every_layer_is_checked():
    assert {path.relative_to(ROOT / PACKAGE).parts[0] for path in MODULES} == set(ALLOWED)


@pytest.mark.parametrize(
    ('line', 'expected'),
    [
        ('import rclpy.node', 'ros'),
        ('from sensor_msgs.msg import BatteryState', 'ros'),
        ('from pymavlink import mavutil', 'pymavlink'),
        ('from uav_mission_manager import nodes', 'nodes'),
        ('from uav_mission_manager.policy import Policy', 'policy'),
        ('from uav_mission_manager import build_policy', 'policy'),
        ('from uav_mission_manager.paths import share_directory', None),
        ('from uav_mission_manager.geodesy import Origin', None),
        ('from ..solver import bellman', 'solver'),
        ('from .states import StateSpace', 'mdp'),
        ('def f():\n    import rclpy', 'ros'),
        ('import numpy', None),
    ],
)
def test_layer_of_an_import(line, expected, tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), 'ROOT', tmp_path)
    path = tmp_path / PACKAGE / 'mdp' / 'probe.py'
    path.parent.mkdir(parents=True)
    path.write_text(line)
    assert {layer(name) for name in imports(path)} == {expected}


@pytest.mark.parametrize(
    ('line', 'expected'),
    [
        ('from uav_mission_manager.solver.exact import LookAhead', 'exact'),
        ('from uav_mission_manager.solver.exact.sweep import Sweeper', 'exact'),
        ('from uav_mission_manager.solver import evaluation', 'evaluation'),
        ('from uav_mission_manager.solver import memory', 'ground floor'),
        ('from uav_mission_manager.solver.reduced import ReducedMission', 'ground floor'),
        ('from ..bounds import lower_bound', 'bounds'),
        ('from uav_mission_manager.mdp import Mission', None),
    ],
)
def test_room_of_an_import(line, expected, tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), 'ROOT', tmp_path)
    path = tmp_path / PACKAGE / 'solver' / 'exact' / 'probe.py'
    path.parent.mkdir(parents=True)
    path.write_text(line)
    assert {room(name) for name in imports(path)} == {expected}


def public_names(path: Path) -> set[str]:
    """Return the functions, classes and variables that a module defines for others to use."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            parts = (part for target in targets for part in ast.walk(target))
            names |= {part.id for part in parts if isinstance(part, ast.Name)}
    return {name for name in names if not name.startswith('_')}


def names_of_two_things(paths: list[Path]) -> dict[str, list[str]]:
    """Return the public names that several modules define, with the modules that do."""
    homes: dict[str, list[str]] = {}
    for path in paths:
        for name in public_names(path) - PLAYS_ONE_PART:
            homes.setdefault(name, []).append(path.name)
    return {name: modules for name, modules in sorted(homes.items()) if len(modules) > 1}


def test_every_public_name_is_of_one_thing():
    paths = sorted((ROOT / PACKAGE).rglob('*.py'))
    found = names_of_two_things(paths)
    assert found == {}


@pytest.mark.parametrize(
    ('first', 'second', 'shared'),
    [
        ('class Battery: ...', 'class Battery: ...', ['Battery']),
        ('def run(): ...', 'run = print', ['run']),
        ('A, LIMIT = 1, 2', 'LIMIT: int = 3', ['LIMIT']),
        ('def f():\n    LIMIT = 1', 'LIMIT = 1', []),
        ('from .a import LIMIT', 'LIMIT = 1', []),
        ("_T = TypeVar('T')", "_T = TypeVar('T')", []),
        ('def main(): ...\nPARAMETERS = ()', 'def main(): ...\nPARAMETERS = ()', []),
        ('__all__ = []', '__all__ = []', []),
    ],
)
def test_names_of_two_things_are_found(first, second, shared, tmp_path):
    paths = [tmp_path / 'first.py', tmp_path / 'second.py']
    for path, text in zip(paths, (first, second), strict=True):
        path.write_text(text)
    assert names_of_two_things(paths) == {name: ['first.py', 'second.py'] for name in shared}


def test_the_reference_model_shares_no_code_with_the_package():
    names = imports(ROOT / 'test' / 'brute_force.py')
    assert not any(name.startswith(PACKAGE) for name in names)


def test_a_node_starts_and_decides_without_scipy():
    """Its parts take twice as long to import as all else; only a solver needs them."""
    program = """
import sys
from uav_mission_manager.nodes import base_station, console, fleet, manager, mavlink_bridge, solver
from uav_mission_manager.policy import load_policy
for name in 'case_study', 'case_one':
    policy = load_policy(f'policies/{name}')
    k = policy.mission.k
    policy.decide((1, *(1,) * k, *(2,) * k, 0, 0, 0, 0)).upper_bound
print([name for name in sys.modules if name.startswith('scipy.') and name[6] != '_'])
"""
    done = subprocess.run(
        [sys.executable, '-c', program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "['scipy.version']"
