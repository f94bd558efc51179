"""Files read once into bytes that nobody else can change.

A file mapped into memory is not such a copy: who truncates it under the reader ends the reader
(SIGBUS), and who overwrites it changes what the reader sees, after all checks.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.paths import opened_file
from uav_mission_manager.solver import memory

CHUNK_BYTES = 1 << 20
"""Bytes that are read and hashed at a time: 1 MiB, a choice."""

MEMORY_DIVISOR = 2
"""A copy in memory takes one part in so many of what is free: a choice, the rest is for others."""


def private_copy(file: Path) -> tuple[NDArray[np.uint8], str]:
    """Return a file's bytes, read-only, and their SHA-256.

    They are in memory. Where that is short they are in a file without a name in TMPDIR, mapped,
    and a warning says so.

    Raises
    ------
    OSError
        If the file cannot be read, or there is no room for the copy.
    """
    digest, end = hashlib.sha256(), 0
    with open(opened_file(file), 'rb', buffering=0) as stream:
        copy = _room(file, os.fstat(stream.fileno()).st_size)
        while count := stream.readinto(copy.data[end : end + CHUNK_BYTES]):
            # What is hashed is the copy: the file may change meanwhile.
            digest.update(copy.data[end : end + count])
            end += count
    copy.flags.writeable = False
    return copy[:end], digest.hexdigest()


def _room(file: Path, size: int) -> NDArray[np.uint8]:
    """Bytes in memory, or in a file without a name; lack of room shows now, not as SIGBUS."""
    if memory.fits(MEMORY_DIVISOR * size):
        return np.empty(size, np.uint8)
    free = memory.size_text(memory.available_bytes())
    warnings.warn(
        f'{file}: {memory.size_text(size)} are too much for {free} of free memory: '
        f'copied to a private file in {tempfile.gettempdir()} (TMPDIR)',
        RuntimeWarning,
        stacklevel=2,
    )
    with tempfile.TemporaryFile() as room:
        os.posix_fallocate(room.fileno(), 0, size)
        return np.memmap(room, np.uint8, 'r+', shape=(size,))
