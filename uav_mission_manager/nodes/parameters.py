"""Node parameters from one declarative table, checked when declared and when set."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterException
from rclpy.node import Node

from uav_mission_manager.nodes.overrides import refuse_unknown
from uav_mission_manager.paths import expanded, share_directory


@dataclass(frozen=True)
class NodeParameter:
    """One row of a node's table.

    Attributes
    ----------
    name : str
    default : object
        Its type is the parameter's.
    description : str
        With the unit in brackets.
    minimum, maximum : float, optional
        The range, inclusive; they come together.
    read_only : bool
        Whether it can be given at the start only; else `ros2 param set` changes it in flight.
    path : bool
        Whether it is a path, in which `~` and `$VARIABLE` are replaced.
    example : str
        A shipped file or directory; with it the parameter has no default and must be given.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    read_only: bool = True
    path: bool = False
    example: str = ''

    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows; rclpy enforces the range."""
        message = ParameterDescriptor(
            name=self.name, description=self.description, read_only=self.read_only
        )
        if self.minimum is None or self.maximum is None:
            return message
        if isinstance(self.default, float):
            message.floating_point_range = [
                FloatingPointRange(from_value=float(self.minimum), to_value=float(self.maximum))
            ]
        else:
            message.integer_range = [
                IntegerRange(from_value=int(self.minimum), to_value=int(self.maximum))
            ]
        return message

    def checked(self, value: Any) -> Any:
        """Return a value as the node shall use it.

        Raises
        ------
        ValueError
            One line naming the parameter: NaN, no value, or a path that cannot be.
        """
        if self.example and not value:
            raise ValueError(
                f'parameter {self.name}: not given; give it as '
                f'--ros-args -p {self.name}:={share_directory() / self.example} '
                f'for the shipped example'
            )
        if value is None:
            raise ValueError(f'parameter {self.name}: an empty list or value')
        if _has_nan(value):
            raise ValueError(f'parameter {self.name}: {value} is not a number')
        try:
            return str(expanded(value)) if self.path and value else value
        except ValueError as error:
            raise ValueError(f'parameter {self.name}: {error}') from error


def declare(
    node: Node,
    table: tuple[NodeParameter, ...],
    later: tuple[NodeParameter, ...] = (),
    changed: Callable[[], None] | None = None,
) -> SimpleNamespace:
    """Declare `table` on `node` and return the values by name.

    Parameters
    ----------
    node : Node
    table, later : tuple of NodeParameter
        What the node declares now, and with another call.
    changed : callable, optional
        Called when parameters were set: the values returned are the new ones by then.

    Raises
    ------
    ValueError
        One line naming the parameter: NaN, out of range, of the wrong type, not given, or given
        and none of the node's.
    """
    refuse_unknown(node, [row.name for row in (*table, *later)])
    values = SimpleNamespace()
    for row in table:
        try:
            value = node.declare_parameter(row.name, row.default, row.descriptor()).value
        except ParameterException as error:
            raise ValueError(f'parameter {row.name}: {error}') from error
        setattr(values, row.name, row.checked(value))
    node.add_on_set_parameters_callback(_refuse_nan)
    if changed is not None:
        _follow(node, values, changed)
    return values


def _follow(node: Node, values: SimpleNamespace, changed: Callable[[], None]) -> None:
    """Keep values up to date."""

    def take(parameters: Iterable[Any]) -> None:
        new = {each.name: each.value for each in parameters if hasattr(values, each.name)}
        vars(values).update(new)
        if new:
            told = ', '.join(f'{name} is {value} now' for name, value in new.items())
            node.get_logger().info(told)
            changed()

    node.add_post_set_parameters_callback(take)


def _refuse_nan(parameters: Iterable[Any]) -> SetParametersResult:
    for parameter in parameters:
        if _has_nan(parameter.value):
            return SetParametersResult(
                successful=False, reason=f'parameter {parameter.name}: NaN is not a number'
            )
    return SetParametersResult(successful=True)


def _has_nan(value: Any) -> bool:
    if isinstance(value, float):
        return math.isnan(value)
    # Parameter arrays arrive as lists or array.array; strings have no numbers in them.
    return (
        not isinstance(value, (str, bytes))
        and isinstance(value, Iterable)
        and any(_has_nan(item) for item in value)
    )
