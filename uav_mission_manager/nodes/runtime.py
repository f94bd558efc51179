"""Run one node in a process: start, spin, stop on SIGINT or SIGTERM."""

from __future__ import annotations

import signal
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node

# MissionError, PolicyError and refused parameters are ValueErrors.
START_ERRORS = (ValueError, OSError)


def run(node_class: Callable[[], Node], args: list[str] | None = None) -> int:
    """Spin a `node_class()` until the process is asked to stop.

    Returns
    -------
    int
        Exit code: 0 after SIGINT or SIGTERM, 1 when the node could not start (one log line).
    """
    rclpy.init(args=args)
    node = None
    try:
        try:
            node = node_class()
        except START_ERRORS as error:
            get_logger(node_class.__name__).fatal(str(error))
            return 1
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        # A signal can slip in just before `spin` starts to wait, and a node without timers would
        # then wait for ever: look again every now and then.
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.5)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except rclpy_implementation.RCLError:
        # A signal between two calls of a callback invalidates the context under it.
        if rclpy.ok():
            raise
    finally:
        # `ros2 launch` passes on a Ctrl-C that the terminal has sent here already.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
