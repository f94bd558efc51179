"""The commands of README's shell blocks run as they stand there.

There need not be a `ros2` command here: `ros2 run uav_mission_manager NAME` becomes the module of
that command with the same arguments, and `ros2 param set` the same call. Bash makes the words.
What only a robot, the network or another test can run is named in `NOT_HERE`; no line is passed
over.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from ros_helpers import LIMIT, NODES_HERE, ROOT, NodeProcess, Ros, free_port

from uav_mission_manager.nodes.ending import NODES

BLOCK = re.compile(r'^```(\w*)\n(.*?)^```$', re.MULTILINE | re.DOTALL)
DIAGRAM = '──▶'
RUN = re.compile(r'(?:ros2 run uav_mission_manager )?(\w+) (.*)')
NOT_HERE = (
    'cd ',
    'sudo ',
    'rosdep ',
    'colcon ',
    'pip install ',  # test_packaging.py holds what it installs.
    'ros2 launch ',  # test_mission_launch.py
    'ros2 param set /uav1/',  # A node of the launch before it.
)
PORTS = re.compile('14550|8080')
"""Those of README; free ones are used in their place, as others may fly here."""


def blocks(language: str) -> list[str]:
    """Return README's fenced blocks in a language, with none for the shell; no diagrams."""
    found = BLOCK.findall((ROOT / 'README.md').read_text('utf-8'))
    return [block for name, block in found if name == language and DIAGRAM not in block]


def shell_lines() -> list[str]:
    """Return the command lines: continued ones whole, comments left out."""
    lines = ''.join(blocks('')).replace('\\\n', ' ').splitlines()
    return [line for line in (re.sub(r'(^| +)# .*', '', line).strip() for line in lines) if line]


def modules() -> dict[str, str]:
    """Return the module of each command, as setup.py has them."""
    text = (ROOT / 'setup.py').read_text('utf-8')
    return ast.literal_eval(re.search(r'^COMMANDS = (\{.*?^\})', text, re.M | re.S)[1])


ABSENT = [f'ros2 run uav_mission_manager {name} ' for name in set(NODES) - set(NODES_HERE)]
LINES = [line for line in shell_lines() if not line.startswith((*NOT_HERE, *ABSENT))]


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """Return a ROS workspace with this package in it, which is a checkout of it, too."""
    (tmp_path / 'src').mkdir()
    (tmp_path / 'src' / 'uav_mission_manager').symlink_to(ROOT)
    for name in ('config', 'policies'):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def bash(command: str, home: Path) -> str:
    """Run a line in bash, with what is installed here on its path; return what it printed."""
    path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'
    run = subprocess.run(
        ['bash', '-ec', command],
        cwd=home,
        env=os.environ | {'HOME': str(home), 'PATH': path},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def run_command(ros: Ros, name: str, rest: str, home: Path) -> None:
    """Run a command to its end, or, if it is a node, until it is up."""
    words = bash(f'printf "%s\\0" {rest}', home).split('\0')[:-1]
    process = NodeProcess(
        ros.domain,
        home,
        f'uav_mission_manager.{modules()[name]}',
        *(PORTS.sub(str(free_port()), word) for word in words),
        cwd=home,
        HOME=str(home),
        PYTHONPATH=f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
    )
    ros.processes.append(process)
    if name in NODES:
        ros.until(
            lambda: name in ros.node.get_node_names() or process.process.poll() is not None, name
        )
        assert process.process.poll() is None, process.output
    else:
        assert process.wait() == 0, process.output


def test_every_command_of_the_shell_blocks_runs(ros: Ros, workspace: Path) -> None:
    assert {RUN.match(line)[1] for line in LINES} >= {'policy_build', *NODES_HERE} - {'solver'}
    for line in LINES:
        if line.startswith('make '):
            subprocess.run(['make', '-n', *line.split()[1:]], cwd=ROOT, check=True)
        elif line.startswith('ros2 param set '):
            node, name, value = bash(f'printf "%s\\0" {line[15:]}', workspace).split('\0')[:-1]
            assert ros.set_parameter(node, name, yaml.safe_load(value)).successful
        elif (match := RUN.match(line)) and match[1] in modules():
            run_command(ros, match[1], match[2], workspace)
        elif line.startswith('eval '):
            assert '-F ' in bash(f'{line}; complete -p policy_build', workspace)
        else:
            pytest.fail(f'README: {line!r} is neither run nor in NOT_HERE')
    for process in ros.processes:
        assert process.stop() == 0, process.output


@pytest.mark.parametrize('block', blocks('python'))
def test_python_blocks_run(block: str, workspace: Path) -> None:
    subprocess.run(
        [sys.executable, '-c', block],
        cwd=workspace,
        env=os.environ | {'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'},
        timeout=LIMIT,
        check=True,
    )


@pytest.mark.parametrize('name', sorted(modules()))
def test_the_table_names_every_option_of_a_command(name: str) -> None:
    """Of nodes, which have no table of options, parameters are named that exist."""
    run = subprocess.run(
        [sys.executable, '-m', f'uav_mission_manager.{modules()[name]}', '--help'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=True,
    )
    row = re.search(rf'^\| `({name}\b[^`]*)` \|(.*)\|$', (ROOT / 'README.md').read_text(), re.M)
    options = set(re.findall(r'--[a-z][a-z-]+', run.stdout)) - {'--help', '--version'}
    if name in ('policy_build', 'policy_query', 'mission_check'):
        assert set(re.findall(r'--[a-z-]+', row[1])) == options - {'--no-certificate'}
    elif name in NODES:
        named = set(re.findall(r'`(\w+)`', row[2].partition('parameters')[2].partition('(')[0]))
        assert set() < named <= set(re.findall(r'^  (\w+) ', run.stdout, re.M))
