"""Run one node in a process: start, spin, stop on SIGINT, SIGTERM or SIGHUP."""

from __future__ import annotations

import gc
import inspect
import os
import sys
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger, set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from uav_mission_manager.arguments import version_line
from uav_mission_manager.nodes.ending import ENDING
from uav_mission_manager.nodes.failures import START_ERRORS, FatalError, one_line
from uav_mission_manager.nodes.lifecycle import ManagedNode
from uav_mission_manager.nodes.overrides import refuse_unknown
from uav_mission_manager.nodes.parameters import NodeParameter
from uav_mission_manager.nodes.transport import without_shared_memory
from uav_mission_manager.output import flushed

MAX_DOMAIN = 232
"""Largest ROS_DOMAIN_ID: the ports of larger ones would be above 65535."""

SPIN_TIME = 0.2
"""Time [s] after which a node without work looks whether it is to end: a choice."""


class RestingExecutor(SingleThreadedExecutor):
    """Rests before it looks what has arrived, to take at one look what has come meanwhile.

    A look costs as much as all that a node listens to, however little has arrived. It takes one
    message of each topic, so there is no rest while a topic has one at each look.

    Parameters
    ----------
    rest : float
        Time [s]; a message may wait as long. With 0 it is a `SingleThreadedExecutor`.
    context : Context, optional
        Default: that of the process.
    """

    def __init__(self, rest: float, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._rest = rest
        self._ready: set[Any] = set()
        self._ready_before: set[Any] = set()

    def _wait_for_ready_callbacks(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        if self._rest and self._ready.isdisjoint(self._ready_before):
            time.sleep(self._rest)
        self._ready_before, self._ready = self._ready, set()
        work: Any
        for work in super()._wait_for_ready_callbacks(*args, **options):
            self._ready.add(work[1])
            yield work


def run_node(
    node_class: Callable[[], Node],
    table: tuple[NodeParameter, ...],
    args: list[str] | None = None,
    rest: float = 0.0,
) -> int:
    """Spin a `node_class()` with the parameters of `table` until the process is asked to stop.

    A node with a life cycle is configured and activated first, unless it is to wait for that.

    Parameters
    ----------
    node_class : callable
    table : tuple of NodeParameter
    args : list of str, optional
        Default: the command line's.
    rest : float
        Time [s] between two looks at what has arrived: see `RestingExecutor`.

    Returns
    -------
    int
        Exit code: 0 after SIGINT, SIGTERM, SIGHUP, `--help` or `--version`, 1 when the node could
        not start or a callback raised `FatalError` (one log line).
    """
    words = sys.argv[1:] if args is None else args
    if {'-h', '--help', '--version'} & set(words):
        text = version_line() if '--version' in words else _help(node_class, table)
        try:
            with flushed():
                print(text)
        except OSError as error:
            sys.exit(one_line(error))
        return 0
    ENDING.watch()
    node = executor = None
    try:
        try:
            _start_ros(words)
            node = node_class()
            if isinstance(node, ManagedNode):
                node.start()
            else:
                refuse_unknown(node, qos=True)
        except START_ERRORS as error:
            raise FatalError(one_line(error)) from error
        executor = RestingExecutor(rest)
        executor.add_node(node)
        ENDING.orderly = True
        gc.collect()
        gc.freeze()  # What is there now stays: the collector need not look at it in flight.
        while not ENDING.begun:
            with suppress(InvalidHandle):  # Of what ended while a callback of it waited.
                executor.spin_once(timeout_sec=SPIN_TIME)
    except KeyboardInterrupt:
        pass
    except (FatalError, OSError, MemoryError) as error:
        get_logger(node_class.__name__).fatal(one_line(error))
        return 1
    finally:
        ENDING.close()
        # First: an executor that still waits for what a node is made of can crash its destruction.
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _start_ros(arguments: list[str]) -> None:
    """Begin with ROS; what would end the process in C++, or in many lines, is refused here."""
    if words := _not_for_ros(arguments):
        raise ValueError(
            f'unknown arguments: {" ".join(words)}; parameters are given by --ros-args -p'
        )
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (domain.isascii() and domain.isdigit() and int(domain[:9]) <= MAX_DOMAIN):
        raise ValueError(f'ROS_DOMAIN_ID {domain!r} is not one of 0 to {MAX_DOMAIN}')
    if not any(os.environ.get(name) for name in ('ROS_LOG_DIR', 'ROS_HOME', 'HOME')):
        raise ValueError('no place for log files: none of HOME, ROS_HOME and ROS_LOG_DIR is set')
    set_logger_level('rcl', LoggingSeverity.FATAL)  # It repeats what it raises.
    without_shared_memory()
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    set_logger_level('rcl', LoggingSeverity.UNSET)


def _not_for_ros(arguments: list[str]) -> list[str]:
    """Return the words outside `--ros-args ... --`; ROS takes some of them for its own, too."""
    words, inside = [], False
    for word in arguments:
        if inside or word == '--ros-args':
            inside = word != '--'
        else:
            words.append(word)
    return words


def _help(node_class: Callable[[], Node], table: tuple[NodeParameter, ...]) -> str:
    rows = '\n'.join(
        f'  {row.name:<24} {row.description} ({"needed" if row.example else repr(row.default)})'
        for row in table
    )
    usage = '--ros-args [-r __ns:=/NAMESPACE] [-p NAME:=VALUE ...] [--params-file FILE]'
    return f'{inspect.getdoc(node_class)}\n\n{usage}\n\nparameters (default):\n{rows}'
