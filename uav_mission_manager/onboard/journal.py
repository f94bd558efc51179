"""The journal: what a process knows, for the one that is started after it.

A file of lines, each a whole state with its checksum; the last one counts. A line is appended by
one `write`, so the state outlives the process from then on; a thread has it on the disk soon
after. A line that ends in its middle was being written when its writer died, and the one before
it counts. Anything else that is not as it was written is damage: what it says is not believed.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from uav_mission_manager.echo import quoted
from uav_mission_manager.mdp import Mission
from uav_mission_manager.paths import opened_file
from uav_mission_manager.policy.replacement import flush

JOURNAL_VERSION = 1
"""Version of what a line holds."""

CHECKSUM_DIGITS = 16
"""Hexadecimal digits of SHA-256 before the text of a line: a choice, against damage by chance."""

LARGEST_JOURNAL = 64 * 1024
"""Bytes of a file above which it is replaced by one of one line: a choice, some hundred lines."""

RETRY_PERIOD = 1.0
"""Time [s] after which what could not be brought to the disk is tried again: a choice."""


READ_AND_APPEND = os.O_RDWR | os.O_APPEND
"""How a journal is opened."""

_ENCODER = json.JSONEncoder(sort_keys=True)


class JournalError(ValueError):
    """A journal that cannot be believed: one line naming the file and what is wrong."""


@dataclass(frozen=True)
class Record:
    """What a journal says: the hash of the mission that it is about, and the state."""

    mission: str
    state: dict[str, Any]


def goals_hash(mission: Mission) -> str:
    """Return a hash of what priorities and cells mean: goals and grid, not weights."""
    text = json.dumps(mission.geography(), default=asdict, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class Journal:
    """A process's state in a file of its own.

    The file is this process's alone from the first `write` to `close` or death.

    Parameters
    ----------
    path : Path
        Its folder is made.
    kind : str
        Whose state it is, such as `manager`.
    mission : str
        `goals_hash` of the mission that the state is about.

    Raises
    ------
    OSError
        If nothing can be written there.

    Attributes
    ----------
    path, kind, mission
        As given; `mission` is set anew where another one follows in flight.
    """

    def __init__(self, path: Path, kind: str, mission: str) -> None:
        self.path, self.kind, self.mission = path, kind, mission
        self._new = path.with_name(f'{path.name}.new')
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass  # Only to see that there is a place for files.
        if os.path.lexists(path):
            os.close(opened_file(path, READ_AND_APPEND))
        self._lock = threading.RLock()  # Held for as long as a write takes, not for the disk.
        self._written, self._descriptor = b'', -1
        self._write_error = self._disk_error = ''
        self._closed = False
        self._dirty = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def error(self) -> str:
        """What is wrong with the last state's record, in one line; empty if nothing is."""
        return self._write_error or self._disk_error

    def read(self) -> Record | None:
        """Return what was written last, by this process or one before it; None if nothing ever.

        Raises
        ------
        JournalError
            If what is there is damaged, or of another version or kind.
        """
        try:
            line, _ = _last_line(_content(self.path))
            return self._record(line)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise JournalError(f'{self.path}: {error}') from error

    def write(self, state: Mapping[str, Any]) -> None:
        """Record a state of JSON values. It outlives this process when this returns.

        One that is recorded already is not written again. If it cannot be recorded, `error` says
        why; with the next call it is tried again.
        """
        with self._lock:
            try:
                line = self._line(state)
                if self._descriptor < 0:
                    self._open(line)
                if line != self._written:
                    _append(self._descriptor, line)
                    self._written = line
                    self._dirty.set()
                self._write_error = ''
            except (OSError, TypeError, ValueError, RuntimeError) as error:
                self._release()
                self._write_error = f'{self.path}: not written: {error}'

    def close(self) -> None:
        """Leave the file to others, as the end of the process does; waits for nothing."""
        with self._lock:
            self._closed = True
            self._release()
        self._dirty.set()

    def _record(self, line: bytes) -> Record:
        fields = json.loads(line[CHECKSUM_DIGITS:])
        for name, wanted in (('version', JOURNAL_VERSION), ('kind', self.kind)):
            if fields.get(name) != wanted:
                raise ValueError(f'{name} is {quoted(fields.get(name))}, not {wanted!r}')
        return Record(fields['mission'], fields['state'])

    def _line(self, state: Mapping[str, Any]) -> bytes:
        fields = {
            'version': JOURNAL_VERSION,
            'kind': self.kind,
            'mission': self.mission,
            'state': dict(state),
        }
        return _with_checksum(_ENCODER.encode(fields).encode())

    def _open(self, line: bytes) -> None:
        """Take the file, up to its last whole line; if there is none, make one of `line`."""
        if self._closed:
            raise ValueError('closed')
        try:
            self._descriptor = _taken(self.path)
            self._written, end = _last_line(_content(self.path))
            os.ftruncate(self._descriptor, end)
        except (FileNotFoundError, ValueError):
            self._written = line
            self._renew()
        self._dirty.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._keep_on_disk, daemon=True)
            self._thread.start()

    def _release(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1

    def _renew(self) -> None:
        """Put a file of one line, the last one, in the place of the old one."""
        line = self._written
        new = _taken(self._new, os.O_CREAT)
        try:
            os.ftruncate(new, 0)
            _append(new, line)
            if self._thread is threading.current_thread():
                os.fsync(new)  # First, or a power cut now costs both.
            with self._lock:
                if self._descriptor < 0 and (self._closed or self.path.exists()):
                    raise BlockingIOError('another process may have it now')
                if self._written != line:
                    _append(new, self._written)
                os.replace(self._new, self.path)
                self._release()
                self._descriptor = new
        except OSError:
            os.close(new)
            raise

    def _keep_on_disk(self) -> None:
        """Bring to the disk what is written, in a thread of its own: a disk may be slow."""
        while not self._closed:
            self._dirty.wait(RETRY_PERIOD if self._disk_error else None)
            self._dirty.clear()
            try:
                if self._disk_error:
                    self._renew()  # What could not be flushed once, Linux takes for flushed.
                elif self.path.stat().st_size > LARGEST_JOURNAL:
                    with suppress(BlockingIOError):  # The one before this is not done yet.
                        self._renew()
                flush(self.path)
                flush(self.path.parent)
                self._disk_error = ''
            except OSError as error:
                self._disk_error = f'{self.path}: not safe on the disk: {error}'


def _with_checksum(text: bytes) -> bytes:
    return hashlib.sha256(text).hexdigest()[:CHECKSUM_DIGITS].encode() + b' ' + text + b'\n'


def _is_whole(line: bytes) -> bool:
    return line == _with_checksum(line[CHECKSUM_DIGITS + 1 : -1])


def _last_line(content: bytes) -> tuple[bytes, int]:
    """Return the last line that was written to its end, and where that is.

    Raises
    ------
    ValueError
        If it is damaged, or there is none.
    """
    end = content.rfind(b'\n') + 1
    line, rest = content[content.rfind(b'\n', 0, max(end - 1, 0)) + 1 : end], content[end:]
    if not _is_whole(line) or _is_whole(rest[:-1] + b'\n'):
        raise ValueError('its last line is damaged' if content else 'it is empty')
    return line, end


def _content(path: Path) -> bytes:
    with open(opened_file(path, READ_AND_APPEND), 'rb') as file:
        return file.read()


def _taken(path: Path, flags: int = 0) -> int:
    """Open a file that this process alone has until it closes it."""
    descriptor = opened_file(path, READ_AND_APPEND | flags)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.path.samestat(os.fstat(descriptor), os.stat(path)):
            raise BlockingIOError
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise BlockingIOError('another process has it') from error
        raise
    return descriptor


def _append(descriptor: int, line: bytes) -> None:
    if os.write(descriptor, line) != len(line):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
