"""Folders replaced in one step: whoever looks finds the old one or the new one, whole.

The new folder is filled beside the old one and exchanged with it by Linux's `renameat2`
(RENAME_EXCHANGE), which ext4, XFS, Btrfs, tmpfs and overlay file systems have. Where that is
missing, such as on NFS, or cannot be done, such as to a mount point, the old folder stays, and the
new one is kept beside it and named.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

FILLED = 'set'
"""Name of the new folder in the scratch folder, which also marks what a dead writer left."""

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""Relative paths start from the working directory; swap both: linux/fcntl.h, linux/fs.h."""


@contextmanager
def taking_the_place_of(place: Path) -> Iterator[Path]:
    """Give a new folder to fill; at the end, without an error, it is at `place` in one step.

    The new one is on the disk before, lest a power cut costs both. What writers that were killed
    left beside `place` is deleted.

    Raises
    ------
    OSError
        If it cannot be written, or the old one cannot be replaced; that stays as it is.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    with _scratch_folder(place) as fresh:
        yield fresh
        for path in (*fresh.iterdir(), fresh):
            flush(path)
        _put(fresh, place)
        flush(place.parent)


def exchange(first: Path, second: Path) -> None:
    """Swap two paths of one file system in one step. Raises `OSError`."""
    library = ctypes.CDLL(None, use_errno=True)
    paths = os.fsencode(first), os.fsencode(second)
    if library.renameat2(AT_FDCWD, paths[0], AT_FDCWD, paths[1], RENAME_EXCHANGE):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def _put(fresh: Path, place: Path) -> None:
    """Move a folder to a place that is free or an empty folder, else exchange both."""
    with suppress(OSError):
        fresh.rename(place)
        return
    try:
        exchange(fresh, place)
    except (OSError, AttributeError) as error:  # The latter where the C library is too old.
        kept = fresh.parent.with_name(fresh.parent.name.removeprefix('.'))
        shutil.move(fresh, kept)  # Copies where folders cannot be renamed.
        raise OSError(f'not replaced in one step ({error}); the new one is {kept}') from error


@contextmanager
def _scratch_folder(place: Path) -> Iterator[Path]:
    """Give a folder beside `place` with an empty one in it, locked while its writer lives."""
    with ExitStack() as held:
        with _opened(place.parent) as parent:
            _lock(parent)  # Lest another writer cleans up this folder before it is locked.
            _clean_up(place)
            scratch = Path(tempfile.mkdtemp(dir=place.parent, prefix=_prefix(place)))
            held.callback(shutil.rmtree, scratch, ignore_errors=True)
            _lock(held.enter_context(_opened(scratch)))
        (scratch / FILLED).mkdir()
        yield scratch / FILLED


def _clean_up(place: Path) -> None:
    """Delete what dead writers left beside `place`; what cannot be deleted stays."""
    for path in place.parent.iterdir():
        if path.name.startswith(_prefix(place)) and path.is_dir():
            with suppress(OSError), _opened(path) as descriptor:
                if set(os.listdir(path)) <= {FILLED} and _lock(descriptor, fcntl.LOCK_NB):
                    shutil.rmtree(path)


def _prefix(place: Path) -> str:
    return f'.{place.name}.new-'


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _lock(descriptor: int, options: int = 0) -> bool:
    """Lock until closed; False where the lock is taken and not waited for, or cannot be had."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | options)
    except OSError:
        return False
    return True


def flush(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    with _opened(path) as descriptor:
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL:  # The file system flushes no folders.
                raise
