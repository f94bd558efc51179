"""Run one node in a process: start, spin, stop on SIGINT or SIGTERM."""

from __future__ import annotations

import inspect
import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node

from uav_mission_manager.nodes.parameters import NodeParameter

START_ERRORS = (ValueError, OSError)
"""What a node that cannot start raises; a bad mission, policy or parameter is a ValueError."""


class FatalError(Exception):
    """Raise it in a callback to end the node with this one line and exit code 1."""


def safety_clock(node: Node) -> Clock:
    """Return a clock for timers and time-outs that does not jump when the system's time is set.

    It is the node's own clock where `use_sim_time` is set at the start.
    """
    if node.get_parameter('use_sim_time').value:
        return node.get_clock()
    return Clock(clock_type=ClockType.STEADY_TIME)


def run_node(
    node_class: Callable[[], Node],
    table: tuple[NodeParameter, ...],
    args: list[str] | None = None,
) -> int:
    """Spin a `node_class()` with the parameters of `table` until the process is asked to stop.

    Returns
    -------
    int
        Exit code: 0 after SIGINT or SIGTERM or `--help`, 1 when the node could not start or a
        callback raised `FatalError` (one log line).
    """
    if {'-h', '--help'} & set(sys.argv[1:] if args is None else args):
        print(_help(node_class, table))
        return 0
    rclpy.init(args=args)
    node, executor = None, SingleThreadedExecutor()
    try:
        try:
            node = node_class()
        except START_ERRORS as error:
            get_logger(node_class.__name__).fatal(str(error))
            return 1
        executor.add_node(node)
        # A signal can slip in just before `spin` starts to wait, and a node without timers would
        # then wait for ever: look again every now and then.
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.5)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except FatalError as error:
        get_logger(node_class.__name__).fatal(str(error))
        return 1
    except rclpy_implementation.RCLError:
        # A signal between two calls of a callback invalidates the context under it.
        if rclpy.ok():
            raise
    finally:
        # `ros2 launch` passes on a Ctrl-C that the terminal has sent here already.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        # First: an executor that still waits for what a node is made of can crash its destruction.
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _help(node_class: Callable[[], Node], table: tuple[NodeParameter, ...]) -> str:
    rows = '\n'.join(f'  {row.name:<24} {row.description} ({row.default!r})' for row in table)
    usage = '--ros-args [-r __ns:=/NAMESPACE] [-p NAME:=VALUE ...] [--params-file FILE]'
    return f'{inspect.getdoc(node_class)}\n\n{usage}\n\nparameters (default):\n{rows}'
