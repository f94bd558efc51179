"""What a command prints: whoever reads it may have had enough of it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def flushed() -> Iterator[None]:
    """Write out what is printed in here.

    Where a reader has had enough, such as `head`, the process ends without a word, with exit
    code 1. Raises `OSError` where it cannot be written for another reason.
    """
    try:
        try:
            yield
        finally:
            _flush()
    except BrokenPipeError:
        sys.exit(1)


def _flush() -> None:
    """Write it out; where that fails drop it, lest the interpreter tries again."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise
