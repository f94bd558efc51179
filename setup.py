from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'uav_mission_manager'

COMMANDS = {
    'policy_build': 'cli.policy_build',
    'policy_query': 'cli.policy_query',
    'mission_new': 'cli.mission_new',
    'mission_simulate': 'cli.mission_simulate',
    'mission_check': 'cli.mission_check',
    'mission_replay': 'cli.mission_replay',
    'mission_report': 'cli.mission_report',
    'mission_learn': 'cli.mission_learn',
    'fault_calibrate': 'cli.fault_calibrate',
    'demo': 'cli.demo',
    'manager': 'nodes.manager',
    'solver': 'nodes.solver',
    'mission_record': 'nodes.mission_record',
    'mavlink_bridge': 'nodes.mavlink_bridge',
    'base_station': 'nodes.base_station',
    'fleet': 'nodes.fleet',
    'console': 'nodes.console',
    'sim_autopilot': 'autopilot.sim_autopilot',
}


def requirements(which: str = '') -> list[str]:
    """Return what a requirements file names, comments left out: libraries are declared there."""
    lines = Path(f'requirements{which}.txt').read_text(encoding='utf-8').splitlines()
    return [line for line in lines if line and not line.startswith('#')]


def share_files() -> list[tuple[str, list[str]]]:
    """Return `data_files` entries for every file under config, policies and launch."""
    files: dict[str, list[str]] = {}
    for top in ('config', 'policies', 'launch'):
        for path in sorted(Path(top).rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                files.setdefault(f'share/{NAME}/{path.parent}', []).append(str(path))
    return list(files.items())


def executables() -> list[tuple[str, list[str]]]:
    """Return shims for `ros2 run`, which pip needs because it puts commands into bin only."""
    if {'install', 'develop'} & set(sys.argv):  # colcon: setup.cfg puts the commands there
        return []
    return [(f'lib/{NAME}', [f'resource/bin/{command}' for command in COMMANDS])]


setup(
    name=NAME,
    version=ElementTree.parse('package.xml').findtext('version'),
    description='Contingency-aware mission management of a UAV as a Markov decision process',
    maintainer='Seed 397f598a maintainers',
    maintainer_email='maintainers@users.noreply.h-seed-397f598a.example',
    license='Apache-2.0',
    python_requires='>=3.10',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *share_files(),
        *executables(),
    ],
    package_data={NAME: ['py.typed', 'nodes/loopback.xml']},
    zip_safe=False,  # Type checkers look for py.typed in a folder.
    install_requires=requirements(),
    extras_require={
        'test': requirements('-dev'),
        'ros': requirements('-ros-wheels'),  # The nodes, where no ROS is sourced.
        'cluster': requirements('-cluster'),  # policy_build --scheduler.
        'page': requirements('-page'),  # console.
        'plan': requirements('-plan'),  # mission_new.
        'fast': requirements('-fast'),  # Exact solutions of large missions, sooner.
        'gpu': requirements('-gpu'),  # policy_build --device gpu.
        'plot': requirements('-plot'),  # --plot of commands, plot_policy.
        'record': requirements('-record'),  # mission_record, and all that read bags.
    },
    entry_points={
        'console_scripts': [
            f'{command} = {NAME}.{module}:main' for command, module in COMMANDS.items()
        ],
    },
)
