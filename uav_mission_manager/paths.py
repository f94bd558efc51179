"""Where files are, and how to open one that may be something else."""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from pathlib import Path

from uav_mission_manager.echo import shown


def share_directory() -> Path:
    """Return the folder that holds `config`, `policies` and `launch`.

    That is the source tree when running from it, else `share/uav_mission_manager` in the
    prefix this package is installed in, be it by pip, colcon or apt.

    Raises
    ------
    FileNotFoundError
        The package was installed without its data files.
    """
    package = Path(__file__).resolve().parent
    candidates = [package.parent, *(p / 'share' / package.name for p in package.parents)]
    for candidate in candidates:
        if (candidate / 'package.xml').is_file():
            return candidate
    raise FileNotFoundError(f'{package} has neither package.xml beside it nor a share folder')


def expanded(text: str) -> Path:
    """Return the path that a shell would make of `text`: with `~` and `$VARIABLE` replaced.

    Raises
    ------
    ValueError
        There is no such variable or no such home directory.
    """
    path = os.path.expandvars(text)
    if unset := re.search(r'\$(\w+|{\w+})', path):
        raise ValueError(f'{shown(text)}: the environment variable {shown(unset[0])} is not set')
    path = os.path.expanduser(path)
    if path.startswith('~'):
        raise ValueError(
            f'{shown(text)}: no home directory is known for {shown(path.partition("/")[0])}'
        )
    return Path(path)


def file_content(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file of at most `most` of them.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it has more.
    """
    with open(opened_file(path), 'rb') as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f'more than {most:,} bytes')
    return content


def opened_file(path: Path, flags: int = os.O_RDONLY) -> int:
    """Return a descriptor of a regular file: a pipe or a device may let its reader wait for ever.

    Raises
    ------
    OSError
        If it is none, or cannot be opened.
    """
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, 'no regular file', str(path))
    return descriptor


def write_whole(path: Path, text: str) -> None:
    """Write a text file in one step: whoever looks finds the old one or the new one, whole.

    Raises
    ------
    OSError
        If it cannot be written, with its path and why; an old one then stays.
    """
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f'.{path.name}.') as folder:
            fresh = Path(folder) / 'new'
            fresh.write_text(text, encoding='utf-8')
            fresh.replace(path)
    except OSError as error:
        raise OSError(f'{path}: cannot be written: {error.strerror}') from error
