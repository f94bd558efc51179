"""Commands for people."""

import sys
from types import TracebackType

_excepthook = sys.excepthook


def _quietly(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Show an error; of Ctrl-C while a command still imports its modules, only that."""
    if issubclass(kind, KeyboardInterrupt):
        print('interrupted', file=sys.stderr)
    else:
        _excepthook(kind, error, trace)


sys.excepthook = _quietly
