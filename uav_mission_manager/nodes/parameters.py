"""Node parameters from one declarative table, checked when declared and when set."""

from __future__ import annotations

import math
from collections.abc import Iterable
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


@dataclass(frozen=True)
class NodeParameter:
    """One row of a node's table; `minimum` and `maximum` are inclusive and come together."""

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    read_only: bool = True

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


def declare(node: Node, table: tuple[NodeParameter, ...]) -> SimpleNamespace:
    """Declare `table` on `node` and return the values by name.

    Raises
    ------
    ValueError
        One line naming the parameter: NaN, out of range or of the wrong type.
    """
    values = SimpleNamespace()
    for row in table:
        try:
            value = node.declare_parameter(row.name, row.default, row.descriptor()).value
        except ParameterException as error:
            raise ValueError(f'parameter {row.name}: {error}') from error
        if _has_nan(value):
            raise ValueError(f'parameter {row.name}: {value} is not a number')
        setattr(values, row.name, value)
    node.add_on_set_parameters_callback(_refuse_nan)
    return values


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
