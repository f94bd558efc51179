"""The greedy choice, and when actions tie."""

from __future__ import annotations

import numpy as np

from uav_mission_manager.mdp.arrays import FloatArray, IntArray

TIE_TOLERANCE = 1e-9
"""Actions within this of the least Q, relative to it, tie and the lowest number wins: a choice,
far above rounding."""


def choose(q_values: FloatArray) -> IntArray:
    """Action numbers of least Q of tables (N, A), shape (N,)."""
    least = q_values.min(axis=1, keepdims=True)
    return np.argmax(q_values <= least + TIE_TOLERANCE * np.abs(least), axis=1) + 1
