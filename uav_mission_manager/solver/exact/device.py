"""Where backups are made: by NumPy on the processors, or by CuPy on a CUDA card.

The steps of a sweep call NumPy's functions, and NumPy leaves those of CuPy's arrays to CuPy
(NEP 13 and NEP 18). So a device makes the arrays and brings results back, and nothing else knows
of it. CuPy never converts between its arrays and NumPy's unasked; whoever mixes them is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from uav_mission_manager.echo import quoted, shown
from uav_mission_manager.mdp.arrays import AnyArray
from uav_mission_manager.solver import memory


@dataclass(frozen=True)
class Device:
    """Where arrays are.

    Attributes
    ----------
    name : {'cpu', 'gpu'}
    """

    name: str

    @property
    def on_gpu(self) -> bool:
        """Whether it is a card."""
        return self.name == 'gpu'

    @property
    def namespace(self) -> Any:
        """NumPy or CuPy."""
        return import_module('cupy') if self.on_gpu else np

    def put(self, values: AnyArray) -> Any:
        """An array as one of the device; on the processors it is the same one."""
        return self.namespace.asarray(values)

    def copy(self, values: Any, dtype: DTypeLike) -> Any:
        """Copy an array of the device, or one of NumPy's, to the device in a floating type."""
        return self.namespace.array(values, dtype)

    def take_back(self, values: Any) -> AnyArray:
        """Bring an array of the device back, as one of NumPy's."""
        return self.namespace.asnumpy(values) if self.on_gpu else values

    def release(self) -> None:
        """Give what was freed back to the card: CuPy keeps it, in pieces of the sizes it had."""
        if self.on_gpu:
            self.namespace.get_default_memory_pool().free_all_blocks()

    def available_bytes(self) -> int:
        """Memory of the device that may still be used."""
        if not self.on_gpu:
            return memory.available_bytes()
        free, _ = self.namespace.cuda.runtime.memGetInfo()
        return int(free + self.namespace.get_default_memory_pool().free_bytes())


CPU = Device('cpu')

DEVICES = ('cpu', 'gpu')
"""Names of devices."""


def find_device(name: str) -> Device:
    """Return a device that works. Raises `ValueError` where there is none of that name."""
    if name not in DEVICES:
        raise ValueError(f'device {quoted(name)} is none of {", ".join(DEVICES)}')
    if name == 'cpu':
        return CPU
    try:
        cupy = Device(name).namespace
    except ImportError as error:
        raise ValueError(
            f"device 'gpu' needs the Python package cupy: pip install '.[gpu]' "
            f'({_first_line(error)})'
        ) from error
    try:
        # A first computation: card, driver, and the compiler that CuPy makes its kernels with.
        float((cupy.zeros(1) + 1.0).min())
    except (ImportError, OSError, RuntimeError) as error:
        raise ValueError(f"device 'gpu' cannot be used: {_first_line(error)}") from error
    return Device(name)


def _first_line(error: Exception) -> str:
    """First line with a word in it; CuPy frames what it says."""
    lines = [line for line in str(error).splitlines() if any(map(str.isalpha, line))]
    return shown(lines[0].strip() if lines else repr(error))
