"""The commands and the Python of README's and the documentation's blocks run as they stand there.

Blocks without a language are commands; what is no command says so, by `text`. A page runs from top
to bottom in a folder that looks like a clone of this repository. There need not be a `ros2`
command here: `ros2 run uav_mission_manager NAME` becomes the module of that command with the same
arguments; parameters are set and topics published by the test. Bash makes the words.

What only a robot, the network or another test can run is named in `NOT_HERE` and `LONG`; no line
is passed over.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml
from ros_helpers import LIMIT, ROOT, NodeProcess, Ros, free_port

from uav_mission_manager.nodes import qos
from uav_mission_manager.nodes.ending import NODES

BLOCK = re.compile(r'^( *)```([^\n`]*)\n(.*?)^\1```$', re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^[^\n]*<<'(\w+)'\n.*?^\1$|^[^\n]+$", re.MULTILINE | re.DOTALL)
"""A line, or one with the here-document below it."""

RUN = re.compile(r'(?:ros2 run uav_mission_manager )?(\w+) (.*)')
PORT = re.compile(r'\b(145[56]\d|8080)\b')
"""Ports of the pages; free ones are used in their place, as others may fly here."""

NOT_HERE = (
    'cd ',
    'sudo ',
    'rosdep ',
    'colcon ',
    'python3 -m venv ',  # An environment of one's own, and the installation into it:
    '. .venv-mission/',
    'pip install ',  # test_packaging.py holds what it installs.
    'ros2 launch ',  # test_mission_launch.py
    'ros2 param set /uav1/',  # A node of the launch before it.
    'mavproxy.py ',
    'ros2 bag ',  # No ROS wheel has it.
    'rviz2',
    'ros2 run diagnostic_aggregator ',
)
SHELL = ('cat ', 'mkdir ', 'sed ')
"""Commands that bash runs as they are."""

LONG = {'demo': 'test_demo.py', 'mission_replay': 'test_demo.py'}
"""Commands that take a minute, or a flight, and the test that runs them; here options are held."""

SHORTER = {'mission_simulate': ('--episodes', '10'), 'policy_build': ('--tolerance', '1e-3')}
"""What is added to a command, for time."""

SERVES = 'rclpy.spin('
"""What Python says that runs until it is stopped: its own test runs it."""

SERVERS = (*NODES, 'sim_autopilot')
"""Commands that run until they are stopped."""


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """Return a page's blocks of commands, with no language, and of Python."""
    found = (Block(*match[1:]) for match in BLOCK.findall(page.read_text('utf-8')))
    return [block for block in found if block.language in ('', 'python')]


def commands_of(block: Block) -> list[str]:
    """Return the commands of a block, continued lines and here-documents whole."""
    found = (match[0].strip() for match in COMMAND.finditer(block.text.replace('\\\n', ' ')))
    return [command for command in found if command and not command.startswith('#')]


PAGES = [
    page for page in (ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))) if blocks(page)
]


def modules() -> dict[str, str]:
    """Return the module of each command, as setup.py has them."""
    text = (ROOT / 'setup.py').read_text('utf-8')
    return ast.literal_eval(re.search(r'^COMMANDS = (\{.*?^\})', text, re.M | re.S)[1])


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """Return a folder like a clone that is a ROS workspace, too."""
    (tmp_path / 'src').mkdir()
    (tmp_path / 'src' / 'uav_mission_manager').symlink_to(ROOT)
    for name in ('config', 'policies', 'test/bags'):
        shutil.copytree(ROOT / name, tmp_path / name)  # Pages write there.
    return tmp_path


class Reader:
    """Does what a page says, from top to bottom."""

    def __init__(self, ros: Ros, folder: Path) -> None:
        self.ros, self.folder = ros, folder
        self.ports: dict[str, int] = {}
        self.python = ''  # A block goes on from those above it.
        self.environment = {
            'HOME': str(folder),
            'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}',
            'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
            'ROS_DOMAIN_ID': str(ros.domain),
        }

    def read(self, block: Block) -> None:
        """Run a block."""
        if block.language == 'python':
            self.python += self.with_free_ports(block.text)
            if SERVES not in block.text:
                self.run([sys.executable, '-c', self.python])
            return
        for command in commands_of(block):
            if not command.startswith(NOT_HERE):
                self.do(command)

    def do(self, command: str) -> None:
        """Run a command."""
        match = RUN.match(command)
        if match and match[1] in modules():
            self.command(match[1], self.words(match[2]))
        elif command.startswith('make '):
            subprocess.run(['make', '-n', *self.words(command)[1:]], cwd=ROOT, check=True)
        elif command.startswith('ros2 param set '):
            node, name, value = self.words(command)[3:]
            assert self.ros.set_parameter(node, name, yaml.safe_load(value)).successful
        elif command.startswith('ros2 topic pub '):
            topic, kind, value = self.words(command)[-3:]
            message = filled(message_type(kind)(), yaml.safe_load(value))
            self.ros.publish(topic, message, qos.RELIABLE)
        elif command.startswith('ros2 topic echo '):
            topic = self.words(command)[-1]
            publishers = self.ros.node.get_publishers_info_by_topic
            self.ros.until(lambda: bool(publishers(topic)), f'a publisher of {topic}')
        elif command.startswith('eval '):
            assert '-F ' in self.run(['bash', '-ec', f'{command}\ncomplete -p policy_build'])
        elif command.startswith(SHELL):
            self.run(['bash', '-ec', command])
        else:
            pytest.fail(f'{command!r} is neither run nor in NOT_HERE')

    def command(self, name: str, words: list[str]) -> None:
        """Run a command of this package to its end or, if it serves, until it is up."""
        module = f'uav_mission_manager.{modules()[name]}'
        if name in LONG:
            assert (ROOT / 'test' / 'integration' / LONG[name]).is_file()
            text = self.run([sys.executable, '-m', module, *words, '--help'])
            assert {word for word in words if word.startswith('--')} <= set(text.split())
            return
        process = NodeProcess(
            self.ros.domain,
            self.folder,
            module,
            *words,
            *SHORTER.get(name, ()),
            cwd=self.folder,
            **self.environment,
        )
        if name not in SERVERS:
            assert process.wait() == 0, process.output
            return
        self.ros.processes.append(process)
        self.ros.until(lambda: self.is_up(name, process), name)
        assert process.process.poll() is None, process.output

    def is_up(self, name: str, process: NodeProcess) -> bool:
        """Whether a server is there, or has ended."""
        up = name in self.ros.node.get_node_names() if name in NODES else bool(process.output)
        return up or process.process.poll() is not None

    def words(self, text: str) -> list[str]:
        """Return the words that bash makes of a text."""
        text = self.with_free_ports(text)
        return self.run(['bash', '-ec', f'printf "%s\\0" {text}']).split('\0')[:-1]

    def with_free_ports(self, text: str) -> str:
        """Return a text with another port in place of each of the pages'."""
        return PORT.sub(lambda port: str(self.ports.setdefault(port[0], free_port())), text)

    def run(self, words: list[str]) -> str:
        """Run a program to its end; return what it printed."""
        run = subprocess.run(
            words,
            cwd=self.folder,
            env=os.environ | self.environment,
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        assert run.returncode == 0, run.stderr
        return run.stdout


def message_type(name: str) -> Any:
    """Return the class of a message type, such as std_msgs/msg/String."""
    package, _, kind = name.split('/')
    return getattr(import_module(f'{package}.msg'), kind)


def filled(message: Any, values: Mapping[str, Any]) -> Any:
    """Return a message with some of its fields set, those of its parts too."""
    for name, value in values.items():
        part = getattr(message, name)
        setattr(message, name, filled(part, value) if isinstance(value, Mapping) else value)
    return message


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_block_of_a_page_runs(page: Path, ros: Ros, clone: Path) -> None:
    reader = Reader(ros, clone)
    for block in blocks(page):
        reader.read(block)
    for process in ros.processes:
        assert process.stop() == 0, process.output


def test_every_command_and_node_is_shown_somewhere() -> None:
    lines = [c for page in PAGES for block in blocks(page) for c in commands_of(block)]
    shown = {match[1] for line in lines if (match := RUN.match(line))}
    assert shown >= set(modules()) - {'solver'}  # A service of a node, in README.


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('a \\\n  b\n\n# no\nc  # not a word\n', ['a    b', 'c  # not a word']),
        (
            "cat > x <<'END'\na  # kept\n\nb\nEND\nc\n",
            ["cat > x <<'END'\na  # kept\n\nb\nEND", 'c'],
        ),
        ('a --b=#c\n', ['a --b=#c']),
    ],
)
def test_commands_of_a_block(text: str, expected: list[str]) -> None:
    assert commands_of(Block('', text)) == expected


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
