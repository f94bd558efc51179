"""What ends a node or keeps it from starting, in one line."""

from __future__ import annotations

import re

from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation

from uav_mission_manager.echo import said_by, shown

START_ERRORS = (
    ValueError,
    OSError,
    MemoryError,
    ParameterException,
    NameValidationException,
    RuntimeError,
)
"""What a node that cannot start raises; a bad mission, policy or parameter is a ValueError, and
rclpy's own errors are RuntimeErrors."""

LONGEST_LINE = 400
"""Characters of an error that are shown: a choice, a few lines of a terminal."""


class FatalError(Exception):
    """Raise it in a callback to end the node with this one line and exit code 1."""


def one_line(error: Exception) -> str:
    """Return what an error says in one line, without places in the source of ROS."""
    text = re.sub(r',? at /\S+:\d+', '', ' '.join(said_by(error).split()))
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):
        text = f'unknown ROS arguments: {text}'
    elif isinstance(error, MemoryError):
        text = f'not enough memory. {text}'
    elif not isinstance(error, (*START_ERRORS, FatalError)):
        text = f'{type(error).__name__}: {text}'  # A fault of this package.
    return shown(text, LONGEST_LINE) or type(error).__name__
