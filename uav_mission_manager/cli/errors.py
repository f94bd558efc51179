"""Errors that are the user's to mend end a command in one line, not in a traceback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_line_errors(command: str) -> Iterator[None]:
    """End the command with exit code 1 and one line on stderr, 130 on Ctrl-C."""
    try:
        yield
    except (ValueError, OSError) as error:
        sys.exit(f'{command}: {error}')
    except KeyboardInterrupt:
        sys.exit(130)
