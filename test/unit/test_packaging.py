"""What package.xml, setup.py, the launch files and the tree say of each other agrees."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from datetime import date
from importlib import import_module
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

import uav_mission_manager
from uav_mission_manager.paths import share_directory

ROOT = Path(__file__).parents[2]
PACKAGE = 'uav_mission_manager'
LAUNCH_FILES = sorted((ROOT / 'launch').glob('*.py'))
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()
# Name on PyPI -> rosdep key.
ROSDEP_KEYS = {
    'numpy': 'python3-numpy',
    'scipy': 'python3-scipy',
    'pyyaml': 'python3-yaml',
    'rich': 'python3-rich',
    'pymavlink': 'python3-pymavlink-pip',
    'pyserial': 'python3-serial',
    'pymap3d': 'python3-pymap3d',
    'argcomplete': 'python3-argcomplete',
}
OPTIONAL = {'threadpoolctl'}  # rosdep has no key for it.
OF_AN_EXTRA = {  # Whoever needs one asks for it.
    *('shapely', 'defusedxml', 'matplotlib', 'rosbags'),
    *('nicegui', 'fastapi', 'uvicorn', 'numba'),
}
PYPI_NAMES = {'yaml': 'pyyaml', 'serial': 'pyserial'}  # Where the import is called otherwise.


def commands() -> dict[str, str]:
    """Return setup.py's console scripts and the modules that they call."""
    tree = ast.parse((ROOT / 'setup.py').read_text())
    return next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'COMMANDS'
    )


@pytest.mark.parametrize('module', commands().values())
def test_output_that_nobody_reads_any_more_ends_each_command_without_a_word(module):
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, '-m', f'{PACKAGE}.{module}', '--help'],
            cwd=ROOT,
            env=os.environ | {'PYTHONUNBUFFERED': ''},
            stdout=writer,
            stderr=subprocess.PIPE,
            timeout=120,
        )
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (1, b'')


def imported_packages(path: Path) -> set[str]:
    """Return the top-level packages that the module at `path` imports."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.append(node.module)
    return {name.split('.')[0] for name in names}


def names_defined(module: str) -> set[str]:
    """Return the functions and imports of one of this package's modules, named from its top."""
    path = ROOT / PACKAGE / module.replace('.', '/')
    path = path / '__init__.py' if path.is_dir() else path.with_suffix('.py')
    body = ast.parse(path.read_text()).body
    functions = {node.name for node in body if isinstance(node, ast.FunctionDef)}
    return functions | {
        alias.name for node in body if isinstance(node, ast.ImportFrom) for alias in node.names
    }


def keywords(path: Path, name: str) -> set[str]:
    """Return the string values of every keyword argument `name` in the file at `path`."""
    return {
        keyword.value.value
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        for keyword in node.keywords
        if keyword.arg == name and isinstance(keyword.value, ast.Constant)
    }


def calls(path: Path, name: str) -> list[ast.Call]:
    """Return the calls of `name` in the file at `path` whose first argument is a literal."""
    return [
        node
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) == name
        and node.args
        and isinstance(node.args[0], ast.Constant)
    ]


def first_arguments(path: Path, name: str) -> set[str]:
    """Return the first arguments of the calls of `name` in the file at `path`."""
    return {call.args[0].value for call in calls(path, name)}


def launched_nodes(path: Path) -> dict[str, set[str]]:
    """Return the nodes that a launch file starts, and the parameters it sets on each."""
    return {call.args[0].value: {k.arg for k in call.keywords} for call in calls(path, 'node')}


def test_name_and_license_agree():
    assert MANIFEST.findtext('name') == PACKAGE
    assert keywords(ROOT / 'setup.py', 'license') == {MANIFEST.findtext('license')}


@pytest.fixture(scope='module')
def metadata(tmp_path_factory):
    """What pip would be told of this package, from a copy: setuptools writes beside setup.py."""
    copy = tmp_path_factory.mktemp('source')
    for name in (
        'setup.py',
        'setup.cfg',
        'package.xml',
        *map(str, ROOT.glob('requirements*.txt')),
    ):
        shutil.copy(ROOT / name, copy)
    shutil.copytree(ROOT / PACKAGE, copy / PACKAGE, ignore=shutil.ignore_patterns('__pycache__'))
    command = [sys.executable, 'setup.py', '-q', 'egg_info']
    subprocess.run(command, cwd=copy, check=True, capture_output=True)
    return PathDistribution(copy / f'{PACKAGE}.egg-info')


def test_version_is_the_manifests_everywhere(metadata):
    assert metadata.version == uav_mission_manager.__version__ == MANIFEST.findtext('version')


@pytest.mark.parametrize('command', commands())
def test_every_command_says_the_version(command, capsys):
    main = import_module(f'{PACKAGE}.{commands()[command]}').main
    try:
        code = main(['--version'])
    except SystemExit as end:
        code = end.code
    assert (code, capsys.readouterr().out) == (0, f'{PACKAGE} {uav_mission_manager.__version__}\n')


@pytest.mark.parametrize(
    ('extra', 'which'),
    [
        ('', ''),
        ('test', '-dev'),
        ('ros', '-ros-wheels'),
        ('cluster', '-cluster'),
        ('page', '-page'),
        ('plan', '-plan'),
        ('fast', '-fast'),
        ('gpu', '-gpu'),
        ('plot', '-plot'),
        ('record', '-record'),
    ],
)
def test_pip_installs_what_a_requirements_file_names(metadata, extra, which):
    marked = [line.replace("'", '"').partition(';') for line in metadata.requires]
    marker = f'extra == "{extra}"' if extra else ''
    lines = (ROOT / f'requirements{which}.txt').read_text().splitlines()
    named = {line for line in lines if line and not line.startswith('#')}
    assert {name for name, _, when in marked if when.strip() == marker} == named != set()


def test_types_are_shipped(metadata):
    assert f'{PACKAGE}/py.typed' in {str(path) for path in metadata.files}


def test_changelog_ends_its_news_with_the_version_and_falling_dates():
    text = (ROOT / 'CHANGELOG.rst').read_text()
    found = re.findall(r'^([\d.]+) \((\d{4}-\d\d-\d\d)\)\n-+$', text, re.MULTILINE)
    versions = [tuple(map(int, version.split('.'))) for version, _ in found]
    dates = [date.fromisoformat(day) for _, day in found]
    assert found[0][0] == MANIFEST.findtext('version')
    assert versions == sorted(set(versions), reverse=True)
    assert dates == sorted(dates, reverse=True)


def test_every_import_is_declared():
    sources = [*(ROOT / PACKAGE).rglob('*.py'), *LAUNCH_FILES]
    used = set().union(*map(imported_packages, sources)) - sys.stdlib_module_names - {PACKAGE}
    declared = {tag.text for tag in MANIFEST.findall('exec_depend')}
    names = {PYPI_NAMES.get(name, name) for name in used} - OPTIONAL - OF_AN_EXTRA
    assert {ROSDEP_KEYS.get(name, name) for name in names} <= declared


def test_every_folder_of_modules_is_a_package():
    """Without `__init__.py` it runs from the source tree and is not installed."""
    folders = {path.parent for path in (ROOT / PACKAGE).rglob('*.py')}
    assert [folder for folder in folders if not (folder / '__init__.py').is_file()] == []


def test_requirements_and_manifest_name_the_same_libraries():
    lines = (ROOT / 'requirements.txt').read_text().splitlines()
    names = {re.split('[<>=]', line)[0].lower() for line in lines if not line.startswith('#')}
    declared = {tag.text for tag in MANIFEST.findall('exec_depend')}
    assert names == ROSDEP_KEYS.keys() | OPTIONAL
    assert {key for key in declared if key.startswith('python3-')} == set(ROSDEP_KEYS.values())


@pytest.mark.parametrize('command', commands())
def test_command_has_a_main_and_a_shim(command):
    assert 'main' in names_defined(commands()[command])
    assert os.access(ROOT / 'resource' / 'bin' / command, os.X_OK)


def test_no_shim_without_a_command():
    assert {path.name for path in (ROOT / 'resource' / 'bin').iterdir()} == {*commands(), 'shim'}


def test_shim_runs_the_command_in_bin(tmp_path):
    for folder, text in (
        ('lib/uav_mission_manager', (ROOT / 'resource' / 'bin' / 'manager').read_text()),
        ('bin', '#!/bin/sh\nfor word; do echo "$word"; done\nexit 3\n'),
    ):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / 'manager').write_text(text)
        (tmp_path / folder / 'manager').chmod(0o755)
    run = subprocess.run(
        [tmp_path / 'lib/uav_mission_manager/manager', 'two words', '-p'],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stdout) == (3, 'two words\n-p\n')


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_sets_only_declared_parameters(path):
    for node, parameters in launched_nodes(path).items():
        module = ROOT / PACKAGE / 'nodes' / f'{node}.py'
        assert parameters <= first_arguments(module, 'NodeParameter')


def test_share_directory_of_a_source_tree():
    assert share_directory() == ROOT
    assert (share_directory() / 'config' / 'case_study.yaml').is_file()


def test_share_directory_of_an_installation(tmp_path):
    site = tmp_path / 'lib' / 'python3' / 'site-packages' / PACKAGE
    share = tmp_path / 'share' / PACKAGE
    site.mkdir(parents=True)
    (site / '__init__.py').touch()
    for name in ('paths.py', 'echo.py'):
        (site / name).write_text((ROOT / PACKAGE / name).read_text())
    code = f'from {PACKAGE}.paths import share_directory; print(share_directory())'

    def run() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, '-c', code],
            cwd=site.parent,
            capture_output=True,
            text=True,
            check=False,
        )

    assert 'FileNotFoundError' in run().stderr
    share.mkdir(parents=True)
    (share / 'package.xml').touch()
    assert run().stdout.strip() == str(share.resolve())
