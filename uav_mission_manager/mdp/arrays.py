"""Names of the array types that the whole package uses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]
"""Truth values."""

IntArray = NDArray[np.int64]
"""Whole numbers, such as states and actions."""

FloatArray = NDArray[np.float64]
"""Numbers in double precision."""

IndexArray = NDArray[np.intp]
"""Positions in other arrays."""

RealArray = NDArray[np.floating[Any]]
"""Numbers in single or double precision."""

AnyArray = NDArray[Any]
"""Numbers of any kind, such as a file may hold."""
