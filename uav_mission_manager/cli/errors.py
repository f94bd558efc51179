"""How a command ends: whatever goes wrong, in one line and not in a traceback."""

from __future__ import annotations

import argparse
import signal
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from uav_mission_manager.arguments import complete, version_line
from uav_mission_manager.echo import said_by, shown
from uav_mission_manager.output import flushed

LONGEST_REFUSAL = 600
"""Characters of an error that are shown: a choice, two echoes and what is said of them."""

LONGEST_USAGE_ERROR = 300
"""The same of arguments: one echo."""

SIGNAL_EXIT = 128
"""What shells add to the number of the signal that a command ended by, for its exit code."""

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a command to end: Ctrl-C, a service manager, a terminal that was closed."""

_come: list[int] = []  # signals since the command began


def require_folder(option: str, file: Path) -> None:
    """Raise `FileNotFoundError` where there is no folder for a file that is to be written."""
    if not file.parent.is_dir():
        raise FileNotFoundError(f'{option}: there is no folder {shown(file.parent)}')


class CommandParser(argparse.ArgumentParser):
    """Has `--version` and completion; refuses arguments in one line, with exit code 2."""

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.add_argument('--version', action='version', version=version_line())

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, or complete for a shell that asks."""
        complete(self)
        return super().parse_args(args, namespace)

    def print_help(self, file: Any = None) -> None:
        """Print the help; without room for it this raises `OSError`, unlike argparse."""
        print(self.format_help(), end='', file=file)

    def error(self, message: str) -> NoReturn:
        """End the command."""
        text = shown(message, LONGEST_USAGE_ERROR)
        self.exit(2, f'{self.prog}: {text}; `{self.prog} --help` lists the options\n')


@contextmanager
def one_line_errors(command: str) -> Iterator[None]:
    """End the command with one line on stderr where something goes wrong, or somebody ends it.

    The exit code is 1, for a signal 128 and its number. Where a reader of the output has had
    enough, such as `head`, the command ends without a word.
    """
    _prepare(command)
    try:
        try:
            with flushed():
                yield
        except Exception:
            look_for_interruption()  # Compiled code makes an error of its own of it.
            raise
    except KeyboardInterrupt as error:
        print(f'{command}: interrupted', file=sys.stderr)
        # Python's own has no number.
        sys.exit(SIGNAL_EXIT + (error.args or (signal.SIGINT,))[0])
    except MemoryError as error:
        sys.exit(f'{command}: not enough memory. {shown(error, LONGEST_REFUSAL)}')
    except BrokenExecutor:
        sys.exit(f'{command}: a process that solves a part has died: of too little memory?')
    except (ValueError, OSError) as error:
        sys.exit(f'{command}: {shown(said_by(error), LONGEST_REFUSAL)}')


@contextmanager
def undisturbed() -> Iterator[None]:
    """Ignore further signals in here: an end in order that is interrupted is none."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in STOP_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _prepare(command: str) -> None:
    """Let signals end the command in order, warn in one line, and print what a terminal lacks."""
    _come.clear()
    for number in STOP_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # `nohup` asks to outlive the terminal.
            signal.signal(number, _interrupt)
    warnings.showwarning = lambda message, *_, **__: print(
        f'{command}: warning: {shown(message, LONGEST_REFUSAL)}', file=sys.stderr
    )
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, 'reconfigure'):  # It is None where the shell closed it.
            stream.reconfigure(errors='backslashreplace')


def look_for_interruption() -> None:
    """Raise `KeyboardInterrupt` if a signal has come; call it now and then where ROS spins.

    What a signal raises is lost where Python tidies up, as it does after each look of rclpy's.
    """
    if _come:
        raise KeyboardInterrupt(_come[0])


def _interrupt(number: int, _: object) -> NoReturn:
    _come.append(number)
    raise KeyboardInterrupt(number)
